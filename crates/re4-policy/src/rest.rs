//! Observations of a block at rest: how noisy they are, and their mean.

use re4_geometry::{Point2, Pose2};

use crate::outcome::Body;

/// Noise of observations in pixels, below which the last observation is used as it is. Estimates from images have less.
const IGNORED: f64 = 2.0;

/// Error of the mean in pixels for which a noisy block is observed long enough.
const WANTED: f64 = 4.0;

/// Maximum number of observations that are waited for.
const LONGEST: u32 = 20;

/// An observation that is farther away from the mean than this multiple of the noise starts a new mean: the block has moved.
const OUTLIER: f64 = 4.0;

/// Ratio of the median distance between two observations to the root mean square distance of an observation from the truth, if
/// positions dominate: sqrt(2 ln 2).
const MEDIAN_DISTANCE: f64 = 1.177;

/// The observations since the block was last pushed, and the noise of all observations at rest.
#[derive(Debug, Default)]
pub(crate) struct Rest {
    last: Option<Pose2>,
    /// Distances between consecutive observations of a block at rest, ascending.
    distances: Vec<f64>,
    count: u32,
    position: Point2,
    /// Sum of the direction vectors of the angles.
    direction: Point2,
}

impl Rest {
    /// Adds an observation. `pushed`: whether the block may have been pushed since the last one.
    pub(crate) fn observe(&mut self, body: &Body, pose: Pose2, pushed: bool) {
        if let (Some(last), false) = (self.last, pushed) {
            let distance = body.distance(last, pose);
            let at = self.distances.partition_point(|other| *other < distance);
            self.distances.insert(at, distance);
        }
        self.last = Some(pose);
        let elsewhere = self
            .mean()
            .is_none_or(|mean| body.distance(mean, pose) > OUTLIER * self.noise().max(IGNORED));
        if pushed || elsewhere {
            (self.count, self.position, self.direction) = (0, Point2::zeros(), Point2::zeros());
        }
        self.count += 1;
        self.position += pose.translation();
        self.direction += Point2::new(pose.theta.cos(), pose.theta.sin());
    }

    /// Returns the root mean square distance of an observation from the true pose, estimated from the median of the distances
    /// between consecutive observations, so that a few sudden motions do not change it.
    pub(crate) fn noise(&self) -> f64 {
        let median = self.distances.get(self.distances.len() / 2).copied().unwrap_or(0.0);
        median / MEDIAN_DISTANCE
    }

    /// Returns whether the observations are so noisy that their mean is used.
    pub(crate) fn is_noisy(&self) -> bool {
        self.noise() > IGNORED
    }

    /// Returns whether the mean is accurate enough for a decision.
    pub(crate) fn is_known(&self) -> bool {
        let needed = (self.noise() / WANTED).powi(2).ceil();
        !self.is_noisy() || f64::from(self.count.min(LONGEST)) >= needed.min(f64::from(LONGEST))
    }

    /// Returns the mean of the observations since the last push.
    pub(crate) fn mean(&self) -> Option<Pose2> {
        let position = self.position / f64::from(self.count);
        let theta = self.direction.y.atan2(self.direction.x);
        (self.count > 0).then(|| Pose2::new(position.x, position.y, theta).normalized())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Deterministic errors with a known spread.
    fn noisy(truth: Pose2, size: f64, i: u32) -> Pose2 {
        let angle = f64::from(i) * 2.399_963;
        let radius = size * (-2.0 * ((f64::from(i * 37 % 101) + 0.5) / 101.0).ln()).sqrt();
        Pose2::new(
            truth.x + radius * angle.cos(),
            truth.y + radius * angle.sin(),
            truth.theta,
        )
    }

    #[test]
    fn noise_and_mean_are_estimated_and_a_jump_starts_a_new_mean() {
        let body = Body::tee();
        let (truth, after) = (Pose2::new(200.0, 300.0, 6.28), Pose2::new(300.0, 250.0, 1.0));
        let mut rest = Rest::default();
        for i in 0..60 {
            rest.observe(&body, noisy(truth, 10.0, i), false);
        }
        // The root mean square of a radius with standard deviation 10 along each axis is 14.1.
        assert!((10.0..19.0).contains(&rest.noise()), "{}", rest.noise());
        assert!(rest.is_noisy() && rest.is_known());
        assert!(body.distance(rest.mean().unwrap(), truth) < 4.0);
        let noise = rest.noise();
        for i in 0..20 {
            rest.observe(&body, noisy(after, 10.0, i), false);
        }
        assert!((rest.noise() - noise).abs() < 3.0);
        assert!(body.distance(rest.mean().unwrap(), after) < 8.0);
        rest.observe(&body, truth, true);
        assert!(!rest.is_known());
    }

    #[test]
    fn exact_observations_are_used_as_they_are() {
        let body = Body::tee();
        let mut rest = Rest::default();
        for i in 0..30 {
            let jump = if i == 20 { 60.0 } else { 0.0 };
            rest.observe(&body, Pose2::new(100.0 + jump, 100.0, 1.0), false);
            assert!(!rest.is_noisy() && rest.is_known());
        }
    }
}

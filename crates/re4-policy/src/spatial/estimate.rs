//! Estimates the object pose from all observed poses so far.

use std::collections::VecDeque;

use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_geometry::spatial::{SymmetryGroup, pose_between, pose_distance};
use re4_stats::upper_median;

use crate::spatial::config::PoseFilterConfig;

/// Maximum number of differences between successive observations from which the errors are estimated.
const DIFFERENCES: usize = 60;

/// Minimum number of differences for an estimate of the errors.
const MIN_DIFFERENCES: usize = 5;

/// Maximum weight, in observations, that an average keeps when the frame in which the object is fixed changes. At a grasp or a
/// release the object moves by millimetres, and new observations must be able to correct the average.
const CARRIED_OVER: u32 = 5;

/// Median of the chi-squared distribution with three degrees of freedom.
const MEDIAN_CHI_SQUARED_3: f64 = 2.365_973_884_375_338;

/// Averages observed object poses in the frame in which the object is fixed: the world in transit, the gripper in transfer.
/// [`PoseFilterConfig`] describes when the average restarts.
///
/// The average is sequential. Each observation, in its symmetry-equivalent pose that is nearest to the average, moves the average
/// by a fraction `1 / n` of their difference, where `n` is the number of averaged observations, at most `samples`. The standard
/// deviation of an error along one axis is `√(m / (2 · 2.366))`, where `m` is the median of the squared differences between
/// successive observations: the difference of two errors has twice the variance of one, and 2.366 is the median of the
/// chi-squared distribution with three degrees of freedom.
pub struct ObjectEstimate {
    config: Option<PoseFilterConfig>,
    group: SymmetryGroup,
    state: Option<State>,
    /// Squared differences of translation and rotation.
    differences: VecDeque<(f64, f64)>,
}

struct State {
    mode: Mode,
    /// Average pose in the frame of the mode.
    average: Isometry3<f64>,
    count: u32,
    /// Last observation in the same frame, or `None` if the frame has changed since.
    last: Option<Isometry3<f64>>,
}

/// Returns the pose of the frame in which the object is fixed.
fn frame_of(mode: Mode, eef: &Isometry3<f64>) -> Isometry3<f64> {
    match mode {
        Mode::Transit => Isometry3::identity(),
        Mode::Transfer => *eef,
    }
}

impl State {
    /// Converts the average to the frame of a mode.
    fn change_mode(&mut self, mode: Mode, eef: &Isometry3<f64>) {
        if self.mode != mode {
            // The gripper has hardly moved since the last step, so its current pose is used for both frames.
            let world = match self.mode {
                Mode::Transit => self.average,
                Mode::Transfer => eef * self.average,
            };
            *self = Self {
                mode,
                average: frame_of(mode, eef).inv_mul(&world),
                count: self.count.min(CARRIED_OVER),
                last: None,
            };
        }
    }
}

impl ObjectEstimate {
    /// Creates an estimate without observations. Without a configuration, every observation is used as the estimate.
    pub fn new(config: Option<PoseFilterConfig>, group: SymmetryGroup) -> Self {
        Self {
            config,
            group,
            state: None,
            differences: VecDeque::with_capacity(DIFFERENCES),
        }
    }

    /// Adds an observation of the object and returns the estimated object pose. `mode` and `eef` are those at the observation.
    /// World frame.
    pub fn observe(&mut self, mode: Mode, eef: &Isometry3<f64>, object: &Isometry3<f64>) -> Isometry3<f64> {
        let frame = frame_of(mode, eef);
        let observed = frame.inv_mul(object);
        let (Some(config), Some(mut state)) = (self.config.clone(), self.state.take()) else {
            self.state = Some(State {
                mode,
                average: observed,
                count: 1,
                last: Some(observed),
            });
            return *object;
        };
        state.change_mode(mode, eef);
        let (observed, _) = self.group.align(&observed, &state.average);
        if let Some(last) = state.last {
            let (distance, angle) = pose_distance(&self.group.align(&last, &state.average).0, &observed);
            if self.differences.len() == DIFFERENCES {
                self.differences.pop_front();
            }
            self.differences.push_back((distance * distance, angle * angle));
        }
        state.last = Some(observed);
        let is_still = self.deviations().is_some_and(|(translation, rotation)| {
            let (distance, angle) = pose_distance(&state.average, &observed);
            // The variance of the difference includes that of the average, which is 1 / count of a single error's.
            let limit = config.gate * (1.0 + 1.0 / f64::from(state.count)).sqrt();
            distance <= limit * translation && angle <= limit * rotation
        });
        if is_still {
            state.count = (state.count + 1).min(config.samples.max(1));
            state.average = pose_between(&state.average, &observed, 1.0 / f64::from(state.count));
        } else {
            (state.average, state.count) = (observed, 1);
        }
        let estimate = frame * state.average;
        self.state = Some(state);
        estimate
    }

    /// Returns the estimate at a control step without an observation, assuming that the object is fixed in the world or in the
    /// gripper. Returns `None` before the first observation. World frame.
    ///
    /// Call this at every such step, so that a change of the mode is noticed when it happens.
    pub fn carry(&mut self, mode: Mode, eef: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        let state = self.state.as_mut()?;
        state.change_mode(mode, eef);
        Some(frame_of(mode, eef) * state.average)
    }

    /// Returns the standard deviations of an observation's errors along one axis, in metres and rad, or `None` if there are too
    /// few observations.
    pub fn deviations(&self) -> Option<(f64, f64)> {
        if self.differences.len() < MIN_DIFFERENCES {
            return None;
        }
        let deviation = |of: fn(&(f64, f64)) -> f64| {
            let square = upper_median(self.differences.iter().map(of))?;
            Some((square / (2.0 * MEDIAN_CHI_SQUARED_3)).sqrt())
        };
        Some((deviation(|d| d.0)?, deviation(|d| d.1)?))
    }
}

//! Poses of the block from its eight corners, as gym-pusht's `environment_state_agent_pos` has them.

use re4_geometry::{Point2, Pose2, wrap_to_two_pi};
use re4_sim::tee_rectangles;

/// Number of values of a frame: x and y of the corners of the bar and of the stem.
pub(super) const VALUES: usize = 16;

/// Maximum distance between a recorded corner and that of the fitted block, in pixels. The corners of the simulator fit to 1e-5 px;
/// those that were rounded to whole pixels to less than 1. Other points, or another order, are off by tens of pixels.
pub(super) const MAX_RESIDUAL: f64 = 1.0;

/// The order of the values of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// x and y of each corner.
    Pairs,
    /// All x, then all y.
    Halves,
}

impl Layout {
    /// All of them.
    pub(super) const ALL: [Self; 2] = [Self::Pairs, Self::Halves];

    /// Its name in the table of conventions.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Pairs => "corners_xy",
            Self::Halves => "corners_x_then_y",
        }
    }

    fn corners(self, values: &[f64; VALUES]) -> [Point2; 8] {
        std::array::from_fn(|i| match self {
            Self::Pairs => Point2::new(values[2 * i], values[2 * i + 1]),
            Self::Halves => Point2::new(values[i], values[VALUES / 2 + i]),
        })
    }

    /// The pose of the block whose corners are nearest to the recorded ones in the sense of least squares, and the largest distance
    /// between corners. Values in pixels.
    pub(super) fn fit(self, values: &[f64; VALUES]) -> (Pose2, f64) {
        let [bar, stem] = tee_rectangles();
        let model: [Point2; 8] = std::array::from_fn(|i| if i < 4 { bar[i] } else { stem[i - 4] });
        let corners = self.corners(values);
        let mean = |points: &[Point2; 8]| {
            let sum = points
                .iter()
                .fold((0.0, 0.0), |sum, point| (sum.0 + point.x, sum.1 + point.y));
            Point2::new(sum.0 / 8.0, sum.1 / 8.0)
        };
        let (from, to) = (mean(&model), mean(&corners));
        let (mut dot, mut cross) = (0.0, 0.0);
        for (a, b) in model.iter().zip(&corners) {
            let (ax, ay, bx, by) = (a.x - from.x, a.y - from.y, b.x - to.x, b.y - to.y);
            dot += ax * bx + ay * by;
            cross += ax * by - ay * bx;
        }
        let theta = wrap_to_two_pi(cross.atan2(dot));
        let turned = Pose2::new(0.0, 0.0, theta).transform_point(from);
        let pose = Pose2::new(to.x - turned.x, to.y - turned.y, theta);
        let distance = |(a, b): (&Point2, &Point2)| {
            let found = pose.transform_point(*a);
            (found.x - b.x).hypot(found.y - b.y)
        };
        // Not `f64::max`, which ignores NaN.
        let worst = model.iter().zip(&corners).map(distance).fold(0.0, |worst: f64, next| {
            if next > worst || next.is_nan() { next } else { worst }
        });
        (pose, worst)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;
    use re4_geometry::periodic_distance;
    use re4_sim::tee_vertices;

    use super::*;

    fn values(pose: Pose2, layout: Layout) -> [f64; VALUES] {
        let corners: Vec<Point2> = tee_vertices(pose).concat();
        std::array::from_fn(|i| match layout {
            Layout::Pairs if i % 2 == 0 => corners[i / 2].x,
            Layout::Pairs => corners[i / 2].y,
            Layout::Halves if i < 8 => corners[i].x,
            Layout::Halves => corners[i - 8].y,
        })
    }

    proptest! {
        #[test]
        fn a_pose_is_found_from_its_corners(x in 0.0..512.0, y in 0.0..512.0, theta in 0.0..TAU) {
            let pose = Pose2::new(x, y, theta);
            for layout in Layout::ALL {
                let (found, residual) = layout.fit(&values(pose, layout));
                prop_assert!(residual < 1e-9);
                prop_assert!((found.x - x).hypot(found.y - y) < 1e-9);
                prop_assert!(periodic_distance(found.theta, theta, TAU) < 1e-12);
                let other = if layout == Layout::Pairs { Layout::Halves } else { Layout::Pairs };
                prop_assert!(other.fit(&values(pose, layout)).1 > 10.0);
            }
        }

        #[test]
        fn no_other_pose_is_nearer(
            x in 100.0..400.0, y in 100.0..400.0, theta in 0.0..TAU,
            noise in proptest::array::uniform16(-3.0..3.0), step in proptest::array::uniform3(-0.1..0.1),
        ) {
            let recorded: [f64; VALUES] = std::array::from_fn(|i| values(Pose2::new(x, y, theta), Layout::Pairs)[i] + noise[i]);
            let squares = |pose: Pose2| -> f64 {
                values(pose, Layout::Pairs).iter().zip(&recorded).map(|(a, b)| (a - b).powi(2)).sum()
            };
            let (found, _) = Layout::Pairs.fit(&recorded);
            let other = Pose2::new(found.x + step[0], found.y + step[1], found.theta + step[2]);
            prop_assert!(squares(found) <= squares(other) + 1e-9);
        }
    }

    #[test]
    fn other_points_do_not_fit() {
        let good = values(Pose2::new(200.0, 300.0, 1.0), Layout::Pairs);
        let mut swapped = good;
        swapped.swap(0, 2);
        swapped.swap(1, 3);
        let mut mirrored = good;
        for i in 0..8 {
            mirrored[2 * i] = 512.0 - mirrored[2 * i];
        }
        let mut missing = good;
        missing[5] = f64::NAN;
        for wrong in [swapped, mirrored, missing, [0.0; VALUES]] {
            let residual = Layout::Pairs.fit(&wrong).1;
            assert!(residual > MAX_RESIDUAL || residual.is_nan(), "{residual}");
        }
        let rounded = good.map(f64::round);
        assert!(Layout::Pairs.fit(&rounded).1 < MAX_RESIDUAL);
    }
}

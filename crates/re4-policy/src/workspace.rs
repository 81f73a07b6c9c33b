//! The window and the walls of Push-T, as a policy with a moved frame of observations sees them.

use re4_geometry::{Point2, Pose2};
use re4_sim::depth_in_walls;

/// Side of the square window in pixels.
const SIDE: f64 = 512.0;

/// The window and its walls, which do not move with the goal. All arguments and results are in the frame of the policy's
/// observations, in pixels and radians.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Workspace {
    /// Motion from the world frame to the frame of the observations; `None` if they are the same.
    observed_from_world: Option<Pose2>,
}

impl Workspace {
    /// Creates the workspace of an episode from [`Senses::observed_from_world`](re4_rollout::Senses::observed_from_world).
    pub fn new(observed_from_world: Option<Pose2>) -> Self {
        Self { observed_from_world }
    }

    fn to_world(self, p: Point2) -> Point2 {
        self.observed_from_world
            .map_or(p, |motion| motion.inverse_transform_point(p))
    }

    fn to_observed(self, p: Point2) -> Point2 {
        self.observed_from_world.map_or(p, |motion| motion.transform_point(p))
    }

    /// Returns whether a point is inside the window, at least `margin` away from its sides.
    pub fn contains(self, p: Point2, margin: f64) -> bool {
        let p = self.to_world(p);
        (margin..=SIDE - margin).contains(&p.x) && (margin..=SIDE - margin).contains(&p.y)
    }

    /// Returns the nearest point of the window.
    #[must_use]
    pub fn clamp(self, p: Point2) -> Point2 {
        if self.contains(p, 0.0) {
            return p;
        }
        self.to_observed(self.to_world(p).map(|at| at.clamp(0.0, SIDE)))
    }

    /// Returns the point of the window at these fractions of its sides.
    pub fn at(self, x: f64, y: f64) -> Point2 {
        self.to_observed(Point2::new(x * SIDE, y * SIDE))
    }

    /// Returns how far a block reaches into a wall or past it; 0 between the walls.
    pub fn depth_in_walls(self, block: Pose2) -> f64 {
        depth_in_walls(
            self.observed_from_world
                .map_or(block, |motion| motion.inverse().compose(block)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-300.0..800.0f64, -300.0..800.0f64, -7.0..7.0f64).prop_map(|(x, y, t)| Pose2::new(x, y, t))
    }

    proptest! {
        #[test]
        fn a_moved_workspace_answers_as_the_window_does_for_moved_arguments(
            motion in pose(), block in pose(), x in -100.0..612.0f64, y in -100.0..612.0f64, margin in 0.0..20.0f64,
        ) {
            let (window, moved) = (Workspace::default(), Workspace::new(Some(motion)));
            let p = Point2::new(x, y);
            let nearest_side = [x - margin, SIDE - margin - x, y - margin, SIDE - margin - y]
                .into_iter()
                .map(f64::abs)
                .fold(f64::INFINITY, f64::min);
            prop_assume!(nearest_side > 1e-6);
            let seen = motion.transform_point(p);
            prop_assert_eq!(moved.contains(seen, margin), window.contains(p, margin));
            prop_assert!((moved.clamp(seen) - motion.transform_point(window.clamp(p))).norm() < 1e-8);
            prop_assert!((moved.at(0.25, 0.75) - motion.transform_point(window.at(0.25, 0.75))).norm() < 1e-8);
            let depth = moved.depth_in_walls(motion.compose(block));
            prop_assert!((depth - window.depth_in_walls(block)).abs() < 1e-8);
        }
    }
}

//! Planar rigid motions, SE(2).

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::angle::wrap_to_two_pi;

/// A point or displacement in the plane.
pub type Point2 = Vector2<f64>;

/// An element of SE(2): rotate by `theta` (radians, from the x axis towards the y axis), then translate by `(x, y)`.
///
/// As the pose of a body it maps the body's frame to the world. In Push-T images y points downwards, so a growing `theta` rotates
/// the block clockwise on the screen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose2 {
    /// Translation along the world's x axis.
    pub x: f64,
    /// Translation along the world's y axis.
    pub y: f64,
    /// Rotation in radians. The group operations do not wrap it.
    pub theta: f64,
}

impl Pose2 {
    /// The identity motion.
    pub const IDENTITY: Self = Self {
        x: 0.0,
        y: 0.0,
        theta: 0.0,
    };

    /// Creates a pose from its coordinates.
    pub const fn new(x: f64, y: f64, theta: f64) -> Self {
        Self { x, y, theta }
    }

    /// Returns the origin of the body's frame in the world.
    pub fn translation(self) -> Point2 {
        Point2::new(self.x, self.y)
    }

    /// Group product: `self.compose(other)` applies `other` first.
    #[must_use]
    pub fn compose(self, other: Self) -> Self {
        let t = self.transform_point(other.translation());
        Self {
            x: t.x,
            y: t.y,
            theta: self.theta + other.theta,
        }
    }

    /// Group inverse.
    #[must_use]
    pub fn inverse(self) -> Self {
        let (s, c) = self.theta.sin_cos();
        Self {
            x: -(c * self.x + s * self.y),
            y: -(-s * self.x + c * self.y),
            theta: -self.theta,
        }
    }

    /// Returns the same pose with its angle in `[0, 2π)`.
    #[must_use]
    pub fn normalized(self) -> Self {
        Self {
            theta: wrap_to_two_pi(self.theta),
            ..self
        }
    }

    /// Transforms a point from the body's frame to the world.
    pub fn transform_point(self, p: Point2) -> Point2 {
        let (s, c) = self.theta.sin_cos();
        Point2::new(self.x + c * p.x - s * p.y, self.y + s * p.x + c * p.y)
    }

    /// Transforms a point from the world to the body's frame.
    pub fn inverse_transform_point(self, p: Point2) -> Point2 {
        let (s, c) = self.theta.sin_cos();
        let d = p - self.translation();
        Point2::new(c * d.x + s * d.y, -s * d.x + c * d.y)
    }

    /// Returns `self · other⁻¹`: the motion in the world frame that moves `other` to `self`, the paper's δ.
    #[must_use]
    pub fn delta_from(self, other: Self) -> Self {
        self.compose(other.inverse())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-500.0..500.0f64, -500.0..500.0f64, -10.0..10.0f64).prop_map(|(x, y, t)| Pose2::new(x, y, t))
    }

    fn close(a: Pose2, b: Pose2) -> bool {
        (a.translation() - b.translation()).norm() < 1e-8
            && crate::periodic_distance(a.theta, b.theta, std::f64::consts::TAU) < 1e-9
    }

    proptest! {
        #[test]
        fn group_laws(a in pose(), b in pose(), c in pose()) {
            prop_assert!(close(a.compose(b).compose(c), a.compose(b.compose(c))));
            prop_assert!(close(a.compose(a.inverse()), Pose2::IDENTITY));
            prop_assert!(close(a.inverse().compose(a), Pose2::IDENTITY));
            prop_assert!(close(a.compose(b).inverse(), b.inverse().compose(a.inverse())));
            prop_assert!(close(b.delta_from(a).compose(a), b));
        }

        #[test]
        fn the_inverse_transform_undoes_the_transform(a in pose(), x in -500.0..500.0f64, y in -500.0..500.0f64) {
            let p = Point2::new(x, y);
            prop_assert!((a.inverse_transform_point(a.transform_point(p)) - p).norm() < 1e-8);
            prop_assert!((a.inverse().transform_point(p) - a.inverse_transform_point(p)).norm() < 1e-8);
        }

        #[test]
        fn agrees_with_nalgebra(a in pose(), b in pose()) {
            let iso = |p: Pose2| nalgebra::Isometry2::new(p.translation(), p.theta);
            let product = iso(a) * iso(b);
            let ours = a.compose(b);
            prop_assert!((product.translation.vector - ours.translation()).norm() < 1e-8);
        }
    }
}

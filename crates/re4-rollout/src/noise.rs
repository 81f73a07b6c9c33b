//! Simulated errors of pose estimates.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Vector3};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_geometry::Pose2;
use re4_geometry::spatial::rotation_from_vector;

/// White Gaussian errors for object poses.
///
/// Every call of [`PoseNoise::perturb`] samples a new error. A rollout perturbs every observation of the object before the policy
/// receives it, so the errors of successive observations are independent. End-effector poses stay exact.
pub struct PoseNoise {
    random: Pcg64,
    translation: f64,
    rotation: f64,
}

impl PoseNoise {
    /// Creates a generator of errors with the standard deviations `translation`, in metres (Push-T: px) along each axis of the
    /// world frame, and `rotation`, in rad for each component of a rotation vector in the world frame. The same seed gives the same errors.
    pub fn new(seed: u64, translation: f64, rotation: f64) -> Self {
        // The stream number is the ASCII code of "pose_noise", so that the errors are independent of other numbers of the seed.
        Self {
            random: Pcg64::new(u128::from(seed), 0x706f_7365_5f6e_6f69_7365),
            translation,
            rotation,
        }
    }

    /// Adds an error to a pose: a translation, and a rotation about the object's own origin. It always samples six numbers, so
    /// that the random sequence does not depend on the standard deviations.
    pub fn perturb(&mut self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let translation = self.vector() * self.translation;
        let rotation = self.vector() * self.rotation;
        Isometry3::from_parts(
            (pose.translation.vector + translation).into(),
            rotation_from_vector(rotation) * pose.rotation,
        )
    }

    /// The same in the plane, for Push-T: translations in px, one rotation in rad about the frame of the block. It always samples
    /// three numbers.
    pub fn perturb_planar(&mut self, pose: &Pose2) -> Pose2 {
        let [x, y, theta] = [(); 3].map(|()| self.normal());
        Pose2::new(
            pose.x + self.translation * x,
            pose.y + self.translation * y,
            pose.theta + self.rotation * theta,
        )
        .normalized()
    }

    fn vector(&mut self) -> Vector3<f64> {
        let (x, y, z) = (self.normal(), self.normal(), self.normal());
        Vector3::new(x, y, z)
    }

    /// Samples a standard normal number by the Box-Muller transform.
    fn normal(&mut self) -> f64 {
        // `unit` is in (0, 1], so the logarithm is finite.
        let radius = (-2.0 * self.unit().ln()).sqrt();
        radius * (TAU * self.unit()).cos()
    }

    fn unit(&mut self) -> f64 {
        ((self.random.next_u64() >> 11) + 1) as f64 * (1.0 / (1u64 << 53) as f64)
    }
}

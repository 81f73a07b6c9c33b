//! Errors of pose estimates, made on purpose.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Vector3};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_geometry::spatial::rotation_from_vector;

/// White Gaussian errors for object poses: every call draws anew. A rollout perturbs each observation with it before the policy
/// sees it, so that errors of successive observations are independent; the end effector is left as it is.
pub struct PoseNoise {
    random: Pcg64,
    translation: f64,
    rotation: f64,
}

impl PoseNoise {
    /// Errors with the standard deviations `translation`, in metres along each axis of the world, and `rotation`, in rad for
    /// each component of a rotation vector in the world. The same seed draws the same errors.
    pub fn new(seed: u64, translation: f64, rotation: f64) -> Self {
        Self {
            random: Pcg64::new(u128::from(seed), 0x706f_7365_5f6e_6f69_7365),
            translation,
            rotation,
        }
    }

    /// The pose with an error: moved, and turned about its own origin. Six numbers are drawn, whatever the deviations.
    pub fn perturb(&mut self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let moved = self.vector() * self.translation;
        let turned = self.vector() * self.rotation;
        Isometry3::from_parts(
            (pose.translation.vector + moved).into(),
            rotation_from_vector(turned) * pose.rotation,
        )
    }

    fn vector(&mut self) -> Vector3<f64> {
        let (x, y, z) = (self.normal(), self.normal(), self.normal());
        Vector3::new(x, y, z)
    }

    /// A standard normal number, by Box and Muller's transform.
    fn normal(&mut self) -> f64 {
        // In (0, 1], so that the logarithm is finite.
        let radius = (-2.0 * self.unit().ln()).sqrt();
        radius * (TAU * self.unit()).cos()
    }

    fn unit(&mut self) -> f64 {
        ((self.random.next_u64() >> 11) + 1) as f64 * (1.0 / (1u64 << 53) as f64)
    }
}

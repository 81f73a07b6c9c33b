//! The motion of an end effector and an object over one step, and the rule that tells carrying from everything else.

use nalgebra::Isometry3;
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::signed_difference;

use crate::config::{ObjectDistance, SegmentConfig};

/// An end effector and an object at one moment, in one world.
pub trait Pair {
    /// How the two move from this moment to the next.
    fn step_to(&self, next: &Self) -> StepMotion;
}

/// How an end effector and an object move over one step. Nothing in it depends on the choice of the world frame. Lengths
/// are in the units of the world, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepMotion {
    /// |x, x'|: distance that the end effector moves.
    pub eef_translation: f64,
    /// |o, o'|: distance that the object's origin moves.
    pub object_translation: f64,
    /// Distance that the point of the object under the end effector moves.
    pub object_translation_at_eef: f64,
    /// Angle that the object turns: signed, in [-π, π), in the plane; geodesic, in [0, π], in space.
    pub object_rotation: f64,
    /// Distance that the end effector moves as seen from the object, |o'⁻¹x' - o⁻¹x|.
    pub relative_translation: f64,
    /// Angle that the end effector turns as seen from the object; none where it is a point.
    pub relative_rotation: Option<f64>,
}

impl StepMotion {
    /// Whether the object moves or turns further than the configured thresholds.
    pub fn object_moves(&self, config: &SegmentConfig) -> bool {
        self.object_translation > config.minimum_motion || self.object_rotation.abs() > config.minimum_rotation
    }

    /// The mode by the paper's general definition (section "Manipulation Modes"): transfer when the object moves, by the
    /// same distance as the end effector, | |x, x'| - |o, o'| | < ε, and their relative pose stays, transit otherwise.
    pub fn mode(&self, config: &SegmentConfig) -> Mode {
        let object_distance = match config.object_distance {
            ObjectDistance::AtEef => self.object_translation_at_eef,
            ObjectDistance::AtOrigin => self.object_translation,
        };
        let equally_far = (self.eef_translation - object_distance).abs() < config.translation_epsilon;
        let rigid = self.relative_translation < config.translation_epsilon
            && self
                .relative_rotation
                .is_none_or(|angle| angle < config.rotation_epsilon);
        if self.object_moves(config) && equally_far && rigid {
            Mode::Transfer
        } else {
            Mode::Transit
        }
    }
}

impl Pair for PlanarFrame {
    fn step_to(&self, next: &Self) -> StepMotion {
        let seen = self.object.inverse_transform_point(self.eef);
        let seen_next = next.object.inverse_transform_point(next.eef);
        StepMotion {
            eef_translation: (next.eef - self.eef).norm(),
            object_translation: (next.object.translation() - self.object.translation()).norm(),
            object_translation_at_eef: (next.object.transform_point(seen) - self.eef).norm(),
            object_rotation: signed_difference(self.object.theta, next.object.theta),
            relative_translation: (seen_next - seen).norm(),
            relative_rotation: None,
        }
    }
}

/// An end effector with an orientation and an object, in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialPair {
    /// Pose of the end effector, world frame.
    pub eef: Isometry3<f64>,
    /// Pose of the object, world frame.
    pub object: Isometry3<f64>,
}

impl Pair for SpatialPair {
    fn step_to(&self, next: &Self) -> StepMotion {
        let seen = self.object.inv_mul(&self.eef);
        let seen_next = next.object.inv_mul(&next.eef);
        let carried = next.object * seen;
        let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| (b.translation.vector - a.translation.vector).norm();
        StepMotion {
            eef_translation: distance(&self.eef, &next.eef),
            object_translation: distance(&self.object, &next.object),
            object_translation_at_eef: distance(&self.eef, &carried),
            object_rotation: self.object.rotation.angle_to(&next.object.rotation),
            relative_translation: distance(&seen, &seen_next),
            relative_rotation: Some(seen.rotation.angle_to(&seen_next.rotation)),
        }
    }
}

/// The modes of a sequence by the rigid-motion rule, one a frame: that of the step to the next frame, and for the last
/// frame that of the step before.
pub fn rigid_motion_modes<P: Pair>(frames: &[P], config: &SegmentConfig) -> Vec<Mode> {
    let steps = frames.windows(2).map(|pair| match pair {
        [now, next] => now.step_to(next).mode(config),
        _ => Mode::Transit,
    });
    with_last(steps.collect(), frames.len())
}

/// One mode a frame from one mode a step.
pub(crate) fn with_last(mut modes: Vec<Mode>, frames: usize) -> Vec<Mode> {
    if modes.len() < frames {
        modes.push(modes.last().copied().unwrap_or(Mode::Transit));
    }
    modes
}

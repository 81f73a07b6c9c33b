//! The relative motion of an end effector and an object over one step, and the rule that detects carrying from it.

use nalgebra::Isometry3;
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::signed_difference;

use crate::config::{ObjectDistance, SegmentConfig};

/// The poses of an end effector and an object at one frame, both in the world frame.
pub trait Pair {
    /// Returns the motion of both from this frame to the next one.
    fn step_to(&self, next: &Self) -> StepMotion;
}

/// The motion of an end effector and an object over one step. No value depends on the choice of the world frame. Lengths
/// are in the units of the demonstration, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepMotion {
    /// |x, x'|: distance that the end effector moves.
    pub eef_translation: f64,
    /// |o, o'|: distance that the object's origin moves.
    pub object_translation: f64,
    /// Distance that the point of the object at the end effector moves.
    pub object_translation_at_eef: f64,
    /// Angle by which the object rotates: signed, in [-π, π), in SE(2); geodesic, in [0, π], in SE(3).
    pub object_rotation: f64,
    /// Distance that the end effector moves in the object's frame, |o'⁻¹x' - o⁻¹x|.
    pub relative_translation: f64,
    /// Angle by which the end effector rotates in the object's frame; `None` if the end effector is a point.
    pub relative_rotation: Option<f64>,
}

impl StepMotion {
    /// Whether the object translates or rotates further than the configured thresholds.
    pub fn object_moves(&self, config: &SegmentConfig) -> bool {
        self.object_translation > config.minimum_motion || self.object_rotation.abs() > config.minimum_rotation
    }

    /// Returns the mode by the paper's general definition (section "Manipulation Modes"): transfer if the object moves, by the
    /// same distance as the end effector, | |x, x'| - |o, o'| | < ε, and their relative pose is fixed; transit otherwise.
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
        let eef_in_object = self.object.inverse_transform_point(self.eef);
        let next_eef_in_object = next.object.inverse_transform_point(next.eef);
        StepMotion {
            eef_translation: (next.eef - self.eef).norm(),
            object_translation: (next.object.translation() - self.object.translation()).norm(),
            object_translation_at_eef: (next.object.transform_point(eef_in_object) - self.eef).norm(),
            object_rotation: signed_difference(self.object.theta, next.object.theta),
            relative_translation: (next_eef_in_object - eef_in_object).norm(),
            relative_rotation: None,
        }
    }
}

/// An end effector with an orientation and an object, both in SE(3).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialPair {
    /// Pose of the end effector, world frame.
    pub eef: Isometry3<f64>,
    /// Pose of the object, world frame.
    pub object: Isometry3<f64>,
}

impl Pair for SpatialPair {
    fn step_to(&self, next: &Self) -> StepMotion {
        let object_from_eef = self.object.inv_mul(&self.eef);
        let next_object_from_eef = next.object.inv_mul(&next.eef);
        // Pose that the end effector would have if it were fixed to the object.
        let carried = next.object * object_from_eef;
        let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| (b.translation.vector - a.translation.vector).norm();
        StepMotion {
            eef_translation: distance(&self.eef, &next.eef),
            object_translation: distance(&self.object, &next.object),
            object_translation_at_eef: distance(&self.eef, &carried),
            object_rotation: self.object.rotation.angle_to(&next.object.rotation),
            relative_translation: distance(&object_from_eef, &next_object_from_eef),
            relative_rotation: Some(object_from_eef.rotation.angle_to(&next_object_from_eef.rotation)),
        }
    }
}

/// Returns the modes of a sequence by the rigid-motion rule, one per frame. A frame has the mode of the step to the next frame; the
/// last frame has that of the step before it.
pub fn rigid_motion_modes<P: Pair>(frames: &[P], config: &SegmentConfig) -> Vec<Mode> {
    let steps = frames.windows(2).map(|pair| match pair {
        [now, next] => now.step_to(next).mode(config),
        _ => Mode::Transit,
    });
    with_last(steps.collect(), frames.len())
}

/// Extends one mode per step to one mode per frame, by repeating the last mode. A single frame is transit.
pub(crate) fn with_last(mut modes: Vec<Mode>, frames: usize) -> Vec<Mode> {
    if modes.len() < frames {
        modes.push(modes.last().copied().unwrap_or(Mode::Transit));
    }
    modes
}

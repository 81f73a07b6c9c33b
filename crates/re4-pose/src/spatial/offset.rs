//! The constant rigid offset between an estimator's frame and the recorded one.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::columns;
use re4_geometry::spatial::{Symmetry, SymmetryError, SymmetryGroup, rotation_from_vector, rotation_vector};

/// Number of initial candidates for the rotation; the one with the smallest sum of angles to the frames is refined.
const CANDIDATES: usize = 48;

/// Number of frames on which the candidates are compared.
const SCORING_FRAMES: usize = 512;

/// Maximum number of iterations of the rotation's median.
const MAXIMUM_ITERATIONS: usize = 100;

/// A step shorter than this ends the iterations, in rad.
const CONVERGED: f64 = 1e-9;

/// Lower bound of the angles whose reciprocals are the weights of the median, in rad: avoids infinite weights.
const MINIMUM_ANGLE: f64 = 1e-6;

/// The constant rigid offset C between estimated and recorded poses: `recorded S ≈ estimated Z C`.
///
/// * S is a rotation in the object's symmetry group. For a full rotational symmetry (a can) its angle cannot be observed, and
///   only the directions of the axes are compared.
/// * Z is the identity, or a rotation by pi about the z axis of the estimated frame, along which the gripper approaches. A
///   two-finger gripper grasps equally well after this rotation, and a demonstrator chooses the nearer alternative, so the
///   choice of Z is not an error of the estimator. Z is used only if the object has no symmetry by pi: if it has one (cube, can),
///   Z would change nothing observable. For the nut, whose handle is grasped 6 cm from its origin, a single C without Z cannot
///   fit: the origin is on one side of the gripper or on the other.
///
/// So C has six parameters, of which five are observable under a full rotational symmetry. S and Z are chosen for each frame,
/// so that they minimise the remaining angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Offset {
    motion: Isometry3<f64>,
    symmetry: SymmetryGroup,
    allows_pi: bool,
}

columns! {
    /// Error of an estimate with respect to the recorded pose, after the offset is removed.
    #[derive(Copy)]
    pub struct FrameError {
        /// Distance between the estimated (estimated Z C) and the recorded position, at the origin of the recorded frame.
        #[unit = "m"]
        pub translation: f64,
        /// The same at the origin of the estimated frame, where the gripper grasps (recorded S C^-1 compared with estimated). The
        /// two differ by the effect of the rotation error along the lever arm between the two origins.
        #[unit = "m"]
        pub translation_at_grasp: f64,
        /// Angle between the estimated and the recorded orientation, modulo S and Z.
        #[unit = "rad"]
        pub rotation: f64,
        /// Whether Z is a rotation by pi about the axis of approach.
        #[formerly = "half_turn"]
        pub rotated_by_pi: bool,
    }
}

/// A rotation by pi about the axis of approach.
fn rotation_by_pi() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI)
}

/// Whether a rotation by pi is in the object's symmetry.
fn has_rotation_by_pi(symmetry: &Symmetry) -> bool {
    match symmetry {
        Symmetry::None => false,
        Symmetry::Fold { n, .. } => n % 2 == 0,
        Symmetry::Full { .. } => true,
    }
}

impl Offset {
    /// Fits the offset to pairs of an estimated and a recorded pose: the rotation is the geodesic median modulo S and Z, the
    /// translation is the median of each component in the estimated frame. Outliers therefore do not affect the fit while they are
    /// fewer than half of the pairs. Returns `None` if there are no pairs.
    ///
    /// # Errors
    /// If the symmetry is invalid.
    pub fn fit(pairs: &[[Isometry3<f64>; 2]], symmetry: Symmetry) -> Result<Option<Self>, SymmetryError> {
        let group = symmetry.group()?;
        let allows_pi = !has_rotation_by_pi(&symmetry);
        let relative: Vec<UnitQuaternion<f64>> = pairs
            .iter()
            .map(|[estimated, recorded]| estimated.rotation.inverse() * recorded.rotation)
            .collect();
        let Some(rotation) = initial_rotation(&relative, &group, allows_pi) else {
            return Ok(None);
        };
        let mut found = Self {
            motion: Isometry3::from_parts(Translation3::identity(), rotation),
            symmetry: group,
            allows_pi,
        };
        found.refine_rotation(&relative);
        let mut components = [const { Vec::new() }; 3];
        for ([estimated, recorded], relative) in pairs.iter().zip(&relative) {
            let rotated = found.apply_z(estimated, found.nearest(relative).0);
            let lever = rotated.inverse_transform_vector(&(recorded.translation.vector - rotated.translation.vector));
            for (component, value) in components.iter_mut().zip(&lever) {
                component.push(*value);
            }
        }
        let [x, y, z] = components.map(median);
        found.motion.translation = Translation3::new(x, y, z);
        Ok(Some(found))
    }

    /// The offset C: the pose of the recorded frame in the estimated frame.
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.motion
    }

    /// Whether Z may be a rotation by pi, because the object itself has no symmetry by pi.
    pub fn allows_pi(&self) -> bool {
        self.allows_pi
    }

    /// Error of an estimate with respect to the recorded pose.
    pub fn error(&self, estimated: &Isometry3<f64>, recorded: &Isometry3<f64>) -> FrameError {
        let (rotated_by_pi, rotation) = self.nearest(&(estimated.rotation.inverse() * recorded.rotation));
        let corrected = self.apply_z(estimated, rotated_by_pi) * self.motion;
        let (aligned, _) = self.symmetry.align(recorded, &corrected);
        // Z does not move the origin of the estimated frame.
        let grasp = aligned * self.motion.inverse();
        let apart = |a: &Isometry3<f64>, b: &Isometry3<f64>| (a.translation.vector - b.translation.vector).norm();
        FrameError {
            translation: apart(&corrected, recorded),
            translation_at_grasp: apart(&grasp, estimated),
            rotation,
            rotated_by_pi,
        }
    }

    fn apply_z(&self, estimated: &Isometry3<f64>, by_pi: bool) -> Isometry3<f64> {
        if by_pi && self.allows_pi {
            return Isometry3::from_parts(estimated.translation, estimated.rotation * rotation_by_pi());
        }
        *estimated
    }

    /// Whether Z is a rotation by pi for a recorded orientation in the estimated frame, and the remaining angle.
    fn nearest(&self, relative: &UnitQuaternion<f64>) -> (bool, f64) {
        nearest(&self.motion.rotation, relative, &self.symmetry, self.allows_pi)
    }

    /// Weiszfeld iterations towards the geodesic median.
    fn refine_rotation(&mut self, relative: &[UnitQuaternion<f64>]) {
        for _ in 0..MAXIMUM_ITERATIONS {
            let (mut step, mut weights) = (Vector3::zeros(), 0.0);
            for own in relative {
                let (by_pi, angle) = self.nearest(own);
                let own = if by_pi { rotation_by_pi().inverse() * own } else { *own };
                let (equivalent, _) = self.symmetry.nearest_rotation(&own, &self.motion.rotation);
                let difference =
                    rotation_vector(&(self.motion.rotation.inverse() * own * self.symmetry.rotation(equivalent)));
                let weight = 1.0 / angle.max(MINIMUM_ANGLE);
                step += difference * weight;
                weights += weight;
            }
            let step = step / weights;
            let mut rotation = self.motion.rotation * rotation_from_vector(step);
            rotation.renormalize();
            self.motion.rotation = rotation;
            if step.norm() < CONVERGED {
                break;
            }
        }
    }
}

/// The relative rotation with the smallest sum of angles to a sample of the others.
fn initial_rotation(
    relative: &[UnitQuaternion<f64>],
    symmetry: &SymmetryGroup,
    allows_pi: bool,
) -> Option<UnitQuaternion<f64>> {
    let subset = |count: usize| relative.iter().step_by(relative.len().div_ceil(count).max(1));
    let sum = |candidate: &UnitQuaternion<f64>| -> f64 {
        subset(SCORING_FRAMES)
            .map(|own| nearest(candidate, own, symmetry, allows_pi).1)
            .sum()
    };
    subset(CANDIDATES)
        .map(|candidate| (sum(candidate), candidate))
        .min_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, candidate)| *candidate)
}

fn nearest(
    offset: &UnitQuaternion<f64>,
    relative: &UnitQuaternion<f64>,
    symmetry: &SymmetryGroup,
    allows_pi: bool,
) -> (bool, f64) {
    let angle = symmetry.angle(relative, offset);
    if !allows_pi {
        return (false, angle);
    }
    let angle_by_pi = symmetry.angle(relative, &(rotation_by_pi() * offset));
    if angle_by_pi < angle {
        (true, angle_by_pi)
    } else {
        (false, angle)
    }
}

/// The middle value, or the mean of the two middle values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n % 2 == 0 => f64::midpoint(values[middle - 1], values[middle]),
        _ => values[middle],
    }
}

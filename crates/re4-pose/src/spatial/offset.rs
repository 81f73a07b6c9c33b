//! The constant rigid offset between an estimator's frame and the recorded one.

use std::f64::consts::PI;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::columns;
use re4_geometry::spatial::{Symmetry, SymmetryError, SymmetryGroup, rotation_from_vector, rotation_vector};

/// First guesses of the rotation; the one that most frames agree with is improved.
const GUESSES: usize = 48;

/// Frames that guesses are compared on.
const JURY: usize = 512;

/// Steps of the rotation's median, at most.
const STEPS: usize = 100;

/// A step shorter than this is the last one, in rad.
const ENOUGH: f64 = 1e-9;

/// Angles nearer than this to the median count as if they were this far, in rad.
const NEAREST: f64 = 1e-6;

/// The constant rigid offset C between estimated and recorded poses: `recorded S ≈ estimated Z C`.
///
/// * S is a turn after which the object looks the same. For a full turn (a can) its angle cannot be observed, and what is
///   compared is the direction of the axis.
/// * Z is the identity, or half a turn about the z axis of the estimated frame, along which the gripper approaches: a
///   two-finger gripper grasps the same after it, and a demonstrator takes whichever way is nearer, so which of the two an
///   estimated frame is turned by says nothing of the estimator's precision. It is only there where the object's own symmetry
///   has no half turn: where it has one (cube, can), Z would change nothing that can be observed. For the nut, whose handle is
///   grasped 6 cm from its origin, one C without Z could not hold: the origin lies on the one side or on the other.
///
/// So C has six parameters, of which a full turn leaves five observable. S and Z are chosen frame by frame, each time those
/// that leave the minimum angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Offset {
    motion: Isometry3<f64>,
    symmetry: SymmetryGroup,
    allows_pi: bool,
}

columns! {
    /// How far an estimate is from the recorded pose, the offset taken away.
    #[derive(Copy)]
    pub struct FrameError {
        /// Distance between estimated (estimated Z C) and recorded position, at the origin of the recorded frame.
        #[unit = "m"]
        pub translation: f64,
        /// The same at the origin of the estimated frame, which is where the gripper grasps (recorded S C^-1 against estimated). It
        /// differs from the other by what an error of the rotation does along the lever between the two.
        #[unit = "m"]
        pub translation_at_grasp: f64,
        /// Angle between estimated and recorded orientation, up to S and Z.
        #[unit = "rad"]
        pub rotation: f64,
        /// Whether Z was a rotation by pi about the axis of approach.
        #[formerly = "half_turn"]
        pub rotated_by_pi: bool,
    }
}

/// Half a turn about the axis of approach.
fn rotation_by_pi() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI)
}

/// Whether half a turn of the object does not show.
fn has_rotation_by_pi(symmetry: &Symmetry) -> bool {
    match symmetry {
        Symmetry::None => false,
        Symmetry::Fold { n, .. } => n % 2 == 0,
        Symmetry::Full { .. } => true,
    }
}

impl Offset {
    /// The offset that pairs of an estimated and a recorded pose agree on best: for the rotation the geodesic median modulo S
    /// and Z, for the translation the median of each component in the estimated frame. So poses that are far off, fewer than
    /// half of all, do not decide. `None` of no pairs.
    ///
    /// # Errors
    /// When the symmetry is none.
    pub fn fit(pairs: &[[Isometry3<f64>; 2]], symmetry: Symmetry) -> Result<Option<Self>, SymmetryError> {
        let group = symmetry.group()?;
        let allows_pi = !has_rotation_by_pi(&symmetry);
        let relative: Vec<UnitQuaternion<f64>> = pairs
            .iter()
            .map(|[estimated, recorded]| estimated.rotation.inverse() * recorded.rotation)
            .collect();
        let Some(rotation) = first_guess(&relative, &group, allows_pi) else {
            return Ok(None);
        };
        let mut found = Self {
            motion: Isometry3::from_parts(Translation3::identity(), rotation),
            symmetry: group,
            allows_pi,
        };
        found.improve_rotation(&relative);
        let mut components = [const { Vec::new() }; 3];
        for ([estimated, recorded], relative) in pairs.iter().zip(&relative) {
            let turned = found.turned(estimated, found.nearest(relative).0);
            let lever = turned.inverse_transform_vector(&(recorded.translation.vector - turned.translation.vector));
            for (component, value) in components.iter_mut().zip(&lever) {
                component.push(*value);
            }
        }
        let [x, y, z] = components.map(median);
        found.motion.translation = Translation3::new(x, y, z);
        Ok(Some(found))
    }

    /// The offset C: the recorded frame as seen from the estimated one.
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.motion
    }

    /// Whether half a turn of the gripper is told apart from the object's own symmetry.
    pub fn allows_pi(&self) -> bool {
        self.allows_pi
    }

    /// How far an estimate is from the recorded pose.
    pub fn error(&self, estimated: &Isometry3<f64>, recorded: &Isometry3<f64>) -> FrameError {
        let (rotated_by_pi, rotation) = self.nearest(&(estimated.rotation.inverse() * recorded.rotation));
        let corrected = self.turned(estimated, rotated_by_pi) * self.motion;
        let (aligned, _) = self.symmetry.align(recorded, &corrected);
        // Z leaves the origin of the estimated frame where it is.
        let grasp = aligned * self.motion.inverse();
        let apart = |a: &Isometry3<f64>, b: &Isometry3<f64>| (a.translation.vector - b.translation.vector).norm();
        FrameError {
            translation: apart(&corrected, recorded),
            translation_at_grasp: apart(&grasp, estimated),
            rotation,
            rotated_by_pi,
        }
    }

    fn turned(&self, estimated: &Isometry3<f64>, half: bool) -> Isometry3<f64> {
        if half && self.allows_pi {
            return Isometry3::from_parts(estimated.translation, estimated.rotation * rotation_by_pi());
        }
        *estimated
    }

    /// Whether Z is half a turn for a recorded orientation as seen from the estimated one, and the angle that is left.
    fn nearest(&self, relative: &UnitQuaternion<f64>) -> (bool, f64) {
        nearest(&self.motion.rotation, relative, &self.symmetry, self.allows_pi)
    }

    /// Weiszfeld's steps towards the geodesic median.
    fn improve_rotation(&mut self, relative: &[UnitQuaternion<f64>]) {
        for _ in 0..STEPS {
            let (mut step, mut weights) = (Vector3::zeros(), 0.0);
            for own in relative {
                let (half, angle) = self.nearest(own);
                let own = if half { rotation_by_pi().inverse() * own } else { *own };
                let (turn, _) = self.symmetry.nearest_rotation(&own, &self.motion.rotation);
                let away = rotation_vector(&(self.motion.rotation.inverse() * own * self.symmetry.rotation(turn)));
                let weight = 1.0 / angle.max(NEAREST);
                step += away * weight;
                weights += weight;
            }
            let step = step / weights;
            let mut rotation = self.motion.rotation * rotation_from_vector(step);
            rotation.renormalize();
            self.motion.rotation = rotation;
            if step.norm() < ENOUGH {
                break;
            }
        }
    }
}

/// The relative rotation that most others are near to.
fn first_guess(
    relative: &[UnitQuaternion<f64>],
    symmetry: &SymmetryGroup,
    allows_pi: bool,
) -> Option<UnitQuaternion<f64>> {
    let some = |count: usize| relative.iter().step_by(relative.len().div_ceil(count).max(1));
    let sum =
        |guess: &UnitQuaternion<f64>| -> f64 { some(JURY).map(|own| nearest(guess, own, symmetry, allows_pi).1).sum() };
    some(GUESSES)
        .map(|guess| (sum(guess), guess))
        .min_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, guess)| *guess)
}

fn nearest(
    offset: &UnitQuaternion<f64>,
    relative: &UnitQuaternion<f64>,
    symmetry: &SymmetryGroup,
    allows_pi: bool,
) -> (bool, f64) {
    let plain = symmetry.angle(relative, offset);
    if !allows_pi {
        return (false, plain);
    }
    let turned = symmetry.angle(relative, &(rotation_by_pi() * offset));
    if turned < plain { (true, turned) } else { (false, plain) }
}

/// The middle one of the values, or the mean of the two in the middle.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => 0.0,
        n if n % 2 == 0 => f64::midpoint(values[middle - 1], values[middle]),
        _ => values[middle],
    }
}

//! Rigid motions in SE(3): distances, interpolation, limited steps, and symmetries of objects.
//!
//! Poses are `nalgebra::Isometry3<f64>`: a translation in metres and a unit quaternion. A quaternion and its negative represent
//! the same rotation; all functions in this module treat them alike.

mod symmetry;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

pub use symmetry::{LARGEST_FOLD, Symmetry, SymmetryError, SymmetryGroup};

/// Geodesic distance between two rotations: the angle, in `[0, π]` rad, of the relative rotation.
///
/// It is computed as `2 atan2(|v|, |w|)` from the quaternion `(w, v)` of the relative rotation. This is accurate near π and near
/// 0, where the arc cosine of a scalar product loses half of its digits.
pub fn rotation_angle(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    let relative = a.rotation_to(b);
    2.0 * relative.imag().norm().atan2(relative.scalar().abs())
}

/// Returns the rotation vector of a rotation: axis times angle in rad, with an angle of at most π.
///
/// A rotation by π has two such vectors; the result is the one with the direction of the quaternion's imaginary part.
pub fn rotation_vector(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let sine = rotation.imag().norm();
    if sine == 0.0 {
        return Vector3::zeros();
    }
    let angle = 2.0 * sine.atan2(rotation.scalar().abs());
    let sign = if rotation.scalar() < 0.0 { -1.0 } else { 1.0 };
    rotation.imag() * (sign * angle / sine)
}

/// Returns the rotation of a rotation vector (axis times angle in rad).
pub fn rotation_from_vector(vector: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(vector)
}

/// Interpolates between two rotations along the geodesic, from `from` (`part` 0) to `to` (`part` 1).
///
/// Unlike `UnitQuaternion::slerp` it is also defined for rotations that differ by π.
pub fn rotation_between(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>, part: f64) -> UnitQuaternion<f64> {
    if part == 1.0 {
        return *to;
    }
    rotation_from_vector(rotation_vector(&from.rotation_to(to)) * part) * from
}

/// Interpolates between two poses, from `from` (`part` 0) to `to` (`part` 1): the translation along the straight line, the
/// rotation along the geodesic. For `part` 1 the result is bit-identical to `to`.
pub fn pose_between(from: &Isometry3<f64>, to: &Isometry3<f64>, part: f64) -> Isometry3<f64> {
    let line = to.translation.vector - from.translation.vector;
    Isometry3::from_parts(
        if part == 1.0 {
            to.translation
        } else {
            Translation3::from(from.translation.vector + line * part)
        },
        rotation_between(&from.rotation, &to.rotation, part),
    )
}

/// Returns the distance in metres between the origins of two poses and the angle in rad between their rotations.
pub fn pose_distance(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
    (
        (b.translation.vector - a.translation.vector).norm(),
        rotation_angle(&a.rotation, &b.rotation),
    )
}

/// Moves a pose from `from` towards `to` by at most `length` metres and `angle` rad.
///
/// The limits apply separately: translation and rotation each reach their target if it is within their limit. A limit of 0 or
/// less keeps the translation or rotation of `from`, unless it already equals that of `to`.
pub fn step_toward(from: &Isometry3<f64>, to: &Isometry3<f64>, length: f64, angle: f64) -> Isometry3<f64> {
    let (distance, rotation) = pose_distance(from, to);
    // A part of exactly 1 returns the target bit for bit, so that repeated steps arrive. The check for 0 avoids a division by 0.
    let part = |limit: f64, whole: f64| {
        if whole <= limit || whole == 0.0 {
            1.0
        } else {
            limit.max(0.0) / whole
        }
    };
    Isometry3::from_parts(
        pose_between(from, to, part(length, distance)).translation,
        rotation_between(&from.rotation, &to.rotation, part(angle, rotation)),
    )
}

/// Whether all numbers of a pose are finite and the length of its quaternion is 1 within about 1e-6.
pub fn is_valid_pose(pose: &Isometry3<f64>) -> bool {
    // An error of 1e-6 in the length is one of 2e-6 in its square.
    pose.translation.vector.iter().all(|v| v.is_finite())
        && (pose.rotation.quaternion().norm_squared() - 1.0).abs() <= 2e-6
}

#[cfg(test)]
mod tests;

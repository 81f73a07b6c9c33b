//! Rigid motions in space: angles, limited steps, and objects that look the same after some turns.
//!
//! Poses are `nalgebra::Isometry3<f64>`: a translation in metres and a unit quaternion. A quaternion and its negative are
//! the same rotation, and every function here treats them as the same.

mod symmetry;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

pub use symmetry::{LARGEST_FOLD, Symmetry, SymmetryError, SymmetryGroup};

/// Geodesic distance between two rotations: the angle, in `[0, π]` rad, of the rotation that takes one into the other.
///
/// It is `2 atan2(|v|, |w|)` of the quaternion `(w, v)` of that rotation, which keeps its digits near 0, where the arc cosine
/// of a scalar product loses half of them, and near π.
pub fn rotation_angle(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    let relative = a.rotation_to(b);
    2.0 * relative.imag().norm().atan2(relative.scalar().abs())
}

/// The rotation vector, axis times angle in rad, of the shortest way to a rotation; its length is at most π.
///
/// Half a turn has two shortest ways; the axis is then the one that the quaternion names.
pub fn rotation_vector(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let sine = rotation.imag().norm();
    if sine == 0.0 {
        return Vector3::zeros();
    }
    let angle = 2.0 * sine.atan2(rotation.scalar().abs());
    let sign = if rotation.scalar() < 0.0 { -1.0 } else { 1.0 };
    rotation.imag() * (sign * angle / sine)
}

/// The rotation that a rotation vector (axis times angle in rad) stands for.
pub fn rotation_from_vector(vector: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(vector)
}

/// A rotation part of the shortest way from `from` (part 0) to `to` (part 1), at constant angular velocity.
///
/// Unlike a slerp over quaternions it is defined for rotations half a turn apart, too.
pub fn rotation_between(from: &UnitQuaternion<f64>, to: &UnitQuaternion<f64>, part: f64) -> UnitQuaternion<f64> {
    if part == 1.0 {
        return *to;
    }
    rotation_from_vector(rotation_vector(&from.rotation_to(to)) * part) * from
}

/// The pose at a part of the way from `from` (part 0) to `to` (part 1): the translation along the straight line, the
/// rotation along its own shortest way.
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

/// Distance in metres between the origins of two poses, and the angle in rad between their rotations.
pub fn pose_distance(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
    (
        (b.translation.vector - a.translation.vector).norm(),
        rotation_angle(&a.rotation, &b.rotation),
    )
}

/// A pose at most `length` metres and `angle` rad ahead on the way from `from` to `to`; `to` itself where it is nearer.
///
/// The two limits hold on their own: the nearer one of translation and rotation is taken whole, even if the other is not.
/// A limit that is not above 0 leaves its part where it is, unless it is there already.
pub fn step_toward(from: &Isometry3<f64>, to: &Isometry3<f64>, length: f64, angle: f64) -> Isometry3<f64> {
    let (distance, turn) = pose_distance(from, to);
    let part = |limit: f64, whole: f64| {
        if whole <= limit || whole == 0.0 {
            1.0
        } else {
            limit.max(0.0) / whole
        }
    };
    Isometry3::from_parts(
        pose_between(from, to, part(length, distance)).translation,
        rotation_between(&from.rotation, &to.rotation, part(angle, turn)),
    )
}

/// Whether every number of a pose is finite and its quaternion is of unit length, to 1e-6.
pub fn is_sound(pose: &Isometry3<f64>) -> bool {
    pose.translation.vector.iter().all(|v| v.is_finite())
        && (pose.rotation.quaternion().norm_squared() - 1.0).abs() <= 2e-6
}

#[cfg(test)]
mod tests;

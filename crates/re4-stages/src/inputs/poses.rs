//! Poses in space as numbers.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

/// The pose of a position in metres and a unit quaternion x, y, z, w. The quaternion is taken as it is, sign and all.
pub fn from_numbers([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz)),
    )
}

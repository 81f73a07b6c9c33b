//! Points and poses: one field of a row is stored as one column per number.
//!
//! The type determines the unit: planar types are Push-T's and in pixels, types of SE(3) are robosuite's and in metres.
//! Quaternions have the order x, y, z, w.

use arrow_array::ArrayRef;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use re4_geometry::{Point2, Pose2};

use super::{Cell, ColumnSource, Place};
use crate::error::ArtifactError;
use crate::spec::ColumnSpec;

/// Suffixes of the names of the columns of a pose in SE(3), in the order of the columns.
pub const QUATERNION_PARTS: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];

/// An action of six numbers: translation, then rotation vector. In metres and radians unless the field has another unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SixAxis(pub [f64; 6]);

impl From<&Isometry3<f64>> for SixAxis {
    fn from(pose: &Isometry3<f64>) -> Self {
        let (t, r) = (pose.translation.vector, pose.rotation.scaled_axis());
        Self([t.x, t.y, t.z, r.x, r.y, r.z])
    }
}

impl From<SixAxis> for Isometry3<f64> {
    fn from(SixAxis([x, y, z, rx, ry, rz]): SixAxis) -> Self {
        Self::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz)),
        )
    }
}

/// Implements [`Cell`] for a type that is stored as `$count` floats. `$domain` is the domain of the type; `$parts` are the name
/// suffix, description and unit of each float; `$to` and `$from` convert to and from the floats.
macro_rules! floats {
    ($type:ty, $domain:literal, $count:literal, $parts:expr, $to:expr, $from:expr) => {
        impl Cell for $type {
            type Buffers = [<f64 as Cell>::Buffers; $count];
            type View = Vec<<f64 as Cell>::View>;

            const DOMAIN: &'static str = $domain;

            fn describe(at: &Place, columns: &mut Vec<ColumnSpec>) {
                let parts: [(&str, &str, &'static str); $count] = $parts;
                for (name, words, unit) in parts {
                    let unit = if at.unit.is_empty() { unit } else { at.unit };
                    f64::describe(
                        &Place {
                            unit,
                            ..at.part(name, words)
                        },
                        columns,
                    );
                }
            }

            fn push(value: Option<&Self>, buffers: &mut Self::Buffers) {
                let to: fn(&Self) -> [f64; $count] = $to;
                let numbers = value.map(to);
                for (i, buffer) in buffers.iter_mut().enumerate() {
                    buffer.append_option(numbers.map(|numbers| numbers[i]));
                }
            }

            fn finish(buffers: &mut Self::Buffers, arrays: &mut Vec<ArrayRef>) {
                for buffer in buffers {
                    f64::finish(buffer, arrays);
                }
            }

            fn view(source: &mut ColumnSource<'_>, required: bool) -> Result<Self::View, ArtifactError> {
                (0..$count).map(|_| f64::view(source, required)).collect()
            }

            fn get(view: &Self::View, row: usize) -> Option<Self> {
                let from: fn([f64; $count]) -> Self = $from;
                let mut numbers = [0.0; $count];
                for (number, view) in numbers.iter_mut().zip(view) {
                    *number = f64::get(view, row)?;
                }
                Some(from(numbers))
            }
        }
    };
}

floats!(
    Point2,
    "plane",
    2,
    [("x", "x", "px"), ("y", "y", "px")],
    |point| [point.x, point.y],
    |[x, y]| Self::new(x, y)
);

floats!(
    Pose2,
    "plane",
    3,
    [("x", "x", "px"), ("y", "y", "px"), ("theta", "angle", "rad")],
    |pose| [pose.x, pose.y, pose.theta],
    |[x, y, theta]| Self::new(x, y, theta)
);

floats!(
    Vector3<f64>,
    "space",
    3,
    [("x", "x", "m"), ("y", "y", "m"), ("z", "z", "m")],
    |point| [point.x, point.y, point.z],
    |[x, y, z]| Self::new(x, y, z)
);

floats!(
    SixAxis,
    "space",
    6,
    [
        ("x", "translation x", "m"),
        ("y", "translation y", "m"),
        ("z", "translation z", "m"),
        ("rx", "rotation vector x", "rad"),
        ("ry", "rotation vector y", "rad"),
        ("rz", "rotation vector z", "rad"),
    ],
    |axes| axes.0,
    Self
);

// Quaternions are neither normalized nor given a canonical sign, so that they are stored and read bit for bit.
floats!(
    Isometry3<f64>,
    "space",
    7,
    [
        ("x", "position x", "m"),
        ("y", "position y", "m"),
        ("z", "position z", "m"),
        ("qx", "quaternion x", ""),
        ("qy", "quaternion y", ""),
        ("qz", "quaternion z", ""),
        ("qw", "quaternion w", ""),
    ],
    |pose| {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
    },
    |[x, y, z, qx, qy, qz, qw]| Self::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz)),
    )
);

floats!(
    UnitQuaternion<f64>,
    "space",
    4,
    [
        ("qx", "quaternion x", ""),
        ("qy", "quaternion y", ""),
        ("qz", "quaternion z", ""),
        ("qw", "quaternion w", ""),
    ],
    |rotation| rotation.coords.into(),
    |parts| Self::new_unchecked(Quaternion::from(parts))
);

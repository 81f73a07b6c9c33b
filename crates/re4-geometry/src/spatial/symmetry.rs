//! Rotational symmetries of objects about an axis.

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};
use re4_fault::Remedy;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Largest `n` of a [`Symmetry::Fold`].
pub const LARGEST_FOLD: u32 = 360;

/// Rotational symmetry of an object: the rotations about its own origin after which it looks the same.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Table", into = "Table")]
#[schemars(with = "Table")]
pub enum Symmetry {
    /// No symmetry: every orientation looks different.
    #[default]
    None,
    /// Rotations about `axis` by multiples of `2π / n`: a cube on a table has `n = 4` about the vertical axis.
    Fold {
        /// Axis through the object's origin, in the object's frame; only its direction matters.
        axis: [f64; 3],
        /// Order of the symmetry, from 2 to [`LARGEST_FOLD`].
        n: u32,
    },
    /// All rotations about `axis`: a can about its axis.
    Full {
        /// Axis through the object's origin, in the object's frame; only its direction matters.
        axis: [f64; 3],
    },
}

/// Rotational symmetry of an object: the rotations about its own origin after which it looks the same. This is the form of
/// [`Symmetry`] in a pipeline file.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
#[schemars(rename = "Symmetry")]
enum Table {
    /// Every orientation looks different.
    None {},
    /// The object looks the same after rotations about `axis` by multiples of 360 degrees divided by `n`.
    Fold {
        /// Axis through the object's origin, in the object's frame; only its direction matters.
        axis: [f64; 3],
        /// Order of the symmetry, from 2 to 360.
        n: u32,
    },
    /// The object looks the same after any rotation about `axis`.
    Full {
        /// Axis through the object's origin, in the object's frame; only its direction matters.
        axis: [f64; 3],
    },
}

impl TryFrom<Table> for Symmetry {
    /// What is wrong and its remedy as one sentence, because deserializers keep only the text of an error.
    type Error = String;

    fn try_from(table: Table) -> Result<Self, String> {
        let symmetry = match table {
            Table::None {} => Self::None,
            Table::Fold { axis, n } => Self::Fold { axis, n },
            Table::Full { axis } => Self::Full { axis },
        };
        match symmetry.group() {
            Ok(_) => Ok(symmetry),
            Err(error) => Err(error.sentence()),
        }
    }
}

impl From<Symmetry> for Table {
    fn from(symmetry: Symmetry) -> Self {
        match symmetry {
            Symmetry::None => Self::None {},
            Symmetry::Fold { axis, n } => Self::Fold { axis, n },
            Symmetry::Full { axis } => Self::Full { axis },
        }
    }
}

/// Why a symmetry is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Error, Remedy)]
pub enum SymmetryError {
    /// The axis has no direction.
    #[error("the symmetry axis {axis:?} has no direction")]
    #[remedy("give three finite numbers that are not all 0, such as [0, 0, 1]")]
    Axis {
        /// What was given.
        axis: [f64; 3],
    },
    /// The order is out of range.
    #[error("a symmetry of kind fold has n = {n}")]
    #[remedy("set n to a number from 2 to {LARGEST_FOLD}, or use kind = \"full\" for symmetry under all rotations")]
    Fold {
        /// What was given.
        n: u32,
    },
}

impl Symmetry {
    /// Returns the group of rotations of the symmetry.
    ///
    /// # Errors
    /// If the axis has no direction or the order is out of range.
    pub fn group(&self) -> Result<SymmetryGroup, SymmetryError> {
        let direction = |axis: [f64; 3]| {
            // Scaled before normalization, because the squares of very large or very small numbers would overflow or underflow.
            let largest = axis.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            let has_direction = axis.iter().all(|v| v.is_finite()) && largest > 0.0;
            has_direction
                .then(|| Unit::new_normalize(Vector3::from(axis) / largest))
                .ok_or(SymmetryError::Axis { axis })
        };
        match *self {
            Self::None => Ok(SymmetryGroup {
                axis: Vector3::z_axis(),
                rotations: Rotations::Some(vec![AxisRotation::new(0.0)]),
            }),
            Self::Fold { axis, n } => {
                if !(2..=LARGEST_FOLD).contains(&n) {
                    return Err(SymmetryError::Fold { n });
                }
                let rotation = |k: u32| {
                    // Angles above π are replaced by negative ones, so that all are in (-π, π].
                    let k = if 2 * k > n {
                        f64::from(k) - f64::from(n)
                    } else {
                        f64::from(k)
                    };
                    AxisRotation::new(k * std::f64::consts::TAU / f64::from(n))
                };
                Ok(SymmetryGroup {
                    axis: direction(axis)?,
                    rotations: Rotations::Some((0..n).map(rotation).collect()),
                })
            }
            Self::Full { axis } => Ok(SymmetryGroup {
                axis: direction(axis)?,
                rotations: Rotations::All,
            }),
        }
    }
}

/// The group of rotations S of a [`Symmetry`]: the object at the pose `o` looks like the object at the pose `o S`.
///
/// For two rotations `q` and `j` of the object, [`SymmetryGroup::nearest_rotation`] finds the S for which `q S` is nearest to `j`
/// by the geodesic angle, and that angle. The angle is a metric on classes of symmetry-equivalent orientations: it is 0 exactly
/// for orientations that look the same, it is symmetric, and it satisfies the triangle inequality.
///
/// Method: let `a` be the axis, `(w, v)` the quaternion of `j⁻¹ q`, and `p = v·a`. S rotates the pair `(w, p)` by half the angle
/// of S and keeps the length of `v - p a`. With `(w', p')` the rotated pair, the remaining angle is `2 atan2(√(|v - p a|² + p'²),
/// |w'|)`. It is smallest for the largest `|w'|`:
///
/// * [`Symmetry::None`] and [`Symmetry::Fold`]: each rotation is tried. The first one wins ties, in the order `0, 2π/n, 4π/n,
///   ...`.
/// * [`Symmetry::Full`]: `p' = 0` can be reached, so the remaining angle is that between the axes `j a` and `q a`. If these are
///   opposite (`w = p = 0`), it is π for every S, and S is defined as 0.
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetryGroup {
    axis: Unit<Vector3<f64>>,
    rotations: Rotations,
}

#[derive(Debug, Clone, PartialEq)]
enum Rotations {
    /// A finite group. The first rotation is that by 0.
    Some(Vec<AxisRotation>),
    /// All rotations about the axis.
    All,
}

/// A rotation about the axis, with precomputed values.
#[derive(Debug, Clone, Copy, PartialEq)]
struct AxisRotation {
    /// In rad.
    angle: f64,
    /// Sine and cosine of half the angle.
    sine: f64,
    cosine: f64,
}

impl AxisRotation {
    fn new(angle: f64) -> Self {
        let (sine, cosine) = (0.5 * angle).sin_cos();
        Self { angle, sine, cosine }
    }
}

impl SymmetryGroup {
    /// Returns the rotation S for which `query S` is nearest to `demo`, as an angle in `(-π, π]` rad about the axis, and the
    /// angle in `[0, π]` rad that remains between `query S` and `demo`.
    pub fn nearest_rotation(&self, query: &UnitQuaternion<f64>, demo: &UnitQuaternion<f64>) -> (f64, f64) {
        let relative = demo.inverse() * query;
        let (w, v) = (relative.scalar(), relative.imag());
        let p = v.dot(&self.axis);
        let across = (v - self.axis.into_inner() * p).norm_squared();
        match &self.rotations {
            Rotations::All => {
                let along = w.hypot(p);
                let remaining = 2.0 * across.sqrt().atan2(along);
                let nearest = if along < DEGENERATE {
                    0.0
                } else {
                    wrapped(-2.0 * p.atan2(w))
                };
                (nearest, remaining)
            }
            Rotations::Some(rotations) => {
                let mut best = (0.0, f64::NEG_INFINITY, 0.0);
                for rotation in rotations {
                    let scalar = (w * rotation.cosine - p * rotation.sine).abs();
                    if scalar > best.1 {
                        best = (rotation.angle, scalar, w * rotation.sine + p * rotation.cosine);
                    }
                }
                let (nearest, w, p) = best;
                (nearest, 2.0 * (across + p * p).sqrt().atan2(w))
            }
        }
    }

    /// Returns the rotation by an angle in rad about the axis, in the object's frame.
    pub fn rotation(&self, angle: f64) -> UnitQuaternion<f64> {
        if angle == 0.0 {
            return UnitQuaternion::identity();
        }
        UnitQuaternion::from_axis_angle(&self.axis, angle)
    }

    /// Returns the angle in `[0, π]` rad between two orientations of the object up to symmetry.
    pub fn angle(&self, a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
        self.nearest_rotation(a, b).1
    }

    /// Returns the pose that is symmetry-equivalent to `query` and whose rotation is nearest to that of `demo`, and the angle in
    /// rad of the rotation S between the two: the pose is `query S`.
    pub fn align(&self, query: &Isometry3<f64>, demo: &Isometry3<f64>) -> (Isometry3<f64>, f64) {
        let (angle, _) = self.nearest_rotation(&query.rotation, &demo.rotation);
        (self.rotated(query, angle), angle)
    }

    /// Rotates a pose of the object by an angle in rad about the object's axis.
    pub fn rotated(&self, pose: &Isometry3<f64>, angle: f64) -> Isometry3<f64> {
        // An angle of 0 returns the pose bit for bit.
        if angle == 0.0 {
            return *pose;
        }
        Isometry3::from_parts(pose.translation, pose.rotation * self.rotation(angle))
    }
}

/// Length of `(w, p)` below which its direction, and thus the angle of S, is only rounding error.
const DEGENERATE: f64 = 1e-12;

/// Wraps an angle in `[-2π, 2π]` into `(-π, π]`.
fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle > PI {
        angle - TAU
    } else if angle <= -PI {
        angle + TAU
    } else {
        angle
    }
}

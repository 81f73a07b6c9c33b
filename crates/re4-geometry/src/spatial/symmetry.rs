//! Objects that look the same after some turns about an axis.

use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};
use re4_fault::Remedy;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Most turns that a [`Symmetry::Fold`] may count.
pub const LARGEST_FOLD: u32 = 360;

/// The turns about its own origin after which an object looks the same: part of a task's description.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "Table", into = "Table")]
#[schemars(with = "Table")]
pub enum Symmetry {
    /// None: every orientation looks different.
    #[default]
    None,
    /// A full turn in `n` equal parts: a cube lying on a table has `n = 4` about the vertical.
    Fold {
        /// Axis through the object's origin, in the object's frame; only its direction counts.
        axis: [f64; 3],
        /// Number of turns, the full one included; from 2 to [`LARGEST_FOLD`].
        n: u32,
    },
    /// Any turn: a can about its axis.
    Full {
        /// Axis through the object's origin, in the object's frame; only its direction counts.
        axis: [f64; 3],
    },
}

/// [`Symmetry`] as a pipeline file writes it.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
#[schemars(rename = "Symmetry")]
enum Table {
    /// Every orientation looks different.
    None {},
    /// The object looks the same after each of `n` equal parts of a full turn about `axis`.
    Fold {
        /// Axis through the object's origin, in the object's frame; only its direction counts.
        axis: [f64; 3],
        /// Number of turns, the full one included; from 2 to 360.
        n: u32,
    },
    /// The object looks the same after any turn about `axis`.
    Full {
        /// Axis through the object's origin, in the object's frame; only its direction counts.
        axis: [f64; 3],
    },
}

impl TryFrom<Table> for Symmetry {
    /// A sentence: all that decoders hand on of an error.
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

/// Why a symmetry is none.
#[derive(Debug, Clone, Copy, PartialEq, Error, Remedy)]
pub enum SymmetryError {
    /// The axis has no direction.
    #[error("the symmetry axis {axis:?} has no direction")]
    #[remedy("give three finite numbers that are not all 0, such as [0, 0, 1]")]
    Axis {
        /// What was given.
        axis: [f64; 3],
    },
    /// Not a number of turns.
    #[error("a symmetry of kind fold has n = {n}")]
    #[remedy("give a number from 2 to {LARGEST_FOLD}, or kind = \"full\" for any turn")]
    Fold {
        /// What was given.
        n: u32,
    },
}

impl Symmetry {
    /// The symmetry made ready for use.
    ///
    /// # Errors
    /// When the axis has no direction or the number of turns is out of range.
    pub fn group(&self) -> Result<SymmetryGroup, SymmetryError> {
        let direction = |axis: [f64; 3]| {
            // Scaled first, so that neither huge nor tiny axes leave the range of squares.
            let largest = axis.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            let sound = axis.iter().all(|v| v.is_finite()) && largest > 0.0;
            sound
                .then(|| Unit::new_normalize(Vector3::from(axis) / largest))
                .ok_or(SymmetryError::Axis { axis })
        };
        match *self {
            Self::None => Ok(SymmetryGroup {
                axis: Vector3::z_axis(),
                turns: Turns::Some(vec![Turn::new(0.0)]),
            }),
            Self::Fold { axis, n } => {
                if !(2..=LARGEST_FOLD).contains(&n) {
                    return Err(SymmetryError::Fold { n });
                }
                let turn = |k: u32| {
                    // Turns beyond half a turn are counted backwards, so that angles are in (-π, π].
                    let k = if 2 * k > n {
                        f64::from(k) - f64::from(n)
                    } else {
                        f64::from(k)
                    };
                    Turn::new(k * std::f64::consts::TAU / f64::from(n))
                };
                Ok(SymmetryGroup {
                    axis: direction(axis)?,
                    turns: Turns::Some((0..n).map(turn).collect()),
                })
            }
            Self::Full { axis } => Ok(SymmetryGroup {
                axis: direction(axis)?,
                turns: Turns::All,
            }),
        }
    }
}

/// The group of turns S of a [`Symmetry`], ready for use: the object at `o` looks like the object at `o S`.
///
/// Of two rotations `q` and `j` of the object, it knows the turn S for which `q S` is nearest to `j` by the geodesic angle,
/// and that angle. The angle is a metric on orientations that look different: it is 0 exactly where they look the same,
/// symmetric, and keeps to the triangle inequality.
///
/// How: with `a` the axis and `(w, v)` the quaternion of `j⁻¹ q`, the pair `(w, p)` with `p = v·a` turns by half the angle of S
/// when S is applied, and `v - p a` keeps its length. So the angle left is `2 atan2(√(|v - p a|² + p'²), |w'|)`, minimum where
/// `|w'|` is maximum:
///
/// * for some turns, each is tried; ties go to the first, in the order 0, 1/n of a turn, 2/n, ...
/// * for all turns, `p' = 0` can be had, and what is left is the angle between the axes of the two, `j a` and `q a`. Where they
///   point in opposite directions (`w = p = 0`), every turn leaves half a turn and the turn is taken to be 0.
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetryGroup {
    axis: Unit<Vector3<f64>>,
    turns: Turns,
}

#[derive(Debug, Clone, PartialEq)]
enum Turns {
    /// These, the first of them by 0.
    Some(Vec<Turn>),
    All,
}

/// One turn, with what is asked of it again and again.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Turn {
    /// In rad.
    angle: f64,
    /// Sine and cosine of half of it.
    sine: f64,
    cosine: f64,
}

impl Turn {
    fn new(angle: f64) -> Self {
        let (sine, cosine) = (0.5 * angle).sin_cos();
        Self { angle, sine, cosine }
    }
}

impl SymmetryGroup {
    /// The turn S, as an angle in `(-π, π]` rad about the axis, for which `query S` is nearest to `demo`, and the angle in
    /// `[0, π]` rad that is left between them.
    pub fn nearest_rotation(&self, query: &UnitQuaternion<f64>, demo: &UnitQuaternion<f64>) -> (f64, f64) {
        let relative = demo.inverse() * query;
        let (w, v) = (relative.scalar(), relative.imag());
        let p = v.dot(&self.axis);
        let across = (v - self.axis.into_inner() * p).norm_squared();
        match &self.turns {
            Turns::All => {
                let along = w.hypot(p);
                let angle = 2.0 * across.sqrt().atan2(along);
                let turn = if along < DEGENERATE {
                    0.0
                } else {
                    wrapped(-2.0 * p.atan2(w))
                };
                (turn, angle)
            }
            Turns::Some(turns) => {
                let mut best = (0.0, f64::NEG_INFINITY, 0.0);
                for turn in turns {
                    let left = (w * turn.cosine - p * turn.sine).abs();
                    if left > best.1 {
                        best = (turn.angle, left, w * turn.sine + p * turn.cosine);
                    }
                }
                let (turn, w, p) = best;
                (turn, 2.0 * (across + p * p).sqrt().atan2(w))
            }
        }
    }

    /// The rotation that a turn stands for, in the object's frame.
    pub fn rotation(&self, turn: f64) -> UnitQuaternion<f64> {
        if turn == 0.0 {
            return UnitQuaternion::identity();
        }
        UnitQuaternion::from_axis_angle(&self.axis, turn)
    }

    /// The angle in `[0, π]` rad between two orientations of the object, turns that do not show left out.
    pub fn angle(&self, a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
        self.nearest_rotation(a, b).1
    }

    /// The pose `query S` that looks like `query` and whose rotation is nearest to that of `demo`, with the turn S in rad.
    pub fn align(&self, query: &Isometry3<f64>, demo: &Isometry3<f64>) -> (Isometry3<f64>, f64) {
        let (turn, _) = self.nearest_rotation(&query.rotation, &demo.rotation);
        (self.turned(query, turn), turn)
    }

    /// The pose of the object turned by an angle in rad about its axis.
    pub fn turned(&self, pose: &Isometry3<f64>, turn: f64) -> Isometry3<f64> {
        if turn == 0.0 {
            return *pose;
        }
        Isometry3::from_parts(pose.translation, pose.rotation * self.rotation(turn))
    }
}

/// Below this the direction of a turn is rounding, not information.
const DEGENERATE: f64 = 1e-12;

/// An angle in `[-2π, 2π]` brought into `(-π, π]`.
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

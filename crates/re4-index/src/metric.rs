//! Min-max normalisation and the two distances of the planar Retrieve.

use std::f64::consts::TAU;

use re4_geometry::wrap_to_two_pi;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{IndexedFrame, Query};

/// How block angles are compared in the distances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AngleMetric {
    /// Shortest angular distance, so that 0 and 2π are the same angle.
    #[default]
    Periodic,
    /// Plain difference of the angles in [0, 2π), as in the paper's L2 distance. It has a discontinuity between 0 and 2π.
    Raw,
}

/// Minimum and maximum value of one dimension over the indexed frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Minimum value.
    pub minimum: f64,
    /// Maximum value.
    pub maximum: f64,
}

impl Range {
    /// The range of no values.
    const EMPTY: Self = Self {
        minimum: f64::INFINITY,
        maximum: f64::NEG_INFINITY,
    };

    /// The range of the values of both. Of 0 and -0, the latter is less; `f64::min` returns either, so that the result would depend on
    /// the order. Bounds that are NaN are ignored.
    fn including(self, other: Self) -> Self {
        let less = other.minimum.total_cmp(&self.minimum).is_lt() && !other.minimum.is_nan();
        let more = other.maximum.total_cmp(&self.maximum).is_gt() && !other.maximum.is_nan();
        Self {
            minimum: if less { other.minimum } else { self.minimum },
            maximum: if more { other.maximum } else { self.maximum },
        }
    }

    /// Length of the range. Returns 1 for a dimension that does not vary, so that such a dimension contributes its unscaled
    /// difference.
    pub fn span(self) -> f64 {
        if self.maximum > self.minimum {
            self.maximum - self.minimum
        } else {
            1.0
        }
    }
}

/// Min-max normalisation of `(eef x, eef y, object x, object y, object θ)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Normalization {
    /// Ranges in the order of [`Self::DIMENSIONS`].
    pub ranges: [Range; 5],
    /// How block angles are compared.
    pub angle: AngleMetric,
}

impl Normalization {
    /// Names of the dimensions, in order.
    pub const DIMENSIONS: [&str; 5] = ["eef_x", "eef_y", "object_x", "object_y", "object_theta"];

    /// Computes the ranges over `frames`. Angles are first wrapped into `[0, 2π)`.
    pub fn over(frames: &[IndexedFrame], angle: AngleMetric) -> Self {
        let mut ranges = [Range::EMPTY; 5];
        for frame in frames {
            for (range, value) in ranges.iter_mut().zip(raw(frame.eef.x, frame.eef.y, frame.object)) {
                *range = range.including(Range {
                    minimum: value,
                    maximum: value,
                });
            }
        }
        Self { ranges, angle }
    }

    /// The normalisation of all frames, from those of several sets of frames with the same angle metric. `None` if there is no set. Bit
    /// for bit the same as [`Self::over`] all frames, in whichever order they are.
    pub fn merged(parts: impl IntoIterator<Item = Self>) -> Option<Self> {
        parts.into_iter().reduce(|all, part| Self {
            ranges: std::array::from_fn(|i| all.ranges[i].including(part.ranges[i])),
            angle: all.angle,
        })
    }

    fn apply(&self, values: [f64; 5]) -> [f64; 5] {
        let mut out = values;
        for (value, range) in out.iter_mut().zip(&self.ranges) {
            *value = (*value - range.minimum) / range.span();
        }
        out
    }

    /// Returns the normalised coordinates of a frame.
    pub fn frame(&self, frame: &IndexedFrame) -> [f64; 5] {
        self.apply(raw(frame.eef.x, frame.eef.y, frame.object))
    }

    /// Returns the normalised coordinates of a query.
    pub fn query(&self, query: &Query) -> [f64; 5] {
        self.apply(raw(query.eef.x, query.eef.y, query.object))
    }

    /// Returns the length of 2π in normalised units, or infinity for [`AngleMetric::Raw`], which does not wrap.
    pub fn period(&self) -> f64 {
        match self.angle {
            AngleMetric::Periodic => TAU / self.ranges[4].span(),
            AngleMetric::Raw => f64::INFINITY,
        }
    }
}

/// Returns whether squared differences between such coordinates stay finite.
pub(crate) fn in_bounds(normalized: &[f64; 5]) -> bool {
    normalized.iter().all(|v| v.abs() < 1e100)
}

fn raw(eef_x: f64, eef_y: f64, object: re4_geometry::Pose2) -> [f64; 5] {
    [eef_x, eef_y, object.x, object.y, wrap_to_two_pi(object.theta)]
}

/// Squared `d_o` between normalised states.
///
/// The index and the linear scan both use this expression with this order of operations, so that equal distances are
/// bit-identical and ties are resolved in the same way.
#[inline]
pub(crate) fn object_squared(a: &[f64; 5], x: f64, y: f64, theta: f64, period: f64) -> f64 {
    let (dx, dy) = (a[2] - x, a[3] - y);
    let direct = (a[4] - theta).abs();
    let angle = direct.min((period - direct).abs());
    dx * dx + dy * dy + angle * angle
}

/// Lower bound of [`object_squared`] over the poses in a box.
///
/// It uses the same order of operations as [`object_squared`]. Rounding is monotonic, so the bound is valid for the rounded
/// distances without a tolerance.
#[inline]
pub(crate) fn box_squared(a: &[f64; 5], low: [f64; 3], high: [f64; 3], period: f64) -> f64 {
    let outside = |q: f64, i: usize| larger(larger(low[i] - q, q - high[i]), 0.0);
    let (dx, dy) = (outside(a[2], 0), outside(a[3], 1));
    let (nearest, farthest) = (outside(a[4], 2), larger(a[4] - low[2], high[2] - a[4]));
    // In the opposite direction around the circle, the nearest angle of the box is the one that is farthest in the direct
    // direction.
    let around = larger(period - farthest, 0.0);
    let angle = if around < nearest { around } else { nearest };
    dx * dx + dy * dy + angle * angle
}

/// Maximum that compiles to one instruction. Unlike `f64::max` it does not handle NaN, which cannot occur here.
#[inline]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Squared `d_q`, computed from the end-effector coordinates and the squared `d_o`.
#[inline]
pub(crate) fn state_squared(a: &[f64; 5], x: f64, y: f64, object_squared: f64) -> f64 {
    let (dx, dy) = (a[0] - x, a[1] - y);
    dx * dx + dy * dy + object_squared
}

/// Largest squared `d_o` at which a frame of a demonstration is a candidate for stage 1.
#[inline]
pub(crate) fn admissible_squared(minimum_object_squared: f64, epsilon: f64) -> f64 {
    let limit = minimum_object_squared.sqrt() + epsilon;
    // The square of a rounded root can be smaller than the minimum, which would exclude the minimum frame itself.
    (limit * limit).max(minimum_object_squared)
}

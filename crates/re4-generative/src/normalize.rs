//! Normalisation of observations and actions.

use serde::{Deserialize, Serialize};

use crate::GenerativeError;
use crate::windows::Demo;

/// Dimensions with a smaller range are only shifted, because scaling would amplify their noise.
const MINIMUM_RANGE: f64 = 1e-4;

/// How a dimension is normalised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Its range in the demonstrations is mapped to [-1, 1].
    Range,
    /// It is left as it is, for instance because it is an entry of a rotation matrix.
    Unchanged,
}

/// An affine map of every dimension: `normalised = (value - offset) / scale`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Normalizer {
    /// Offset of every dimension, in its own unit.
    pub offset: Vec<f64>,
    /// Scale of every dimension, in its own unit.
    pub scale: Vec<f64>,
}

impl Normalizer {
    /// The normalisation of vectors with dimensions of these kinds. `rows` yields all vectors.
    pub fn fit<'a>(kinds: &[Kind], rows: impl Iterator<Item = &'a [f64]>) -> Self {
        let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; kinds.len()];
        for row in rows {
            for ([minimum, maximum], value) in ranges.iter_mut().zip(row) {
                *minimum = minimum.min(*value);
                *maximum = maximum.max(*value);
            }
        }
        let mut own = Self {
            offset: Vec::with_capacity(kinds.len()),
            scale: Vec::with_capacity(kinds.len()),
        };
        for (kind, [minimum, maximum]) in kinds.iter().zip(ranges) {
            let (offset, scale) = match kind {
                Kind::Unchanged => (0.0, 1.0),
                Kind::Range if maximum - minimum < MINIMUM_RANGE => (0.5 * (minimum + maximum), 1.0),
                Kind::Range => (0.5 * (minimum + maximum), 0.5 * (maximum - minimum)),
            };
            own.offset.push(offset);
            own.scale.push(scale);
        }
        own
    }

    /// Number of dimensions.
    pub fn dimensions(&self) -> usize {
        self.offset.len()
    }

    /// Normalises a vector.
    pub fn forward<'a>(&'a self, row: &'a [f64]) -> impl Iterator<Item = f32> + 'a {
        let affine = self.offset.iter().zip(&self.scale);
        row.iter()
            .zip(affine)
            .map(|(value, (offset, scale))| ((value - offset) / scale) as f32)
    }

    /// The inverse of [`Normalizer::forward`].
    pub fn inverse<'a>(&'a self, row: &'a [f32]) -> impl Iterator<Item = f64> + 'a {
        let affine = self.offset.iter().zip(&self.scale);
        row.iter()
            .zip(affine)
            .map(|(value, (offset, scale))| f64::from(*value) * scale + offset)
    }
}

/// Returns an error for the first number of the demonstrations that is not finite.
pub(crate) fn check_finite(demos: &[Demo]) -> Result<(), GenerativeError> {
    for demo in demos {
        for (what, rows) in [("observations", &demo.observations), ("actions", &demo.actions)] {
            for (frame, row) in rows.iter().enumerate() {
                if let Some(dimension) = row.iter().position(|value| !value.is_finite()) {
                    return Err(GenerativeError::NotFinite {
                        what,
                        demo: demo.number,
                        frame,
                        dimension,
                    });
                }
            }
        }
    }
    Ok(())
}

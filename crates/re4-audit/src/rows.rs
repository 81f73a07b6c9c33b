//! Sequences of vectors of equal length.

/// The vectors of a demonstration, one per frame or one per step.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Rows {
    width: usize,
    values: Vec<f64>,
}

impl Rows {
    /// Creates it from the numbers of all vectors in order.
    pub(crate) fn new(width: usize, values: impl IntoIterator<Item = f64>) -> Self {
        Self {
            width,
            values: values.into_iter().collect(),
        }
    }

    /// Length of a vector.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Iterates over the vectors.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.width.max(1))
    }

    pub(crate) fn get(&self, place: usize) -> Option<&[f64]> {
        self.values.get(place * self.width..(place + 1) * self.width)
    }

    /// Differences between consecutive vectors.
    pub(crate) fn steps(&self) -> Self {
        let later = self.values.iter().skip(self.width);
        Self::new(self.width, later.zip(&self.values).map(|(next, now)| next - now))
    }
}

/// Euclidean length.
pub(crate) fn norm(vector: &[f64]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}

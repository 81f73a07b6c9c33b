//! A latent space: the principal components of feature vectors.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Principal components of a set of vectors, in descending order of their variances.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Latent {
    mean: Vec<f64>,
    /// Unit vectors, with the sign that makes the largest component positive.
    axes: Vec<Vec<f64>>,
    /// Divisor of each component.
    divisors: Vec<f64>,
}

impl Latent {
    /// Finds the first `components` principal components. If `whitening` is w, component c is divided by
    /// `(variance_c + 1e-8)^w`: 0 keeps distances, 0.5 gives every component the variance 1.
    pub(crate) fn fit(rows: &[Vec<f64>], components: usize, whitening: f64) -> Self {
        let dimensions = rows.first().map_or(0, Vec::len);
        if dimensions == 0 {
            return Self::default();
        }
        let count = rows.len().max(1) as f64;
        let mean: Vec<f64> = (0..dimensions)
            .map(|i| rows.iter().map(|row| row[i]).sum::<f64>() / count)
            .collect();
        let mut covariance = DMatrix::<f64>::zeros(dimensions, dimensions);
        for row in rows {
            let centred = DVector::from_iterator(dimensions, row.iter().zip(&mean).map(|(v, m)| v - m));
            covariance.ger(1.0, &centred, &centred, 1.0);
        }
        covariance /= (count - 1.0).max(1.0);
        let eigen = SymmetricEigen::new(covariance);
        let mut order: Vec<usize> = (0..dimensions).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        order.truncate(components);
        let axes = order.iter().map(|&column| {
            let axis: Vec<f64> = eigen.eigenvectors.column(column).iter().copied().collect();
            let largest = axis
                .iter()
                .fold(0.0f64, |best, v| if v.abs() > best.abs() { *v } else { best });
            axis.iter().map(|v| v * largest.signum()).collect()
        });
        let divisors = order
            .iter()
            .map(|&column| (eigen.eigenvalues[column].max(0.0) + 1e-8).powf(whitening));
        Self {
            axes: axes.collect(),
            divisors: divisors.collect(),
            mean,
        }
    }

    /// Returns the coordinates of a vector in the latent space.
    pub(crate) fn of(&self, row: &[f64]) -> Vec<f64> {
        let project = |axis: &Vec<f64>| -> f64 {
            axis.iter()
                .zip(row.iter().zip(&self.mean))
                .map(|(a, (v, m))| a * (v - m))
                .sum()
        };
        self.axes
            .iter()
            .zip(&self.divisors)
            .map(|(axis, divisor)| project(axis) / divisor)
            .collect()
    }
}

/// Squared Euclidean distance.
pub(crate) fn squared(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

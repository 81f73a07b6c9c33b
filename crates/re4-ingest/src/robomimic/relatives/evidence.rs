//! Rows of the table `conventions` for comparisons of poses.

use nalgebra::Isometry3;
use re4_stats::{nearest_rank, sorted, upper_median};

use crate::tables::Convention;

/// Maximum residual (metres or radians) of poses that belong to the same state. Sensors of a running simulation can be one of its
/// steps late (2 ms): this is the motion of an object at 2.5 m/s or 2.5 rad/s. Observations that were made from states are exact.
pub(super) const CLOSE: f64 = 5e-3;

/// Larger one of distance (metres) and angle (radians).
pub(super) fn difference(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let distance = (a.translation.vector - b.translation.vector).norm();
    distance.max(a.rotation.angle_to(&b.rotation))
}

/// Residuals of one hypothesis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit {
    /// 99th percentile; infinite without residuals.
    pub(super) high: f64,
    /// Median.
    pub(super) median: f64,
    /// Number of residuals.
    pub(super) frames: usize,
}

impl Fit {
    pub(super) fn of(residuals: impl Iterator<Item = f64>) -> Self {
        let residuals = sorted(residuals);
        let quantile = |fraction: f64| nearest_rank(&residuals, fraction).unwrap_or(f64::INFINITY);
        Self {
            high: quantile(0.99),
            median: quantile(0.5),
            frames: residuals.len(),
        }
    }

    /// The fit of a file from those of its demonstrations with residuals: the median demonstration. A demonstration that contradicts
    /// the others does not change it; it is found when demonstrations are checked one by one.
    pub(super) fn of_demos(demos: impl Iterator<Item = Self>) -> Self {
        let demos: Vec<Self> = demos.filter(|fit| fit.frames > 0).collect();
        let middle = |value: fn(&Self) -> f64| upper_median(demos.iter().map(value)).unwrap_or(f64::INFINITY);
        Self {
            high: middle(|fit| fit.high),
            median: middle(|fit| fit.median),
            frames: demos.iter().map(|fit| fit.frames).sum(),
        }
    }
}

/// A proven convention; `rival` is the best other hypothesis, if there is one.
pub(super) fn proven(
    convention: &'static str,
    value: String,
    evidence: &str,
    own: Fit,
    rival: Option<Fit>,
    threshold: f64,
) -> Convention {
    Convention {
        convention: convention.into(),
        value: value.into(),
        basis: "proven".into(),
        evidence: evidence.to_owned(),
        residual: Some(own.high),
        runner_up: rival.map(|rival| rival.median).filter(|median| median.is_finite()),
        threshold: Some(threshold),
        unit: "m or rad".into(),
        frames: own.frames,
    }
}

/// A convention without evidence.
pub(super) fn declared(convention: &'static str, value: &'static str, evidence: &str) -> Convention {
    Convention {
        convention: convention.into(),
        value: value.into(),
        basis: "declared".into(),
        evidence: evidence.to_owned(),
        residual: None,
        runner_up: None,
        threshold: None,
        unit: "".into(),
        frames: 0,
    }
}

//! Order statistics.

use serde_json::{Map, Value, json};

/// Sorts values in ascending order.
pub fn sorted(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    values
}

/// Quantile of values in ascending order, with linear interpolation between neighbours, as numpy's default. `None` if there are
/// no values or one is NaN.
///
/// `probability` is clamped to `[0, 1]`.
pub fn quantile(sorted: &[f64], probability: f64) -> Option<f64> {
    // The total order of `sorted` puts negative NaNs first and positive NaNs last.
    if probability.is_nan() || sorted.first()?.is_nan() || sorted.last()?.is_nan() {
        return None;
    }
    let at = probability.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let below = at.floor();
    let (low, high) = (sorted[below as usize], sorted[at.ceil() as usize]);
    Some(low + (high - low) * (at - below))
}

/// Median of values in any order: the middle value, or the mean of the two middle values. `None` if there are no values or one is
/// NaN.
pub fn median(values: &[f64]) -> Option<f64> {
    quantile(&sorted(values.iter().copied()), 0.5)
}

/// The middle value, or the larger of the two middle values, so the result is always one of the values. `None` if there are no
/// values.
pub fn upper_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let values = sorted(values);
    values.get(values.len() / 2).copied()
}

/// Quantile by nearest rank: the smallest of the values, given in ascending order, such that at least this fraction of the values
/// does not exceed it. The result is always one of the values; `None` if there are no values.
pub fn nearest_rank(sorted: &[f64], fraction: f64) -> Option<f64> {
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied()
}

/// Tukey's upper outer fence, Q3 + 3 (Q3 - Q1), of values in any order. `None` if there are no values or one is NaN.
pub fn outer_fence(values: &[f64]) -> Option<f64> {
    let values = sorted(values.iter().copied());
    let (low, high) = (quantile(&values, 0.25)?, quantile(&values, 0.75)?);
    Some(high + 3.0 * (high - low))
}

/// Robust estimate of the standard deviation: 1.4826 times the median absolute deviation, which is correct for normal
/// distributions. `None` if there are no values or one is NaN.
pub fn robust_deviation(values: &[f64]) -> Option<f64> {
    let middle = median(values)?;
    let distances: Vec<f64> = values.iter().map(|value| (value - middle).abs()).collect();
    Some(1.4826 * median(&distances)?)
}

/// Returns quantiles by name, as in summaries of artifacts: `min`, `p50`, `p99`, `max`. Null if there are no values.
pub fn spread(values: impl IntoIterator<Item = f64>, probabilities: &[f64]) -> Value {
    let values = sorted(values);
    if values.is_empty() {
        return Value::Null;
    }
    let named = probabilities.iter().map(|&probability| {
        let name = match probability {
            0.0 => "min".to_owned(),
            1.0 => "max".to_owned(),
            probability => format!("p{:.0}", 100.0 * probability),
        };
        (name, json!(quantile(&values, probability)))
    });
    Value::Object(named.collect::<Map<_, _>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCORES: [f64; 20] = [
        0.31, 0.85, 0.92, 0.44, 1.0, 0.0, 0.67, 0.73, 0.95, 0.88, 0.12, 0.59, 0.99, 0.76, 0.81, 0.38, 0.91, 0.64, 0.97,
        0.55,
    ];

    #[test]
    fn medians_are_exact() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert!((median(&SCORES).unwrap() - 0.745).abs() < 1e-15);
        assert_eq!((median(&[]), median(&[1.0, f64::NAN])), (None, None));
        assert_eq!(upper_median([4.0, 1.0, 2.0, 3.0]), Some(3.0));
        assert_eq!(upper_median([]), None);
    }

    #[test]
    fn quantiles_are_those_of_numpy() {
        // numpy 2.4.6: quantile([1, 2, 4, 8], [0, 0.1, 0.5, 0.9, 1]) = 1, 1.3, 3, 6.8, 8.
        for (probability, expected) in [
            (0.0, 1.0),
            (0.1, 1.3),
            (0.5, 3.0),
            (0.9, 6.8),
            (1.0, 8.0),
            (-1.0, 1.0),
            (9.0, 8.0),
        ] {
            assert!((quantile(&[1.0, 2.0, 4.0, 8.0], probability).unwrap() - expected).abs() < 1e-14);
        }
        assert_eq!((quantile(&[], 0.5), quantile(&[1.0], f64::NAN)), (None, None));
    }

    #[test]
    fn nearest_ranks_are_existing_values() {
        let values = [1.0, 2.0, 3.0, 4.0];
        let found = [0.0, 0.25, 0.5, 0.51, 1.0].map(|fraction| nearest_rank(&values, fraction));
        assert_eq!(found, [1.0, 1.0, 2.0, 3.0, 4.0].map(Some));
        assert_eq!(nearest_rank(&[], 0.5), None);
    }

    #[test]
    fn fences_and_deviations_match_their_formulas() {
        let values = [4.0, 1.0, 3.0, 2.0, 5.0];
        assert_eq!(outer_fence(&values), Some(4.0 + 3.0 * 2.0));
        assert_eq!(robust_deviation(&values), Some(1.4826));
        assert_eq!((outer_fence(&[]), robust_deviation(&[])), (None, None));
    }

    #[test]
    fn quantiles_of_spreads_are_named() {
        let found = spread([3.0, 1.0, 2.0], &[0.0, 0.5, 0.99, 1.0]);
        assert_eq!(found.to_string(), r#"{"min":1.0,"p50":2.0,"p99":2.98,"max":3.0}"#);
        assert!(spread([], &[0.5]).is_null());
    }
}

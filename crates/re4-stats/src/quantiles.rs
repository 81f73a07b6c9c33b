//! Order statistics.

use serde_json::{Map, Value, json};

/// The values in ascending order.
pub fn sorted(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    values
}

/// Quantile of values in ascending order, linear between neighbours, as numpy's default; none of nothing and of data with a NaN.
///
/// `share` is taken to the nearest number in `[0, 1]`.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    // NaNs are at the ends of the order.
    if share.is_nan() || sorted.first()?.is_nan() || sorted.last()?.is_nan() {
        return None;
    }
    let at = share.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let below = at.floor();
    let (low, high) = (sorted[below as usize], sorted[at.ceil() as usize]);
    Some(low + (high - low) * (at - below))
}

/// Middle value, or the mean of the two middle values, of values in any order; none of nothing and of data with a NaN.
pub fn median(values: &[f64]) -> Option<f64> {
    quantile(&sorted(values.iter().copied()), 0.5)
}

/// The upper one of the two middle values, or the middle one: a value that occurs.
pub fn upper_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let values = sorted(values);
    values.get(values.len() / 2).copied()
}

/// Minimum value that at least this fraction of the values, in ascending order, does not exceed: a value that occurs.
pub fn nearest_rank(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied()
}

/// Tukey's upper outer fence, Q3 + 3 (Q3 - Q1).
pub fn outer_fence(values: &[f64]) -> Option<f64> {
    let values = sorted(values.iter().copied());
    let (low, high) = (quantile(&values, 0.25)?, quantile(&values, 0.75)?);
    Some(high + 3.0 * (high - low))
}

/// Standard deviation as estimated from the median absolute deviation: 1.4826 of it, which is right for a normal distribution.
pub fn robust_deviation(values: &[f64]) -> Option<f64> {
    let middle = median(values)?;
    let distances: Vec<f64> = values.iter().map(|value| (value - middle).abs()).collect();
    Some(1.4826 * median(&distances)?)
}

/// Quantiles by name, as summaries state them: `min`, `p50`, `p99`, `max`. Null of nothing.
pub fn spread(values: impl IntoIterator<Item = f64>, shares: &[f64]) -> Value {
    let values = sorted(values);
    if values.is_empty() {
        return Value::Null;
    }
    let named = shares.iter().map(|&share| {
        let name = match share {
            0.0 => "min".to_owned(),
            1.0 => "max".to_owned(),
            share => format!("p{:.0}", 100.0 * share),
        };
        (name, json!(quantile(&values, share)))
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
    fn medians() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert!((median(&SCORES).unwrap() - 0.745).abs() < 1e-15);
        assert_eq!((median(&[]), median(&[1.0, f64::NAN])), (None, None));
        assert_eq!(upper_median([4.0, 1.0, 2.0, 3.0]), Some(3.0));
        assert_eq!(upper_median([]), None);
    }

    #[test]
    fn quantiles() {
        // numpy 2.4.6: quantile([1, 2, 4, 8], [0, 0.1, 0.5, 0.9, 1]) = 1, 1.3, 3, 6.8, 8.
        for (share, expected) in [
            (0.0, 1.0),
            (0.1, 1.3),
            (0.5, 3.0),
            (0.9, 6.8),
            (1.0, 8.0),
            (-1.0, 1.0),
            (9.0, 8.0),
        ] {
            assert!((quantile(&[1.0, 2.0, 4.0, 8.0], share).unwrap() - expected).abs() < 1e-14);
        }
        assert_eq!((quantile(&[], 0.5), quantile(&[1.0], f64::NAN)), (None, None));
    }

    #[test]
    fn nearest_ranks_are_values_that_occur() {
        let values = [1.0, 2.0, 3.0, 4.0];
        let found = [0.0, 0.25, 0.5, 0.51, 1.0].map(|share| nearest_rank(&values, share));
        assert_eq!(found, [1.0, 1.0, 2.0, 3.0, 4.0].map(Some));
        assert_eq!(nearest_rank(&[], 0.5), None);
    }

    #[test]
    fn fences_and_deviations_are_those_of_the_textbook() {
        let values = [4.0, 1.0, 3.0, 2.0, 5.0];
        assert_eq!(outer_fence(&values), Some(4.0 + 3.0 * 2.0));
        assert_eq!(robust_deviation(&values), Some(1.4826));
        assert_eq!((outer_fence(&[]), robust_deviation(&[])), (None, None));
    }

    #[test]
    fn spreads_have_names() {
        let found = spread([3.0, 1.0, 2.0], &[0.0, 0.5, 0.99, 1.0]);
        assert_eq!(found.to_string(), r#"{"min":1.0,"p50":2.0,"p99":2.98,"max":3.0}"#);
        assert!(spread([], &[0.5]).is_null());
    }
}

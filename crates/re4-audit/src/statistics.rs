//! Robust statistics.

/// A quantile by linear interpolation between the order statistics; none of nothing.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let place = share.clamp(0.0, 1.0) * last as f64;
    let below = place.floor() as usize;
    let (low, high) = (*sorted.get(below)?, *sorted.get((below + 1).min(last))?);
    Some(low + (high - low) * (place - below as f64))
}

/// The median.
pub fn median(values: &[f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// Tukey's upper outer fence, Q3 + 3 (Q3 - Q1).
pub(crate) fn outer_fence(values: &[f64]) -> Option<f64> {
    let (low, high) = (quantile(values, 0.25)?, quantile(values, 0.75)?);
    Some(high + 3.0 * (high - low))
}

/// Standard deviation as estimated from the median absolute deviation: 1.4826 of it, which is right for a normal distribution.
pub(crate) fn robust_deviation(values: &[f64]) -> Option<f64> {
    let middle = median(values)?;
    let distances: Vec<f64> = values.iter().map(|value| (value - middle).abs()).collect();
    Some(1.4826 * median(&distances)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_textbook() {
        let values = [4.0, 1.0, 3.0, 2.0, 5.0];
        assert_eq!(median(&values), Some(3.0));
        assert_eq!(quantile(&values, 0.25), Some(2.0));
        assert_eq!(quantile(&values, 0.9), Some(4.6));
        assert_eq!(outer_fence(&values), Some(4.0 + 3.0 * 2.0));
        assert_eq!(robust_deviation(&values), Some(1.4826));
        assert_eq!(median(&[]), None);
    }
}

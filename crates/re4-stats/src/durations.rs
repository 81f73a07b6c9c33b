//! Quantiles of durations in bounded memory.

use std::time::Duration;

/// Number of classes per power of two: the width of a class is below 1 % of its values.
const CLASSES: usize = 128;
const CLASS_BITS: u32 = CLASSES.trailing_zeros();

/// Counts of durations in classes of nanoseconds. The mean and the maximum are exact; a quantile is the middle of its class, at
/// most 0.4 % away from a value.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Durations {
    counts: Vec<u64>,
    count: u64,
    total: u128,
    maximum: u64,
}

impl Durations {
    /// Adds a duration.
    pub fn add(&mut self, duration: Duration) {
        let nanoseconds = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        let class = class_of(nanoseconds);
        if self.counts.len() <= class {
            self.counts.resize(class + 1, 0);
        }
        self.counts[class] += 1;
        self.count += 1;
        self.total += u128::from(nanoseconds);
        self.maximum = self.maximum.max(nanoseconds);
    }

    /// Number of durations.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Arithmetic mean in microseconds; `None` if there are no durations.
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.total as f64 / self.count as f64 / 1e3)
    }

    /// Longest duration in microseconds; `None` if there are no durations.
    pub fn maximum(&self) -> Option<f64> {
        (self.count > 0).then(|| self.maximum as f64 / 1e3)
    }

    /// Quantile by nearest rank, in microseconds; `None` if there are no durations. `probability` is clamped to `[0, 1]`.
    pub fn quantile(&self, probability: f64) -> Option<f64> {
        let rank = ((probability.clamp(0.0, 1.0) * self.count as f64).ceil() as u64).max(1);
        let mut seen = 0;
        let class = self.counts.iter().position(|count| {
            seen += count;
            seen >= rank
        })?;
        Some(middle_of(class) / 1e3)
    }
}

/// Below [`CLASSES`], each number is a class. Above, the class is the exponent and the leading bits after the first.
fn class_of(value: u64) -> usize {
    if value < CLASSES as u64 {
        return value as usize;
    }
    let exponent = value.ilog2();
    let leading = (value >> (exponent - CLASS_BITS)) as usize - CLASSES;
    (exponent - CLASS_BITS + 1) as usize * CLASSES + leading
}

fn middle_of(class: usize) -> f64 {
    let (octave, leading) = (class / CLASSES, class % CLASSES);
    if octave == 0 {
        return leading as f64;
    }
    let width = (1_u64 << (octave - 1)) as f64;
    (CLASSES + leading) as f64 * width + (width - 1.0) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn classes_are_contiguous_and_contain_their_middle() {
        let mut last = 0;
        for value in (0..100_000_u64).chain([1 << 40, u64::MAX]) {
            let class = class_of(value);
            assert!(class == last || class == last + 1 || value > 100_000, "{value}");
            last = class;
            let middle = middle_of(class);
            assert!(
                (middle - value as f64).abs() <= 0.004 * value as f64 + 0.5,
                "{value} {middle}"
            );
        }
        assert!(Durations::default().quantile(0.5).is_none() && Durations::default().mean().is_none());
    }

    proptest! {
        #[test]
        fn quantiles_are_within_half_a_percent(mut values in prop::collection::vec(0..5_000_000_000_u64, 1..200), p in 0.0..1.0f64) {
            let mut durations = Durations::default();
            for &value in &values {
                durations.add(Duration::from_nanos(value));
            }
            values.sort_unstable();
            let rank = ((p * values.len() as f64).ceil() as usize).max(1);
            let expected = values[rank - 1] as f64 / 1e3;
            prop_assert!((durations.quantile(p).unwrap() - expected).abs() <= 0.004 * expected + 1e-3);
            prop_assert_eq!(durations.maximum().unwrap(), *values.last().unwrap() as f64 / 1e3);
            let mean = values.iter().map(|&value| value as f64).sum::<f64>() / values.len() as f64 / 1e3;
            prop_assert!((durations.mean().unwrap() - mean).abs() <= 1e-9 * mean.max(1.0));
            prop_assert_eq!(durations.count(), values.len() as u64);
        }
    }
}

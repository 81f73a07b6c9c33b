//! Means and proportions with 95 % confidence intervals.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng;
use serde::{Deserialize, Serialize};

use crate::{quantile, sorted};

/// Number of values from which [`mean_interval`] resamples blocks of values instead of single ones.
const BLOCKED_FROM: usize = 100_000;

/// Number of blocks.
const BLOCKS: usize = 10_000;

/// Number of bootstrap resamples of [`mean_interval`].
pub const RESAMPLES: usize = 10_000;

/// The 97.5 % quantile of the standard normal distribution (scipy 1.17.1, `norm.ppf(0.975)`).
const NORMAL_QUANTILE: f64 = 1.959_963_984_540_054;

/// An estimate with its 95 % confidence interval, all in the unit of the data.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Arithmetic mean; NaN if there are no values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Mean with its percentile bootstrap interval: the 2.5 % and 97.5 % quantiles of the means of [`RESAMPLES`] resamples
/// (Efron and Tibshirani 1993, section 13.3).
///
/// The same values in the same order and the same seed give the same bits on every machine. All three numbers are NaN if there
/// are no values or one is NaN. For a single value all three are equal, which does not mean that the mean is certain.
///
/// From 100,000 values on, the unit that is resampled is a block of consecutive values, of which there are 10,000. The means of blocks vary
/// as much as the values predict, so the interval is the same but for the noise of resampling, and its cost no longer grows with the
/// number of values. If values that follow each other are alike, the interval is wider, as it should be.
///
/// The interval describes the variation between samples of episodes, so repeated runs of the same episode must be averaged first.
pub fn mean_interval(values: &[f64], seed: u64) -> Interval {
    let value = mean(values);
    if value.is_nan() {
        return Interval {
            value,
            low: f64::NAN,
            high: f64::NAN,
        };
    }
    if values.len() >= BLOCKED_FROM {
        return blocked_interval(value, values, seed);
    }
    let n = values.len();
    let means = resampled(n, seed, |sum, at| (sum.0 + values[at], n));
    percentiles(value, means)
}

/// [`mean_interval`] for many values. The sums are added block by block, in order.
fn blocked_interval(value: f64, values: &[f64], seed: u64) -> Interval {
    let n = values.len();
    let end = |block: usize| n * block / BLOCKS;
    let blocks: Vec<(f64, usize)> = (0..BLOCKS)
        .map(|block| &values[end(block)..end(block + 1)])
        .map(|block| (block.iter().sum(), block.len()))
        .collect();
    let means = resampled(BLOCKS, seed, |(sum, count), at| {
        (sum + blocks[at].0, count + blocks[at].1)
    });
    percentiles(value, means)
}

/// The means of [`RESAMPLES`] resamples, each of `n` indices below `n`. `add` adds the value at an index to a sum and a number of values.
fn resampled(n: usize, seed: u64, add: impl Fn((f64, usize), usize) -> (f64, usize)) -> Vec<f64> {
    // Any fixed stream number is suitable, because the seed selects the state.
    let mut generator = Pcg64::new(u128::from(seed), 0x5245_3452_4550_4f52);
    let mean = |_| {
        // The upper half of a 64 x 64 bit product is an index below n, uniform to within n / 2^64.
        let chosen = (0..n).map(|_| ((u128::from(generator.next_u64()) * n as u128) >> 64) as usize);
        // Negative zero is the neutral element of the addition of floats.
        let (sum, count) = chosen.fold((-0.0, 0), &add);
        sum / count as f64
    };
    (0..RESAMPLES).map(mean).collect()
}

fn percentiles(value: f64, means: Vec<f64>) -> Interval {
    let means = sorted(means);
    let end = |probability| quantile(&means, probability).unwrap_or(f64::NAN);
    Interval {
        value,
        low: end(0.025),
        high: end(0.975),
    }
}

/// Fraction of successes in `n` trials with its Wilson score interval, without continuity correction (Wilson 1927).
///
/// Without trials the fraction is NaN and the interval is `[0, 1]`. `successes` is clamped to `n`.
pub fn wilson_interval(successes: u64, n: u64) -> Interval {
    if n == 0 {
        return Interval {
            value: f64::NAN,
            low: 0.0,
            high: 1.0,
        };
    }
    let trials = n as f64;
    let fraction = successes.min(n) as f64 / trials;
    let z2 = NORMAL_QUANTILE * NORMAL_QUANTILE;
    let centre = fraction + z2 / (2.0 * trials);
    let spread = NORMAL_QUANTILE * (fraction * (1.0 - fraction) / trials + z2 / (4.0 * trials * trials)).sqrt();
    let scale = 1.0 + z2 / trials;
    Interval {
        value: fraction,
        // The formulas give exactly 0 and 1 here, but with rounding errors of about 1e-17.
        low: if successes == 0 { 0.0 } else { (centre - spread) / scale },
        high: if successes >= n { 1.0 } else { (centre + spread) / scale },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SCORES: [f64; 20] = [
        0.31, 0.85, 0.92, 0.44, 1.0, 0.0, 0.67, 0.73, 0.95, 0.88, 0.12, 0.59, 0.99, 0.76, 0.81, 0.38, 0.91, 0.64, 0.97,
        0.55,
    ];

    #[test]
    fn wilson_intervals_are_those_of_scipy() {
        // scipy 1.17.1: binomtest(k, n).proportion_ci(0.95, method="wilson")
        for (k, n, low, high) in [
            (0, 10, 0.0, 0.277_532_799_862_889_26),
            (3, 10, 0.107_791_267_406_301_02, 0.603_221_852_538_854_6),
            (10, 10, 0.722_467_200_137_110_9, 1.0),
            (45, 50, 0.786_397_685_625_203_4, 0.956_524_235_068_109_5),
            (1, 1, 0.206_549_314_377_237_45, 1.0),
            (190, 206, 0.877_568_988_568_590_3, 0.951_628_449_239_35),
            (500, 1000, 0.469_069_600_368_104_2, 0.530_930_399_631_895_8),
            (0, 1, 0.0, 0.793_450_685_622_762_6),
        ] {
            let interval = wilson_interval(k, n);
            assert_eq!(interval.value, k as f64 / n as f64);
            assert!((interval.low - low).abs() < 1e-14, "{k} of {n}: {interval:?}");
            assert!((interval.high - high).abs() < 1e-14, "{k} of {n}: {interval:?}");
        }
        let nothing = wilson_interval(0, 0);
        assert!(nothing.value.is_nan() && nothing.low == 0.0 && nothing.high == 1.0);
    }

    #[test]
    fn bootstrap_intervals_are_close_to_those_of_scipy() {
        // scipy 1.17.1: bootstrap((SCORES,), np.mean, n_resamples=2_000_000, method="percentile") gives 0.542 and 0.793; with
        // 10,000 resamples, five seeds gave 0.5410 to 0.5445 and 0.7915 to 0.7965.
        let mut lower_ends = Vec::new();
        for seed in 0..5 {
            let interval = mean_interval(&SCORES, seed);
            assert!((interval.value - 0.6735).abs() < 1e-15);
            assert!((interval.low - 0.542).abs() < 0.005, "{interval:?}");
            assert!((interval.high - 0.793).abs() < 0.005, "{interval:?}");
            assert_eq!(interval, mean_interval(&SCORES, seed));
            lower_ends.push(interval.low.to_bits());
        }
        lower_ends.dedup();
        assert!(lower_ends.len() > 1, "the seed has no effect");
    }

    #[test]
    fn the_bootstrap_of_coin_flips_is_binomial() {
        // scipy 1.17.1: binom.ppf([0.025, 0.975], 100, 0.5) = 40, 60 and binom.ppf([0.025, 0.975], 20, 0.8) = 12, 19;
        // the probabilities next to these values differ enough from 2.5 % that 10,000 resamples give the same result.
        for (k, n, low, high) in [(50, 100, 0.40, 0.60), (16, 20, 0.60, 0.95)] {
            let flips: Vec<f64> = (0..n).map(|i| f64::from(u8::from(i < k))).collect();
            let interval = mean_interval(&flips, 1);
            assert_eq!((interval.low, interval.high), (low, high));
        }
    }

    #[test]
    fn intervals_of_many_values_are_those_of_single_resampled_values() {
        // Without blocks, the interval of independent values is within 1 % of the normal one.
        let mut generator = Pcg64::new(3, 5);
        let values: Vec<f64> = (0..BLOCKED_FROM + 17)
            .map(|_| f64::from(u8::from(generator.next_u64() % 10 < 7)))
            .collect();
        let n = values.len() as f64;
        let interval = mean_interval(&values, 0);
        let half = NORMAL_QUANTILE * (interval.value * (1.0 - interval.value) / n).sqrt();
        assert!((interval.value - 0.7).abs() < 3.0 * half);
        for end in [interval.value - interval.low, interval.high - interval.value] {
            assert!((end / half - 1.0).abs() < 0.04, "{end} and {half}");
        }
        // Constant values have no interval, wherever the blocks end.
        let same = mean_interval(&vec![0.25; BLOCKED_FROM + 1], 0);
        assert_eq!((same.low, same.high), (0.25, 0.25));
    }

    #[test]
    fn single_values_and_nans_are_handled() {
        let one = mean_interval(&[0.3], 7);
        assert_eq!((one.value, one.low, one.high), (0.3, 0.3, 0.3));
        for values in [&[][..], &[0.1, f64::NAN]] {
            let broken = mean_interval(values, 7);
            assert!(broken.value.is_nan() && broken.low.is_nan() && broken.high.is_nan());
        }
        let text = serde_json::to_string(&one).unwrap();
        assert_eq!(text, r#"{"value":0.3,"low":0.3,"high":0.3}"#);
        assert_eq!(serde_json::from_str::<Interval>(&text).unwrap(), one);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn intervals_are_equivariant_under_shift_and_scale(
            values in prop::collection::vec(-5.0..5.0f64, 2..40), shift in -3.0..3.0f64, scale in 0.1..4.0f64, seed: u64,
        ) {
            let moved: Vec<f64> = values.iter().map(|v| scale * v + shift).collect();
            let (a, b) = (mean_interval(&values, seed), mean_interval(&moved, seed));
            for (x, y) in [(a.value, b.value), (a.low, b.low), (a.high, b.high)] {
                prop_assert!((scale * x + shift - y).abs() < 1e-9);
            }
            prop_assert!(a.low <= a.high);
            let range = values.iter().fold((f64::MAX, f64::MIN), |r, &v| (r.0.min(v), r.1.max(v)));
            prop_assert!(range.0 - 1e-12 <= a.low && a.high <= range.1 + 1e-12);
        }

        #[test]
        fn the_wilson_interval_contains_the_fraction(n in 1..500u64, k in 0..500u64) {
            let k = k.min(n);
            let i = wilson_interval(k, n);
            prop_assert!(0.0 <= i.low && i.low <= i.value && i.value <= i.high && i.high <= 1.0);
            let mirrored = wilson_interval(n - k, n);
            prop_assert!((i.low + mirrored.high - 1.0).abs() < 1e-12);
        }
    }
}

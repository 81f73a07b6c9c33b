//! Comparisons of two policies on the same seeds.

use serde::{Deserialize, Serialize};

use crate::{Interval, mean_interval};

/// The exact sign test of paired values (Dixon and Mood 1946). For successes and failures it is the exact McNemar test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SignTest {
    /// Number of pairs whose value is larger than that of the baseline.
    pub better: u64,
    /// Number of pairs whose value is smaller.
    pub worse: u64,
    /// Number of pairs with equal values. The test leaves them out.
    pub equal: u64,
    /// Two-sided probability of a split at least as uneven, if both directions were equally likely; 1 if all pairs are equal.
    pub p: f64,
}

/// Tests whether `values` tend to be larger or smaller than the `baseline` of the same seeds. `None` if the numbers of values
/// differ or a value is NaN.
pub fn sign_test(values: &[f64], baseline: &[f64]) -> Option<SignTest> {
    if values.len() != baseline.len() || values.iter().chain(baseline).any(|value| value.is_nan()) {
        return None;
    }
    let count =
        |larger: fn(f64, f64) -> bool| values.iter().zip(baseline).filter(|&(&a, &b)| larger(a, b)).count() as u64;
    let (better, worse) = (count(|a, b| a > b), count(|a, b| a < b));
    Some(SignTest {
        better,
        worse,
        equal: values.len() as u64 - better - worse,
        p: (2.0 * lower_tail(better.min(worse), better + worse)).min(1.0),
    })
}

/// Probability of at most `k` heads in `n` tosses of a fair coin.
fn lower_tail(k: u64, n: u64) -> f64 {
    // The largest term, C(n, k) / 2^n. Halving with every factor would underflow and the binomial coefficient would overflow, so
    // the value is halved whenever it exceeds 1. Only products and quotients are used, which are the same on every machine.
    let (mut largest, mut halvings) = (1.0_f64, 0);
    for i in 1..=k {
        largest *= (n - k + i) as f64 / i as f64;
        while largest > 1.0 && halvings < n {
            largest *= 0.5;
            halvings += 1;
        }
    }
    while halvings < n && largest > 0.0 {
        largest *= 0.5;
        halvings += 1;
    }
    // The other terms as fractions of the largest: C(n, j - 1) = C(n, j) j / (n - j + 1).
    let (mut term, mut sum) = (1.0, 1.0);
    for j in (1..=k).rev() {
        term *= j as f64 / (n - j + 1) as f64;
        sum += term;
        if term < f64::EPSILON * 1e-3 {
            break;
        }
    }
    largest * sum
}

/// Mean difference between `values` and the `baseline` of the same seeds, with its 95 % percentile bootstrap interval: pairs are
/// resampled, see [`mean_interval`]. `None` if the numbers of values differ.
pub fn paired_interval(values: &[f64], baseline: &[f64], seed: u64) -> Option<Interval> {
    if values.len() != baseline.len() {
        return None;
    }
    let differences: Vec<f64> = values.iter().zip(baseline).map(|(a, b)| a - b).collect();
    Some(mean_interval(&differences, seed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{mean, nearest_rank, sorted};
    use proptest::prelude::*;

    /// The test by enumeration: all directions of the unequal pairs.
    fn enumerated(better: u32, worse: u32) -> f64 {
        let n = better + worse;
        let extreme = better.min(worse);
        let uneven = (0..1_u32 << n).filter(|signs| signs.count_ones().min(n - signs.count_ones()) <= extreme);
        uneven.count() as f64 / f64::from(1_u32 << n)
    }

    fn split(better: usize, worse: usize, equal: usize) -> (Vec<f64>, Vec<f64>) {
        let values = [vec![1.0; better], vec![0.0; worse], vec![0.5; equal]].concat();
        let baseline = [vec![0.0; better], vec![1.0; worse], vec![0.5; equal]].concat();
        (values, baseline)
    }

    #[test]
    fn the_sign_test_counts_all_directions_of_the_unequal_pairs() {
        for better in 0..9 {
            for worse in 0..9 {
                let (values, baseline) = split(better, worse, 3);
                let test = sign_test(&values, &baseline).unwrap();
                assert_eq!((test.better, test.worse, test.equal), (better as u64, worse as u64, 3));
                let expected = enumerated(better as u32, worse as u32);
                assert!(
                    (test.p - expected).abs() < 1e-14,
                    "{better} {worse}: {} {expected}",
                    test.p
                );
                let mirrored = sign_test(&baseline, &values).unwrap();
                assert_eq!(
                    (mirrored.better, mirrored.worse, mirrored.p),
                    (test.worse, test.better, test.p)
                );
            }
        }
    }

    #[test]
    fn many_pairs_neither_overflow_nor_underflow() {
        // Python 3.13: 2 * sum(math.comb(n, j) for j in range(k + 1)) / 2 ** n as a fraction.
        for (k, n, expected) in [
            (40, 100, 0.056_887_933_640_980_79),
            (450, 1000, 0.001_730_536_084_976_317_6),
            (4900, 10_000, 0.046_585_527_704_947_39),
            (0, 300, 9.818_186_930_595_453e-91),
        ] {
            let (values, baseline) = split(k, n - k, 0);
            let p = sign_test(&values, &baseline).unwrap().p;
            assert!((p / expected - 1.0).abs() < 1e-11, "{k} of {n}: {p:e}");
        }
        let (values, baseline) = split(0, 3000, 0);
        assert_eq!(sign_test(&values, &baseline).unwrap().p, 0.0);
    }

    #[test]
    fn values_of_other_numbers_of_seeds_are_not_paired() {
        assert_eq!(sign_test(&[1.0], &[1.0, 0.0]), None);
        assert_eq!(sign_test(&[f64::NAN], &[1.0]), None);
        assert_eq!(paired_interval(&[1.0], &[1.0, 0.0], 0), None);
        assert_eq!(sign_test(&[], &[]).unwrap().p, 1.0);
    }

    /// All means of resamples of four pairs, with the same probability each.
    fn all_resamples(differences: &[f64; 4]) -> Vec<f64> {
        let pick = |digits: usize| (0..4).map(move |i| differences[(digits >> (2 * i)) & 3]);
        sorted((0..256).map(|digits| mean(&pick(digits).collect::<Vec<_>>())))
    }

    #[test]
    fn the_bootstrap_of_four_pairs_is_that_of_all_their_resamples() {
        let (values, baseline) = ([0.9, 0.4, 0.8, 0.6], [0.5, 0.6, 0.1, 0.5]);
        let interval = paired_interval(&values, &baseline, 3).unwrap();
        let differences = [0.9 - 0.5, 0.4 - 0.6, 0.8 - 0.1, 0.6 - 0.5];
        let exact = all_resamples(&differences);
        assert!((interval.value - mean(&differences)).abs() < 1e-15);
        // A quantile of 10,000 resamples lies between the exact quantiles at probabilities a few standard errors away.
        for (found, probability) in [(interval.low, 0.025), (interval.high, 0.975)] {
            let at = |p: f64| nearest_rank(&exact, p).unwrap();
            let (low, high) = (at(probability - 0.006), at(probability + 0.006));
            assert!(low <= found && found <= high, "{found} is not in [{low}, {high}]");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        #[test]
        fn pairs_with_equal_differences_have_no_spread(baseline in prop::collection::vec(0.0..1.0f64, 1..30), shift in -1.0..1.0f64) {
            let values: Vec<f64> = baseline.iter().map(|value| value + shift).collect();
            let interval = paired_interval(&values, &baseline, 0).unwrap();
            prop_assert!((interval.low - shift).abs() < 1e-12 && (interval.high - shift).abs() < 1e-12);
        }

        #[test]
        fn p_falls_as_the_split_becomes_uneven(n in 1..400_u64, k in 0..200_u64) {
            let k = k.min(n / 2);
            let p = |k: u64| (2.0 * lower_tail(k, n)).min(1.0);
            prop_assert!(0.0 <= p(k) && p(k) <= 1.0);
            prop_assert!(k == 0 || p(k - 1) <= p(k));
        }
    }
}

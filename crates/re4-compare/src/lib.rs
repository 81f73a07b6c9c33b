//! Comparisons of policies on the same seeds: the scores of cells with intervals, paired differences from a baseline, and the tables
//! of a `comparison` artifact.
//!
//! A cell is a policy under a pipeline: the row names the policy, the column the pipeline. [`Outcomes`] are the values of a cell's
//! rollouts, one per seed. [`compare`] makes the rows of the tables.

mod curves;
mod measure;
mod outcomes;
mod tables;

pub use curves::curves;
pub use measure::Measure;
pub use outcomes::Outcomes;
pub use tables::{CellRow, CurveRow, DifferenceRow};

use re4_stats::{Interval, mean_interval, paired_interval, sign_test, wilson_interval};

/// Seed of all bootstraps. It is that of the summaries of rollouts, so that intervals are the same there.
pub const BOOTSTRAP_SEED: u64 = 0;

/// The mean of a measure with its 95 % interval: Wilson for success, percentile bootstrap for the other measures.
pub fn score(measure: Measure, values: &[f64]) -> Interval {
    match measure {
        Measure::Success => {
            let successes = values.iter().filter(|&&value| value > 0.5).count();
            wilson_interval(successes as u64, values.len() as u64)
        }
        Measure::Score | Measure::Coverage | Measure::Iou => mean_interval(values, BOOTSTRAP_SEED),
    }
}

/// Why the outcomes of two cells cannot be compared pair by pair; `None` if they can.
pub fn unpaired(one: &Outcomes, other: &Outcomes) -> Option<String> {
    if one.seeds().len() != other.seeds().len() {
        return Some(format!("{} and {} seeds", one.seeds().len(), other.seeds().len()));
    }
    let differing = one.seeds().iter().zip(other.seeds()).find(|(a, b)| a != b);
    differing.map(|(a, b)| format!("seed {a} and seed {b} in the same place"))
}

/// The differences between a cell and the baseline's cell in the same column, one row per measure that both have. Empty if the
/// seeds differ, see [`unpaired`].
pub fn differences(
    [row, baseline, column]: [&str; 3],
    measures: &[Measure],
    outcomes: &Outcomes,
    against: &Outcomes,
) -> Vec<DifferenceRow> {
    if unpaired(outcomes, against).is_some() {
        return Vec::new();
    }
    let of = |&measure: &Measure| {
        let (values, others) = (outcomes.of(measure)?, against.of(measure)?);
        let interval = paired_interval(values, others, BOOTSTRAP_SEED)?;
        let test = sign_test(values, others)?;
        Some(DifferenceRow {
            row: row.to_owned().into(),
            baseline: baseline.to_owned().into(),
            column: column.to_owned().into(),
            measure,
            pairs: values.len() as u32,
            difference: interval.value,
            low: interval.low,
            high: interval.high,
            better: test.better as u32,
            worse: test.worse as u32,
            equal: test.equal as u32,
            p: test.p,
        })
    };
    measures.iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcomes(seeds: &[u32], successes: &[bool]) -> Outcomes {
        let values = successes.iter().map(|&success| f64::from(u8::from(success))).collect();
        Outcomes::new(seeds.to_vec(), [(Measure::Success, values)])
    }

    #[test]
    fn a_difference_counts_the_seeds_that_only_one_policy_solves() {
        let seeds = [500, 501, 502, 503];
        let ours = outcomes(&seeds, &[true, true, true, false]);
        let baseline = outcomes(&seeds, &[true, false, false, false]);
        let rows = differences(["a", "b", "c"], &Measure::ALL, &ours, &baseline);
        let [row] = rows.as_slice() else { panic!("{rows:?}") };
        assert_eq!((row.measure, row.pairs, row.difference), (Measure::Success, 4, 0.5));
        assert_eq!((row.better, row.worse, row.equal), (2, 0, 2));
        // Both unequal pairs point in the same direction: 2 of the 4 possible ways.
        assert_eq!(row.p, 0.5);
        assert!(row.low <= 0.5 && 0.5 <= row.high);
    }

    #[test]
    fn other_seeds_are_not_paired() {
        let one = outcomes(&[1, 2], &[true, true]);
        for (seeds, why) in [
            (vec![1, 3], "seed 2 and seed 3 in the same place"),
            (vec![1], "2 and 1 seeds"),
        ] {
            let other = outcomes(&seeds, &vec![false; seeds.len()]);
            assert_eq!(unpaired(&one, &other).unwrap(), why);
            assert_eq!(differences(["a", "b", "c"], &[Measure::Success], &one, &other), []);
        }
        assert_eq!(unpaired(&one, &one), None);
    }

    #[test]
    fn the_interval_of_success_is_wilsons() {
        let values = [1.0, 1.0, 0.0, 1.0];
        assert_eq!(score(Measure::Success, &values), wilson_interval(3, 4));
        assert_eq!(score(Measure::Score, &values), mean_interval(&values, 0));
    }
}

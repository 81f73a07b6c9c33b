//! Results of rollouts under smaller step budgets.

/// Number of control steps between two budgets in the paper's curve (figure "Sparse Observations": 50, 100, ..., 500).
const BUDGET_SPACING: u32 = 50;

/// Returns the step budgets at which rollouts of at most `max_steps` steps are compared: 50, 100, ... and finally `max_steps`.
pub fn budgets(max_steps: u32) -> Vec<u32> {
    let mut budgets: Vec<u32> = (1..=max_steps / BUDGET_SPACING).map(|i| i * BUDGET_SPACING).collect();
    if budgets.last() != Some(&max_steps) {
        budgets.push(max_steps);
    }
    budgets
}

/// Returns the maximum of the first `budget` values for each budget, at least 0. `values` are the values after each step of one
/// rollout.
///
/// A rollout that ended before the budget, because it succeeded, keeps its maximum. Budgets may have any order.
pub fn running_maxima(values: &[f64], budgets: &[u32]) -> Vec<f64> {
    let mut maximum = 0.0;
    let running: Vec<f64> = values
        .iter()
        .map(|&value| {
            maximum = f64::max(maximum, value);
            maximum
        })
        .collect();
    budgets
        .iter()
        .map(|&budget| {
            let within = running.len().min(budget as usize);
            within.checked_sub(1).map_or(0.0, |last| running[last])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn budgets_are_multiples_of_50_and_the_last_step() {
        assert_eq!(budgets(200), [50, 100, 150, 200]);
        assert_eq!(budgets(120), [50, 100, 120]);
        assert_eq!(budgets(50), [50]);
        assert_eq!(budgets(7), [7]);
    }

    #[test]
    fn the_maximum_grows_with_the_budget_and_is_kept_after_an_early_end() {
        let values = [0.1, 0.5, 0.3, 0.9, 0.2];
        assert_eq!(running_maxima(&values, &[1, 2, 3, 4, 5]), [0.1, 0.5, 0.5, 0.9, 0.9]);
        assert_eq!(running_maxima(&values, &[50, 3, 0]), [0.9, 0.5, 0.0]);
        assert_eq!(running_maxima(&[], &[0, 50]), [0.0, 0.0]);
    }

    proptest! {
        #[test]
        fn it_is_the_maximum_of_the_first_values(values in prop::collection::vec(0.0..1.0f64, 0..60), budget in 0..80u32) {
            let naive = values.iter().take(budget as usize).copied().fold(0.0, f64::max);
            prop_assert_eq!(running_maxima(&values, &[budget]), vec![naive]);
        }
    }
}

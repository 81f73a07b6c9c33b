//! What rollouts would have reached with fewer steps.

/// Control steps between two budgets of the paper's curve (figure "Sparse Observations": 50, 100, ..., 500).
const BUDGET_SPACING: u32 = 50;

/// Step budgets at which rollouts of at most `max_steps` are compared: 50, 100, ... and last `max_steps` itself.
pub fn budgets(max_steps: u32) -> Vec<u32> {
    let mut budgets: Vec<u32> = (1..=max_steps / BUDGET_SPACING).map(|i| i * BUDGET_SPACING).collect();
    if budgets.last() != Some(&max_steps) {
        budgets.push(max_steps);
    }
    budgets
}

/// Maximum value within each of the budgets, for the values after each step of one rollout; 0 before the first step.
///
/// A rollout that ended early, because it succeeded, keeps its maximum. Budgets may come in any order.
pub fn running_maxima(values: &[f64], budgets: &[u32]) -> Vec<f64> {
    let mut most = 0.0;
    let running: Vec<f64> = values
        .iter()
        .map(|&value| {
            most = f64::max(most, value);
            most
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
    fn budgets_go_in_fifties_to_the_last_step() {
        assert_eq!(budgets(200), [50, 100, 150, 200]);
        assert_eq!(budgets(120), [50, 100, 120]);
        assert_eq!(budgets(50), [50]);
        assert_eq!(budgets(7), [7]);
    }

    #[test]
    fn the_maximum_grows_with_the_budget_and_stays_after_an_early_end() {
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

//! Scores of rollouts under smaller budgets of control steps.

use rayon::prelude::*;
use re4_artifact::{columns, table};
use re4_rollout::{PlaneResultRow, PlaneStepRow};
use re4_stats::{Interval, budgets, mean_interval, wilson_interval};

/// Seed of the bootstrap. It is fixed so that intervals are the same in every run.
pub(super) const BOOTSTRAP_SEED: u64 = 0;

columns! {
    /// A mean with its 95 % interval.
    #[derive(Copy)]
    pub struct MeanColumns {
        /// Mean over the rollouts of each rollout's maximum within the budget.
        pub mean: f64,
        /// Lower end of its interval.
        pub low: f64,
        /// Upper end of its interval.
        pub high: f64,
    }
}

columns! {
    /// A rate with its 95 % interval.
    #[derive(Copy)]
    pub struct RateColumns {
        /// Fraction of the rollouts that succeeded within the budget.
        pub rate: f64,
        /// Lower end of its interval.
        pub low: f64,
        /// Upper end of its interval.
        pub high: f64,
    }
}

table! {
    /// Scores of the rollouts under a budget of control steps. One row per budget: every 50 steps up to the maximum, and the
    /// maximum. A rollout that ended with success keeps its maxima for all larger budgets. 95 % intervals: percentile bootstrap
    /// for means, Wilson for the success rate. Sorted by budget.
    #[table("budgets", version = 1)]
    #[domain = "plane"]
    #[derive(Copy)]
    pub struct BudgetRow {
        /// Number of control steps that are counted.
        pub budget: u32,
        /// Number of rollouts.
        pub rollouts: u32,
        /// Score.
        pub score: MeanColumns,
        /// Coverage.
        pub coverage: MeanColumns,
        /// IoU.
        pub iou: MeanColumns,
        /// Success.
        pub success: RateColumns,
    }
}

impl From<Interval> for MeanColumns {
    fn from(Interval { value, low, high }: Interval) -> Self {
        Self { mean: value, low, high }
    }
}

impl From<Interval> for RateColumns {
    fn from(Interval { value, low, high }: Interval) -> Self {
        Self { rate: value, low, high }
    }
}

/// A budget, and each rollout's maxima within it.
struct Budget {
    steps: u32,
    score: Vec<f64>,
    coverage: Vec<f64>,
    iou: Vec<f64>,
    successes: u64,
}

/// All budgets of a set of rollouts.
pub(super) struct Budgets(Vec<Budget>);

impl Budgets {
    /// The budgets of rollouts of at most `max_steps` steps; see [`budgets`].
    pub(super) fn up_to(max_steps: u32) -> Self {
        let budget = |steps| Budget {
            steps,
            score: Vec::new(),
            coverage: Vec::new(),
            iou: Vec::new(),
            successes: 0,
        };
        Self(budgets(max_steps).into_iter().map(budget).collect())
    }

    /// Adds rollouts and their steps, in the same order.
    pub(super) fn add(&mut self, results: &[PlaneResultRow], steps: &[PlaneStepRow]) {
        let mut rest = steps.iter();
        for result in results {
            let (mut score, mut coverage, mut iou, mut taken) = (0.0_f64, 0.0_f64, 0.0_f64, 0);
            // After the last step of the rollout, the maxima remain the same for all larger budgets.
            for budget in &mut self.0 {
                let until = budget.steps.min(result.core.steps);
                for step in rest.by_ref().take((until - taken) as usize) {
                    score = score.max(step.score);
                    coverage = coverage.max(step.coverage);
                    iou = iou.max(step.iou);
                }
                taken = until;
                budget.score.push(score);
                budget.coverage.push(coverage);
                budget.iou.push(iou);
                // Success ends a rollout, so it is reached exactly with the rollout's last step.
                budget.successes += u64::from(result.core.success && taken == result.core.steps);
            }
        }
    }

    /// The rows of table `budgets`.
    pub(super) fn rows(&self) -> Vec<BudgetRow> {
        self.0.par_iter().map(Budget::row).collect()
    }
}

impl Budget {
    fn row(&self) -> BudgetRow {
        let mean = |values: &[f64]| MeanColumns::from(mean_interval(values, BOOTSTRAP_SEED));
        BudgetRow {
            budget: self.steps,
            rollouts: self.score.len() as u32,
            score: mean(&self.score),
            coverage: mean(&self.coverage),
            iou: mean(&self.iou),
            success: wilson_interval(self.successes, self.score.len() as u64).into(),
        }
    }
}

//! What rollouts had reached under smaller budgets of steps.

use rayon::prelude::*;
use re4_artifact::{columns, table};
use re4_rollout::{PlaneResultRow, PlaneStepRow};
use re4_stats::{Interval, budgets, mean_interval, wilson_interval};

/// Seed of the bootstrap, so that intervals are the same in every run.
pub(super) const BOOTSTRAP_SEED: u64 = 0;

columns! {
    /// A mean with its interval.
    #[derive(Copy)]
    pub struct MeanColumns {
        /// Mean over the rollouts of the maximum value within the budget.
        pub mean: f64,
        /// Lower end of its interval.
        pub low: f64,
        /// Upper end of its interval.
        pub high: f64,
    }
}

columns! {
    /// A rate with its interval.
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
    /// One row a budget of control steps, every 50 up to the maximum and the maximum itself: what the rollouts of this artifact
    /// had reached by then. A rollout that ended by success keeps its maxima. Intervals are those of 95 %: percentile bootstrap
    /// of the mean, Wilson for the success rate. Sorted by budget.
    #[table("budgets", version = 1)]
    #[domain = "plane"]
    #[derive(Copy)]
    pub struct BudgetRow {
        /// Control steps that count.
        pub budget: u32,
        /// Rollouts behind every figure of the row.
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

/// One budget, and what every rollout had reached by it.
struct Budget {
    steps: u32,
    score: Vec<f64>,
    coverage: Vec<f64>,
    iou: Vec<f64>,
    successes: u64,
}

/// Every budget of a set of rollouts.
pub(super) struct Budgets(Vec<Budget>);

impl Budgets {
    /// The budgets of rollouts of at most `max_steps`, as [`budgets`] has them.
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

    /// Adds rollouts, with their steps in the same order.
    pub(super) fn add(&mut self, results: &[PlaneResultRow], steps: &[PlaneStepRow]) {
        let mut rest = steps.iter();
        for result in results {
            let (mut score, mut coverage, mut iou, mut taken) = (0.0_f64, 0.0_f64, 0.0_f64, 0);
            // Once the steps are used up, the maxima stay for all budgets that are left.
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
                // Success ends a rollout.
                budget.successes += u64::from(result.core.success && taken == result.core.steps);
            }
        }
    }

    /// The table.
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

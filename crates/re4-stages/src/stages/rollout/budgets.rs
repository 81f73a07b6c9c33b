//! What rollouts had reached under smaller budgets of steps.

use rayon::prelude::*;
use re4_artifact::{Columns, tables};
use re4_stats::{Interval, budgets, mean_interval, wilson_interval};

use super::{BOOTSTRAP_SEED, EpisodeRollout};

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

    /// Adds rollouts.
    pub(super) fn add(&mut self, episodes: &[EpisodeRollout]) {
        for episode in episodes {
            let (mut score, mut coverage, mut iou, mut success) = (0.0_f64, 0.0_f64, 0.0_f64, false);
            // Once the steps are used up, the maxima stay for all budgets that are left.
            let mut steps = episode.steps.iter();
            let mut spent = 0;
            for budget in &mut self.0 {
                for step in steps.by_ref().take((budget.steps - spent) as usize) {
                    score = score.max(step.after.score);
                    coverage = coverage.max(step.after.coverage);
                    iou = iou.max(step.after.iou);
                    success |= step.after.success;
                }
                spent = budget.steps;
                budget.score.push(score);
                budget.coverage.push(coverage);
                budget.iou.push(iou);
                budget.successes += u64::from(success);
            }
        }
    }

    /// The table.
    pub(super) fn columns(&self) -> Columns {
        let intervals: Vec<[Interval; 4]> = self.0.par_iter().map(Budget::intervals).collect();
        let rollouts = self.0.iter().map(|budget| budget.score.len() as u32);
        let mut columns = Columns::new(&tables::BUDGETS)
            .u32("budget", self.0.iter().map(|budget| budget.steps).collect())
            .u32("rollouts", rollouts.collect());
        for (measure, [value, low, high]) in BUDGET_MEASURES.into_iter().enumerate() {
            let of = |part: fn(&Interval) -> f64| intervals.iter().map(|row| part(&row[measure])).collect::<Vec<f64>>();
            columns = columns
                .f64(value, of(|interval| interval.value))
                .f64(low, of(|interval| interval.low))
                .f64(high, of(|interval| interval.high));
        }
        columns
    }
}

/// Columns of the table, measure by measure.
pub const BUDGET_MEASURES: [[&str; 3]; 4] = [
    ["score_mean", "score_low", "score_high"],
    ["coverage_mean", "coverage_low", "coverage_high"],
    ["iou_mean", "iou_low", "iou_high"],
    ["success_rate", "success_low", "success_high"],
];

impl Budget {
    fn intervals(&self) -> [Interval; 4] {
        [
            mean_interval(&self.score, BOOTSTRAP_SEED),
            mean_interval(&self.coverage, BOOTSTRAP_SEED),
            mean_interval(&self.iou, BOOTSTRAP_SEED),
            wilson_interval(self.successes, self.score.len() as u64),
        ]
    }
}

//! Results as a function of the step budget.

use re4_rollout::PlaneStepRow;
use re4_stats::{Interval, budgets, mean, mean_interval, running_maxima};
use serde::Serialize;

use super::Plane;
use crate::html::rollouts::Rollouts;

/// Seed of the bootstrap. The summaries of the artifacts use the same seed, so that the interval of the last budget equals theirs.
const BOOTSTRAP_SEED: u64 = 0;

/// Maximum number of points of a plotted curve.
const CURVE_POINTS: u32 = 256;

/// Means over rollouts of the best value that they reached within a step budget.
#[derive(Debug, Serialize)]
pub struct Curve {
    /// Budgets in the table.
    pub budgets: Vec<u32>,
    /// Mean scaled score for each budget in the table.
    pub score: Vec<Interval>,
    /// Mean coverage for each budget in the table.
    pub coverage: Vec<Interval>,
    /// Budgets of the plotted line.
    pub steps: Vec<u32>,
    /// Mean scaled score for each budget of the line.
    pub score_line: Vec<f64>,
    /// Mean coverage for each budget of the line.
    pub coverage_line: Vec<f64>,
}

impl Curve {
    pub(super) fn of(artifact: &Rollouts<Plane>) -> Self {
        let marks = budgets(artifact.max_steps);
        let spacing = artifact.max_steps.div_ceil(CURVE_POINTS).max(1);
        let steps: Vec<u32> = (1..=artifact.max_steps)
            .filter(|step| step % spacing == 0 || *step == artifact.max_steps)
            .collect();
        // One column per budget, with one value per rollout.
        let columns = |value: fn(&PlaneStepRow) -> f64, at: &[u32]| -> Vec<Vec<f64>> {
            let mut columns = vec![Vec::with_capacity(artifact.rollouts.len()); at.len()];
            for rollout in &artifact.rollouts {
                let values: Vec<f64> = rollout.steps.iter().map(value).collect();
                for (column, best) in columns.iter_mut().zip(running_maxima(&values, at)) {
                    column.push(best);
                }
            }
            columns
        };
        let intervals = |value| -> Vec<Interval> {
            let columns = columns(value, &marks);
            columns
                .iter()
                .map(|column| mean_interval(column, BOOTSTRAP_SEED))
                .collect()
        };
        let line = |value| -> Vec<f64> { columns(value, &steps).iter().map(|column| mean(column)).collect() };
        Self {
            score: intervals(|step| step.score),
            coverage: intervals(|step| step.coverage),
            score_line: line(|step| step.score),
            coverage_line: line(|step| step.coverage),
            budgets: marks,
            steps,
        }
    }
}

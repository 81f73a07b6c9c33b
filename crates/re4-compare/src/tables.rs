//! The tables of a `comparison` artifact.

use re4_artifact::{Label, table};

use crate::Measure;

table! {
    /// One row per cell and measure of a suite: a policy under a pipeline, its mean over the seeds, and the figure that the paper
    /// prints for it. Cells are in the order of the suite, column by column; the first measure of a cell is the one that is
    /// printed. 95 % intervals: Wilson for success, percentile bootstrap of the mean (10,000 resamples, seed 0) otherwise.
    #[table("cells", version = 1)]
    pub struct CellRow {
        /// Name of the row in the suite.
        pub row: Label,
        /// Name of the column in the suite.
        pub column: Label,
        /// Path of the pipeline file as in the suite.
        pub pipeline: Label,
        /// Kind of the policy. Null if the cell has no valid pipeline.
        pub policy: Option<Label>,
        /// The measure.
        pub measure: Measure,
        /// Number of rollouts. Null if the cell cannot run.
        pub rollouts: Option<u32>,
        /// Mean over the rollouts. Null if the cell cannot run.
        pub value: Option<f64>,
        /// Lower end of its interval.
        pub low: Option<f64>,
        /// Upper end of its interval.
        pub high: Option<f64>,
        /// The figure that the suite states as printed elsewhere. Null if it states none.
        pub printed: Option<f64>,
        /// Maximum length of an episode in control steps. Null if the cell cannot run.
        pub max_steps: Option<u32>,
        /// Seeds of the rollouts as in the pipeline. Null if rollouts start from scenes.
        pub seeds: Option<String>,
        /// Size of the artifacts and files that the policy and its pose estimator open.
        #[unit = "B"]
        pub carried: Option<u64>,
        /// Key of the rollouts artifact. Null if the cell cannot run.
        pub rollouts_key: Option<String>,
        /// Why the cell cannot run, in one sentence. Null if it ran.
        pub error: Option<String>,
    }
}

table! {
    /// One row per cell, except those of the baseline, and measure: the difference from the baseline's cell in the same column over
    /// equal seeds. 95 % interval: percentile bootstrap of the mean difference over pairs (10,000 resamples, seed 0). The order is
    /// that of table cells.
    #[table("differences", version = 1)]
    pub struct DifferenceRow {
        /// Name of the row in the suite.
        pub row: Label,
        /// Name of the baseline's row.
        pub baseline: Label,
        /// Name of the column in the suite.
        pub column: Label,
        /// The measure.
        pub measure: Measure,
        /// Number of seeds.
        pub pairs: u32,
        /// Mean difference: the row minus the baseline.
        pub difference: f64,
        /// Lower end of its interval.
        pub low: f64,
        /// Upper end of its interval.
        pub high: f64,
        /// Number of seeds with a larger value than the baseline. For success: seeds that only the row solves.
        pub better: u32,
        /// Number of seeds with a smaller value. For success: seeds that only the baseline solves.
        pub worse: u32,
        /// Number of seeds with the same value.
        pub equal: u32,
        /// Two-sided probability of the exact sign test over the unequal pairs; for success, this is the exact McNemar test. Not
        /// corrected for the number of comparisons.
        pub p: f64,
    }
}

table! {
    /// Scores under a budget of control steps, for the cells of Push-T: each rollout's maximum within the budget, and their mean.
    /// One row per cell, measure and budget: every 50 steps up to the maximum, and the maximum. Intervals as in table cells.
    #[table("curves", version = 1)]
    pub struct CurveRow {
        /// Name of the row in the suite.
        pub row: Label,
        /// Name of the column in the suite.
        pub column: Label,
        /// The measure.
        pub measure: Measure,
        /// Number of control steps that are counted.
        pub budget: u32,
        /// Mean over the rollouts.
        pub value: f64,
        /// Lower end of its interval.
        pub low: f64,
        /// Upper end of its interval.
        pub high: f64,
    }
}

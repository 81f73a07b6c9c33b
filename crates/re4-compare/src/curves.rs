//! Scores under smaller budgets of control steps, from the table `budgets` of rollouts.

use re4_artifact::{Artifact, ArtifactError, columns};

use crate::{CurveRow, Measure};

columns! {
    /// A mean with its interval.
    #[derive(Copy)]
    pub struct MeanOf {
        /// The mean.
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
    pub struct RateOf {
        /// The rate.
        pub rate: f64,
        /// Lower end of its interval.
        pub low: f64,
        /// Upper end of its interval.
        pub high: f64,
    }
}

columns! {
    /// A row of the table `budgets`.
    #[derive(Copy)]
    pub struct BudgetOf {
        /// Number of control steps that are counted.
        pub budget: u32,
        /// Score.
        pub score: MeanOf,
        /// Coverage.
        pub coverage: MeanOf,
        /// IoU.
        pub iou: MeanOf,
        /// Success.
        pub success: RateOf,
    }
}

impl BudgetOf {
    fn of(&self, measure: Measure) -> MeanOf {
        match measure {
            Measure::Score => self.score,
            Measure::Coverage => self.coverage,
            Measure::Iou => self.iou,
            Measure::Success => MeanOf {
                mean: self.success.rate,
                low: self.success.low,
                high: self.success.high,
            },
        }
    }
}

/// The curves of a cell, measure by measure. Empty for rollouts of robosuite tasks, which have no table `budgets`.
///
/// # Errors
/// If the table cannot be read.
pub fn curves(
    rollouts: &Artifact,
    [row, column]: [&str; 2],
    measures: &[Measure],
) -> Result<Vec<CurveRow>, ArtifactError> {
    const BUDGETS: &str = "budgets";
    if !rollouts.manifest().tables.contains_key(BUDGETS) {
        return Ok(Vec::new());
    }
    let budgets: Vec<BudgetOf> = rollouts.table_named(BUDGETS)?.read()?;
    let curve = |&measure: &Measure| {
        let point = move |budget: &BudgetOf| {
            let MeanOf { mean, low, high } = budget.of(measure);
            CurveRow {
                row: row.to_owned().into(),
                column: column.to_owned().into(),
                measure,
                budget: budget.budget,
                value: mean,
                low,
                high,
            }
        };
        budgets.iter().map(point).collect::<Vec<_>>()
    };
    Ok(measures.iter().flat_map(curve).collect())
}

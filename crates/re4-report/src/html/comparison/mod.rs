//! A self-contained HTML page of a comparison: the table of all cells beside the printed figures, paired differences from the
//! baseline, curves over step budgets, costs and the protocol.
//!
//! The page needs no script. Its bytes depend only on [`Comparison`].

mod curves;
mod format;
mod sections;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use maud::html;
use re4_compare::{CellRow, CurveRow, DifferenceRow, Measure};
use serde_json::json;

use super::shell::{self, Document};

pub(crate) use format::probability;

/// The content of the page.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// Key of the `comparison` artifact.
    pub key: String,
    /// Title.
    pub title: String,
    /// What the comparison is about; may be empty.
    pub about: String,
    /// Where the printed figures are from; may be empty.
    pub printed_in: String,
    /// Name of the baseline's row.
    pub baseline: Option<String>,
    /// Names of the rows.
    pub rows: Vec<String>,
    /// The columns.
    pub columns: Vec<Column>,
    /// The cells, column by column.
    pub cells: Vec<Cell>,
    /// Paired differences.
    pub differences: Vec<DifferenceRow>,
    /// Scores under smaller budgets.
    pub curves: Vec<CurveRow>,
    /// Sentences of the artifact's warnings.
    pub warnings: Vec<String>,
}

/// A column.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Its name.
    pub name: String,
    /// Printed figures by the name of the row, also of cells that are left out.
    pub printed: BTreeMap<String, f64>,
}

/// A cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// Its rows of table `cells`, the printed measure first. Not empty.
    pub scores: Vec<CellRow>,
    /// Overrides of its pipeline.
    pub overrides: Vec<String>,
    /// What it cost; `None` if its rollouts were not found.
    pub cost: Option<Cost>,
}

/// What a cell cost, from the records of runs. A time is `None` if there is no record of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Cost {
    /// The training.
    pub training: Training,
    /// Wall times of the policy's calls.
    pub actions: Option<Times>,
    /// Wall times of the calls in which the policy made a decision.
    pub decisions: Option<Times>,
    /// Number of threads that ran rollouts at the same time.
    pub threads: Option<u64>,
    /// End of the run, in seconds since 1970.
    pub finished: Option<u64>,
}

/// The training that a cell's policy or pose estimator needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Training {
    /// Nothing is trained.
    Nothing,
    /// Wall time in seconds.
    Took(f64),
    /// Something is trained, but there is no record of it.
    Unrecorded,
}

/// Quantiles of wall times in microseconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Times {
    /// Median.
    pub p50: f64,
    /// 99 % quantile.
    pub p99: f64,
}

impl Comparison {
    fn cell(&self, row: &str, column: &str) -> Option<&Cell> {
        self.cells
            .iter()
            .find(|cell| cell.first().row == *row && cell.first().column == *column)
    }

    /// Every measure that a cell has.
    fn measures(&self) -> Vec<Measure> {
        let has = |measure: &Measure| self.cells.iter().any(|cell| cell.score(*measure).is_some());
        Measure::ALL.into_iter().filter(has).collect()
    }

    fn is_baseline(&self, row: &str) -> bool {
        self.baseline.as_deref() == Some(row)
    }

    /// The measure of a column's printed figures.
    fn printed_measure(&self, column: &str) -> Option<Measure> {
        let cell = self.cells.iter().find(|cell| cell.first().column == *column)?;
        Some(cell.first().measure)
    }
}

impl Cell {
    /// The row of the printed measure. A cell has at least one measure.
    fn first(&self) -> &CellRow {
        &self.scores[0]
    }

    fn score(&self, measure: Measure) -> Option<&CellRow> {
        self.scores.iter().find(|score| score.measure == measure)
    }
}

const STYLE: &str = include_str!("page.css");

/// Makes the page.
#[must_use]
pub fn page(comparison: &Comparison) -> String {
    let body = html! {
        (sections::header(comparison))
        main {
            (sections::table(comparison))
            (sections::failures(comparison))
            (sections::differences(comparison))
            (curves::section(comparison))
            (sections::costs(comparison))
            (sections::measures(comparison))
            (sections::protocol(comparison))
        }
        (shell::footer_with(
            &html! { "with " code { "re4-pipe compare" } },
            "Scores are the same for the same artifacts; times are those of the recorded runs.",
            [("", "comparison", comparison.key.as_str())].into_iter(),
        ))
    };
    Document {
        tool_version: &comparison.tool_version,
        title: comparison.title.clone(),
        style: STYLE,
        script: &[],
        data: &json!({}),
        body,
    }
    .render()
}

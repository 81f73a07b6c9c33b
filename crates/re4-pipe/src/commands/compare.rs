//! `re4-pipe compare`: runs the cells of a suite, and writes the `comparison` artifact and its page.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use re4_compare::{CellRow, DifferenceRow};
use re4_report::comparison_page;
use re4_stages::{Cell, Compared, Suite, compare_inputs, compare_shard, read_suite};
use serde_json::{Value, json};

use super::Outcome;
use super::plan::sources_of;
use super::suite::session;
use crate::arguments::{Common, CompareArguments};
use crate::console::Console;
use crate::output::Output;

/// `re4-pipe compare`.
pub(crate) fn compare(arguments: &CompareArguments) -> Result<Outcome> {
    let start = Instant::now();
    let CompareArguments {
        common, suite: file, ..
    } = arguments;
    let selected = &arguments.selected;
    let selection = selected.selection(arguments.seeds.clone(), arguments.set.clone());
    let (suite, cells) = read_suite(file, &selection)?;
    let plan = arguments.plan.as_deref();
    let hashes = plan.map(sources_of).transpose()?.unwrap_or_default();
    if let Some(shard) = arguments.shard {
        let session = session(common, &hashes)?;
        let run = if arguments.inputs {
            compare_inputs
        } else {
            compare_shard
        };
        return Err(run(&session, file, &cells, shard)?.into());
    }
    let page = Page::at(arguments.output.as_deref(), file, &cells)?;
    let session = session(common, &hashes)?;
    let compared = re4_stages::compare(&session, &suite, &cells)?;
    page.finish(common, file, &suite, &compared, start)
}

/// The page of a comparison.
pub(super) struct Page {
    path: PathBuf,
    output: Output,
}

impl Page {
    /// Checks the path of the page before any cell runs.
    pub(super) fn at(path: Option<&Path>, file: &Path, cells: &[Cell]) -> Result<Self> {
        let default = || PathBuf::from(file.file_stem().unwrap_or_default()).with_extension("html");
        let path = path.map_or_else(default, Path::to_path_buf);
        let output = Output::at(&path, "page")?;
        let inputs = cells.iter().flat_map(Cell::inputs).chain([file.to_path_buf()]);
        output.refuse_inputs(&inputs.collect::<Vec<_>>())?;
        Ok(Self { path, output })
    }

    /// Writes the page and prints the comparison.
    pub(super) fn finish(
        &self,
        common: &Common,
        file: &Path,
        suite: &Suite,
        compared: &Compared,
        start: Instant,
    ) -> Result<Outcome> {
        let console = Console::new(common);
        let page = comparison_page(&compared.built.artifact, &common.artifacts)?;
        self.output.write(&page)?;
        let size = page.len() as f64 / 1e6;
        console.note(&format!("{:>10}  {}  {size:.1} MB", "page", self.path.display()));
        let mut answer = compared.built.to_json();
        for (name, value) in [
            ("suite", json!(file)),
            ("page", json!(self.path)),
            ("failed", json!(compared.failed)),
            ("cells", compared.cells.iter().map(cell_json).collect()),
            (
                "differences",
                compared.differences.iter().map(difference_json).collect(),
            ),
            ("wall_s", json!(start.elapsed().as_secs_f64())),
        ] {
            answer[name] = value;
        }
        console.answer(&answer)?;
        console.say(&text(suite, compared)?)?;
        Ok(if compared.failed == 0 {
            Outcome::Done
        } else {
            Outcome::GateFailed
        })
    }
}

fn cell_json(row: &CellRow) -> Value {
    json!({
        "row": &*row.row,
        "column": &*row.column,
        "pipeline": &*row.pipeline,
        "policy": row.policy.as_deref(),
        "measure": row.measure,
        "rollouts": row.rollouts,
        "value": row.value,
        "low": row.low,
        "high": row.high,
        "printed": row.printed,
        "carried_bytes": row.carried,
        "rollouts_key": row.rollouts_key,
        "error": row.error,
    })
}

fn difference_json(row: &DifferenceRow) -> Value {
    json!({
        "row": &*row.row,
        "baseline": &*row.baseline,
        "column": &*row.column,
        "measure": row.measure,
        "pairs": row.pairs,
        "difference": row.difference,
        "low": row.low,
        "high": row.high,
        "better": row.better,
        "worse": row.worse,
        "equal": row.equal,
        "p": row.p,
    })
}

/// One table per column: each row's printed measure, the figure printed elsewhere, and the difference from the baseline.
fn text(suite: &Suite, compared: &Compared) -> Result<String> {
    let mut text = suite.title.clone();
    let width = suite.row.iter().map(|row| row.name.chars().count()).max().unwrap_or(0);
    for column in &suite.column {
        let cells: Vec<&CellRow> = compared
            .cells
            .iter()
            .filter(|cell| cell.column == *column.name)
            .collect();
        let Some(first) = cells.first() else { continue };
        write!(text, "\n\n{}: {}, 95 % interval", column.name, first.measure.title())?;
        for cell in cells.iter().filter(|cell| cell.measure == first.measure) {
            write!(text, "\n  {:<width$}  ", &*cell.row)?;
            let (Some(value), Some(low), Some(high)) = (cell.value, cell.low, cell.high) else {
                write!(text, "cannot run: {}", cell.error.as_deref().unwrap_or_default())?;
                continue;
            };
            write!(text, "{value:.3} [{low:.3}, {high:.3}]")?;
            if let Some(printed) = cell.printed {
                write!(text, "  printed {printed:.3}")?;
            }
            let own =
                |row: &&DifferenceRow| (&row.row, &row.column, row.measure) == (&cell.row, &cell.column, cell.measure);
            if let Some(row) = compared.differences.iter().find(own) {
                write!(
                    text,
                    "  difference from {} {:+.3} [{:+.3}, {:+.3}], p {}",
                    row.baseline,
                    row.difference,
                    row.low,
                    row.high,
                    if row.p < 0.001 {
                        "< 0.001".to_owned()
                    } else {
                        format!("{:.3}", row.p)
                    }
                )?;
            }
        }
    }
    if compared.failed > 0 {
        let noun = if compared.failed == 1 { "cell" } else { "cells" };
        write!(text, "\n\n{} {noun} cannot run", compared.failed)?;
    }
    Ok(text)
}

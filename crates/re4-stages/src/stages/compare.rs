//! The stage `compare`: runs the cells of a suite one after another and makes `comparison` from their `rollouts`.

mod shards;

use std::collections::BTreeMap;

use anyhow::{Result, bail};
use re4_artifact::{Artifact, ArtifactSummary, Key, Label, Manifest, Recipe, Row as _, Stage};
use re4_compare::{CellRow, CurveRow, DifferenceRow, Outcomes, curves, differences, score, unpaired};
use re4_fault::Remedy as _;
use re4_policy::kinds::PolicyCard;
use re4_pose::AnchorRow;
use serde_json::{Value, json};

use crate::inputs::estimators::{CONFIDENCE, WEIGHTS};
use crate::notes::fault_of;
use crate::parts::Share;
use crate::runner::{Built, Runner, Session};
use crate::suite::{Cell, Suite};

pub use shards::{PlannedCell, PlannedSuite, compare_inputs, compare_shard, merge_comparison, planned_suite};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 1;

/// A comparison, and what it consists of.
pub struct Compared {
    /// The `comparison` artifact.
    pub built: Built,
    /// The rows of its table `cells`.
    pub cells: Vec<CellRow>,
    /// The rows of its table `differences`.
    pub differences: Vec<DifferenceRow>,
    /// Number of cells that cannot run.
    pub failed: usize,
}

/// What a cell's rollouts contribute to the comparison.
struct Ran {
    key: Key,
    outcomes: Outcomes,
    curves: Vec<CurveRow>,
    carried: u64,
}

/// Runs the cells of a suite, in their order, and makes the `comparison` artifact. A cell that cannot run is recorded with the
/// sentence of its error.
///
/// # Errors
/// If the run is interrupted, or the artifact cannot be written.
pub fn compare(session: &Session, suite: &Suite, cells: &[Cell]) -> Result<Compared> {
    let mut ran = Vec::with_capacity(cells.len());
    for (number, cell) in cells.iter().enumerate() {
        session.notes.note(&format!(
            "{:>10}  {}, {}  ({} of {})",
            "cell",
            cell.row,
            cell.column,
            number + 1,
            cells.len()
        ));
        let result = run_cell(session, suite, cell, Share::Whole);
        // An interrupt also ends the rollouts of the cell with an error.
        session.interrupt.check("the comparison")?;
        let result = result.map_err(|error| fault_of(&error).sentence());
        if let Err(sentence) = &result {
            session.notes.note(&format!("{:>10}  cannot run: {sentence}", "cell"));
        }
        ran.push(result);
    }
    comparison(session, suite, cells, &ran)
}

/// Makes the `comparison` artifact from the rollouts of the cells.
fn comparison(session: &Session, suite: &Suite, cells: &[Cell], ran: &[Result<Ran, String>]) -> Result<Compared> {
    let rows: Vec<CellRow> = cells
        .iter()
        .zip(ran)
        .flat_map(|(cell, ran)| rows_of(cell, ran))
        .collect();
    let (differences, unpaired) = differences_of(suite, cells, ran);
    let curves: Vec<&CurveRow> = ran.iter().flatten().flat_map(|ran| &ran.curves).collect();
    let recipe = recipe(suite, cells, ran)?;
    let failed = ran.iter().filter(|ran| ran.is_err()).count();
    let warning = |code: &'static str| move |message: String| json!({ "code": code, "message": message });
    let protocols = suite
        .different_protocols(cells)
        .into_iter()
        .map(warning("different_protocols"));
    let unpaired = unpaired.into_iter().map(warning("unpaired"));
    let warnings: Vec<Value> = protocols.chain(unpaired).collect();
    let built = session.build(&recipe, |writer| {
        writer.write_rows(rows.iter().cloned())?;
        writer.write_rows(differences.iter().cloned())?;
        writer.write_rows(curves.into_iter().cloned())?;
        Ok(ArtifactSummary {
            summary: json!({ "cells": cells.len(), "failed": failed, "differences": differences.len() }),
            warnings,
        })
    })?;
    Ok(Compared {
        built,
        cells: rows,
        differences,
        failed,
    })
}

/// The recipe of the `comparison` artifact.
fn recipe(suite: &Suite, cells: &[Cell], ran: &[Result<Ran, String>]) -> Result<Recipe> {
    let mut recipe = Recipe::new(Stage::Compare, CODE_VERSION).config(&config(suite, cells, ran))?;
    for (cell, ran) in cells.iter().zip(ran) {
        if let Ok(ran) = ran {
            recipe = recipe.input(&format!("{}, {}", cell.row, cell.column), &ran.key);
        }
    }
    Ok(recipe)
}

/// The runner of a cell.
fn runner_of(session: &Session, cell: &Cell, share: Share) -> Result<Runner> {
    match &cell.pipeline {
        Ok(pipeline) => Ok(session.runner(&cell.file, pipeline.clone()).with_share(share)),
        Err(sentence) => bail!("{sentence}"),
    }
}

fn run_cell(session: &Session, suite: &Suite, cell: &Cell, share: Share) -> Result<Ran> {
    let runner = runner_of(session, cell, share)?;
    let (built, _) = runner.roll_out()?;
    let rollouts = &built.artifact;
    Ok(Ran {
        key: *rollouts.key(),
        outcomes: Outcomes::read(rollouts)?,
        curves: if suite.curves {
            curves(rollouts, [&cell.row, &cell.column], &cell.measures)?
        } else {
            Vec::new()
        },
        carried: carried(session, runner.pipeline.policy()?.inputs(), rollouts.manifest())?,
    })
}

/// Size in bytes of what the policy and its pose estimator need.
fn carried(session: &Session, opened: &[Stage], rollouts: &Manifest) -> Result<u64> {
    let mut bytes = 0;
    // A learned policy opens the index only to name the most similar demonstrated chunk.
    let learned = opened.contains(&Stage::Train);
    let opened = opened.iter().filter(|stage| !learned || **stage == Stage::Train);
    for &stage in opened.chain(&[Stage::TrainEncoder, Stage::TrainPose]) {
        let Some(key) = rollouts.inputs.get(stage.artifact()) else {
            continue;
        };
        let artifact = Artifact::open(&session.store.folder(stage, key))?;
        let Manifest { tables, files, .. } = artifact.manifest();
        let opens = |name: &str| match stage {
            Stage::TrainEncoder => [WEIGHTS, CONFIDENCE].contains(&name),
            // A poses artifact also has the estimates of the demonstrations' images, which a rollout does not read.
            Stage::TrainPose => name == AnchorRow::NAME,
            Stage::Train => [PolicyCard::WEIGHTS, PolicyCard::FILE].contains(&name),
            _ => true,
        };
        let tables = tables.iter().map(|(name, table)| (name, table.bytes));
        let files = files.iter().map(|(name, file)| (name, file.bytes));
        bytes += tables
            .chain(files)
            .filter(|(name, _)| opens(name))
            .map(|(_, bytes)| bytes)
            .sum::<u64>();
    }
    Ok(bytes)
}

/// The rows of table `cells`, one per measure.
fn rows_of(cell: &Cell, ran: &Result<Ran, String>) -> Vec<CellRow> {
    let label = |text: &str| Label::from(text.to_owned());
    let pipeline = cell.pipeline.as_ref().ok();
    let section = pipeline
        .and_then(|pipeline| pipeline.rollout.as_ref())
        .filter(|_| ran.is_ok());
    let row = |(number, &measure): (usize, _)| {
        let found = ran.as_ref().ok();
        let values = found.and_then(|ran| ran.outcomes.of(measure));
        let interval = values.map(|values| score(measure, values));
        CellRow {
            row: label(&cell.row),
            column: label(&cell.column),
            pipeline: label(&cell.named.to_string_lossy()),
            policy: pipeline
                .and_then(|pipeline| pipeline.policy.as_ref())
                .map(|policy| policy.kind().into()),
            measure,
            rollouts: values.map(|values| values.len() as u32),
            value: interval.map(|interval| interval.value),
            low: interval.map(|interval| interval.low),
            high: interval.map(|interval| interval.high),
            printed: cell.printed.filter(|_| number == 0),
            max_steps: section.map(|section| section.max_steps),
            seeds: section.and_then(|section| Some(section.seeds.as_ref()?.text().to_owned())),
            carried: found.map(|ran| ran.carried),
            rollouts_key: found.map(|ran| ran.key.to_string()),
            error: ran.as_ref().err().cloned(),
        }
    };
    cell.measures.iter().enumerate().map(row).collect()
}

/// The rows of table `differences`, and one sentence for each cell whose seeds differ from the baseline's although the suite says
/// that they are the same.
fn differences_of(suite: &Suite, cells: &[Cell], ran: &[Result<Ran, String>]) -> (Vec<DifferenceRow>, Vec<String>) {
    let found: BTreeMap<[&str; 2], &Ran> = cells
        .iter()
        .zip(ran)
        .filter_map(|(cell, ran)| Some(([cell.row.as_str(), cell.column.as_str()], ran.as_ref().ok()?)))
        .collect();
    let (mut rows, mut sentences) = (Vec::new(), Vec::new());
    for (cell, other) in suite.compared(cells) {
        let of = |cell: &Cell| {
            found
                .get(&[cell.row.as_str(), cell.column.as_str()])
                .map(|ran| &ran.outcomes)
        };
        let (Some(outcomes), Some(against)) = (of(cell), of(other)) else {
            continue;
        };
        if let Some(why) = unpaired(outcomes, against) {
            sentences.push(format!(
                "in column {:?}, {} and the baseline {} are not compared: their rollouts have {why}",
                cell.column, cell.row, other.row
            ));
        }
        let names = [cell.row.as_str(), other.row.as_str(), cell.column.as_str()];
        rows.extend(differences(names, &cell.measures, outcomes, against));
    }
    (rows, sentences)
}

/// Everything besides the rollouts that determines the bytes of the comparison.
fn config(suite: &Suite, cells: &[Cell], ran: &[Result<Ran, String>]) -> Value {
    let cell = |(cell, ran): (&Cell, &Result<Ran, String>)| {
        json!({
            "row": cell.row,
            "column": cell.column,
            "pipeline": cell.named,
            "overrides": cell.overrides,
            "measures": cell.measures,
            "printed": cell.printed,
            "error": ran.as_ref().err(),
        })
    };
    let printed = |column: &crate::suite::SuiteColumn| json!({ "name": column.name, "printed": column.printed });
    json!({
        "title": suite.title,
        "about": suite.about,
        "printed_in": suite.printed_in,
        "baseline": suite.baseline,
        "rows": suite.row.iter().map(|row| &row.name).collect::<Vec<_>>(),
        "columns": suite.column.iter().map(printed).collect::<Vec<_>>(),
        "curves": suite.curves,
        "cells": cells.iter().zip(ran).map(cell).collect::<Vec<_>>(),
    })
}

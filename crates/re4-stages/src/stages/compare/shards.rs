//! Comparisons by several processes: each makes some parts of the rollouts of the cells, and one makes the comparison from them.
//!
//! The parts of all cells are numbered one after the other, in the order of the cells. A cell that cannot run leaves no artifact.
//! Its sentence is kept in the folder `runs`, by the settings of the cell and the state of its files, so that the process that makes
//! the comparison knows it. Running the cell again does not read that sentence.

use std::collections::BTreeMap;
use std::ops::Range;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Error, Result};
use re4_artifact::{Key, Recipe, Shard, Stage, Store};
use re4_fault::Remedy as _;
use serde_json::{Value, json};

use super::{CODE_VERSION, Compared, Ran, comparison, recipe, run_cell, runner_of};
use crate::notes::fault_of;
use crate::parts::{Partly, Share, ranges};
use crate::runner::Session;
use crate::suite::{Cell, Suite};

/// Field of a record in the folder `runs`: why a part of a cell cannot run.
const SENTENCE: &str = "cannot_run";

/// A cell of a suite, and what is missing of its rollouts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedCell {
    /// Its row and column.
    pub name: String,
    /// Number of parts of its rollouts; 1 if they start from a table of scenes, whose number is not known.
    pub parts: u32,
    /// Numbers of the parts that do not exist.
    pub missing: Vec<u32>,
    /// Whether what its rollouts read is missing as well.
    pub inputs_missing: bool,
    /// Why it cannot run.
    pub error: Option<String>,
}

/// The cells of a suite, and what is missing of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedSuite {
    /// The cells, in their order.
    pub cells: Vec<PlannedCell>,
    /// For each dataset that several parts read: whether all that they read exists.
    pub inputs: Vec<bool>,
    /// Folder of the comparison; `None` if its key depends on rollouts that are missing.
    pub artifact: Option<PathBuf>,
    /// Whether the comparison exists.
    pub done: bool,
}

impl PlannedSuite {
    /// Number of parts of all cells.
    pub fn parts(&self) -> u32 {
        self.cells.iter().map(|cell| cell.parts).sum()
    }

    /// Numbers of the missing parts, of those of all cells.
    pub fn missing(&self) -> Vec<u32> {
        let mut first = 0;
        let mut missing = Vec::new();
        for cell in &self.cells {
            missing.extend(cell.missing.iter().map(|part| first + part));
            first += cell.parts;
        }
        missing
    }
}

/// What exists of a cell.
enum Found {
    Ran(Ran),
    CannotRun(String),
    Missing { parts: Vec<u32>, inputs: bool },
}

/// Runs a shard of the parts of all cells. A cell that cannot run is recorded.
///
/// # Errors
/// If the run is interrupted, or a record cannot be written.
pub fn compare_shard(session: &Session, file: &Path, cells: &[Cell], shard: Shard) -> Result<Partly> {
    let parts: Vec<u32> = cells.iter().map(|cell| parts_of(session, cell)).collect();
    let total = parts.iter().sum();
    let own = shard.parts(total);
    let (mut names, mut failed) = (Vec::new(), Vec::new());
    let mut first = 0;
    for (cell, parts) in cells.iter().zip(parts) {
        let of_cell = first.max(own.start)..(first + parts).min(own.end);
        let of_cell = of_cell.start.saturating_sub(first)..of_cell.end.saturating_sub(first);
        first += parts;
        if of_cell.is_empty() {
            continue;
        }
        let name = name_of(cell);
        session.notes.note(&format!("{:>10}  {name}", "cell"));
        if let Some(sentence) = run_parts(session, cell, of_cell, parts)? {
            session.notes.note(&format!("{:>10}  cannot run: {sentence}", "cell"));
            failed.push(name.clone());
        }
        names.push(name);
    }
    Ok(Partly::Ran {
        suite: file.to_path_buf(),
        all: cells.len() as u32,
        parts: total,
        first: own.start,
        end: own.end,
        cells: names,
        failed,
    })
}

/// Makes what the rollouts of cells read, for a shard of the datasets that several parts read. A cell that cannot run is left out; it
/// is recorded when its rollouts are to be made.
///
/// # Errors
/// If the run is interrupted.
pub fn compare_inputs(session: &Session, file: &Path, cells: &[Cell], shard: Shard) -> Result<Partly> {
    let families = families(session, cells);
    let own = shard.parts(families.len() as u32);
    let (mut names, mut failed) = (Vec::new(), Vec::new());
    for &number in families[own.start as usize..own.end as usize].iter().flatten() {
        let cell = &cells[number];
        names.push(name_of(cell));
        let made = runner_of(session, cell, Share::Whole).and_then(|runner| runner.with_artifacts(&|_, _| Ok(())));
        session.interrupt.check("the comparison")?;
        if let Err(error) = made {
            let sentence = fault_of(&error).sentence();
            session.notes.note(&format!("{:>10}  cannot run: {sentence}", "cell"));
            failed.push(name_of(cell));
        }
    }
    Ok(Partly::Ran {
        suite: file.to_path_buf(),
        all: cells.len() as u32,
        parts: families.len() as u32,
        first: own.start,
        end: own.end,
        cells: names,
        failed,
    })
}

/// Makes the `comparison` artifact from rollouts that exist.
///
/// # Errors
/// [`Partly::MissingCells`] if rollouts are missing; if the run is interrupted, or the artifact cannot be written.
pub fn merge_comparison(session: &Session, file: &Path, suite: &Suite, cells: &[Cell]) -> Result<Compared> {
    let (mut ran, mut missing) = (Vec::new(), Vec::new());
    for cell in cells {
        match look(session, suite, cell)? {
            Found::Ran(of_cell) => ran.push(Ok(of_cell)),
            Found::CannotRun(sentence) => {
                session
                    .notes
                    .note(&format!("{:>10}  {} cannot run: {sentence}", "cell", name_of(cell)));
                ran.push(Err(sentence));
            }
            Found::Missing { parts, .. } => missing.push(match parts_of(session, cell) {
                1 => name_of(cell),
                all => format!("{} (parts {} of {all})", name_of(cell), ranges(&parts)),
            }),
        }
    }
    if !missing.is_empty() {
        return Err(Partly::MissingCells {
            suite: file.to_path_buf(),
            all: cells.len() as u32,
            cells: missing,
        }
        .into());
    }
    comparison(session, suite, cells, &ran)
}

/// What exists of the artifacts of a suite. Only manifests are made.
///
/// # Errors
/// If the run is interrupted, or the artifacts cannot be read.
pub fn planned_suite(session: &Session, suite: &Suite, cells: &[Cell]) -> Result<PlannedSuite> {
    let (mut planned, mut ran) = (Vec::new(), Vec::new());
    for cell in cells {
        let mut of_cell = PlannedCell {
            name: name_of(cell),
            parts: parts_of(session, cell),
            missing: Vec::new(),
            inputs_missing: false,
            error: None,
        };
        match look(session, suite, cell)? {
            Found::Ran(found) => ran.push(Ok(found)),
            Found::CannotRun(sentence) => {
                of_cell.error = Some(sentence.clone());
                ran.push(Err(sentence));
            }
            Found::Missing { parts, inputs } => {
                of_cell.missing = parts;
                of_cell.inputs_missing = inputs;
            }
        }
        planned.push(of_cell);
    }
    let complete = |family: &Vec<usize>| family.iter().all(|&cell| !planned[cell].inputs_missing);
    let inputs = families(session, cells).iter().map(complete).collect();
    let (mut artifact, mut done) = (None, false);
    if ran.len() == cells.len() && planned.iter().all(|cell| cell.missing.is_empty()) {
        let key = recipe(suite, cells, &ran)?.key();
        artifact = Some(session.store.folder(Stage::Compare, &key));
        done = session.store.lookup(Stage::Compare, &key)?.is_some();
    }
    Ok(PlannedSuite {
        cells: planned,
        inputs,
        artifact,
        done,
    })
}

fn name_of(cell: &Cell) -> String {
    format!("{} under {}", cell.row, cell.column)
}

/// Number of parts of the rollouts of a cell.
fn parts_of(session: &Session, cell: &Cell) -> u32 {
    let runner = runner_of(session, cell, Share::Whole);
    let parts = runner.and_then(|runner| runner.parts_of_rollouts());
    parts.ok().flatten().unwrap_or(1)
}

/// The cells of each dataset that several parts read.
fn families(session: &Session, cells: &[Cell]) -> Vec<Vec<usize>> {
    let mut families: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (number, cell) in cells.iter().enumerate() {
        if let Ok(pipeline) = &cell.pipeline {
            let dataset = json!([pipeline.task, pipeline.variant, pipeline.ingest]);
            families.entry(dataset.to_string()).or_default().push(number);
        }
    }
    let several = |family: &Vec<usize>| {
        let parts = family.iter().map(|&cell| parts_of(session, &cells[cell]));
        parts.sum::<u32>() > 1
    };
    let mut families: Vec<Vec<usize>> = families.into_values().filter(several).collect();
    families.sort_unstable();
    families
}

/// Runs some parts of a cell. Returns why one of them cannot run.
fn run_parts(session: &Session, cell: &Cell, own: Range<u32>, parts: u32) -> Result<Option<String>> {
    for part in own {
        let shard: Shard = format!("{part}/{parts}").parse().map_err(Error::msg)?;
        let share = Share::Parts(Stage::Rollout, shard);
        let made = runner_of(session, cell, share).and_then(|runner| runner.roll_out());
        // An interrupt also ends the rollouts of the cell with an error.
        session.interrupt.check("the comparison")?;
        let Err(error) = made else { continue };
        if error.is::<Partly>() {
            continue;
        }
        let sentence = fault_of(&error).sentence();
        let key = record_of(cell, part)?;
        let record = json!({ SENTENCE: sentence });
        session.store.record_run(Stage::Compare, &key, &record)?;
        return Ok(Some(sentence));
    }
    Ok(None)
}

/// What exists of a cell. Nothing but manifests of artifacts whose parts all exist is made.
fn look(session: &Session, suite: &Suite, cell: &Cell) -> Result<Found> {
    let found = run_cell(session, suite, cell, Share::Existing);
    session.interrupt.check("the comparison")?;
    let error = match found {
        Ok(ran) => return Ok(Found::Ran(ran)),
        Err(error) => error,
    };
    let Some(Partly::Missing { stage, missing, .. }) = error.downcast_ref::<Partly>() else {
        return Ok(Found::CannotRun(fault_of(&error).sentence()));
    };
    let parts = parts_of(session, cell);
    let inputs = stage != Stage::Rollout.as_str();
    let missing = if inputs || parts == 1 {
        (0..parts).collect()
    } else {
        missing.clone()
    };
    // One process would have stopped at the first part that cannot run.
    let first = record_of(cell, missing.first().copied().unwrap_or(0))?;
    let record = Store::run_record(session.store.root(), Stage::Compare, &first);
    if let Some(sentence) = record.as_ref().and_then(|record| record[SENTENCE].as_str()) {
        return Ok(Found::CannotRun(sentence.to_owned()));
    }
    Ok(Found::Missing { parts: missing, inputs })
}

/// The key under which it is recorded that a part of a cell cannot run. It depends on the settings of the cell and on the state of its
/// files, so that a record is not found after they have changed.
fn record_of(cell: &Cell, part: u32) -> Result<Key> {
    let state = |path: PathBuf| {
        let path = std::fs::canonicalize(&path).unwrap_or(path);
        let (files, bytes, changed) = state_of(&path);
        json!([path, files, bytes, changed])
    };
    let files: Vec<Value> = cell.inputs().into_iter().map(state).collect();
    let config = json!({
        "part": part,
        "pipeline": cell.pipeline.as_ref().ok(),
        "files": files,
        "program": env!("CARGO_PKG_VERSION"),
    });
    Ok(Recipe::new(Stage::Compare, CODE_VERSION).config(&config)?.key())
}

/// Number, bytes and latest time of change, in seconds and nanoseconds since 1970, of a file or of the files and folders in a folder.
fn state_of(path: &Path) -> (u64, u64, (i64, i64)) {
    let Ok(own) = std::fs::metadata(path) else {
        return (0, 0, (0, 0));
    };
    let (mut files, mut bytes, mut changed) = (1, own.len(), (own.mtime(), own.mtime_nsec()));
    for entry in std::fs::read_dir(path).into_iter().flatten().flatten() {
        // A link can point to a folder that contains it.
        if entry.file_type().is_ok_and(|kind| kind.is_symlink()) && entry.path().is_dir() {
            continue;
        }
        let (inner_files, inner_bytes, inner_changed) = state_of(&entry.path());
        files += inner_files;
        bytes += inner_bytes;
        changed = changed.max(inner_changed);
    }
    (files, bytes, changed)
}

//! The page of a comparison: reads the tables of a `comparison` artifact, and the records of the runs of its cells.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use re4_artifact::{Artifact, Key, Stage, Store};
use re4_compare::{CellRow, CurveRow, DifferenceRow};
use serde::Deserialize;
use serde_json::Value;

use super::stated;
use crate::html::comparison::{Cell, Column, Comparison, Cost, Times, Training, page};

/// Stages that train or calibrate something, if a cell has their artifact.
const TRAINING: [Stage; 3] = [Stage::TrainEncoder, Stage::TrainPose, Stage::Train];

/// Makes the page of a `comparison` artifact. The rollouts of its cells and the records of their runs are looked for in the folder of
/// artifacts that contains it, and in `store`; the page states which times are missing.
///
/// # Errors
/// If the artifact is no comparison, or a table or the manifest cannot be read.
pub fn comparison_page(artifact: &Artifact, store: &Path) -> Result<String> {
    let manifest = artifact.manifest();
    ensure!(
        manifest.artifact == Stage::Compare.artifact(),
        "cannot report on {}: it has {}, not a comparison; name a comparison artifact",
        artifact.path().display(),
        manifest.artifact
    );
    artifact.verify_bytes()?;
    let config = &manifest.config;
    let stores: Vec<PathBuf> = std::fs::canonicalize(artifact.path())
        .ok()
        .and_then(|path| path.ancestors().nth(2).map(Path::to_path_buf))
        .into_iter()
        .chain([store.to_path_buf()])
        .collect();
    let stated_cells: Vec<StatedCell> = stated(artifact, "config", config, "cells")?;
    let mut scores = artifact.read::<CellRow>()?.into_iter();
    let cells = stated_cells.into_iter().map(|stated| {
        let scores: Vec<CellRow> = scores.by_ref().take(stated.measures.len()).collect();
        let first = scores
            .first()
            .filter(|first| first.row == *stated.row && first.column == *stated.column);
        let first = first.with_context(|| {
            format!(
                "cannot report on {}: table cells has no rows of the cell {}, {}; run re4-pipe compare again",
                artifact.path().display(),
                stated.row,
                stated.column
            )
        })?;
        let key = first.rollouts_key.as_ref().and_then(|key| key.parse().ok());
        Ok(Cell {
            cost: key.and_then(|key: Key| stores.iter().find_map(|store| cost(store, &key))),
            scores,
            overrides: stated.overrides,
        })
    });
    let cells = cells.collect::<Result<Vec<Cell>>>()?;
    let columns: Vec<StatedColumn> = stated(artifact, "config", config, "columns")?;
    Ok(page(&Comparison {
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        key: artifact.key().to_string(),
        title: stated(artifact, "config", config, "title")?,
        about: stated(artifact, "config", config, "about")?,
        printed_in: stated(artifact, "config", config, "printed_in")?,
        baseline: stated(artifact, "config", config, "baseline")?,
        rows: stated(artifact, "config", config, "rows")?,
        columns: columns
            .into_iter()
            .map(|StatedColumn { name, printed }| Column { name, printed })
            .collect(),
        cells,
        differences: artifact.read::<DifferenceRow>()?,
        curves: artifact.read::<CurveRow>()?,
        warnings: manifest
            .warnings
            .iter()
            .filter_map(|warning| warning["message"].as_str().map(str::to_owned))
            .collect(),
    }))
}

/// A cell in the manifest.
#[derive(Deserialize)]
struct StatedCell {
    row: String,
    column: String,
    measures: Vec<String>,
    overrides: Vec<String>,
}

/// A column in the manifest.
#[derive(Deserialize)]
struct StatedColumn {
    name: String,
    printed: BTreeMap<String, f64>,
}

/// The cost of rollouts; `None` if they are not in this store.
fn cost(store: &Path, rollouts: &Key) -> Option<Cost> {
    let folder = store.join(Stage::Rollout.artifact()).join(rollouts.short());
    let artifact = Artifact::open(&folder).ok()?;
    let record = Store::run_record(store, Stage::Rollout, rollouts).unwrap_or(Value::Null);
    let times = |name: &str| {
        let of = |quantile: &str| record[name][quantile].as_f64();
        Some(Times {
            p50: of("p50_us")?,
            p99: of("p99_us")?,
        })
    };
    let trained = TRAINING
        .iter()
        .filter_map(|&stage| Some((stage, artifact.manifest().inputs.get(stage.artifact())?)));
    let training = trained.fold(Training::Nothing, |sum, (stage, key)| {
        let took = Store::run_record(store, stage, key).and_then(|record| record["wall_s"].as_f64());
        match (sum, took) {
            (Training::Unrecorded, _) | (_, None) => Training::Unrecorded,
            (Training::Nothing, Some(seconds)) => Training::Took(seconds),
            (Training::Took(others), Some(seconds)) => Training::Took(others + seconds),
        }
    });
    Some(Cost {
        training,
        actions: times("actions"),
        decisions: times("decisions"),
        threads: record["threads"].as_u64(),
        finished: record["finished_unix_s"].as_u64(),
    })
}

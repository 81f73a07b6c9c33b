//! Scores of demonstrations, by which a curation predicts how costly episodes are that follow them.

use std::collections::BTreeMap;

use anyhow::Result;
use arrow_array::Array as _;
use nalgebra::Vector3;
use re4_artifact::{Artifact, col_f64_or_null, col_text, col_u32};
use re4_audit::AuditedEpisodeRow;
use re4_influence::Score;

use super::check_count;
use crate::inputs::demos::{SpatialEpisodes, is_spatial};
use crate::inputs::episodes::read_episodes;

/// Name of the table of quality scores in an `audit` artifact, if it has one.
const SCORES: &str = "scores";

/// Number of errors and warnings of each demonstration.
pub(super) fn findings(audit: &Artifact, demos: usize) -> Result<Vec<u32>> {
    let rows: Vec<AuditedEpisodeRow> = audit.read()?;
    check_count(rows.len(), demos)?;
    Ok(rows.iter().map(|row| row.errors + row.warnings).collect())
}

/// Scores of the demonstrations: those of the audit, if it has any, and the duration and the length of the end effector's path.
pub(super) fn scores(episodes: &Artifact, audit: &Artifact, names: &[String]) -> Result<Vec<Score>> {
    let mut scores = of_audit(audit, names)?;
    let rows: Vec<AuditedEpisodeRow> = audit.read()?;
    check_count(rows.len(), names.len())?;
    let duration = rows.iter().map(|row| Some(row.frames as f64)).collect();
    let paths = paths(episodes)?;
    let length = |demo: usize| paths.get(&(demo as u32)).map(|positions| path_length(positions));
    let ratio = |(demo, row): (usize, &AuditedEpisodeRow)| {
        let positions = paths.get(&(demo as u32))?;
        let (first, last) = (positions.first()?, positions.last()?);
        let grasp = row.grasp_frame.and_then(|frame| positions.get(frame));
        let straight = grasp.map_or((last - first).norm(), |grasp| {
            (grasp - first).norm() + (last - grasp).norm()
        });
        (straight > 0.0).then(|| path_length(positions) / straight)
    };
    for (name, values) in [
        ("duration", duration),
        ("path_length", (0..names.len()).map(length).collect()),
        ("path_ratio", rows.iter().enumerate().map(ratio).collect()),
    ] {
        if scores.iter().all(|score| score.name != name) {
            scores.push(Score {
                name: name.to_owned(),
                values,
            });
        }
    }
    Ok(scores)
}

/// The columns of numbers in the table `scores` of an audit. Its column `demo` has the number or the name of the demonstration.
fn of_audit(audit: &Artifact, names: &[String]) -> Result<Vec<Score>> {
    if !audit.manifest().tables.contains_key(SCORES) {
        return Ok(Vec::new());
    }
    let batch = audit.table_named(SCORES)?.read_all()?;
    let column = if batch.column_by_name("demo").is_some() {
        "demo"
    } else {
        "episode"
    };
    let numbers: Vec<Option<usize>> = if let Ok(numbers) = col_u32(&batch, column) {
        numbers.iter().map(|number| Some(*number as usize)).collect()
    } else {
        let place: BTreeMap<&str, usize> = names.iter().map(String::as_str).zip(0..).collect();
        let texts = col_text(&batch, column)?;
        texts.into_iter().map(|name| place.get(name?).copied()).collect()
    };
    let mut scores = Vec::new();
    for field in batch.schema().fields() {
        let is_number = batch
            .column_by_name(field.name())
            .is_some_and(|column| column.as_any().is::<arrow_array::Float64Array>());
        if !is_number {
            continue;
        }
        let mut values = vec![None; names.len()];
        for (number, value) in numbers.iter().zip(col_f64_or_null(&batch, field.name())?) {
            if let Some(place) = number.and_then(|number| values.get_mut(number)) {
                *place = value;
            }
        }
        scores.push(Score {
            name: field.name().clone(),
            values,
        });
    }
    Ok(scores)
}

/// Positions of the end effector in every demonstration, px or m.
fn paths(episodes: &Artifact) -> Result<BTreeMap<u32, Vec<Vector3<f64>>>> {
    if !is_spatial(episodes)? {
        let all = read_episodes(episodes)?;
        let positions = all.into_iter().map(|episode| {
            let frames = episode.frames.iter();
            frames
                .map(|frame| Vector3::new(frame.eef.x, frame.eef.y, 0.0))
                .collect()
        });
        return Ok((0..).zip(positions).collect());
    }
    SpatialEpisodes::open(episodes)?
        .map(|demo| {
            let (number, episode) = demo?;
            let frames = episode.frames.iter();
            Ok((number, frames.map(|frame| frame.eef.translation.vector).collect()))
        })
        .collect()
}

fn path_length(positions: &[Vector3<f64>]) -> f64 {
    positions.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
}

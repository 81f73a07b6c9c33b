//! Writes made-up `rollouts` artifacts with the table `results` of Push-T, to measure queries over many artifacts.
//!
//! ```text
//! many_artifacts FOLDER ARTIFACTS ROWS
//! ```
//!
//! The artifacts are in `FOLDER/rollouts`. They differ in their settings and in their results, which are pseudo-random and equal in
//! every run.

use std::path::Path;

use anyhow::{Context as _, Result};
use re4_artifact::{ArtifactSummary, Recipe, Stage, Store};
use re4_geometry::{Point2, Pose2};
use re4_rollout::{PlaneResultRow, ResultCore};
use serde_json::json;

/// A fraction that depends only on two numbers.
fn fraction(artifact: u32, row: u32) -> f64 {
    let mixed = (u64::from(artifact) << 32 | u64::from(row)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ mixed >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 11) as f64 / (1_u64 << 53) as f64
}

fn result(artifact: u32, row: u32) -> PlaneResultRow {
    let coverage = fraction(artifact, row);
    PlaneResultRow {
        core: ResultCore {
            episode: row,
            seed: 500 + row,
            success: coverage > 0.95,
            steps: 1 + (200.0 * coverage) as u32,
            decisions: 1 + row % 17,
            images: Some(0),
        },
        eef: Point2::new(256.0 * coverage, 300.0),
        object: Pose2::new(100.0, 512.0 * coverage, coverage),
        contacts: 3.0,
        coverage_max: coverage,
        iou_max: coverage * coverage,
        score_max: (coverage / 0.95).min(1.0),
        coverage_final: coverage / 2.0,
    }
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, artifacts, rows] = arguments.as_slice() else {
        anyhow::bail!("usage: many_artifacts FOLDER ARTIFACTS ROWS");
    };
    let artifacts: u32 = artifacts.parse().context("the number of artifacts")?;
    let rows: u32 = rows.parse().context("the number of rows")?;
    let store = Store::open(Path::new(folder))?;
    for artifact in 0..artifacts {
        let kind = ["re4", "paper", "re2"][artifact as usize % 3];
        let config =
            json!({ "task": "pusht", "policy": { "kind": kind, "number": artifact }, "rollout": { "max_steps": 200 } });
        let writer = store.begin(&Recipe::new(Stage::Rollout, 1).config(&config)?)?;
        writer.write_rows((0..rows).map(|row| result(artifact, row)))?;
        writer.publish(ArtifactSummary::default())?;
    }
    Ok(())
}

//! `re4-pipe inspect`: what an artifact holds.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use arrow::util::pretty::pretty_format_batches;
use re4_artifact::{Artifact, Table, json_description};
use re4_fault::{ensure, fault};
use re4_report::{RolloutPicture, rollout_picture};
use serde_json::{Value, json};

use super::{Outcome, names_of_decisions, rollout_tables};
use crate::arguments::InspectArguments;
use crate::console::Console;

/// Prints provenance, tables and columns.
pub(crate) fn inspect(arguments: &InspectArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let artifact = Artifact::open(&arguments.path)?;
    artifact.verify_bytes()?;
    let manifest = artifact.manifest();
    let mut descriptions = serde_json::Map::new();
    let mut text = format!(
        "{} artifact {}\n  made by stage {} (code version {}) of re4-pipe {}\n  config {}\n",
        manifest.artifact, manifest.key, manifest.stage, manifest.code_version, manifest.tool_version, manifest.config
    );
    for (name, key) in &manifest.inputs {
        writeln!(text, "  input {name} {key}")?;
    }
    if let Some(hash) = &manifest.source_blake3 {
        writeln!(text, "  raw source {} blake3 {hash}", manifest.source)?;
    }
    writeln!(text, "  summary {}", manifest.summary)?;
    for warning in &manifest.warnings {
        writeln!(text, "  warning {warning}")?;
    }
    for (name, facts) in &manifest.tables {
        writeln!(
            text,
            "\ntable {name} (version {}): {} rows, {} bytes",
            facts.schema_version, facts.rows, facts.bytes
        )?;
        let Some(spec) = re4_stages::tables::described(&artifact, name) else {
            continue;
        };
        writeln!(text, "  {}", spec.description)?;
        for column in spec.columns_at(facts.schema_version) {
            let unit = match (column.unit, column.frame) {
                ("", _) => String::new(),
                (unit, "") => format!(" [{unit}]"),
                (unit, frame) => format!(" [{unit}, {frame} frame]"),
            };
            let null = if column.nullable { ", may be null" } else { "" };
            writeln!(
                text,
                "  {:<24} {}{unit}{null}: {}",
                column.name,
                column.kind.as_str(),
                column.description
            )?;
        }
        if arguments.rows > 0 {
            writeln!(text, "{}", first_rows(&artifact.table(spec)?, arguments.rows)?)?;
        }
        descriptions.insert(name.clone(), json_description(spec));
    }
    if let (Some(seed), Some(path)) = (arguments.seed, &arguments.picture) {
        let svg = rollout_picture(&read_picture(&artifact, seed)?)
            .with_context(|| format!("cannot draw {}", path.display()))?;
        console.picture(path, &svg)?;
    }
    console.answer(&json!({ "path": artifact.path(), "manifest": manifest, "tables": Value::Object(descriptions) }))?;
    console.say(text.trim_end())?;
    Ok(Outcome::Done)
}

fn first_rows(table: &Table, count: usize) -> Result<String> {
    let rows = table.read_rows(0..table.rows().min(count as u64))?;
    Ok(pretty_format_batches(&[rows])?.to_string())
}

/// What the picture of one rollout shows, from the artifact's tables.
fn read_picture(artifact: &Artifact, seed: u32) -> Result<RolloutPicture> {
    use re4_artifact::{col_f64, col_f64_list, col_text, col_u32};
    let missing = || {
        fault!(
            "cannot draw seed {seed}: the artifact {} has no such rollout", artifact.path().display();
            "give one of its seeds"
        )
    };
    ensure!(
        !rollout_tables::in_space(artifact),
        "cannot draw seed {seed}: --picture draws Push-T's rollouts";
        "for those of robosuite's tasks use re4-pipe report or re4-pipe film"
    );
    let results = rollout_tables::results(artifact)?;
    let row = col_u32(&results, "seed")?
        .iter()
        .position(|s| *s == seed)
        .with_context(missing)?;
    let start = |name| -> Result<f64> { Ok(col_f64(&results, name)?[row]) };
    let mut picture = RolloutPicture {
        seed,
        score: start("score_max")?,
        blocks: vec![[start("object_x")?, start("object_y")?, start("object_theta")?]],
        pusher: vec![[start("eef_x")?, start("eef_y")?]],
        replaying: Vec::new(),
        decisions: Vec::new(),
        goal: [re4_sim::GOAL.x, re4_sim::GOAL.y, re4_sim::GOAL.theta],
        outline: re4_sim::tee_rectangles()
            .iter()
            .map(|r| r.iter().map(|p| [p.x, p.y]).collect())
            .collect(),
        pusher_radius: re4_sim::AGENT_RADIUS,
    };
    let steps = rollout_tables::steps(artifact)?;
    let phases = col_text(&steps, "phase")?;
    let column = |name| col_f64(&steps, name);
    let (x, y) = (column("eef_x")?, column("eef_y")?);
    let (bx, by, bt) = (column("object_x")?, column("object_y")?, column("object_theta")?);
    for (i, _) in col_u32(&steps, "seed")?.iter().enumerate().filter(|(_, s)| **s == seed) {
        picture.pusher.push([x[i], y[i]]);
        picture.blocks.push([bx[i], by[i], bt[i]]);
        picture.replaying.push(phases[i] == Some("replay"));
    }
    let decisions = rollout_tables::decisions(artifact)?;
    let (step, names) = (col_u32(&decisions, "step")?, names_of_decisions(&decisions)?);
    let paths = col_f64_list(&decisions, "plan_path")?;
    for (i, _) in col_u32(&decisions, "seed")?
        .iter()
        .enumerate()
        .filter(|(_, s)| **s == seed)
    {
        let path = paths[i].chunks_exact(2).map(|p| [p[0], p[1]]).collect();
        picture.decisions.push(re4_report::PictureDecision {
            step: step[i],
            demo: names[i].clone(),
            plan: path,
        });
    }
    Ok(picture)
}

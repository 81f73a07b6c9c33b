//! `re4-pipe inspect`: what an artifact holds.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use arrow::util::pretty::pretty_format_batches;
use re4_artifact::{Artifact, Table, json_description};
use re4_fault::ensure;
use re4_report::{is_spatial, planar_rollout, rollout_image};
use serde_json::{Value, json};

use super::Outcome;
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
    for (name, summary) in &manifest.tables {
        writeln!(
            text,
            "\ntable {name} (version {}): {} rows, {} bytes",
            summary.schema_version, summary.rows, summary.bytes
        )?;
        let Some(spec) = re4_stages::tables::described(&artifact, name) else {
            continue;
        };
        writeln!(text, "  {}", spec.description)?;
        for column in spec.columns_at(summary.schema_version) {
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
    if let (Some(seed), Some(path)) = (arguments.seed, &arguments.image) {
        ensure!(
            !is_spatial(&artifact),
            "cannot draw seed {seed}: --image draws Push-T's rollouts";
            "for those of robosuite's tasks use re4-pipe report or re4-pipe video"
        );
        let svg = rollout_image(&planar_rollout(&artifact, seed)?)
            .with_context(|| format!("cannot draw {}", path.display()))?;
        console.image(path, &svg)?;
    }
    console.answer(&json!({ "path": artifact.path(), "manifest": manifest, "tables": Value::Object(descriptions) }))?;
    console.say(text.trim_end())?;
    Ok(Outcome::Done)
}

fn first_rows(table: &Table, count: usize) -> Result<String> {
    let rows = table.read_rows(0..table.rows().min(count as u64))?;
    Ok(pretty_format_batches(&[rows])?.to_string())
}

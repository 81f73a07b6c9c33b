//! `re4-pipe inspect`: prints the contents of an artifact, or what a dataset is and what can be done with it.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, ColumnSpec, MANIFEST_NAME, Table, cell_text, json_description};
use re4_fault::ensure;
use re4_ingest::Description;
use re4_report::{is_spatial, planar_rollout, rollout_image};
use re4_stages::{Interrupt, Notes, describe, leaves};
use serde_json::{Value, json};

use super::Outcome;
use crate::arguments::InspectArguments;
use crate::console::Console;
use crate::terminal::{cut, paragraph, width};

/// Prints the provenance, tables and columns of an artifact, or the description of a dataset.
pub(crate) fn inspect(arguments: &InspectArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    if !arguments.path.join(MANIFEST_NAME).exists() {
        let notes = Notes::new(arguments.common.quiet);
        if let Some(about) = describe(&arguments.path, &Interrupt::listen(None), &notes)? {
            return dataset(arguments, console, &about);
        }
    }
    let artifact = Artifact::open(&arguments.path)?;
    artifact.verify_bytes()?;
    let manifest = artifact.manifest();
    let width = width();
    let mut descriptions = serde_json::Map::new();
    let mut text = format!("{} artifact {}\n", manifest.artifact, manifest.key);
    let made = format!(
        "made by stage {} (code version {}) of re4-pipe {}",
        manifest.stage, manifest.code_version, manifest.tool_version
    );
    writeln!(text, "{}", paragraph(&made, 2, 2, width))?;
    for (name, key) in &manifest.inputs {
        writeln!(text, "  input {name} {key}")?;
    }
    if let Some(hash) = &manifest.source_blake3 {
        let source = format!("raw source {} blake3 {hash}", manifest.source);
        writeln!(text, "{}", paragraph(&source, 2, 2, width))?;
    }
    for (heading, value) in [("config", &manifest.config), ("summary", &manifest.summary)] {
        writeln!(text, "  {heading}")?;
        for (name, leaf) in leaves(value) {
            writeln!(text, "{}", paragraph(&format!("{name} = {leaf}"), 4, 4, width))?;
        }
    }
    for warning in &manifest.warnings {
        let warning = re4_stages::warning_text(warning);
        writeln!(text, "{}", paragraph(&format!("warning {warning}"), 2, 2, width))?;
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
        writeln!(text, "{}", paragraph(spec.description, 2, 0, width))?;
        for column in spec.columns_at(summary.schema_version) {
            writeln!(text, "{}", paragraph(&described(column), 2, 4, width))?;
        }
        if arguments.rows > 0 {
            text += &first_rows(&artifact.table(spec)?, arguments.rows, width)?;
        }
        descriptions.insert(name.clone(), json_description(spec));
    }
    if let (Some(seed), Some(path)) = (arguments.seed, &arguments.image) {
        ensure!(
            !is_spatial(&artifact),
            "cannot render seed {seed}: --image renders rollouts of Push-T only";
            "for robosuite tasks use re4-pipe report or re4-pipe video"
        );
        let svg = rollout_image(&planar_rollout(&artifact, seed)?)
            .with_context(|| format!("cannot render {}", path.display()))?;
        console.image(path, &svg)?;
    }
    console.answer(&json!({ "path": artifact.path(), "manifest": manifest, "tables": Value::Object(descriptions) }))?;
    console.say(text.trim_end())?;
    Ok(Outcome::Done)
}

/// Prints the description of a dataset.
fn dataset(arguments: &InspectArguments, console: Console, about: &Description) -> Result<Outcome> {
    ensure!(
        arguments.rows == 0 && arguments.image.is_none(),
        "cannot show rows or images of {}: it is a dataset, not an artifact", arguments.path.display();
        "ingest it, then inspect the artifact"
    );
    let lines = about.lines().into_iter();
    let text: Vec<String> = lines
        .map(|(indent, line)| paragraph(&line, indent, 13, width()))
        .collect();
    console.answer(&json!({ "path": arguments.path, "dataset": about }))?;
    console.say(&text.join("\n"))?;
    Ok(Outcome::Done)
}

/// A column's name, type, unit and meaning, on one line.
fn described(column: &ColumnSpec) -> String {
    let unit = match (column.unit, column.frame) {
        ("", _) => String::new(),
        (unit, "") => format!(" [{unit}]"),
        (unit, frame) => format!(" [{unit}, {frame} frame]"),
    };
    let null = if column.nullable { ", may be null" } else { "" };
    let kind = column.kind.as_str();
    format!("{:<24} {kind}{unit}{null}: {}", column.name, column.description)
}

/// Maximum width of a value, in characters.
const WIDEST_CELL: usize = 40;

/// The first rows of a table, transposed: one line per column, with as many rows side by side as fit. Tables have up to 60 columns,
/// which do not fit side by side in a terminal.
fn first_rows(table: &Table, count: usize, width: Option<usize>) -> Result<String> {
    let rows = table.read_rows(0..table.rows().min(count as u64))?;
    let schema = rows.schema();
    let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
    let name_width = names.iter().map(|name| name.chars().count()).max().unwrap_or_default();
    let room = width.map_or(usize::MAX, |width| width.saturating_sub(name_width + 4));
    let widest = WIDEST_CELL.min(room).max(8);
    // Cells by row, because each row of the table is printed as wide as its widest value.
    let cells: Vec<Vec<String>> = (0..rows.num_rows())
        .map(|row| {
            rows.columns()
                .iter()
                .map(|column| cut(&cell_text(column, row), widest))
                .collect()
        })
        .collect();
    let widths: Vec<usize> = cells
        .iter()
        .map(|cells| cells.iter().map(|cell| cell.chars().count()).max().unwrap_or_default())
        .collect();
    let mut text = String::new();
    let mut next = 0;
    while next < cells.len() {
        let first = next;
        let mut used = 0;
        while next < cells.len() && (next == first || used + widths[next] + 2 <= room) {
            used += widths[next] + 2;
            next += 1;
        }
        writeln!(text, "\n  rows {first} to {}", next - 1)?;
        for (i, name) in names.iter().enumerate() {
            let mut line = format!("  {name:<name_width$}");
            for row in first..next {
                write!(line, "  {:>width$}", cells[row][i], width = widths[row])?;
            }
            writeln!(text, "{}", line.trim_end())?;
        }
    }
    Ok(text)
}

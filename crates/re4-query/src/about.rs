//! Tables about the artifacts themselves, made from their manifests.

use polars::prelude::*;
use serde_json::Value;

use crate::sources::{ARTIFACT, DATASET, Sources};

/// Names of the tables about artifacts.
pub(crate) const TABLES: [&str; 5] = ["artifacts", "settings", "summaries", "inputs", "columns"];

/// A table about artifacts; `None` if there is none with this name.
pub(crate) fn table(sources: &Sources, name: &str) -> PolarsResult<Option<LazyFrame>> {
    let frame = match name {
        "artifacts" => artifacts(sources)?,
        "settings" => leaves(sources, |sources, entry| {
            &sources.entries[entry].artifact.manifest().config
        })?,
        "summaries" => leaves(sources, |sources, entry| {
            &sources.entries[entry].artifact.manifest().summary
        })?,
        "inputs" => inputs(sources)?,
        "columns" => columns(sources)?,
        _ => return Ok(None),
    };
    Ok(Some(frame.lazy()))
}

/// One row per artifact.
fn artifacts(sources: &Sources) -> PolarsResult<DataFrame> {
    let manifests = || sources.entries.iter().map(|entry| entry.artifact.manifest());
    let texts = |name: &str, values: Vec<String>| Column::new(name.into(), values);
    frame(vec![
        texts(
            ARTIFACT,
            sources.entries.iter().map(|entry| entry.name.clone()).collect(),
        ),
        Column::new(
            DATASET.into(),
            sources
                .entries
                .iter()
                .map(|entry| entry.dataset.clone())
                .collect::<Vec<_>>(),
        ),
        texts("kind", manifests().map(|manifest| manifest.artifact.clone()).collect()),
        texts("stage", manifests().map(|manifest| manifest.stage.clone()).collect()),
        texts("key", manifests().map(|manifest| manifest.key.to_string()).collect()),
        texts(
            "path",
            sources
                .entries
                .iter()
                .map(|entry| entry.artifact.path().display().to_string())
                .collect(),
        ),
        Column::new(
            "code_version".into(),
            manifests().map(|manifest| manifest.code_version).collect::<Vec<_>>(),
        ),
        texts(
            "tool_version",
            manifests().map(|manifest| manifest.tool_version.clone()).collect(),
        ),
        Column::new(
            "warnings".into(),
            manifests()
                .map(|manifest| manifest.warnings.len() as u64)
                .collect::<Vec<_>>(),
        ),
    ])
}

/// One row per value in nested JSON objects: the artifact, the path of the value separated by dots, and the value as text.
fn leaves(sources: &Sources, of: fn(&Sources, usize) -> &Value) -> PolarsResult<DataFrame> {
    let (mut artifacts, mut names, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for (place, entry) in sources.entries.iter().enumerate() {
        let mut found = Vec::new();
        collect("", of(sources, place), &mut found);
        for (name, value) in found {
            artifacts.push(entry.name.clone());
            names.push(name);
            values.push(value);
        }
    }
    frame(vec![
        Column::new(ARTIFACT.into(), artifacts),
        Column::new("name".into(), names),
        Column::new("value".into(), values),
    ])
}

/// Collects the values in nested objects. Text has no quotes; null stays null; lists are JSON.
fn collect(path: &str, value: &Value, found: &mut Vec<(String, Option<String>)>) {
    match value {
        Value::Object(map) => {
            for (name, value) in map {
                let path = if path.is_empty() {
                    name.clone()
                } else {
                    format!("{path}.{name}")
                };
                collect(&path, value, found);
            }
        }
        Value::Null => found.push((path.to_owned(), None)),
        Value::String(text) => found.push((path.to_owned(), Some(text.clone()))),
        other => found.push((path.to_owned(), Some(other.to_string()))),
    }
}

/// One row per input of an artifact.
fn inputs(sources: &Sources) -> PolarsResult<DataFrame> {
    let rows = || {
        sources
            .entries
            .iter()
            .flat_map(|entry| entry.artifact.manifest().inputs.iter().map(move |input| (entry, input)))
    };
    frame(vec![
        Column::new(
            ARTIFACT.into(),
            rows().map(|(entry, _)| entry.name.clone()).collect::<Vec<_>>(),
        ),
        Column::new(
            "name".into(),
            rows().map(|(_, (name, _))| name.clone()).collect::<Vec<_>>(),
        ),
        Column::new(
            "key".into(),
            rows().map(|(_, (_, key))| key.to_string()).collect::<Vec<_>>(),
        ),
    ])
}

/// One row per column of the tables that the artifacts have.
fn columns(sources: &Sources) -> PolarsResult<DataFrame> {
    let mut rows = Vec::new();
    for name in sources.tables() {
        for spec in sources.specs_of(name) {
            rows.extend(spec.columns.iter().map(|column| (spec, column)));
        }
    }
    let texts = |name: &str, values: Vec<&'static str>| Column::new(name.into(), values);
    frame(vec![
        texts("table", rows.iter().map(|(spec, _)| spec.name).collect()),
        texts("domain", rows.iter().map(|(spec, _)| spec.domain).collect()),
        texts("column", rows.iter().map(|(_, column)| column.name).collect()),
        texts("type", rows.iter().map(|(_, column)| column.kind.as_str()).collect()),
        Column::new(
            "nullable".into(),
            rows.iter().map(|(_, column)| column.nullable).collect::<Vec<_>>(),
        ),
        texts("unit", rows.iter().map(|(_, column)| column.unit).collect()),
        texts("frame", rows.iter().map(|(_, column)| column.frame).collect()),
        texts(
            "description",
            rows.iter().map(|(_, column)| column.description).collect(),
        ),
    ])
}

fn frame(columns: Vec<Column>) -> PolarsResult<DataFrame> {
    DataFrame::new_infer_height(columns)
}

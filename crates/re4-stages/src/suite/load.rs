//! Reads a suite file and reports all of its faults at once.

use std::path::Path;

use anyhow::{Context as _, Result};
use re4_fault::{Fault, OrFault as _, Remedy as _, fault};
use serde_json::Value;

use super::cells::wanted;
use super::{Cell, Selection, Suite, suite_schema};
use crate::pipeline::{one_line, placed, resolve, suggestion};

/// Reads a suite file. Returns it with the cells of the selected rows and columns.
///
/// A cell whose own settings are not valid is no fault of the suite: it has a sentence in place of a pipeline.
///
/// # Errors
/// If the file cannot be read or is not TOML, or with one sentence for each of its faults: an unknown key, a missing pipeline, an
/// unknown name, a measure that the task does not have, or a cell with other seeds than the baseline's.
pub fn read_suite(path: &Path, selection: &Selection) -> Result<(Suite, Vec<Cell>)> {
    let text = std::fs::read_to_string(path).or_fault(|| {
        fault!(
            "cannot read the suite file {}", path.display();
            "give the path of a TOML file such as pipelines/table1.toml"
        )
    })?;
    let table: toml::Table = text.parse().map_err(|error: toml::de::Error| {
        anyhow::anyhow!(
            "cannot read the suite file {}: {}",
            path.display(),
            one_line(&text, &error)
        )
    })?;
    let document = serde_json::to_value(&table).context("cannot represent the suite file")?;
    let schema = suite_schema();
    let mut faults = Vec::new();
    unknown_keys(&schema, &schema, &document, "", &mut faults);
    if !faults.is_empty() {
        // The pipelines and names are checked as well, without the unknown keys.
        let known = without_unknown(&schema, &schema, document);
        if let Ok(suite) = serde_json::from_value::<Suite>(known) {
            faults.extend(suite.cells(path, selection).1);
        }
        return Err(all(path, faults).into());
    }
    let mut suite: Suite = serde_path_to_error::deserialize(toml::Value::Table(table)).map_err(|error| {
        let place = counted_from_one(&error.path().to_string());
        all(path, vec![placed(&place, error.into_inner().message())])
    })?;
    if suite.title.is_empty() {
        suite.title = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    }
    let (cells, mut faults) = suite.cells(path, selection);
    faults.extend(suite.unpaired(&cells));
    if !faults.is_empty() {
        return Err(all(path, faults).into());
    }
    suite.row.retain(|row| wanted(&selection.rows, &row.name));
    suite.column.retain(|column| wanted(&selection.columns, &column.name));
    Ok((suite, cells))
}

/// Whether a file is a suite rather than a pipeline: it has rows or columns. A file that cannot be read is none.
pub fn is_suite(path: &Path) -> bool {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let table: toml::Table = text.parse().unwrap_or_default();
    ["row", "column"].iter().any(|key| table.contains_key(*key))
}

/// One fault made of all faults of a file, each with its remedy.
fn all(path: &Path, mut faults: Vec<Fault>) -> Fault {
    let file = format!("cannot use the suite file {}", path.display());
    if faults.len() == 1
        && let Some(fault) = faults.pop()
    {
        return fault.at(format!("{file}: "));
    }
    let numbered = faults
        .iter()
        .enumerate()
        .map(|(i, fault)| format!("({}) {}", i + 1, fault.sentence()));
    let list = numbered.collect::<Vec<_>>().join("; ");
    Fault::new(
        format!("{file}, which has {} faults: {list}", faults.len()),
        None::<String>,
    )
}

/// A path such as `row[0].name` with numbers of tables counted from 1.
fn counted_from_one(place: &str) -> String {
    let mut parts = place.split('[');
    let mut counted = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (number, rest) = part.split_once(']').unwrap_or((part, ""));
        let next = number
            .parse::<usize>()
            .map_or_else(|_| number.to_owned(), |number| (number + 1).to_string());
        counted.push_str(&["[", &next, "]", rest].concat());
    }
    counted
}

/// Collects the keys that the schema does not have.
fn unknown_keys(root: &Value, schema: &Value, document: &Value, place: &str, faults: &mut Vec<Fault>) {
    let schema = resolve(root, schema);
    match (document, schema.get("properties"), schema.get("items")) {
        (Value::Object(map), Some(Value::Object(properties)), _) => {
            for (key, value) in map {
                let path = [place, key].concat();
                match properties.get(key) {
                    Some(inner) => unknown_keys(root, inner, value, &format!("{path}."), faults),
                    None => faults.push(fault!(
                        "unknown key {path}{}", suggestion(key, properties.keys().map(String::as_str));
                        "the known keys are {}", properties.keys().cloned().collect::<Vec<_>>().join(", ")
                    )),
                }
            }
        }
        (Value::Array(list), _, Some(inner)) => {
            for (number, value) in list.iter().enumerate() {
                let place = format!("{}[{}].", place.trim_end_matches('.'), number + 1);
                unknown_keys(root, inner, value, &place, faults);
            }
        }
        _ => {}
    }
}

/// The document without the keys that the schema does not have.
fn without_unknown(root: &Value, schema: &Value, document: Value) -> Value {
    let schema = resolve(root, schema);
    match (document, schema.get("properties"), schema.get("items")) {
        (Value::Object(map), Some(Value::Object(properties)), _) => {
            let known = |(key, value): (String, Value)| {
                let inner = properties.get(&key)?;
                Some((key, without_unknown(root, inner, value)))
            };
            Value::Object(map.into_iter().filter_map(known).collect())
        }
        (Value::Array(list), _, Some(inner)) => list
            .into_iter()
            .map(|value| without_unknown(root, inner, value))
            .collect(),
        (document, _, _) => document,
    }
}

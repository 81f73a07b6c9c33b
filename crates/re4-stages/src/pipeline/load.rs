//! Reading a pipeline file: its text, overrides, keys that nobody knows, presets.

use std::path::Path;

use anyhow::{Context as _, Result};
use re4_fault::{OrFault as _, bail, fault};
use re4_policy::spatial::{SPATIAL_PRESETS, SpatialPolicyConfig};
use re4_policy::{PRESETS, PolicyConfig};
use re4_segment::SegmentConfig;
use serde_json::{Map, Value};

use super::schema::{SPATIAL_ROLLOUT, inner_schema};
use super::{Pipeline, checks};

/// Reads a pipeline file and applies `--set` overrides.
///
/// # Errors
/// When the file cannot be read, is not TOML, has an unknown key (named, with the nearest known one) or a value that
/// does not fit.
pub(crate) fn load(path: &Path, overrides: &[String]) -> Result<Pipeline> {
    let text = std::fs::read_to_string(path).or_fault(|| {
        fault!(
            "cannot read the pipeline file {}", path.display();
            "give the path of a TOML file such as pipelines/demo.toml"
        )
    })?;
    parse(&text, path, overrides)
}

/// The pipeline in the text of a file; the path is for messages only.
///
/// # Errors
/// As [`load`], but for reading the file.
pub(crate) fn parse(text: &str, path: &Path, overrides: &[String]) -> Result<Pipeline> {
    let table: toml::Table = text.parse().map_err(|error: toml::de::Error| {
        anyhow::anyhow!(
            "cannot read the pipeline file {}: {}",
            path.display(),
            one_line(text, &error)
        )
    })?;
    let mut document = serde_json::to_value(table).context("cannot represent the pipeline file")?;
    for text in overrides {
        apply(&mut document, text)?;
    }
    let unusable = || format!("cannot use the pipeline file {}", path.display());
    refuse_not_finite(&document, "").with_context(unusable)?;
    tell_rollouts_apart(&mut document).with_context(unusable)?;
    let schema = inner_schema();
    refuse_unknown(&schema, &schema, &document, "").with_context(unusable)?;
    complete_segment(&mut document)?;
    complete_policy(&mut document, "rollout", PRESETS, preset).with_context(unusable)?;
    complete_policy(&mut document, SPATIAL_ROLLOUT, SPATIAL_PRESETS, spatial_preset).with_context(unusable)?;
    let pipeline: Pipeline = serde_path_to_error::deserialize(document).map_err(|error| {
        let place = match error.path().to_string().as_str() {
            "." => String::new(),
            place => format!("{}: ", place.replace(SPATIAL_ROLLOUT, "rollout")),
        };
        let why = in_words(&error.into_inner().to_string());
        anyhow::anyhow!("cannot use the pipeline file {}: {place}{why}", path.display())
    })?;
    checks::check(&pipeline).with_context(unusable)?;
    Ok(pipeline)
}

/// The message with line and column, both counted from 1.
fn one_line(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().replace('\n', "; ");
    let Some(before) = error.span().and_then(|span| text.get(..span.start)) else {
        return message;
    };
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    format!("line {line}, column {column}: {message}")
}

/// The decoder's words without names of Rust types.
fn in_words(message: &str) -> String {
    let mut words = Vec::new();
    let mut rest = message.split(' ').peekable();
    while let Some(word) = rest.next() {
        words.push(match word {
            "struct" if words.last() == Some(&"expected") => {
                rest.next();
                "a table"
            }
            "u32" => "a whole number from 0 to 4294967295",
            "usize" => "a whole number of at least 0",
            "f64" => "a number",
            // Neither TOML nor JSON can say null: it stands for what JSON cannot say.
            "null," => "nan or inf,",
            other => other,
        });
    }
    words.join(" ")
}

/// Most parts of a key on the command line, more than any setting has. Tables inside of tables are walked recursively.
const DEEPEST: usize = 16;

/// Applies one `stage.key=value`; the value is TOML, or a plain string where it is not.
fn apply(document: &mut Value, text: &str) -> Result<()> {
    let Some((path, value)) = text.split_once('=') else {
        bail!("cannot apply --set {text}: write stage.key=value, for instance rollout.seeds=500..600");
    };
    let parsed = format!("value = {value}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut table| table.remove("value"))
        .map_or_else(|| Ok(Value::String(value.to_owned())), serde_json::to_value)?;
    let depth = path.split('.').count();
    if depth > DEEPEST {
        bail!(
            "cannot apply --set: the key has {depth} parts, and no setting has more than {DEEPEST}";
            "write stage.key=value"
        );
    }
    let mut at = document;
    for key in path.trim().split('.') {
        if key.is_empty() {
            bail!("cannot apply --set {text}: the key is empty"; "write stage.key=value");
        }
        if !at.is_object() {
            *at = Value::Object(Map::new());
        }
        let Value::Object(map) = at else { continue };
        at = map.entry(key).or_insert(Value::Null);
    }
    *at = parsed;
    Ok(())
}

/// Gives robosuite's tasks, which are in metres, their own defaults of `[segment]` for what the file leaves out.
fn complete_segment(document: &mut Value) -> Result<()> {
    if document.get("task").and_then(Value::as_str) == Some("pusht") {
        return Ok(());
    }
    let Some(section) = document.get_mut("segment").and_then(Value::as_object_mut) else {
        return Ok(());
    };
    if let Value::Object(defaults) = serde_json::to_value(SegmentConfig::spatial())? {
        for (key, value) in defaults {
            section.entry(key).or_insert(value);
        }
    }
    Ok(())
}

/// Puts the table `[rollout]` of robosuite's tasks where it is read.
fn tell_rollouts_apart(document: &mut Value) -> Result<()> {
    let Some(map) = document.as_object_mut() else {
        return Ok(());
    };
    if map.contains_key(SPATIAL_ROLLOUT) {
        bail!("unknown key {SPATIAL_ROLLOUT}"; "the table is called rollout for every task");
    }
    let robosuite = map
        .get("task")
        .and_then(Value::as_str)
        .is_some_and(|task| task != "pusht");
    if robosuite && let Some(rollout) = map.remove("rollout") {
        map.insert(SPATIAL_ROLLOUT.to_owned(), rollout);
    }
    Ok(())
}

fn preset(name: &str) -> Option<Result<Value, serde_json::Error>> {
    PolicyConfig::preset(name).map(serde_json::to_value)
}

fn spatial_preset(name: &str) -> Option<Result<Value, serde_json::Error>> {
    SpatialPolicyConfig::preset(name).map(serde_json::to_value)
}

/// Starts from the preset and lets the file's own settings replace single ones.
fn complete_policy(
    document: &mut Value,
    table: &str,
    presets: [&str; 3],
    preset: fn(&str) -> Option<Result<Value, serde_json::Error>>,
) -> Result<()> {
    let Some(rollout) = document.get_mut(table).and_then(Value::as_object_mut) else {
        return Ok(());
    };
    let Some(name) = rollout.get("policy").and_then(Value::as_str) else {
        return Ok(());
    };
    let Some(preset) = preset(name) else {
        bail!(
            "unknown policy {name:?} in rollout.policy{}", suggestion(name, presets);
            "the presets are {}", presets.join(", ")
        );
    };
    if let Value::Object(sections) = preset? {
        for (section, settings) in sections {
            let own = rollout.remove(&section);
            if let Some(merged) = merge(settings, own) {
                rollout.insert(section, merged);
            }
        }
    }
    Ok(())
}

/// A preset's settings with one's own in their place, table by table. `false` switches an optional table off.
fn merge(preset: Value, own: Option<Value>) -> Option<Value> {
    match (preset, own) {
        (Value::Null, None) => None,
        // An optional setting that is switched off.
        (preset, Some(Value::Bool(false))) if !preset.is_boolean() => None,
        (preset, None) => Some(preset),
        (Value::Object(mut settings), Some(Value::Object(own))) => {
            for (key, value) in own {
                let merged = merge(settings.remove(&key).unwrap_or(Value::Null), Some(value));
                settings.extend(merged.map(|value| (key, value)));
            }
            Some(Value::Object(settings))
        }
        // Not a table: left for the decoder to refuse.
        (_, Some(own)) => Some(own),
    }
}

/// JSON cannot say nan and inf and has null in their place, which an optional setting would take for absence.
fn refuse_not_finite(document: &Value, place: &str) -> Result<()> {
    match document {
        Value::Null => bail!("{place} is nan or inf"; "give a finite number, or leave it out"),
        Value::Object(map) => map.iter().try_for_each(|(key, value)| {
            let dot = if place.is_empty() { "" } else { "." };
            refuse_not_finite(value, &format!("{place}{dot}{key}"))
        }),
        Value::Array(items) => items.iter().try_for_each(|item| refuse_not_finite(item, place)),
        _ => Ok(()),
    }
}

/// Walks the document along its schema and refuses the first key that the schema does not know.
fn refuse_unknown(root: &Value, schema: &Value, document: &Value, place: &str) -> Result<()> {
    let schema = resolve(root, schema);
    let (Value::Object(map), Some(properties)) = (document, schema.get("properties").and_then(Value::as_object)) else {
        return Ok(());
    };
    for (key, value) in map {
        let path = if place.is_empty() {
            key.clone()
        } else {
            format!("{place}.{key}")
        };
        let shown = path.replace(SPATIAL_ROLLOUT, "rollout");
        match properties.get(key) {
            Some(inner) => refuse_unknown(root, inner, value, &path)?,
            None => bail!(
                "unknown key {shown}{}", suggestion(key, known(properties));
                "known here: {}", known(properties).collect::<Vec<_>>().join(", ")
            ),
        }
    }
    Ok(())
}

/// Keys that a file may have.
fn known(properties: &Map<String, Value>) -> impl Iterator<Item = &str> {
    properties
        .keys()
        .map(String::as_str)
        .filter(|key| *key != SPATIAL_ROLLOUT)
}

fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    // An optional table is one of the table and null.
    let table = schema.get("anyOf").and_then(|schemas| schemas.get(0));
    let schema = table.filter(|schema| schema.get("$ref").is_some()).unwrap_or(schema);
    let target = schema
        .get("$ref")
        .and_then(Value::as_str)
        .and_then(|r| r.strip_prefix('#'));
    target.and_then(|pointer| root.pointer(pointer)).unwrap_or(schema)
}

fn suggestion<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(String::new, |(_, candidate)| format!(" (did you mean {candidate}?)"))
}

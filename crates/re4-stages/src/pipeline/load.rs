//! Reads a pipeline file: parses its text, applies overrides, refuses unknown keys and fills in defaults.

use std::path::Path;

use anyhow::{Context as _, Result};
use re4_encoder::EncoderConfig;
use re4_fault::{Fault, OrFault as _, bail, fault};
use re4_policy::kinds::{Kinds, PlanePolicy, SpacePolicy};
use re4_segment::SegmentConfig;
use serde_json::{Map, Value};

use super::rollout::ROBOMIMIC_STEPS;
use super::schema::schema_with;
use super::{Pipeline, Policy, Task, checks};

/// Reads a pipeline file and applies `--set` overrides.
///
/// # Errors
/// If the file cannot be read, is not TOML, or has an unknown key (the message names it and the most similar known key) or an
/// invalid value.
pub fn read_pipeline(path: &Path, overrides: &[String]) -> Result<Pipeline> {
    let text = std::fs::read_to_string(path).or_fault(|| {
        fault!(
            "cannot read the pipeline file {}", path.display();
            "give the path of a TOML file such as pipelines/demo.toml"
        )
    })?;
    parse(&text, path, overrides)
}

/// Reads a pipeline from the text of a file. The path appears only in messages.
///
/// # Errors
/// As for [`read_pipeline`], except that no file is read.
pub(crate) fn parse(text: &str, path: &Path, overrides: &[String]) -> Result<Pipeline> {
    let table: toml::Table = text.parse().map_err(|error: toml::de::Error| {
        anyhow::anyhow!(
            "cannot read the pipeline file {}: {}",
            path.display(),
            one_line(text, &error)
        )
    })?;
    let mut document = serde_json::to_value(table).context("cannot represent the pipeline file")?;
    let unusable = || format!("cannot use the pipeline file {}", path.display());
    // Before the overrides, so that an override of [policy] applies to the policy of an older file; and again after them, because
    // an override can replace the whole table [rollout] by one in the older form.
    move_policy(&mut document).with_context(unusable)?;
    let of_file = document.get("policy").cloned();
    for text in overrides {
        apply(&mut document, text)?;
    }
    refuse_not_finite(&document, "").with_context(unusable)?;
    move_policy(&mut document).with_context(unusable)?;
    let planar = document.get("task").and_then(Value::as_str).unwrap_or("pusht") == "pusht";
    let dropped = match &of_file {
        Some(of_file) if planar => drop_foreign::<PlanePolicy>(&mut document, of_file),
        Some(of_file) => drop_foreign::<SpacePolicy>(&mut document, of_file),
        None => Vec::new(),
    };
    let given = document.clone();
    let policy = if planar {
        read_policy::<PlanePolicy>(&mut document, "plane").map(|(policy, schema)| (policy.map(Policy::Plane), schema))
    } else {
        complete_spatial(&mut document)?;
        read_policy::<SpacePolicy>(&mut document, "space").map(|(policy, schema)| (policy.map(Policy::Space), schema))
    };
    let (policy, schema) = policy.with_context(unusable)?;
    complete_encoder(&mut document)?;
    let mut pipeline: Pipeline = serde_path_to_error::deserialize(document).map_err(|error| {
        let place = error.path().to_string();
        placed(&place, &error.into_inner().to_string()).at(format!("cannot use the pipeline file {}: ", path.display()))
    })?;
    pipeline.policy = policy;
    checks::check(&pipeline).with_context(unusable)?;
    pipeline.without_effect = dropped;
    pipeline
        .without_effect
        .extend(without_effect(&schema, &given, &pipeline)?);
    Ok(pipeline)
}

/// The text of a decoder's error, preceded by the path of the key that it refers to.
pub(crate) fn placed(place: &str, error: &str) -> Fault {
    let place = if place == "." {
        String::new()
    } else {
        format!("{place}: ")
    };
    Fault::from_sentence(&without_type_names(error)).at(place)
}

/// The parser's message with line and column, both counted from 1.
pub(crate) fn one_line(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().replace('\n', "; ");
    let Some(before) = error.span().and_then(|span| text.get(..span.start)) else {
        return message;
    };
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    format!("line {line}, column {column}: {message}")
}

/// The decoder's message with the names of Rust types replaced by words for users.
fn without_type_names(message: &str) -> String {
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
            // TOML has no null. A null in the document is a TOML nan or inf, which JSON cannot represent.
            "null," => "nan or inf,",
            other => other,
        });
    }
    words.join(" ")
}

/// Maximum number of parts of a key on the command line, which is more than any setting has. The limit keeps the recursion over
/// nested tables shallow.
const MAX_DEPTH: usize = 16;

/// Applies one override `stage.key=value`. The value is parsed as TOML; if it is not TOML, it is taken as a plain string.
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
    if depth > MAX_DEPTH {
        bail!(
            "cannot apply --set: the key has {depth} parts, and no setting has more than {MAX_DEPTH}";
            "write stage.key=value"
        );
    }
    let mut at = document;
    for key in moved(path.trim()).split('.') {
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

/// Fills in the settings of the encoder's preset. A wrong value of a setting, also of the preset, is refused later.
fn complete_encoder(document: &mut Value) -> Result<()> {
    let Some(own) = document.pointer_mut("/pose/encoder").filter(|own| own.is_object()) else {
        return Ok(());
    };
    let preset = own.get("preset").cloned();
    let preset = preset.and_then(|preset| serde_json::from_value(preset).ok());
    let config = preset.map_or_else(EncoderConfig::default, EncoderConfig::preset);
    if let Some(merged) = merge(serde_json::to_value(config)?, Some(own.take())) {
        *own = merged;
    }
    Ok(())
}

/// Fills in the defaults of robosuite tasks, which differ from those of Push-T because positions are in metres and episodes are
/// longer.
fn complete_spatial(document: &mut Value) -> Result<()> {
    let arm = document.get("task").and_then(Value::as_str) == Some(Task::Arm.name());
    let defaults = if arm {
        SegmentConfig::arm()
    } else {
        SegmentConfig::spatial()
    };
    if let Some(section) = document.get_mut("segment").and_then(Value::as_object_mut)
        && let Value::Object(defaults) = serde_json::to_value(defaults)?
    {
        for (key, value) in defaults {
            section.entry(key).or_insert(value);
        }
    }
    if let Some(section) = document.get_mut("rollout").and_then(Value::as_object_mut) {
        section.entry("max_steps").or_insert(Value::from(ROBOMIMIC_STEPS));
    }
    Ok(())
}

/// Keys of older pipeline files that have moved from table `[rollout]` to table `[policy]`: the name in `[rollout]` and the name
/// in `[policy]`.
const MOVED: [(&str, &str); 7] = [
    ("policy", "kind"),
    ("retrieve", "retrieve"),
    ("reframe", "reframe"),
    ("replan", "replan"),
    ("replay", "replay"),
    ("recovery", "recovery"),
    ("filter", "filter"),
];

/// The present name of an override's key.
fn moved(path: &str) -> String {
    let present = MOVED.iter().find_map(|(old, new)| {
        let rest = path.strip_prefix("rollout.")?.strip_prefix(old)?;
        (rest.is_empty() || rest.starts_with('.')).then(|| format!("policy.{new}{rest}"))
    });
    present.unwrap_or_else(|| path.to_owned())
}

/// Moves the policy settings of an older file from `[rollout]` to a table `[policy]`.
fn move_policy(document: &mut Value) -> Result<()> {
    let Some(rollout) = document.get_mut("rollout").and_then(Value::as_object_mut) else {
        return Ok(());
    };
    let mut policy = Map::new();
    let mut first = None;
    for (old, new) in MOVED {
        if let Some(value) = rollout.remove(old) {
            first = first.or(Some((old, new)));
            policy.insert(new.to_owned(), value);
        }
    }
    let (Some((old, new)), Some(map)) = (first, document.as_object_mut()) else {
        return Ok(());
    };
    if map.contains_key("policy") {
        bail!(
            "rollout.{old} and a table [policy] both define the policy";
            "replace rollout.{old} by policy.{new}"
        );
    }
    map.insert("policy".to_owned(), Value::Object(policy));
    Ok(())
}

/// If an override has changed the kind of the policy, removes the settings of the file's policy that the new kind does not have. Returns
/// a sentence for each.
fn drop_foreign<K: Kinds>(document: &mut Value, of_file: &Value) -> Vec<String> {
    let kind_in = |policy: &Value| policy.get("kind").and_then(Value::as_str).map(str::to_owned);
    let (Some(old), Some(new)) = (kind_in(of_file), document.get("policy").and_then(kind_in)) else {
        return Vec::new();
    };
    let (Some(schema), Some(policy)) = (
        K::schema(&new).filter(|_| old != new),
        document.get_mut("policy").and_then(Value::as_object_mut),
    ) else {
        return Vec::new();
    };
    let known = |key: &str| schema.get("properties").is_some_and(|known| known.get(key).is_some());
    let mut dropped = Vec::new();
    for (key, value) in of_file.as_object().into_iter().flatten() {
        // A setting that an override has changed is refused later.
        if key != "kind" && !known(key) && policy.get(key) == Some(value) {
            policy.remove(key);
            dropped.push(format!(
                "policy.{key} has no effect, because the policy is {new:?} instead of {old:?}; remove it"
            ));
        }
    }
    dropped
}

/// Refuses unknown keys, and moves the policy out of the document: the defaults of its kind, overridden by the file's own
/// settings. The policy is decoded here and not with the rest because the type of its settings depends on the kind.
fn read_policy<K: Kinds>(document: &mut Value, domain: &str) -> Result<(Option<K>, Value)> {
    let kind = document.get("policy").map(kind_of::<K>).transpose()?;
    let schema = schema_with::<K>(kind.as_deref());
    refuse_unknown(&Walk { root: &schema, domain }, &schema, document, "")?;
    let (Some(kind), Some(Value::Object(mut own))) =
        (kind, document.as_object_mut().and_then(|map| map.remove("policy")))
    else {
        return Ok((None, schema));
    };
    own.remove("kind");
    let mut defaults = serde_json::to_value(K::defaults(&kind))?;
    if let Value::Object(defaults) = &mut defaults {
        defaults.remove("kind");
    }
    let settings = merge(defaults, Some(Value::Object(own))).unwrap_or_default();
    let mut track = serde_path_to_error::Track::new();
    let read = K::read(&kind, serde_path_to_error::Deserializer::new(settings, &mut track));
    read.map(|policy| (Some(policy), schema))
        .map_err(|error| placed(&format!("policy.{}", track.path()), &error.to_string()).into())
}

/// The kind that a table `[policy]` names.
fn kind_of<K: Kinds>(policy: &Value) -> Result<String> {
    let kinds = K::NAMES.join(", ");
    if !policy.is_object() {
        bail!("policy is {policy}"; "give a table, such as {{ kind = \"re4\" }}; the kinds are {kinds}");
    }
    match policy.get("kind") {
        None => bail!("the table [policy] has no kind"; "give policy.kind; the kinds are {kinds}"),
        Some(Value::String(kind)) if K::NAMES.contains(&kind.as_str()) => Ok(kind.clone()),
        Some(Value::String(kind)) => bail!(
            "unknown policy {kind:?} in policy.kind{}", suggestion(kind, K::NAMES.iter().copied());
            "the kinds are {kinds}"
        ),
        Some(other) => bail!("policy.kind is {other}"; "the kinds are {kinds}"),
    }
}

/// Overrides default settings with the file's own, table by table. `false` switches an optional table off.
fn merge(default: Value, own: Option<Value>) -> Option<Value> {
    match (default, own) {
        (Value::Null, None) => None,
        // `false` for a setting that is not a boolean switches it off.
        (default, Some(Value::Bool(false))) if !default.is_boolean() => None,
        (default, None) => Some(default),
        (Value::Object(mut settings), Some(Value::Object(own))) => {
            for (key, value) in own {
                let merged = merge(settings.remove(&key).unwrap_or(Value::Null), Some(value));
                settings.extend(merged.map(|value| (key, value)));
            }
            Some(Value::Object(settings))
        }
        // Either a plain value or a value of the wrong type, which the decoder refuses later.
        (_, Some(own)) => Some(own),
    }
}

/// Refuses nan and inf. In the JSON document they have become null, which an optional setting would read as absent.
fn refuse_not_finite(document: &Value, place: &str) -> Result<()> {
    match document {
        Value::Null => bail!("{place} is nan or inf"; "give a finite number, or remove it"),
        Value::Object(map) => map.iter().try_for_each(|(key, value)| {
            let dot = if place.is_empty() { "" } else { "." };
            refuse_not_finite(value, &format!("{place}{dot}{key}"))
        }),
        Value::Array(items) => items.iter().try_for_each(|item| refuse_not_finite(item, place)),
        _ => Ok(()),
    }
}

/// What stays the same during a walk over a document.
struct Walk<'a> {
    /// The schema in which references are resolved.
    root: &'a Value,
    /// The domain of the task: `plane` or `space`. Keys of the other domain are unknown keys.
    domain: &'a str,
}

/// Walks the document along its schema and refuses the first key that is not in the schema.
fn refuse_unknown(walk: &Walk<'_>, schema: &Value, document: &Value, place: &str) -> Result<()> {
    let schema = resolve(walk.root, schema);
    let (Value::Object(map), Some(properties)) = (document, schema.get("properties").and_then(Value::as_object)) else {
        return Ok(());
    };
    let in_domain = |inner: &Value| inner.get("domain").is_none_or(|domain| domain == walk.domain);
    let known = || {
        properties
            .iter()
            .filter(|(_, inner)| in_domain(inner))
            .map(|(key, _)| key.as_str())
    };
    for (key, value) in map {
        let path = if place.is_empty() {
            key.clone()
        } else {
            format!("{place}.{key}")
        };
        match properties.get(key).filter(|inner| in_domain(inner)) {
            Some(inner) => refuse_unknown(walk, inner, value, &path)?,
            None => bail!(
                "unknown key {path}{}", suggestion(key, known());
                "the known keys are {}", known().collect::<Vec<_>>().join(", ")
            ),
        }
    }
    Ok(())
}

/// Finds the settings of a file, or of the command line, that nothing reads because of the value of another setting. A field
/// of a config declares this with `#[schemars(extend("only_with" = { "path.of.another": value }))]`; all of these have to agree.
fn without_effect(schema: &Value, given: &Value, pipeline: &Pipeline) -> Result<Vec<String>> {
    let mut effective = serde_json::to_value(pipeline)?;
    effective["policy"] = serde_json::to_value(&pipeline.policy)?;
    let mut found = Vec::new();
    walk_given(schema, schema, given, "", &mut |path, field| {
        let conditions = field.get("only_with").and_then(Value::as_object);
        let unmet = conditions.into_iter().flatten().find_map(|(other, needed)| {
            let value = other.split('.').try_fold(&effective, |value, key| value.get(key));
            let value = value.unwrap_or(&Value::Null);
            let agrees = value == needed;
            (!agrees).then_some((other, needed, value))
        });
        if let Some((other, needed, value)) = unmet {
            let why = match (needed, value) {
                (Value::Null, _) => format!("the pipeline has a table [{other}]"),
                (_, Value::Null) => format!("{other} is not {needed}"),
                (needed, value) => format!("{other} is {value}, not {needed}"),
            };
            found.push(format!("{path} has no effect, because {why}; remove it"));
        }
    });
    Ok(found)
}

/// Calls `each` for every setting that a document gives, with its path and its schema.
fn walk_given(root: &Value, schema: &Value, given: &Value, place: &str, each: &mut dyn FnMut(&str, &Value)) {
    let properties = resolve(root, schema).get("properties").and_then(Value::as_object);
    for (key, value) in given.as_object().into_iter().flatten() {
        let Some(field) = properties.and_then(|properties| properties.get(key)) else {
            continue;
        };
        let path = if place.is_empty() {
            key.clone()
        } else {
            format!("{place}.{key}")
        };
        each(&path, field);
        walk_given(root, field, value, &path, each);
    }
}

pub(crate) fn resolve<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    // The schema of an optional table is `anyOf` the table and null.
    let table = schema.get("anyOf").and_then(|schemas| schemas.get(0));
    let schema = table.filter(|schema| schema.get("$ref").is_some()).unwrap_or(schema);
    let target = schema
        .get("$ref")
        .and_then(Value::as_str)
        .and_then(|r| r.strip_prefix('#'));
    target.and_then(|pointer| root.pointer(pointer)).unwrap_or(schema)
}

pub(crate) fn suggestion<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(similarity, _)| *similarity > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(String::new, |(_, candidate)| format!(" (did you mean {candidate}?)"))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{parse, read_pipeline};

    #[test]
    fn settings_that_nothing_reads_are_named() {
        let text = include_str!("../../../../pipelines/pusht-state.toml");
        let with = |overrides: &[&str]| {
            let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
            parse(text, Path::new("x.toml"), &overrides).unwrap().without_effect
        };
        assert_eq!(with(&[]), Vec::<String>::new());
        assert_eq!(
            with(&["policy.retrieve.epsilon=0.2"]),
            [
                "policy.retrieve.epsilon has no effect, because policy.retrieve.selector is \"outcome\", not \"two_stage\"; remove it"
            ]
        );
        assert_eq!(
            with(&["policy.kind=paper", "policy.retrieve.epsilon=0.2"]),
            Vec::<String>::new()
        );
        let off = with(&["policy.replan.enabled=false", "policy.replan.keepout=20"]);
        assert!(
            off.iter()
                .any(|text| text.starts_with("policy.replan.keepout has no effect")),
            "{off:?}"
        );
        let text = include_str!("../../../../pipelines/pusht-sparse-observations.toml");
        let overrides = ["rollout.reset=pose".to_owned()];
        let scenes = parse(text, Path::new("x.toml"), &overrides).unwrap().without_effect;
        assert!(
            scenes
                .iter()
                .any(|text| text.contains("the pipeline has a table [scenes]")),
            "{scenes:?}"
        );
    }

    #[test]
    fn settings_of_the_files_policy_do_not_prevent_another_policy() {
        let text = include_str!("../../../../pipelines/square-image.toml");
        let with = |overrides: &[&str]| {
            let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
            parse(text, Path::new("x.toml"), &overrides)
        };
        let pipeline = with(&["policy.kind=nearest"]).unwrap();
        assert_eq!(pipeline.policy.unwrap().kind(), "nearest");
        assert_eq!(
            pipeline.without_effect,
            ["policy.reframe has no effect, because the policy is \"nearest\" instead of \"re4\"; remove it"]
        );
        // What an override gives is still checked.
        let error = with(&["policy.kind=nearest", "policy.reframe.measure=step"])
            .err()
            .unwrap();
        assert!(format!("{error:#}").contains("unknown key policy.reframe"), "{error:#}");
        assert_eq!(
            with(&["policy.kind=paper"]).unwrap().without_effect,
            Vec::<String>::new()
        );
    }

    #[test]
    fn no_pipeline_of_the_repository_has_settings_that_nothing_reads() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines");
        let mut seen = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if std::fs::read_to_string(&path).unwrap().contains("[[row]]") {
                // A suite of pipelines.
                continue;
            }
            assert_eq!(
                read_pipeline(&path, &[]).unwrap().without_effect,
                Vec::<String>::new(),
                "{}",
                path.display()
            );
            seen += 1;
        }
        assert!(seen > 10);
    }
}

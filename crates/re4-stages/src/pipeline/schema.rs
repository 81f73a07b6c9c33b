//! JSON Schema of the pipeline file.

use re4_policy::kinds::{Kinds, PlanePolicy, SpacePolicy};
use serde_json::{Map, Value, json};

use super::Pipeline;

/// JSON Schema of the pipeline file. Its table `[policy]` has one alternative per distinct set of policy settings.
pub fn schema() -> Value {
    let mut schema = json!(schemars::schema_for!(Pipeline));
    let mut tables = Vec::new();
    for (domain, kinds) in [
        ("Push-T", settings::<PlanePolicy>()),
        ("robosuite's tasks", settings::<SpacePolicy>()),
    ] {
        // Kinds that differ only in their defaults have the same schema here and share one alternative.
        let mut described: Vec<(Vec<&str>, Value)> = Vec::new();
        for (kind, table) in kinds {
            match described.iter_mut().find(|(_, other)| *other == table) {
                Some((kinds, _)) => kinds.push(kind),
                None => described.push((vec![kind], table)),
            }
        }
        for (kinds, mut table) in described {
            table["properties"]["kind"] = json!({ "enum": kinds });
            table["required"] = json!(["kind"]);
            table["title"] = json!(format!("{} of {domain}", kinds.join(", ")));
            take_definitions(&mut table, &mut schema);
            tables.push(table);
        }
    }
    schema["properties"]["policy"] = json!({
        "description": "The policy that is rolled out. Settings that are left out have the defaults of their kind.",
        "anyOf": tables,
    });
    schema
}

/// The schema of a pipeline file whose policy is of this kind.
pub(super) fn schema_with<K: Kinds>(kind: Option<&str>) -> Value {
    let mut schema = json!(schemars::schema_for!(Pipeline));
    let mut table = kind
        .and_then(K::schema)
        .map_or_else(|| json!({}), |schema| described(&schema));
    if let Some(properties) = table.get_mut("properties") {
        properties["kind"] = json!({});
    }
    take_definitions(&mut table, &mut schema);
    schema["properties"]["policy"] = table;
    schema
}

fn settings<K: Kinds>() -> Vec<(&'static str, Value)> {
    let schema = |kind: &&'static str| Some((*kind, described(&K::schema(kind)?)));
    K::NAMES.iter().filter_map(schema).collect()
}

/// The schema of a policy's settings with every setting made optional, since the kind has defaults for all of them.
fn described(schema: &schemars::Schema) -> Value {
    let mut schema = json!(schema);
    let tables = schema.get_mut("$defs").and_then(Value::as_object_mut);
    for table in tables.into_iter().flat_map(Map::values_mut) {
        without_required(table);
    }
    without_required(&mut schema);
    schema
}

fn without_required(schema: &mut Value) {
    if let Some(schema) = schema.as_object_mut() {
        for key in ["required", "$schema"] {
            schema.remove(key);
        }
    }
}

/// Moves definitions to the root, because references (`#/$defs/...`) are resolved from there.
fn take_definitions(table: &mut Value, root: &mut Value) {
    if let Some(Value::Object(definitions)) = table.as_object_mut().and_then(|table| table.remove("$defs")) {
        for (name, definition) in definitions {
            root["$defs"][name] = definition;
        }
    }
}

//! JSON Schema of the pipeline file.

use serde_json::{Value, json};

use super::Pipeline;

/// Tables of the policy, which the preset fills.
const POLICY_TABLES: [&str; 6] = ["retrieve", "reframe", "replan", "replay", "recovery", "filter"];

/// JSON Schema of the pipeline file: the table `[rollout]` is one for Push-T, or one for robosuite's tasks.
pub fn schema() -> Value {
    let mut schema = inner_schema();
    if let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) {
        properties.remove(SPATIAL_ROLLOUT);
        properties.insert(
            "rollout".to_owned(),
            json!({
                "description": "`index` to `rollouts`: for Push-T, or for robosuite's tasks.",
                "anyOf": [
                    { "$ref": "#/$defs/RolloutSection" },
                    { "$ref": "#/$defs/SpatialRolloutSection" },
                ],
            }),
        );
    }
    schema
}

/// Name that the table `[rollout]` of robosuite's tasks has inside of this program.
pub(super) const SPATIAL_ROLLOUT: &str = "spatial_rollout";

/// The schema after `[rollout]` was told apart by task. The policy's own tables need not be complete: the preset fills them.
pub(super) fn inner_schema() -> Value {
    let mut schema = json!(schemars::schema_for!(Pipeline));
    if let Some(definitions) = schema.get_mut("$defs").and_then(Value::as_object_mut) {
        for name in [
            "RetrieveConfig",
            "ReframeConfig",
            "ReplanConfig",
            "ReplayConfig",
            "SpatialRetrieveConfig",
            "SpatialReframeConfig",
            "SpatialReplanConfig",
            "SpatialReplayConfig",
            "SpatialRecoveryConfig",
            "BanConfig",
            "PoseFilterConfig",
        ] {
            if let Some(definition) = definitions.get_mut(name).and_then(Value::as_object_mut) {
                definition.remove("required");
            }
        }
        for section in ["RolloutSection", "SpatialRolloutSection"] {
            let required = definitions
                .get_mut(section)
                .and_then(|section| section.get_mut("required"))
                .and_then(Value::as_array_mut);
            if let Some(required) = required {
                required.retain(|name| !POLICY_TABLES.iter().any(|table| name == table));
            }
        }
    }
    schema
}

//! The goal of Push-T's rollouts.

use std::borrow::Cow;

use re4_geometry::Pose2;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

/// Where the goal of an episode is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// At a random pose, by the seed of the episode.
    Random,
    /// At the same pose in all episodes.
    Fixed(Pose2),
}

impl Serialize for Goal {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Random => serializer.serialize_str("random"),
            Self::Fixed(pose) => [pose.x, pose.y, pose.theta].serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Goal {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        let numbers: Option<Vec<f64>> = value
            .as_array()
            .and_then(|numbers| numbers.iter().map(Value::as_f64).collect());
        match (value.as_str(), numbers.as_deref()) {
            (Some("random"), _) => Ok(Self::Random),
            (_, Some([x, y, theta])) => Ok(Self::Fixed(Pose2::new(*x, *y, *theta))),
            _ => Err(serde::de::Error::custom(format!(
                "{value} is not a goal; write \"random\", or [x, y, theta] in pixels and radians"
            ))),
        }
    }
}

impl JsonSchema for Goal {
    fn schema_name() -> Cow<'static, str> {
        "Goal".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "The word \"random\", or a pose [x, y, theta] in the world frame, in pixels and radians.",
            "anyOf": [
                { "const": "random" },
                { "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 },
            ],
        })
    }
}

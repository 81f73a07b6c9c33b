//! What a policy observes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the policy observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Variant {
    /// The end effector's state and the object's true pose.
    State,
    /// The end effector's state and images.
    Image,
}

//! What a policy observes of a task.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the policy observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Variant {
    /// End-effector state and the object's true pose.
    State,
    /// Images, and the end effector's state.
    Image,
}

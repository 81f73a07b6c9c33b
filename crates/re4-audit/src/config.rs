//! Thresholds that are set rather than derived.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Thresholds of the audit that replace those derived from the data.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AuditConfig {}

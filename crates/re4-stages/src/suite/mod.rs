//! The suite file, which names the cells of a comparison: the policies of its rows under the pipelines of its columns.

mod cells;
mod load;

use std::collections::BTreeMap;
use std::path::PathBuf;

use re4_compare::Measure;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::pipeline::Seeds;

pub use cells::{Cell, Selection};
pub use load::{is_suite, read_suite};

/// Settings that override those of pipeline files. Nested tables are joined by dots: `policy.replay.horizon` is the same as
/// `horizon` in a table `replay` in a table `policy`.
type Overrides = toml::Table;

/// A comparison of policies (rows) under pipelines (columns).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// Title of the page. Default: the name of the file.
    #[serde(default)]
    pub title: String,
    /// What the comparison is about, in a few sentences that the page shows below its title.
    #[serde(default)]
    pub about: String,
    /// Where the printed figures are from, such as `"Table 1 of the paper"`.
    #[serde(default)]
    pub printed_in: String,
    /// Name of the row with which the other rows are compared seed by seed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baseline: Option<String>,
    /// Seeds of all cells. Default: those of each pipeline. Has no effect on pipelines with a table `[scenes]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seeds: Option<Seeds>,
    /// Pipeline file of the columns that name none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pipeline: Option<PathBuf>,
    /// Measures of the columns that name none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measures: Vec<Measure>,
    /// Push-T: whether the page shows the scores under smaller budgets of control steps.
    #[serde(default)]
    pub curves: bool,
    /// Overrides of all cells.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, Value>")]
    pub set: Overrides,
    /// The rows: policies.
    #[serde(default)]
    pub row: Vec<SuiteRow>,
    /// The columns: pipelines.
    #[serde(default)]
    pub column: Vec<SuiteColumn>,
    /// Exceptions.
    #[serde(default)]
    pub cell: Vec<SuiteCell>,
}

/// A row: a policy with its settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SuiteRow {
    /// Name of the row.
    pub name: String,
    /// Kind of policy, as `policy.kind` in a pipeline. Settings in the pipeline's table `[policy]` apply only if it has the same
    /// kind. Default: the policy of each pipeline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// Overrides of the row's cells.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, Value>")]
    pub set: Overrides,
}

/// A column: a pipeline with its settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SuiteColumn {
    /// Name of the column.
    pub name: String,
    /// Pipeline file, relative to the folder of the suite file. Default: that of the suite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pipeline: Option<PathBuf>,
    /// Measures; the printed figures are of the first one. Default: those of the suite, else `score`, `coverage` and `success` for
    /// Push-T and `success` for robosuite tasks.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub measures: Vec<Measure>,
    /// Overrides of the column's cells.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, Value>")]
    pub set: Overrides,
    /// Printed figures by the name of the row.
    #[serde(default)]
    pub printed: BTreeMap<String, f64>,
}

/// An exception for some cells. Later exceptions override earlier ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SuiteCell {
    /// Names of the rows. Default: all rows.
    #[serde(default)]
    pub rows: Vec<String>,
    /// Names of the columns. Default: all columns.
    #[serde(default)]
    pub columns: Vec<String>,
    /// Overrides of these cells.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, Value>")]
    pub set: Overrides,
    /// Leaves these cells out: they are not run, and show only a printed figure.
    #[serde(default)]
    pub leave_out: bool,
}

/// JSON Schema of the suite file.
pub fn suite_schema() -> Value {
    json!(schemars::schema_for!(Suite))
}

//! Errors of the engine as faults with remedies.

use std::collections::BTreeMap;

use polars::prelude::PolarsError;
use re4_fault::{Fault, fault};

/// The tables of a query with the names of their columns.
#[derive(Debug, Default)]
pub(crate) struct Known(BTreeMap<String, Vec<String>>);

impl Known {
    pub(crate) fn add(&mut self, table: &str, columns: Vec<String>) {
        self.0.insert(table.to_owned(), columns);
    }

    fn has(&self, column: &str) -> bool {
        self.0.values().flatten().any(|known| known == column)
    }

    /// The columns of all tables: `results has artifact, seed, ...`.
    fn listed(&self) -> String {
        let tables: Vec<String> = self
            .0
            .iter()
            .map(|(table, columns)| format!("{table} has {}", columns.join(", ")))
            .collect();
        tables.join("; ")
    }
}

/// Converts an error of the engine. The first line of its text says what is wrong; further lines describe the plan.
pub(crate) fn fault_of(error: &PolarsError, known: &Known) -> Fault {
    let root = root_of(error);
    let text = root.to_string();
    let first = text.lines().next().unwrap_or_default().trim_end_matches([':', ' ']);
    match missing_column(root, first) {
        Some(column) if known.has(&column) => fault!(
            "the engine does not find the column {column} in this part of the query";
            "name it in a subquery, as in (select artifact, value as policy from settings) p"
        ),
        Some(column) => fault!("there is no column {column}"; "use one of the columns: {}", known.listed()),
        None if matches!(root, PolarsError::IO { .. }) => {
            fault!("cannot run the query: {first}"; "check the disk and the permissions")
        }
        None => {
            fault!("cannot run the query: {first}"; "correct the query; docs/guides/query-artifacts.md has examples")
        }
    }
}

fn root_of(error: &PolarsError) -> &PolarsError {
    match error {
        PolarsError::Context { error, .. } | PolarsError::ExprContext { error, .. } => root_of(error),
        other => other,
    }
}

/// The name of the column that an error reports as missing.
fn missing_column(error: &PolarsError, text: &str) -> Option<String> {
    let quoted = |mark: char| text.split(mark).nth(1).map(str::to_owned);
    match error {
        PolarsError::ColumnNotFound(_) | PolarsError::SchemaFieldNotFound(_) => quoted('"').or_else(|| quoted('\'')),
        PolarsError::SQLInterface(_) if text.contains("no column named") => quoted('\''),
        _ => None,
    }
}

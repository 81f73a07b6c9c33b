//! The subcommands: one file each, or one for those that run stages.

pub(crate) mod audit;
mod audit_page;
mod audit_text;
pub(crate) mod fetch;
pub(crate) mod film;
pub(crate) mod inspect;
pub(crate) mod report;
mod rollout_tables;
pub(crate) mod run;
pub(crate) mod schemas;
pub(crate) mod verify;

use anyhow::Result;
use arrow::array::RecordBatch;
use re4_artifact::{col_text, col_u32_or_null};

/// What the demonstrations of decisions are called, row by row; nothing on the way home. Artifacts of older versions have numbers
/// in the index alone.
fn names_of_decisions(decisions: &RecordBatch) -> Result<Vec<String>> {
    let numbers = col_u32_or_null(decisions, "demo")?;
    let names = col_text(decisions, "demo_name")?;
    Ok(numbers
        .into_iter()
        .zip(names)
        .map(|row| match row {
            (_, Some(name)) => name.to_owned(),
            (Some(number), None) => format!("demonstration {number}"),
            (None, None) => String::new(),
        })
        .collect())
}

/// How a command ended, unless in an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done.
    Done,
    /// What was to be checked did not hold.
    GateFailed,
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use arrow::array::{ArrayRef, StringArray, UInt32Array};

    use super::*;

    #[test]
    fn decisions_of_older_versions_have_numbers_for_names() {
        let demos: ArrayRef = Arc::new(UInt32Array::from(vec![Some(3), None, Some(0)]));
        let of = |names: Vec<Option<&str>>| {
            let names: ArrayRef = Arc::new(StringArray::from(names));
            let rows = RecordBatch::try_from_iter_with_nullable([
                ("demo", Arc::clone(&demos), true),
                ("demo_name", names, true),
            ]);
            names_of_decisions(&rows.unwrap()).unwrap()
        };
        assert_eq!(of(vec![Some("demo_4"), None, Some("demo_0")]), ["demo_4", "", "demo_0"]);
        assert_eq!(of(vec![None; 3]), ["demonstration 3", "", "demonstration 0"]);
    }
}

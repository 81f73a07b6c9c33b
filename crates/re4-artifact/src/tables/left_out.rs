//! Demonstrations of the source that are not in an `episodes` artifact.

use crate::spec::ColumnKind::Text;
use crate::spec::{ColumnSpec, TableSpec};

/// Demonstrations that cannot be used.
pub const LEFT_OUT: TableSpec = TableSpec {
    name: "left_out",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a demonstration of the source that was asked for and cannot be used, and so is not in this artifact. There is no such table where all can. In the order of the source.",
    columns: &[
        ColumnSpec::new(
            "demo",
            Text,
            "Its name in the source: a group such as demo_12, or episode 12 of Push-T.",
        ),
        ColumnSpec::new("why", Text, "What is wrong with it, one sentence with the remedy."),
    ],
};

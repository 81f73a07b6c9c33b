//! Tables of `rollouts` artifacts of either domain and any version, column by column.

use anyhow::Result;
use arrow::array::RecordBatch;
use arrow::datatypes::Schema;
use re4_artifact::{Artifact, Row, TableSpec};
use re4_policy::kinds::{PlaneRe4Row, SpaceRe4Row};
use re4_rollout::{PlaneDecisionRow, PlaneResultRow, PlaneStepRow, SpaceDecisionRow, SpaceResultRow, SpaceStepRow};

/// Whether these are rollouts of a robosuite task.
pub(crate) fn in_space(artifact: &Artifact) -> bool {
    let tables = &artifact.manifest().tables;
    tables.contains_key(SpaceResultRow::FORMERLY)
        || artifact
            .table_named(SpaceResultRow::NAME)
            .is_ok_and(|table| table.domain().as_deref() == Some("space"))
}

fn read(artifact: &Artifact, plane: &'static TableSpec, space: &'static TableSpec) -> Result<RecordBatch> {
    let spec = if in_space(artifact) { space } else { plane };
    Ok(artifact.table(spec)?.read_all()?)
}

/// How rollouts went.
pub(crate) fn results(artifact: &Artifact) -> Result<RecordBatch> {
    read(artifact, PlaneResultRow::table(), SpaceResultRow::table())
}

/// Their control steps.
pub(crate) fn steps(artifact: &Artifact) -> Result<RecordBatch> {
    read(artifact, PlaneStepRow::table(), SpaceStepRow::table())
}

/// Their decisions, with what is particular to RE4.
pub(crate) fn decisions(artifact: &Artifact) -> Result<RecordBatch> {
    let core = read(artifact, PlaneDecisionRow::table(), SpaceDecisionRow::table())?;
    let details = read(artifact, PlaneRe4Row::table(), SpaceRe4Row::table())?;
    let (mut fields, mut columns) = (core.schema().fields().to_vec(), core.columns().to_vec());
    for (field, column) in details.schema().fields().iter().zip(details.columns()) {
        if core.column_by_name(field.name()).is_none() {
            fields.push(field.clone());
            columns.push(column.clone());
        }
    }
    let schema = Schema::new_with_metadata(fields, core.schema().metadata().clone());
    Ok(RecordBatch::try_new(schema.into(), columns)?)
}

//! Running numbers of the parts of an `episodes` artifact.
//!
//! A part is written as if all demonstrations before it were used, because its writer has not read them. If some were left out, its
//! numbers are too large, and it is written again when the parts are merged.

use anyhow::Result;
use re4_artifact::arrow_array::{ArrayRef, RecordBatch, UInt32Array};
use re4_artifact::{Artifact, ArtifactSummary, Part, Recipe, Store};
use re4_fault::{OrFault as _, fault};

use crate::parts::DEMOS_IN_PART;
use crate::tables::described;

/// Columns with the number of a demonstration.
const EPISODE: &str = "episode";

/// Columns with the number of a demonstration that was left out.
const LEFT_OUT: &str = "left_out";

/// The part, with the numbers that it has after `before` demonstrations that were used and demonstrations that were left out.
pub(super) fn renumbered(store: &Store, recipe: &Recipe, part: &Artifact, before: (u32, u32)) -> Result<Artifact> {
    let unreadable =
        || fault!("cannot read {}: it has no number", part.path().display(); "delete the folder and run again");
    let number: u32 = part
        .manifest()
        .part
        .as_deref()
        .and_then(|part| part.parse().ok())
        .or_fault(unreadable)?;
    let too_large = number * DEMOS_IN_PART as u32 - before.0;
    if too_large == 0 && before.1 == 0 {
        return Ok(part.clone());
    }
    if let Some(done) = store.part(recipe, Part::Renumbered(number))? {
        return Ok(done);
    }
    let writer = store.begin_part(recipe, Part::Renumbered(number))?;
    for (name, summary) in &part.manifest().tables {
        let spec = described(part, name).or_fault(
            || fault!("cannot renumber table {name} of {}: it is unknown", part.path().display(); "update re4-pipe"),
        )?;
        let mut table = writer.table_in_groups(spec, summary.row_group_rows as usize)?;
        for batch in part.table(spec)?.batches()? {
            let batch = shifted(&batch?, EPISODE, |number| number - too_large)?;
            table.write(shifted(&batch, LEFT_OUT, |number| number + before.1)?)?;
        }
        table.finish()?;
    }
    Ok(writer.publish(ArtifactSummary {
        summary: part.manifest().summary.clone(),
        warnings: Vec::new(),
    })?)
}

/// The batch with other numbers in a column, if it has that column.
fn shifted(batch: &RecordBatch, column: &str, shift: impl Fn(u32) -> u32) -> Result<RecordBatch> {
    let Ok(place) = batch.schema().index_of(column) else {
        return Ok(batch.clone());
    };
    let Some(numbers) = batch.column(place).as_any().downcast_ref::<UInt32Array>() else {
        return Ok(batch.clone());
    };
    let mut columns: Vec<ArrayRef> = batch.columns().to_vec();
    columns[place] = std::sync::Arc::new(numbers.unary::<_, re4_artifact::arrow_array::types::UInt32Type>(shift));
    Ok(RecordBatch::try_new(batch.schema(), columns)?)
}

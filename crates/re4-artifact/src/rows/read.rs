//! Reading tables row by row.

use std::ops::Range;

use arrow_array::RecordBatch;

use super::cells::missing;
use super::{Cell, ColumnSource, Row, columns_of};
use crate::columns::table_name;
use crate::error::ArtifactError;
use crate::reader::{Artifact, Batches, Table};

/// The rows of a batch, one after the other.
fn rows_of<C: Cell>(batch: &RecordBatch) -> Result<Vec<C>, ArtifactError> {
    let view = C::view(&mut ColumnSource::new::<C>(batch), true)?;
    let rows = (0..batch.num_rows()).map(|row| C::get(&view, row));
    // Required columns were checked to be complete, so that this does not come about but for a cell that tells it otherwise.
    rows.collect::<Option<Vec<C>>>().ok_or_else(|| {
        let (column, row) = missing(batch);
        ArtifactError::Null {
            table: table_name(batch),
            column,
            row,
        }
    })
}

fn names<C: Cell>() -> Vec<&'static str> {
    columns_of::<C>().iter().map(|column| column.name).collect()
}

impl Artifact {
    /// All rows of a table.
    ///
    /// # Errors
    /// As [`Artifact::table`] and [`Table::read`].
    pub fn read<R: Row>(&self) -> Result<Vec<R>, ArtifactError> {
        self.table(R::table())?.read()
    }

    /// Whether it has the table of these rows.
    pub fn has<R: Row>(&self) -> bool {
        self.has_table(R::table())
    }
}

impl Table {
    /// All rows, as far as `C` has their columns. No other columns are decoded.
    ///
    /// # Errors
    /// As [`Table::read_all`]; [`ArtifactError::NoColumn`], [`ArtifactError::ColumnKind`], [`ArtifactError::Null`] and
    /// [`ArtifactError::UnknownWord`] where the columns are not those of `C`.
    pub fn read<C: Cell>(&self) -> Result<Vec<C>, ArtifactError> {
        rows_of(&self.read_columns(&names::<C>())?)
    }

    /// Some rows; only the row groups that hold them are touched.
    ///
    /// # Errors
    /// As [`Table::read`]; [`ArtifactError::OutOfRange`].
    pub fn read_range<C: Cell>(&self, rows: Range<u64>) -> Result<Vec<C>, ArtifactError> {
        rows_of(&self.read_rows(rows)?)
    }

    /// The rows in order, of which a bounded number is in memory.
    ///
    /// # Errors
    /// As [`Table::read`].
    pub fn stream<C: Cell>(&self) -> Result<RowsOf<C>, ArtifactError> {
        Ok(RowsOf {
            batches: self.batches()?,
            rows: Vec::new().into_iter(),
        })
    }
}

/// The rows of a table in order.
pub struct RowsOf<C> {
    batches: Batches,
    rows: std::vec::IntoIter<C>,
}

impl<C: Cell> Iterator for RowsOf<C> {
    type Item = Result<C, ArtifactError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(row) = self.rows.next() {
                return Some(Ok(row));
            }
            match self.batches.next()?.and_then(|batch| rows_of(&batch)) {
                Ok(rows) => self.rows = rows.into_iter(),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

//! Reading tables row by row.

use std::ops::Range;

use arrow_array::RecordBatch;

use super::cells::missing;
use super::{Cell, ColumnSource, Row, columns_of};
use crate::columns::table_name;
use crate::error::ArtifactError;
use crate::reader::Artifact;
use crate::table::{Batches, Table};

/// Converts a batch to rows.
fn rows_of<C: Cell>(batch: &RecordBatch) -> Result<Vec<C>, ArtifactError> {
    let view = C::view(&mut ColumnSource::new::<C>(batch), true)?;
    let rows = (0..batch.num_rows()).map(|row| C::get(&view, row));
    // `view` has checked that required columns have no nulls, so only an implementation of `Cell` that skips the check fails
    // here.
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
    /// Reads all rows of the table of row type `R`.
    ///
    /// # Errors
    /// As [`Artifact::table`] and [`Table::read`].
    pub fn read<R: Row>(&self) -> Result<Vec<R>, ArtifactError> {
        self.table(R::table())?.read()
    }

    /// Whether the artifact has the table of row type `R`.
    pub fn has<R: Row>(&self) -> bool {
        self.has_table(R::table())
    }
}

impl Table {
    /// Reads all rows with the columns of `C`. Other columns of the table are not decoded.
    ///
    /// # Errors
    /// As [`Table::read_all`], and [`ArtifactError::NoColumn`], [`ArtifactError::ColumnKind`], [`ArtifactError::Null`] or
    /// [`ArtifactError::UnknownWord`] if the table's columns do not match those of `C`.
    pub fn read<C: Cell>(&self) -> Result<Vec<C>, ArtifactError> {
        rows_of(&self.read_columns(&names::<C>())?)
    }

    /// Reads a range of rows with the columns of `C`. Only these columns of the row groups that contain the rows are decoded.
    ///
    /// # Errors
    /// As [`Table::read`], and [`ArtifactError::OutOfRange`].
    pub fn read_range<C: Cell>(&self, rows: Range<u64>) -> Result<Vec<C>, ArtifactError> {
        rows_of(&self.read_columns_of(&names::<C>(), rows)?)
    }

    /// Reads the rows in order, with a bounded number of them in memory.
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

/// Iterator over the rows of a table in order.
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

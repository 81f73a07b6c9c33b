//! Writing tables row by row.

use arrow_array::RecordBatch;

use super::Row;
use crate::error::ArtifactError;
use crate::manifest::TableSummary;
use crate::writer::{DEFAULT_ROW_GROUP_ROWS, TableWriter, Writer};

/// Rows that are gathered before they are handed on. The bytes of a table do not depend on it.
const GATHERED: usize = 4096;

/// A table being written, row by row.
pub struct RowWriter<R: Row> {
    table: TableWriter,
    buffers: R::Buffers,
    gathered: usize,
    most: usize,
}

impl Writer {
    /// Begins the table of these rows.
    ///
    /// # Errors
    /// As [`Writer::table`].
    pub fn rows<R: Row>(&self) -> Result<RowWriter<R>, ArtifactError> {
        self.rows_in_groups(DEFAULT_ROW_GROUP_ROWS)
    }

    /// Begins the table of these rows with row groups of so many rows; few for large values such as images.
    ///
    /// # Errors
    /// As [`Writer::table`].
    pub fn rows_in_groups<R: Row>(&self, row_group_rows: usize) -> Result<RowWriter<R>, ArtifactError> {
        Ok(RowWriter {
            table: self.table_in_groups(R::table(), row_group_rows)?,
            buffers: R::Buffers::default(),
            gathered: 0,
            most: row_group_rows.clamp(1, GATHERED),
        })
    }

    /// Writes a whole table.
    ///
    /// # Errors
    /// As [`Writer::table`] and [`TableWriter::write`].
    pub fn write_rows<R: Row>(&self, rows: impl IntoIterator<Item = R>) -> Result<TableSummary, ArtifactError> {
        let mut table = self.rows()?;
        table.extend(rows)?;
        table.finish()
    }
}

impl<R: Row> RowWriter<R> {
    /// Adds a row.
    ///
    /// # Errors
    /// As [`TableWriter::write`].
    pub fn push(&mut self, row: &R) -> Result<(), ArtifactError> {
        R::push(Some(row), &mut self.buffers);
        self.gathered += 1;
        if self.gathered == self.most {
            self.hand_on()?;
        }
        Ok(())
    }

    /// Adds rows.
    ///
    /// # Errors
    /// As [`TableWriter::write`].
    pub fn extend(&mut self, rows: impl IntoIterator<Item = R>) -> Result<(), ArtifactError> {
        rows.into_iter().try_for_each(|row| self.push(&row))
    }

    /// Rows so far.
    pub fn rows(&self) -> u64 {
        self.table.rows() + self.gathered as u64
    }

    /// Writes what is left and the footer, and makes the file durable.
    ///
    /// # Errors
    /// As [`TableWriter::finish`].
    pub fn finish(mut self) -> Result<TableSummary, ArtifactError> {
        self.hand_on()?;
        self.table.finish()
    }

    fn hand_on(&mut self) -> Result<(), ArtifactError> {
        if self.gathered == 0 {
            return Ok(());
        }
        self.gathered = 0;
        let mut arrays = Vec::new();
        R::finish(&mut self.buffers, &mut arrays);
        let spec = R::table();
        let rows = RecordBatch::try_new(self.table.schema(), arrays).map_err(|error| ArtifactError::Rows {
            table: spec.name.to_owned(),
            reason: error.to_string(),
        })?;
        self.table.write(rows)
    }
}

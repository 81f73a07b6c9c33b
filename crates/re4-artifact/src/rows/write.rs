//! Writing tables row by row.

use arrow_array::RecordBatch;

use super::Row;
use crate::error::ArtifactError;
use crate::manifest::TableSummary;
use crate::writer::{DEFAULT_ROW_GROUP_ROWS, TableWriter, Writer};

/// Maximum number of rows that are buffered before they are converted to a batch. The bytes of a table do not depend on it.
const BUFFERED_ROWS: usize = 4096;

/// Writes a table row by row.
pub struct RowWriter<R: Row> {
    table: TableWriter,
    buffers: R::Buffers,
    buffered: usize,
    capacity: usize,
}

impl Writer {
    /// Starts the table of row type `R`.
    ///
    /// # Errors
    /// As [`Writer::table`].
    pub fn rows<R: Row>(&self) -> Result<RowWriter<R>, ArtifactError> {
        self.rows_in_groups(DEFAULT_ROW_GROUP_ROWS)
    }

    /// Starts the table of row type `R` with row groups of `row_group_rows` rows. Use few rows for large values such as images.
    ///
    /// # Errors
    /// As [`Writer::table`].
    pub fn rows_in_groups<R: Row>(&self, row_group_rows: usize) -> Result<RowWriter<R>, ArtifactError> {
        Ok(RowWriter {
            table: self.table_in_groups(R::table(), row_group_rows)?,
            buffers: R::Buffers::default(),
            buffered: 0,
            capacity: row_group_rows.clamp(1, BUFFERED_ROWS),
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
        self.buffered += 1;
        if self.buffered == self.capacity {
            self.flush()?;
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

    /// Number of rows added so far.
    pub fn rows(&self) -> u64 {
        self.table.rows() + self.buffered as u64
    }

    /// Writes the remaining rows and the footer, and syncs the file.
    ///
    /// # Errors
    /// As [`TableWriter::finish`].
    pub fn finish(mut self) -> Result<TableSummary, ArtifactError> {
        self.flush()?;
        self.table.finish()
    }

    /// Converts the buffered rows to a batch and writes it.
    fn flush(&mut self) -> Result<(), ArtifactError> {
        if self.buffered == 0 {
            return Ok(());
        }
        self.buffered = 0;
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

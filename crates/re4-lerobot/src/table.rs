//! Parquet files: their columns, and their rows from any row on in blocks of bounded size.
//!
//! Types are those of the Parquet schema; the hints of the Arrow writer are not used. Whether a writer had fixed-size, large or
//! ordinary lists therefore makes no difference, and lengths are checked by the caller, which knows the column's name.

use std::fs::File;
use std::ops::Range;
use std::path::Path;

use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::SchemaRef;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
};
use parquet::errors::ParquetError;

use crate::contained::contained;
use crate::fault::{Fault, Kind};

/// An opened file.
pub(crate) struct Table {
    file: File,
    name: String,
    metadata: ArrowReaderMetadata,
    /// The first row of each row group, and the number of all rows.
    starts: Vec<usize>,
}

/// Rows that are read one block after the other.
pub(crate) struct Blocks {
    reader: ParquetRecordBatchReader,
    name: String,
    /// The row that comes next.
    next: usize,
    /// Rows that were read but not taken.
    rest: Option<RecordBatch>,
}

/// A fault of the Parquet library.
fn refused(name: &str, error: &str) -> Fault {
    if error.contains("Disabled feature") || error.contains("NYI") {
        let fix = "write this file again with the compression snappy or zstd";
        return Fault::of_file(
            Kind::Unsupported,
            name,
            format!("its encoding is not supported ({error})"),
            fix,
        );
    }
    Fault::damaged(name, error)
}

fn parquet<T>(name: &str, read: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, Fault> {
    let short = |error: ParquetError| {
        let text = error.to_string();
        text.lines()
            .next()
            .unwrap_or_default()
            .trim_start_matches("Parquet error: ")
            .to_owned()
    };
    contained(|| read().map_err(short)).map_err(|why| refused(name, &why))
}

impl Table {
    /// Opens a file of the dataset and reads its metadata.
    pub(crate) fn open(root: &Path, name: &str) -> Result<Self, Fault> {
        let path = root.join(name);
        let file = File::open(&path).map_err(|error| Fault::io(name, "opened", &error))?;
        let about = file.metadata().map_err(|error| Fault::io(name, "opened", &error))?;
        if !about.is_file() {
            let what = "it is not a regular file";
            return Err(Fault::of_file(Kind::Damaged, name, what, "restore the file"));
        }
        if about.len() < 200 && std::fs::read(&path).is_ok_and(|bytes| bytes.starts_with(b"version https://git-lfs")) {
            let what = "it is a placeholder of Git LFS";
            return Err(Fault::of_file(
                Kind::Damaged,
                name,
                what,
                "fetch the contents with git lfs pull",
            ));
        }
        let options = ArrowReaderOptions::new().with_skip_arrow_metadata(true);
        let metadata = parquet(name, || ArrowReaderMetadata::load(&file, options))?;
        let mut starts = vec![0];
        let mut total = 0_usize;
        for group in metadata.metadata().row_groups() {
            total = usize::try_from(group.num_rows())
                .ok()
                .and_then(|rows| total.checked_add(rows))
                .ok_or_else(|| Fault::damaged(name, "a row group has a negative number of rows"))?;
            starts.push(total);
        }
        if usize::try_from(metadata.metadata().file_metadata().num_rows()) != Ok(total) {
            return Err(Fault::damaged(name, "the number of rows is not that of its row groups"));
        }
        Ok(Self {
            file,
            name: name.to_owned(),
            metadata,
            starts,
        })
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.starts.last().copied().unwrap_or(0)
    }

    /// Its columns.
    pub(crate) fn schema(&self) -> &SchemaRef {
        self.metadata.schema()
    }

    /// Whether it has a column.
    pub(crate) fn has(&self, column: &str) -> bool {
        self.schema().index_of(column).is_ok()
    }

    /// Reads columns from a row on, at most `size` rows at a time.
    pub(crate) fn blocks(&self, columns: &[&str], from: usize, size: usize) -> Result<Blocks, Fault> {
        let file = self
            .file
            .try_clone()
            .map_err(|error| Fault::io(&self.name, "opened", &error))?;
        let metadata = self.metadata.clone();
        // Root columns of the Parquet schema are in the order of the fields of the schema.
        let chosen = columns.iter().filter_map(|column| self.schema().index_of(column).ok());
        let mask = ProjectionMask::roots(metadata.metadata().file_metadata().schema_descr(), chosen);
        let first = self.starts.partition_point(|&start| start <= from).saturating_sub(1);
        let groups: Vec<usize> = (first..self.starts.len() - 1).collect();
        let skip = from - self.starts[first.min(self.starts.len() - 1)];
        let reader = parquet(&self.name, || {
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata)
                .with_projection(mask)
                .with_row_groups(groups)
                .with_offset(skip)
                .with_batch_size(size)
                .build()
        })?;
        Ok(Blocks {
            reader,
            name: self.name.clone(),
            next: from,
            rest: None,
        })
    }

    /// Reads rows of one column and passes each block with its first row to `take`.
    pub(crate) fn each_block(
        &self,
        column: &str,
        rows: Range<usize>,
        size: usize,
        mut take: impl FnMut(usize, &ArrayRef) -> Result<(), Fault>,
    ) -> Result<(), Fault> {
        let mut blocks = self.blocks(&[column], rows.start, size)?;
        while blocks.next() < rows.end {
            let first = blocks.next();
            let block = blocks.take(rows.end - first)?;
            if let Some(array) = block.column_by_name(column) {
                take(first, array)?;
            }
        }
        Ok(())
    }
}

impl Blocks {
    /// The row that comes next.
    pub(crate) fn next(&self) -> usize {
        self.next
    }

    /// The next rows: at least one and at most `most`.
    pub(crate) fn take(&mut self, most: usize) -> Result<RecordBatch, Fault> {
        let block = match self.rest.take() {
            Some(rest) => Some(rest),
            None => parquet(&self.name, || {
                self.reader.next().transpose().map_err(ParquetError::from)
            })?,
        };
        let Some(block) = block.filter(|block| block.num_rows() > 0) else {
            let what = format!("its rows end at row {}, before the number that it states", self.next);
            return Err(Fault::damaged(&self.name, what));
        };
        let taken = block.num_rows().min(most);
        if taken < block.num_rows() {
            self.rest = Some(block.slice(taken, block.num_rows() - taken));
        }
        self.next += taken;
        Ok(block.slice(0, taken))
    }
}

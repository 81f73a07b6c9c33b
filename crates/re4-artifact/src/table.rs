//! Reading tables as a whole, in batches, by row group or by rows. A table has several files if its artifact is in parts.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch, new_null_array};
use arrow_schema::{FieldRef, Schema, SchemaRef};
use arrow_select::concat::concat_batches;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
};
use parquet::errors::ParquetError;

use crate::contained::contained;
use crate::error::{ArtifactError, Damage};
use crate::manifest::{TableFile, TableSummary};
use crate::reader::Artifact;
use crate::spec::{DOMAIN_KEY, TableSpec};

/// Maximum number of rows that are decoded at once. It bounds the memory of [`Table::batches`].
const ROWS_PER_BATCH: usize = 65_536;

/// An opened table of an artifact. It is cheap to clone, because the footer of its first file is read only when the table is opened.
/// In an artifact in parts it has a file in each part, in the order of the rows; the others are opened when they are read.
#[derive(Debug, Clone)]
pub struct Table {
    /// The first file.
    path: PathBuf,
    summary: TableSummary,
    spec: Option<&'static TableSpec>,
    /// Footer of the first file.
    metadata: ArrowReaderMetadata,
    files: Arc<[FileOf]>,
    /// Folder of the artifact.
    folder: PathBuf,
}

/// A file of a table.
#[derive(Debug)]
struct FileOf {
    /// Path relative to the folder of the artifact.
    name: String,
    path: PathBuf,
    /// The rows of the table that are in the file.
    rows: Range<u64>,
    /// The row groups of the table that are in the file.
    groups: Range<usize>,
}

/// The files of a table, with the numbers of their rows and row groups.
fn files_of(folder: &Path, summary: &TableSummary) -> Arc<[FileOf]> {
    let (mut row, mut group) = (0, 0);
    let file = |file: TableFile| {
        let groups = file.rows.div_ceil(summary.row_group_rows.max(1)) as usize;
        let of = FileOf {
            path: folder.join(&file.file),
            name: file.file,
            rows: row..row + file.rows,
            groups: group..group + groups,
        };
        (row, group) = (of.rows.end, of.groups.end);
        of
    };
    summary.files().into_iter().map(file).collect()
}

impl Table {
    pub(crate) fn open(
        artifact: &Artifact,
        summary: &TableSummary,
        spec: Option<&'static TableSpec>,
    ) -> Result<Self, ArtifactError> {
        let files = files_of(artifact.path(), summary);
        let (metadata, path) = match files.first() {
            Some(first) => (footer(artifact.path(), first)?, first.path.clone()),
            None => {
                return Err(ArtifactError::damaged(
                    artifact.path(),
                    Damage::Manifest {
                        reason: format!("lists no file of table {}", summary.file),
                    },
                ));
            }
        };
        let table = Self {
            path,
            summary: summary.clone(),
            spec,
            metadata,
            files,
            folder: artifact.path().to_path_buf(),
        };
        table.refuse_other_domain(artifact)?;
        table.agrees(&table.files[0], &table.metadata)?;
        Ok(table)
    }

    /// The footer of a file.
    fn metadata_of(&self, file: &FileOf) -> Result<ArrowReaderMetadata, ArtifactError> {
        if file.path == self.path {
            return Ok(self.metadata.clone());
        }
        let metadata = footer(&self.folder, file)?;
        self.agrees(file, &metadata)?;
        Ok(metadata)
    }

    /// Returns an error if a file differs from the manifest or from the table's description.
    fn agrees(&self, file: &FileOf, metadata: &ArrowReaderMetadata) -> Result<(), ArtifactError> {
        match self.disagreement(file, metadata) {
            Some(reason) => {
                let file = file.name.clone();
                Err(ArtifactError::damaged(&self.folder, Damage::Table { file, reason }))
            }
            None => Ok(()),
        }
    }

    /// Returns an error if the table has the columns of another domain.
    fn refuse_other_domain(&self, artifact: &Artifact) -> Result<(), ArtifactError> {
        let Some(spec) = self.spec else { return Ok(()) };
        match self.domain().filter(|found| found != spec.domain) {
            Some(found) => Err(ArtifactError::OtherDomain {
                folder: artifact.path().to_path_buf(),
                table: spec.name.to_owned(),
                expected: spec.domain,
                found,
            }),
            None => Ok(()),
        }
    }

    /// Describes the first difference between the file and the manifest or the table's description.
    fn disagreement(&self, file: &FileOf, metadata: &ArrowReaderMetadata) -> Option<String> {
        let rows = metadata.metadata().file_metadata().num_rows();
        let listed = file.rows.end - file.rows.start;
        if u64::try_from(rows) != Ok(listed) {
            return Some(format!("has {rows} rows, but the manifest lists {listed}"));
        }
        if let Some(reason) = self.row_group_disagreement(listed, metadata) {
            return Some(reason);
        }
        let Some(spec) = self.spec else {
            let same = metadata.schema().fields() == self.metadata.schema().fields();
            return (!same).then(|| "has other columns than the first part".to_owned());
        };
        let version = self.summary.schema_version;
        let fields = metadata.schema().fields();
        let current = version == spec.version;
        // An older version may have columns that were removed later, so they are not counted, and found by name.
        if current && fields.len() != spec.columns.len() {
            return Some(format!(
                "has {} columns, but version {version} of the {} table has {}",
                fields.len(),
                spec.name,
                spec.columns.len()
            ));
        }
        spec.columns.iter().enumerate().find_map(|(place, column)| {
            let name = spec.name_at(column, version);
            let field = if current {
                fields.get(place)
            } else {
                fields.iter().find(|field| field.name() == name)
            };
            let same = |field: &FieldRef| field.name() == name && field.data_type() == &column.kind.data_type();
            match field {
                Some(field) if same(field) => None,
                Some(field) => Some(format!(
                    "has a column {} of type {}, but version {version} of the {} table has {name} of type {}",
                    field.name(),
                    field.data_type(),
                    spec.name,
                    column.kind
                )),
                None if column.since > version => None,
                None => Some(format!(
                    "lacks the column {name} of version {version} of the {} table",
                    spec.name
                )),
            }
        })
    }

    /// Describes the first difference between the row groups and the manifest. [`Table::read_rows`] computes the row group of a
    /// row from `row_group_rows`, so all groups must have that length.
    fn row_group_disagreement(&self, rows: u64, metadata: &ArrowReaderMetadata) -> Option<String> {
        let size = self.summary.row_group_rows;
        let groups = metadata.metadata().row_groups();
        let mut left = rows;
        for (number, group) in groups.iter().enumerate() {
            let (rows, expected) = (group.num_rows(), left.min(size));
            if expected == 0 || u64::try_from(rows) != Ok(expected) {
                return Some(format!(
                    "has {rows} rows in row group {number}, but the manifest implies {expected}"
                ));
            }
            left -= expected;
        }
        (left > 0).then(|| format!("lacks row groups for {left} of its {rows} rows"))
    }

    /// File of the table; the first one if the artifact is in parts.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Files of the table, in the order of its rows.
    pub fn paths(&self) -> Vec<PathBuf> {
        self.files.iter().map(|file| file.path.clone()).collect()
    }

    /// The number of rows up to the end of each file, in the order of the rows.
    pub fn file_ends(&self) -> Vec<u64> {
        self.files.iter().map(|file| file.rows.end).collect()
    }

    /// The manifest's entry for the table.
    pub fn summary(&self) -> &TableSummary {
        &self.summary
    }

    /// Number of rows.
    pub fn rows(&self) -> u64 {
        self.summary.rows
    }

    /// Number of row groups.
    pub fn row_groups(&self) -> usize {
        self.files.last().map_or(0, |file| file.groups.end)
    }

    /// Domain of the columns, according to the file; `None` if the table is common to all domains or was written before files
    /// recorded their domain.
    pub fn domain(&self) -> Option<String> {
        self.metadata.schema().metadata.get(DOMAIN_KEY).cloned()
    }

    /// Schema of the batches that are read from the table: names, types, units and frames of reference.
    pub fn schema(&self) -> SchemaRef {
        self.spec
            .map_or_else(|| Arc::clone(self.metadata.schema()), TableSpec::schema)
    }

    /// Reads all rows as one batch.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] and [`ArtifactError::Parquet`], as for all reads.
    pub fn read_all(&self) -> Result<RecordBatch, ArtifactError> {
        let schema = self.schema();
        self.concatenated(&schema, |file| self.collect(self.reader(file, None)?, &schema, None))
    }

    /// The rows that `read` returns for each file.
    fn concatenated(
        &self,
        schema: &SchemaRef,
        read: impl Fn(&FileOf) -> Result<RecordBatch, ArtifactError>,
    ) -> Result<RecordBatch, ArtifactError> {
        match &*self.files {
            [file] => read(file),
            files => {
                let batches = files.iter().map(read).collect::<Result<Vec<_>, _>>()?;
                concat_batches(schema, &batches)
                    .map_err(|error| ArtifactError::parquet("read", &self.path)(error.into()))
            }
        }
    }

    /// Reads all rows of some columns, as one batch with the columns in the given order.
    ///
    /// # Errors
    /// As [`Table::read_all`], and [`ArtifactError::NoColumn`].
    pub fn read_columns(&self, columns: &[&str]) -> Result<RecordBatch, ArtifactError> {
        let (schema, mask) = self.projection(columns)?;
        self.concatenated(&schema, |file| {
            self.collect(self.reader(file, None)?.with_projection(mask.clone()), &schema, None)
        })
    }

    /// The schema of some columns in the given order, and which columns of the files they are.
    fn projection(&self, columns: &[&str]) -> Result<(SchemaRef, ProjectionMask), ArtifactError> {
        let full = self.schema();
        let mut fields = Vec::with_capacity(columns.len());
        for &name in columns {
            let Ok(field) = full.field_with_name(name) else {
                let known: Vec<&str> = full.fields().iter().map(|f| f.name().as_str()).collect();
                return Err(ArtifactError::NoColumn {
                    table: self.summary.file.trim_end_matches(".parquet").to_owned(),
                    column: name.to_owned(),
                    known: known.join(", "),
                });
            };
            fields.push(field.clone());
        }
        let schema = Arc::new(Schema::new_with_metadata(fields, full.metadata.clone()));
        let file_columns = self.metadata.schema().fields();
        let chosen = (0..file_columns.len()).filter(|&i| {
            let name = file_columns[i].name().as_str();
            columns.iter().any(|column| self.name_in_file(column) == name)
        });
        Ok((schema, ProjectionMask::roots(self.metadata.parquet_schema(), chosen)))
    }

    /// Reads the rows of one row group.
    ///
    /// # Errors
    /// As [`Table::read_all`], and [`ArtifactError::OutOfRange`].
    pub fn read_row_group(&self, group: usize) -> Result<RecordBatch, ArtifactError> {
        let Some(file) = self.files.iter().find(|file| file.groups.contains(&group)) else {
            let size = self.summary.row_group_rows;
            let first = (group as u64).saturating_mul(size);
            return Err(self.out_of_range(&(first..first.saturating_add(size))));
        };
        let reader = self.reader(file, Some(vec![group - file.groups.start]))?;
        self.collect(reader, &self.schema(), None)
    }

    /// Reads a range of rows. Only the row groups that contain them are decoded.
    ///
    /// # Errors
    /// As [`Table::read_all`], and [`ArtifactError::OutOfRange`].
    pub fn read_rows(&self, rows: Range<u64>) -> Result<RecordBatch, ArtifactError> {
        self.read_rows_as(rows, &self.schema(), &ProjectionMask::all())
    }

    /// Reads some columns of a range of rows, as one batch with the columns in the given order.
    ///
    /// # Errors
    /// As [`Table::read_rows`], and [`ArtifactError::NoColumn`].
    pub fn read_columns_of(&self, columns: &[&str], rows: Range<u64>) -> Result<RecordBatch, ArtifactError> {
        let (schema, mask) = self.projection(columns)?;
        self.read_rows_as(rows, &schema, &mask)
    }

    fn read_rows_as(
        &self,
        rows: Range<u64>,
        schema: &SchemaRef,
        mask: &ProjectionMask,
    ) -> Result<RecordBatch, ArtifactError> {
        if rows.start > rows.end || rows.end > self.rows() {
            return Err(self.out_of_range(&rows));
        }
        if rows.is_empty() {
            return Ok(RecordBatch::new_empty(Arc::clone(schema)));
        }
        let touched = self
            .files
            .iter()
            .filter(|file| file.rows.start < rows.end && rows.start < file.rows.end);
        let mut batches = touched
            .map(|file| {
                let start = rows.start.max(file.rows.start) - file.rows.start;
                let end = rows.end.min(file.rows.end) - file.rows.start;
                self.read_rows_of(file, start..end, schema, mask)
            })
            .collect::<Result<Vec<_>, _>>()?;
        match (batches.pop(), batches.is_empty()) {
            (Some(only), true) => Ok(only),
            (last, _) => {
                batches.extend(last);
                concat_batches(schema, &batches)
                    .map_err(|error| ArtifactError::parquet("read", &self.path)(error.into()))
            }
        }
    }

    /// Reads rows of a file, counted from its first row.
    fn read_rows_of(
        &self,
        file: &FileOf,
        rows: Range<u64>,
        schema: &SchemaRef,
        mask: &ProjectionMask,
    ) -> Result<RecordBatch, ArtifactError> {
        let size = self.summary.row_group_rows.max(1);
        let groups: Vec<usize> = (rows.start / size..rows.end.div_ceil(size))
            .map(|g| g as usize)
            .collect();
        let before = (rows.start % size) as usize;
        let wanted = before..before + (rows.end - rows.start) as usize;
        // The decoder fills whole batches. A smaller size keeps it from decoding images after the requested ones.
        let size = wanted.end.min(ROWS_PER_BATCH);
        let reader = self.reader(file, Some(groups))?.with_batch_size(size);
        self.collect(reader.with_projection(mask.clone()), schema, Some(wanted))
    }

    /// Reads the rows in order, in batches of bounded size, so that the table does not have to fit in memory.
    ///
    /// # Errors
    /// As [`Table::read_all`].
    pub fn batches(&self) -> Result<Batches, ArtifactError> {
        Ok(Batches {
            reader: Some(self.batches_of(&self.files[0])?),
            next_file: 1,
            table: self.clone(),
            schema: self.schema(),
        })
    }

    fn batches_of(&self, file: &FileOf) -> Result<ParquetRecordBatchReader, ArtifactError> {
        let size = ROWS_PER_BATCH.min((self.summary.row_group_rows as usize).max(1));
        let builder = self.reader(file, None)?.with_batch_size(size);
        contained(|| builder.build()).map_err(ArtifactError::parquet("read", &file.path))
    }

    fn out_of_range(&self, rows: &Range<u64>) -> ArtifactError {
        ArtifactError::OutOfRange {
            path: self.path.clone(),
            first: rows.start,
            end: rows.end,
            rows: self.rows(),
        }
    }

    /// Opens the file again for each read, because clones of a handle share their position and reads may run in parallel.
    fn reader(
        &self,
        of: &FileOf,
        groups: Option<Vec<usize>>,
    ) -> Result<ParquetRecordBatchReaderBuilder<File>, ArtifactError> {
        let metadata = self.metadata_of(of)?;
        let file = File::open(&of.path).map_err(ArtifactError::io("read", &of.path))?;
        let builder =
            ParquetRecordBatchReaderBuilder::new_with_metadata(file, metadata).with_batch_size(ROWS_PER_BATCH);
        Ok(match groups {
            Some(groups) => builder.with_row_groups(groups),
            None => builder,
        })
    }

    /// Decodes the given rows, counted from the first row of the builder's row groups, or all rows of these groups.
    fn collect(
        &self,
        builder: ParquetRecordBatchReaderBuilder<File>,
        schema: &SchemaRef,
        rows: Option<Range<usize>>,
    ) -> Result<RecordBatch, ArtifactError> {
        let refuse = |error| ArtifactError::parquet("read", &self.path)(error);
        let read = || cut(builder.build()?, rows);
        let batches = contained(read).map_err(refuse)?;
        let batches = batches
            .iter()
            .map(|batch| self.upgrade(batch, schema))
            .collect::<Result<Vec<_>, _>>()?;
        concat_batches(schema, &batches).map_err(|e| refuse(e.into()))
    }

    /// Returns the name of a column in the file, which may have an older version.
    fn name_in_file<'a>(&self, column: &'a str) -> &'a str {
        let known = self.spec.and_then(|spec| Some((spec, spec.column(column)?)));
        known.map_or(column, |(spec, known)| spec.name_at(known, self.summary.schema_version))
    }

    /// Returns the batch with the columns of `schema`. Columns that the file's version lacks are null.
    fn upgrade(&self, batch: &RecordBatch, schema: &SchemaRef) -> Result<RecordBatch, ArtifactError> {
        let columns: Vec<ArrayRef> = schema
            .fields()
            .iter()
            .map(|field| {
                batch
                    .column_by_name(self.name_in_file(field.name()))
                    .map_or_else(|| new_null_array(field.data_type(), batch.num_rows()), Arc::clone)
            })
            .collect();
        RecordBatch::try_new(Arc::clone(schema), columns)
            .map_err(|error| ArtifactError::parquet("read", &self.path)(error.into()))
    }
}

/// Reads the footer of a file of the artifact in `folder`.
fn footer(folder: &Path, of: &FileOf) -> Result<ArrowReaderMetadata, ArtifactError> {
    let file = match File::open(&of.path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let file = of.name.clone();
            return Err(ArtifactError::damaged(folder, Damage::Missing { file }));
        }
        Err(error) => return Err(ArtifactError::io("read", &of.path)(error)),
    };
    contained(|| ArrowReaderMetadata::load(&file, ArrowReaderOptions::new()))
        .map_err(ArtifactError::parquet("read", &of.path))
}

/// Reads all batches, or the parts of them that contain a range of rows.
///
/// Rows before the range are decoded and dropped. The decoder's own row selection is not used, because it does not terminate
/// on some invalid pages.
fn cut(reader: ParquetRecordBatchReader, rows: Option<Range<usize>>) -> Result<Vec<RecordBatch>, ParquetError> {
    let Some(rows) = rows else {
        return Ok(reader.collect::<Result<_, _>>()?);
    };
    let (mut before, mut left) = (rows.start, rows.len());
    let mut batches = Vec::new();
    for batch in reader {
        let batch = batch?;
        let skipped = before.min(batch.num_rows());
        let taken = left.min(batch.num_rows() - skipped);
        if taken > 0 {
            batches.push(batch.slice(skipped, taken));
        }
        before -= skipped;
        left -= taken;
        if left == 0 {
            break;
        }
    }
    if left > 0 {
        return Err(ParquetError::EOF(format!("it lacks {left} of its rows")));
    }
    Ok(batches)
}

/// Iterator over the rows of a table in order, batch by batch. It ends after the first error.
pub struct Batches {
    table: Table,
    schema: SchemaRef,
    /// The file that is read; `None` after the last one and after the first error.
    reader: Option<ParquetRecordBatchReader>,
    /// Number of the file to read after that.
    next_file: usize,
}

impl Batches {
    /// The next batch of the file that is read.
    fn next_of_file(&mut self) -> Option<Result<RecordBatch, ArtifactError>> {
        let reader = self.reader.as_mut()?;
        contained(|| Ok(reader.next().transpose()?))
            .map_err(ArtifactError::parquet(
                "read",
                &self.table.files[self.next_file - 1].path,
            ))
            .transpose()
            .map(|batch| batch.and_then(|batch| self.table.upgrade(&batch, &self.schema)))
    }
}

impl Iterator for Batches {
    type Item = Result<RecordBatch, ArtifactError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            self.reader.as_ref()?;
            let batch = self.next_of_file();
            if batch.as_ref().is_some_and(Result::is_err) {
                self.reader = None;
            }
            if batch.is_some() {
                return batch;
            }
            let files = Arc::clone(&self.table.files);
            self.reader = match files.get(self.next_file).map(|file| self.table.batches_of(file)) {
                Some(Ok(reader)) => Some(reader),
                Some(Err(error)) => {
                    self.reader = None;
                    return Some(Err(error));
                }
                None => None,
            };
            self.next_file += 1;
        }
    }
}

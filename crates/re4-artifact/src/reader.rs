//! Reading artifacts: manifests, and tables as a whole, in batches, by row group or by rows.

use std::collections::BTreeSet;
use std::fs::{self, File};
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
use crate::disk::hash_file;
use crate::error::{ArtifactError, Damage};
use crate::key::Key;
use crate::manifest::{MANIFEST_NAME, Manifest, TableSummary};
use crate::spec::{DOMAIN_KEY, TableSpec};

/// Maximum number of rows that are decoded at once. It bounds the memory of [`Table::batches`].
const ROWS_PER_BATCH: usize = 65_536;

/// An artifact that has been published.
#[derive(Debug, Clone)]
pub struct Artifact {
    path: PathBuf,
    manifest: Manifest,
}

impl Artifact {
    /// Opens the artifact in this folder and checks its manifest. The tables are not checked; use [`Artifact::verify_bytes`],
    /// [`crate::verify`] or [`crate::Store::lookup`] for that.
    ///
    /// # Errors
    /// [`ArtifactError::NoFolder`], [`ArtifactError::Damaged`], [`ArtifactError::NewerManifest`].
    pub fn open(path: &Path) -> Result<Self, ArtifactError> {
        if !path.is_dir() {
            return Err(ArtifactError::NoFolder {
                folder: path.to_path_buf(),
            });
        }
        Ok(Self {
            path: path.to_path_buf(),
            manifest: Manifest::read(path)?,
        })
    }

    /// Folder of the artifact.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The key: the hash of everything that determined the bytes of the artifact.
    pub fn key(&self) -> &Key {
        &self.manifest.key
    }

    /// Opens a table by its description in this build: columns that the file's version lacks are read as null.
    ///
    /// # Errors
    /// [`ArtifactError::NoTable`], [`ArtifactError::NewerTable`], [`ArtifactError::OtherDomain`], [`ArtifactError::Damaged`] if
    /// the file is missing or does not have the columns of its version, [`ArtifactError::Parquet`] if it cannot be decoded.
    pub fn table(&self, spec: &'static TableSpec) -> Result<Table, ArtifactError> {
        let summary = match self.under_former_name(spec) {
            Some(summary) => summary,
            None => self.summary(spec.name)?,
        };
        if summary.schema_version > spec.version {
            return Err(self.newer(spec.name, summary, spec.version));
        }
        Table::open(self, summary, Some(spec))
    }

    /// Returns whether the artifact has a table, under its present or its former name.
    pub fn has_table(&self, spec: &'static TableSpec) -> bool {
        self.manifest.tables.contains_key(spec.name) || self.under_former_name(spec).is_some()
    }

    /// The table under the name that it had in older versions.
    fn under_former_name(&self, spec: &'static TableSpec) -> Option<&TableSummary> {
        // A row type that several domains use declares the former name of the table of SE(3), such as `spatial_frames`. The tables of
        // the others always had their present names.
        let unchanged = matches!(spec.domain, "plane" | "arm") && spec.formerly.starts_with("spatial_");
        let summary = self.manifest.tables.get(spec.formerly).filter(|_| !unchanged)?;
        (summary.schema_version < spec.version).then_some(summary)
    }

    /// Opens a table by its name, with the columns of its file; for programs that display arbitrary artifacts.
    ///
    /// # Errors
    /// As [`Artifact::table`], except that any version and any domain is accepted.
    pub fn table_named(&self, name: &str) -> Result<Table, ArtifactError> {
        let summary = self.summary(name)?;
        Table::open(self, summary, None)
    }

    /// Checks every byte: each file of the manifest must exist with its published length and hash, and there must be no other
    /// file.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`], [`ArtifactError::Io`].
    pub fn verify_bytes(&self) -> Result<(), ArtifactError> {
        let mut expected: BTreeSet<String> = BTreeSet::from([MANIFEST_NAME.to_owned()]);
        for summary in self.manifest.tables.values() {
            self.verify_file(&summary.file, summary.bytes, &summary.blake3)?;
            expected.insert(summary.file.clone());
        }
        for (name, summary) in &self.manifest.files {
            self.verify_file(name, summary.bytes, &summary.blake3)?;
            expected.insert(name.clone());
        }
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.path).map_err(ArtifactError::io("list", &self.path))? {
            let entry = entry.map_err(ArtifactError::io("list", &self.path))?;
            found.push(entry.file_name().to_string_lossy().into_owned());
        }
        found.sort();
        match found.into_iter().find(|name| !expected.contains(name)) {
            Some(file) => Err(ArtifactError::damaged(&self.path, Damage::Stray { file })),
            None => Ok(()),
        }
    }

    /// Checks every byte of one table, under its present or its former name.
    ///
    /// # Errors
    /// [`ArtifactError::NoTable`], [`ArtifactError::Damaged`], [`ArtifactError::Io`].
    pub fn verify_table(&self, spec: &'static TableSpec) -> Result<(), ArtifactError> {
        let summary = match self.under_former_name(spec) {
            Some(summary) => summary,
            None => self.summary(spec.name)?,
        };
        self.verify_file(&summary.file, summary.bytes, &summary.blake3)
    }

    fn verify_file(&self, file: &str, bytes: u64, blake3: &Key) -> Result<(), ArtifactError> {
        let path = self.path.join(file);
        let file = file.to_owned();
        let found = match fs::metadata(&path) {
            Ok(metadata) if metadata.is_file() => metadata.len(),
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(ArtifactError::io("read", &path)(error));
            }
            _ => return Err(ArtifactError::damaged(&self.path, Damage::Missing { file })),
        };
        if found != bytes {
            let expected = bytes;
            let damage = Damage::Length { file, expected, found };
            return Err(ArtifactError::damaged(&self.path, damage));
        }
        if hash_file(&path).map_err(ArtifactError::io("read", &path))? != *blake3 {
            return Err(ArtifactError::damaged(&self.path, Damage::Content { file }));
        }
        Ok(())
    }

    fn summary(&self, table: &str) -> Result<&TableSummary, ArtifactError> {
        self.manifest.tables.get(table).ok_or_else(|| {
            let known: Vec<&str> = self.manifest.tables.keys().map(String::as_str).collect();
            ArtifactError::NoTable {
                folder: self.path.clone(),
                table: table.to_owned(),
                known: known.join(", "),
            }
        })
    }

    fn newer(&self, table: &str, summary: &TableSummary, supported: u32) -> ArtifactError {
        ArtifactError::NewerTable {
            folder: self.path.clone(),
            table: table.to_owned(),
            found: summary.schema_version,
            supported,
        }
    }
}

/// An opened table of an artifact. It is cheap to clone, because the footer of the file is read only when the table is opened.
#[derive(Debug, Clone)]
pub struct Table {
    path: PathBuf,
    summary: TableSummary,
    spec: Option<&'static TableSpec>,
    metadata: ArrowReaderMetadata,
}

impl Table {
    fn open(
        artifact: &Artifact,
        summary: &TableSummary,
        spec: Option<&'static TableSpec>,
    ) -> Result<Self, ArtifactError> {
        let path = artifact.path.join(&summary.file);
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                let file = summary.file.clone();
                return Err(ArtifactError::damaged(&artifact.path, Damage::Missing { file }));
            }
            Err(error) => return Err(ArtifactError::io("read", &path)(error)),
        };
        let metadata = contained(|| ArrowReaderMetadata::load(&file, ArrowReaderOptions::new()))
            .map_err(ArtifactError::parquet("read", &path))?;
        let table = Self {
            path,
            summary: summary.clone(),
            spec,
            metadata,
        };
        table.refuse_other_domain(artifact)?;
        if let Some(reason) = table.disagreement() {
            let file = summary.file.clone();
            return Err(ArtifactError::damaged(&artifact.path, Damage::Table { file, reason }));
        }
        Ok(table)
    }

    /// Returns an error if the table has the columns of another domain.
    fn refuse_other_domain(&self, artifact: &Artifact) -> Result<(), ArtifactError> {
        let Some(spec) = self.spec else { return Ok(()) };
        match self.domain().filter(|found| found != spec.domain) {
            Some(found) => Err(ArtifactError::OtherDomain {
                folder: artifact.path.clone(),
                table: spec.name.to_owned(),
                expected: spec.domain,
                found,
            }),
            None => Ok(()),
        }
    }

    /// Describes the first difference between the file and the manifest or the table's description.
    fn disagreement(&self) -> Option<String> {
        let rows = self.metadata.metadata().file_metadata().num_rows();
        if u64::try_from(rows) != Ok(self.summary.rows) {
            return Some(format!("has {rows} rows, but the manifest lists {}", self.summary.rows));
        }
        if let Some(reason) = self.row_group_disagreement() {
            return Some(reason);
        }
        let spec = self.spec?;
        let version = self.summary.schema_version;
        let fields = self.metadata.schema().fields();
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
    fn row_group_disagreement(&self) -> Option<String> {
        let size = self.summary.row_group_rows;
        let groups = self.metadata.metadata().row_groups();
        let mut left = self.summary.rows;
        for (number, group) in groups.iter().enumerate() {
            let (rows, expected) = (group.num_rows(), left.min(size));
            if expected == 0 || u64::try_from(rows) != Ok(expected) {
                return Some(format!(
                    "has {rows} rows in row group {number}, but the manifest implies {expected}"
                ));
            }
            left -= expected;
        }
        (left > 0).then(|| format!("lacks row groups for {left} of its {} rows", self.summary.rows))
    }

    /// File of the table.
    pub fn path(&self) -> &Path {
        &self.path
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
        self.metadata.metadata().num_row_groups()
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
        self.collect(self.reader(None)?, &self.schema(), None)
    }

    /// Reads all rows of some columns, as one batch with the columns in the given order.
    ///
    /// # Errors
    /// As [`Table::read_all`], and [`ArtifactError::NoColumn`].
    pub fn read_columns(&self, columns: &[&str]) -> Result<RecordBatch, ArtifactError> {
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
        let mask = ProjectionMask::roots(self.metadata.parquet_schema(), chosen);
        self.collect(self.reader(None)?.with_projection(mask), &schema, None)
    }

    /// Reads the rows of one row group.
    ///
    /// # Errors
    /// As [`Table::read_all`], and [`ArtifactError::OutOfRange`].
    pub fn read_row_group(&self, group: usize) -> Result<RecordBatch, ArtifactError> {
        if group >= self.row_groups() {
            let size = self.summary.row_group_rows;
            let first = (group as u64).saturating_mul(size);
            return Err(self.out_of_range(&(first..first.saturating_add(size))));
        }
        self.collect(self.reader(Some(vec![group]))?, &self.schema(), None)
    }

    /// Reads a range of rows. Only the row groups that contain them are decoded.
    ///
    /// # Errors
    /// As [`Table::read_all`], and [`ArtifactError::OutOfRange`].
    pub fn read_rows(&self, rows: Range<u64>) -> Result<RecordBatch, ArtifactError> {
        if rows.start > rows.end || rows.end > self.rows() {
            return Err(self.out_of_range(&rows));
        }
        if rows.is_empty() {
            return Ok(RecordBatch::new_empty(self.schema()));
        }
        let size = self.summary.row_group_rows.max(1);
        let groups: Vec<usize> = (rows.start / size..rows.end.div_ceil(size))
            .map(|g| g as usize)
            .collect();
        let before = (rows.start % size) as usize;
        let wanted = before..before + (rows.end - rows.start) as usize;
        // The decoder fills whole batches. A smaller size keeps it from decoding images after the requested ones.
        let size = wanted.end.min(ROWS_PER_BATCH);
        let reader = self.reader(Some(groups))?.with_batch_size(size);
        self.collect(reader, &self.schema(), Some(wanted))
    }

    /// Reads the rows in order, in batches of bounded size, so that the table does not have to fit in memory.
    ///
    /// # Errors
    /// As [`Table::read_all`].
    pub fn batches(&self) -> Result<Batches, ArtifactError> {
        let size = ROWS_PER_BATCH.min((self.summary.row_group_rows as usize).max(1));
        let builder = self.reader(None)?.with_batch_size(size);
        let reader = contained(|| builder.build()).map_err(ArtifactError::parquet("read", &self.path))?;
        Ok(Batches {
            table: self.clone(),
            schema: self.schema(),
            reader: Some(reader),
        })
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
    fn reader(&self, groups: Option<Vec<usize>>) -> Result<ParquetRecordBatchReaderBuilder<File>, ArtifactError> {
        let file = File::open(&self.path).map_err(ArtifactError::io("read", &self.path))?;
        let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.metadata.clone())
            .with_batch_size(ROWS_PER_BATCH);
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
    /// `None` after the first error.
    reader: Option<ParquetRecordBatchReader>,
}

impl Iterator for Batches {
    type Item = Result<RecordBatch, ArtifactError>;

    fn next(&mut self) -> Option<Self::Item> {
        let reader = self.reader.as_mut()?;
        let batch = contained(|| Ok(reader.next().transpose()?))
            .map_err(ArtifactError::parquet("read", &self.table.path))
            .transpose()?
            .and_then(|batch| self.table.upgrade(&batch, &self.schema));
        if batch.is_err() {
            self.reader = None;
        }
        Some(batch)
    }
}

//! Writing an artifact: its files go to a temporary folder, which is published by one rename.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use arrow_select::concat::concat_batches;
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, ZstdLevel};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterVersion};
use parquet::schema::types::ColumnPath;
use serde_json::Value;
use tempfile::TempDir;

use crate::columns::{Columns, check_rows};
use crate::disk::{is_gone, sync_folder};
use crate::error::ArtifactError;
use crate::key::Recipe;
use crate::manifest::{Division, FileSummary, Manifest, TableSummary};
use crate::owner::hold;
use crate::parts::Part;
use crate::reader::Artifact;
use crate::spec::{ColumnKind, TableSpec};
use crate::store::Store;

/// Default number of rows of a row group.
pub const DEFAULT_ROW_GROUP_ROWS: usize = 65_536;

/// Name of the program in the metadata of a Parquet file. It contains no version and no host, so that equal rows give equal bytes
/// on every machine and in every build.
const CREATED_BY: &str = "re4-pipe";
const ZSTD_LEVEL: i32 = 3;

/// A stage's summary of the artifact that it wrote; part of the manifest.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ArtifactSummary {
    /// Figures that summarize the content. They must not contain times, hosts or absolute paths.
    pub summary: Value,
    /// Structured warnings.
    pub warnings: Vec<Value>,
}

/// Writes an artifact. If it is dropped before [`Writer::publish`], all its files are removed.
#[derive(Debug)]
pub struct Writer {
    store: Store,
    recipe: Recipe,
    /// The part that is written; `None` for a whole artifact.
    part: Option<Part>,
    folder: PathBuf,
    temporary: Temporary,
    lock: Option<File>,
    tables: Arc<Mutex<BTreeMap<&'static str, Option<TableSummary>>>>,
    files: Mutex<BTreeMap<String, FileSummary>>,
}

/// The temporary folder of a writer. It is removed on drop, unless it was published.
#[derive(Debug)]
pub(crate) struct Temporary {
    folder: Option<TempDir>,
    path: PathBuf,
}

impl Temporary {
    fn new(store: &Store, key: &str) -> Result<Self, ArtifactError> {
        let folder = store
            .temporary(key)
            .map_err(ArtifactError::io("create a temporary folder in", store.root()))?;
        Ok(Self {
            path: folder.path().to_path_buf(),
            folder: Some(folder),
        })
    }

    /// A temporary folder with the lock that shows others that its writer runs. It is removed if the process is interrupted.
    pub(crate) fn held(store: &Store, name: &str) -> Result<(Self, Option<File>), ArtifactError> {
        let temporary = Self::new(store, name)?;
        let lock = hold(temporary.path());
        locked(&OWN).insert(temporary.path().to_path_buf());
        Ok((temporary, lock))
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// To be called after the folder was renamed, so that nothing is at its path.
    pub(crate) fn published(mut self) {
        let _ = self.folder.take().map(TempDir::keep);
    }
}

/// Temporary folders that writers of this process created. Some of them may have been published or removed.
static OWN: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// The right to publish in this process. Only one thread has it at a time.
static PUBLICATION: Mutex<()> = Mutex::new(());

/// Holds the right to publish until it is dropped.
#[derive(Debug)]
pub(crate) struct Publication(#[expect(dead_code, reason = "held, not used")] MutexGuard<'static, ()>);

impl Publication {
    /// Waits until no other thread publishes.
    pub(crate) fn wait() -> Self {
        Self(locked(&PUBLICATION))
    }
}

/// Removes the temporary folders of this process.
///
/// Only for a process that is about to exit. The caller must hold the right to publish until the exit: a writer that is still running
/// then fails and cannot publish.
pub(crate) fn remove_own() {
    for path in std::mem::take(&mut *locked(&OWN)) {
        // Removal fails if another thread creates a file in the folder at the same time, so it is repeated.
        for _ in 0..100 {
            match fs::remove_dir_all(&path) {
                Err(error) if !is_gone(&error) => {}
                _ => break,
            }
        }
    }
}

impl Writer {
    pub(crate) fn new(store: &Store, recipe: &Recipe) -> Result<Self, ArtifactError> {
        let folder = store.folder(recipe.stage(), &recipe.key());
        Self::into(store, recipe, folder, None)
    }

    /// A writer of a part.
    pub(crate) fn of_part(store: &Store, recipe: &Recipe, part: Part) -> Result<Self, ArtifactError> {
        Self::into(store, recipe, store.part_folder(recipe, part), Some(part))
    }

    fn into(store: &Store, recipe: &Recipe, folder: PathBuf, part: Option<Part>) -> Result<Self, ArtifactError> {
        let (temporary, lock) = Temporary::held(store, &recipe.key().short())?;
        Ok(Self {
            store: store.clone(),
            recipe: recipe.clone(),
            part,
            folder,
            temporary,
            lock,
            tables: Arc::default(),
            files: Mutex::default(),
        })
    }

    /// Starts a table with row groups of [`DEFAULT_ROW_GROUP_ROWS`] rows. Several tables can be written at the same time, also by
    /// several threads.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] if the file cannot be created, [`ArtifactError::Unfinished`] if the table was already started.
    pub fn table(&self, spec: &'static TableSpec) -> Result<TableWriter, ArtifactError> {
        self.table_in_groups(spec, DEFAULT_ROW_GROUP_ROWS)
    }

    /// Starts a table with row groups of `row_group_rows` rows (at least one). Use few rows for large values such as images, so
    /// that one value can be read without many others and few values are in memory at the same time.
    ///
    /// # Errors
    /// As [`Writer::table`].
    pub fn table_in_groups(
        &self,
        spec: &'static TableSpec,
        row_group_rows: usize,
    ) -> Result<TableWriter, ArtifactError> {
        if locked(&self.tables).insert(spec.name, None).is_some() {
            return Err(self.unfinished(spec.name, "was started twice"));
        }
        let path = self.temporary.path().join(spec.file());
        let file = File::create_new(&path).map_err(ArtifactError::io("write", &path))?;
        let schema = spec.schema();
        let sink = Sink {
            file: io::BufWriter::new(file),
            hasher: blake3::Hasher::new(),
            bytes: 0,
        };
        let row_group_rows = row_group_rows.max(1);
        let properties = properties(spec, row_group_rows);
        let parquet = ArrowWriter::try_new(sink, Arc::clone(&schema), Some(properties))
            .map_err(ArtifactError::parquet("write", &path))?;
        Ok(TableWriter {
            spec,
            path,
            schema,
            row_group_rows,
            pending: Vec::new(),
            pending_rows: 0,
            rows: 0,
            parquet,
            tables: Arc::clone(&self.tables),
        })
    }

    /// Writes a file that is not a table, such as weights.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] if the file cannot be written or already exists.
    pub fn file(&self, name: &str, contents: &[u8]) -> Result<(), ArtifactError> {
        let path = self.temporary.path().join(name);
        File::create_new(&path)
            .and_then(|mut file| {
                file.write_all(contents)?;
                file.sync_all()
            })
            .map_err(ArtifactError::io("write", &path))?;
        let summary = FileSummary {
            bytes: contents.len() as u64,
            blake3: blake3::hash(contents).into(),
        };
        locked(&self.files).insert(name.to_owned(), summary);
        Ok(())
    }

    /// Whether a table was started.
    pub fn has_tables(&self) -> bool {
        !locked(&self.tables).is_empty()
    }

    /// The temporary folder, for scratch files. They must be deleted before the artifact is published.
    pub fn scratch(&self) -> &Path {
        self.temporary.path()
    }

    /// The final folder of the artifact.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes the manifest, syncs all files and moves the artifact to its final folder by one rename.
    ///
    /// If another run has published the same key in the meantime, that artifact is verified and returned, and this one is
    /// removed.
    ///
    /// # Errors
    /// [`ArtifactError::Unfinished`] if a table was started but not finished, [`ArtifactError::Io`] if a file cannot be written,
    /// [`ArtifactError::NotReproducible`] if another run published other bytes under the same key, [`ArtifactError::Remote`] if an
    /// object store is not reached.
    pub fn publish(self, summary: ArtifactSummary) -> Result<Artifact, ArtifactError> {
        let mut tables = BTreeMap::new();
        for (&name, table) in &*locked(&self.tables) {
            let table = table.clone().ok_or_else(|| self.unfinished(name, "was not finished"))?;
            tables.insert(name.to_owned(), table);
        }
        let division = self
            .part
            .map_or(Division::None, |part| Division::Part(part.to_string()));
        let files = locked(&self.files).clone();
        if let (Some(_), Some(name)) = (self.part, files.keys().next()) {
            return Err(self.unfinished(name, "is not a table, and a part contains only tables"));
        }
        let manifest = Manifest::new(&self.recipe, tables, files, summary, division)?;
        let path = self.temporary.path().join(manifest.name());
        File::create_new(&path)
            .and_then(|mut file| {
                file.write_all(manifest.to_text().map_err(io::Error::other)?.as_bytes())?;
                file.sync_all()
            })
            .map_err(ArtifactError::io("write", &path))?;
        let store = self.store.clone();
        let artifact = self.move_to_final_folder(&manifest)?;
        // Not under the right to publish, which an interrupt waits for.
        store.push(artifact.path(), manifest.name())?;
        Ok(artifact)
    }

    fn move_to_final_folder(self, ours: &Manifest) -> Result<Artifact, ArtifactError> {
        let Self {
            store,
            recipe,
            part,
            folder,
            temporary,
            lock,
            ..
        } = self;
        let _publication = Publication::wait();
        // In the folder of the store alone, because an interrupt waits for the right to publish.
        let published = || match part {
            Some(part) => store.part_here(&recipe, part),
            None => store.lookup_here(recipe.stage(), &recipe.key()),
        };
        if let Some(theirs) = published()? {
            return same_bytes(theirs, ours);
        }
        if let Some(parent) = folder.parent() {
            fs::create_dir_all(parent).map_err(ArtifactError::io("create the folder", parent))?;
        }
        sync_folder(temporary.path())?;
        // No lock is needed: a rename does not replace a folder that is not empty.
        if let Err(error) = fs::rename(temporary.path(), &folder) {
            // Another process, perhaps on another machine, may have published the artifact since the lookup.
            return match published()? {
                Some(theirs) => same_bytes(theirs, ours),
                None => Err(ArtifactError::io("publish", &folder)(error)),
            };
        }
        temporary.published();
        drop(lock);
        if let Some(parent) = folder.parent() {
            sync_folder(parent)?;
        }
        match part {
            // Read again, because the fields of a summary are sorted when it is written.
            None => Artifact::open(&folder),
            Some(_) => Ok(Artifact::with_manifest(folder, ours.clone())),
        }
    }

    fn unfinished(&self, table: &str, reason: &'static str) -> ArtifactError {
        ArtifactError::Unfinished {
            folder: self.folder.clone(),
            table: table.to_owned(),
            reason,
        }
    }
}

/// Returns the artifact that another run published if it equals the one that this run wrote.
pub(crate) fn same_bytes(theirs: Artifact, ours: &Manifest) -> Result<Artifact, ArtifactError> {
    let what = if theirs.manifest().tables != ours.tables {
        let differing = ours
            .tables
            .iter()
            .find(|(name, summary)| theirs.manifest().tables.get(*name) != Some(summary));
        differing.map_or_else(|| "the list of tables".to_owned(), |(name, _)| format!("table {name}"))
    } else if theirs.manifest().files != ours.files {
        "a file that is not a table".to_owned()
    } else if theirs.manifest().summary != ours.summary || theirs.manifest().warnings != ours.warnings {
        "its summary or warnings".to_owned()
    } else {
        return Ok(theirs);
    };
    Err(ArtifactError::NotReproducible {
        folder: theirs.path().to_path_buf(),
        what,
    })
}

/// Whether the floats of a table are stored without compression.
///
/// These tables contain double precision numbers of the simulator. zstd reduces them by only 20 to 40 %, with or without
/// byte-stream splitting, and takes several times as long as the rest of the ingest stage.
fn is_uncompressed(spec: &TableSpec) -> bool {
    matches!((spec.name, spec.domain), ("frames", "space") | ("states", _))
}

/// Returns the settings that, together with the rows, determine the bytes of a Parquet file.
fn properties(spec: &TableSpec, row_group_rows: usize) -> WriterProperties {
    let metadata = spec
        .key_values()
        .into_iter()
        .map(|(key, value)| KeyValue::new(key, value))
        .collect();
    let mut builder = WriterProperties::builder()
        .set_created_by(CREATED_BY.to_owned())
        .set_writer_version(WriterVersion::PARQUET_1_0)
        .set_key_value_metadata(Some(metadata))
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(ZSTD_LEVEL).unwrap_or_default()))
        // Limited only by the number of rows, because readers compute the row group of a row from that number.
        .set_max_row_group_row_count(Some(row_group_rows))
        .set_max_row_group_bytes(None)
        .set_statistics_enabled(EnabledStatistics::Page);
    for column in spec.columns {
        let path = ColumnPath::from(column.name);
        match column.kind {
            ColumnKind::F64 if is_uncompressed(spec) => {
                builder = builder
                    .set_column_dictionary_enabled(path.clone(), false)
                    .set_column_compression(path.clone(), Compression::UNCOMPRESSED)
                    .set_column_statistics_enabled(path, EnabledStatistics::Chunk);
            }
            ColumnKind::F64List if is_uncompressed(spec) => {
                let path = ColumnPath::new(vec![column.name.to_owned(), "list".to_owned(), "element".to_owned()]);
                builder = builder
                    .set_column_dictionary_enabled(path.clone(), false)
                    .set_column_compression(path.clone(), Compression::UNCOMPRESSED)
                    .set_column_statistics_enabled(path, EnabledStatistics::None);
            }
            ColumnKind::F32List => {
                let path = ColumnPath::new(vec![column.name.to_owned(), "list".to_owned(), "element".to_owned()]);
                builder = builder
                    .set_column_dictionary_enabled(path.clone(), false)
                    .set_column_statistics_enabled(path, EnabledStatistics::None);
            }
            // Continuous values repeat too rarely for a dictionary to be useful.
            ColumnKind::F64 => builder = builder.set_column_dictionary_enabled(path, false),
            // PNG images are already compressed, and minima and maxima of images are meaningless.
            ColumnKind::Binary => {
                builder = builder
                    .set_column_dictionary_enabled(path.clone(), false)
                    .set_column_compression(path.clone(), Compression::UNCOMPRESSED)
                    .set_column_statistics_enabled(path, EnabledStatistics::None);
            }
            _ => {}
        }
    }
    builder.build()
}

/// Writes a table, row group by row group. The bytes depend only on the rows, not on how they are split into batches.
pub struct TableWriter {
    spec: &'static TableSpec,
    path: PathBuf,
    schema: SchemaRef,
    row_group_rows: usize,
    pending: Vec<RecordBatch>,
    pending_rows: usize,
    rows: u64,
    parquet: ArrowWriter<Sink>,
    tables: Arc<Mutex<BTreeMap<&'static str, Option<TableSummary>>>>,
}

impl TableWriter {
    /// Adds rows. Their columns must match the table's description.
    ///
    /// # Errors
    /// [`ArtifactError::Rows`] if the columns do not match, [`ArtifactError::Io`] if the file cannot be written.
    pub fn write(&mut self, batch: RecordBatch) -> Result<(), ArtifactError> {
        let batch = check_rows(self.spec, &self.schema, batch)?;
        self.pending_rows += batch.num_rows();
        self.pending.push(batch);
        while self.pending_rows >= self.row_group_rows {
            let rows = concat_batches(&self.schema, &self.pending)
                .map_err(ParquetError::from)
                .map_err(ArtifactError::parquet("write", &self.path))?;
            let rest = rows.slice(self.row_group_rows, rows.num_rows() - self.row_group_rows);
            self.write_group(&rows.slice(0, self.row_group_rows))?;
            self.pending_rows = rest.num_rows();
            self.pending = vec![rest];
        }
        Ok(())
    }

    /// Adds rows from a builder of columns.
    ///
    /// # Errors
    /// As [`TableWriter::write`].
    pub fn write_columns(&mut self, columns: Columns) -> Result<(), ArtifactError> {
        self.write(columns.finish()?)
    }

    /// Schema of the table.
    pub(crate) fn schema(&self) -> SchemaRef {
        Arc::clone(&self.schema)
    }

    /// Number of rows added so far.
    pub fn rows(&self) -> u64 {
        self.rows + self.pending_rows as u64
    }

    /// Writes the remaining rows and the footer, and syncs the file.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] if the file cannot be written.
    pub fn finish(mut self) -> Result<TableSummary, ArtifactError> {
        if self.pending_rows > 0 {
            let rows = concat_batches(&self.schema, &self.pending)
                .map_err(ParquetError::from)
                .map_err(ArtifactError::parquet("write", &self.path))?;
            self.write_group(&rows)?;
        }
        // `ArrowWriter::into_inner` would convert an I/O error to text; `finish` keeps it as the source of its error.
        self.parquet
            .finish()
            .map_err(ArtifactError::parquet("write", &self.path))?;
        let Sink { file, hasher, bytes } = self.parquet.inner_mut();
        file.flush()
            .and_then(|()| file.get_ref().sync_all())
            .map_err(ArtifactError::io("write", &self.path))?;
        let summary = TableSummary {
            file: self.spec.file(),
            schema_version: self.spec.version,
            rows: self.rows,
            row_group_rows: self.row_group_rows as u64,
            bytes: *bytes,
            blake3: hasher.finalize().into(),
            parts: Vec::new(),
        };
        locked(&self.tables).insert(self.spec.name, Some(summary.clone()));
        Ok(summary)
    }

    fn write_group(&mut self, rows: &RecordBatch) -> Result<(), ArtifactError> {
        self.parquet
            .write(rows)
            .and_then(|()| self.parquet.flush())
            .map_err(ArtifactError::parquet("write", &self.path))?;
        self.rows += rows.num_rows() as u64;
        Ok(())
    }
}

/// Counts and hashes the bytes that are written to the file.
struct Sink {
    file: io::BufWriter<File>,
    hasher: blake3::Hasher,
    bytes: u64,
}

impl Write for Sink {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let written = self.file.write(buffer)?;
        self.hasher.update(&buffer[..written]);
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Locks a mutex and ignores poisoning: entries are inserted in one step, so a panic cannot leave the map inconsistent.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

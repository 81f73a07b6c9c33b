//! Writing an artifact: tables into a temporary folder, then publication in one rename.

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
use crate::disk::{LOCK_NAME, TEMPORARY_PREFIX, lock, sync_folder};
use crate::error::ArtifactError;
use crate::key::Recipe;
use crate::manifest::{FileSummary, MANIFEST_NAME, Manifest, TableSummary};
use crate::reader::Artifact;
use crate::spec::{ColumnKind, TableSpec};
use crate::store::Store;

/// Rows of a row group unless the caller says otherwise.
pub const DEFAULT_ROW_GROUP_ROWS: usize = 65_536;

/// The same on every machine and in every build, so that equal rows give equal bytes.
const CREATED_BY: &str = "re4-pipe";
const ZSTD_LEVEL: i32 = 3;

/// What a stage says about what it made.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ArtifactSummary {
    /// Figures that sum up the content. No time, host or absolute path may be in it.
    pub summary: Value,
    /// Warnings, structured.
    pub warnings: Vec<Value>,
}

/// An artifact being written. Dropped without [`Writer::publish`], it leaves nothing behind.
#[derive(Debug)]
pub struct Writer {
    store: Store,
    recipe: Recipe,
    folder: PathBuf,
    temporary: TempDir,
    lock: File,
    tables: Arc<Mutex<BTreeMap<&'static str, Option<TableSummary>>>>,
    files: Mutex<BTreeMap<String, FileSummary>>,
}

/// Temporaries of this process's writers; some of them may be gone.
static OWN: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Removes what this process has begun to write. Only for a process that is about to end, with the store's lock held until it
/// has: a writer that is still at work then fails, and publishes nothing.
pub(crate) fn remove_own() {
    for path in std::mem::take(&mut *locked(&OWN)) {
        // A thread may add a file while the folder is emptied.
        for _ in 0..100 {
            match fs::remove_dir_all(&path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {}
                _ => break,
            }
        }
    }
}

impl Writer {
    pub(crate) fn new(store: &Store, recipe: &Recipe) -> Result<Self, ArtifactError> {
        let key = recipe.key();
        let folder = store.folder(recipe.stage(), &key);
        let parent = store.root().join(recipe.stage().artifact());
        let guard = store.lock()?;
        fs::create_dir_all(&parent).map_err(ArtifactError::io("make the folder", &parent))?;
        let temporary = tempfile::Builder::new()
            .prefix(&format!("{TEMPORARY_PREFIX}{}-", key.short()))
            .tempdir_in(&parent)
            .map_err(ArtifactError::io("make a temporary folder in", &parent))?;
        let own_lock = lock(&temporary.path().join(LOCK_NAME))?;
        locked(&OWN).insert(temporary.path().to_path_buf());
        drop(guard);
        Ok(Self {
            store: store.clone(),
            recipe: recipe.clone(),
            folder,
            temporary,
            lock: own_lock,
            tables: Arc::default(),
            files: Mutex::default(),
        })
    }

    /// Begins a table with row groups of [`DEFAULT_ROW_GROUP_ROWS`] rows. Several tables can be open at once, also in
    /// several threads.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] when the file cannot be made, [`ArtifactError::Unfinished`] when the table was begun before.
    pub fn table(&self, spec: &'static TableSpec) -> Result<TableWriter, ArtifactError> {
        self.table_in_groups(spec, DEFAULT_ROW_GROUP_ROWS)
    }

    /// Begins a table with row groups of this many rows (at least one): few for large values such as images, so that
    /// one of them can be read without the others, and so that few are in memory at once.
    ///
    /// # Errors
    /// As [`Writer::table`].
    pub fn table_in_groups(
        &self,
        spec: &'static TableSpec,
        row_group_rows: usize,
    ) -> Result<TableWriter, ArtifactError> {
        if locked(&self.tables).insert(spec.name, None).is_some() {
            return Err(self.unfinished(spec.name, "was begun twice"));
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
    /// [`ArtifactError::Io`] when it cannot be written, or was written before.
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

    /// A folder for files that are gone when the artifact is published.
    pub fn scratch(&self) -> &Path {
        self.temporary.path()
    }

    /// Where the artifact will be.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes the manifest, makes everything durable and puts the artifact into its place by one rename. When another run
    /// has published the same key meanwhile, that artifact is verified and returned, and ours is dropped.
    ///
    /// # Errors
    /// [`ArtifactError::Unfinished`] when a table was begun and not finished, [`ArtifactError::Io`] when the disk refuses,
    /// [`ArtifactError::NotReproducible`] when another run published other bytes under the same key.
    pub fn publish(self, summary: ArtifactSummary) -> Result<Artifact, ArtifactError> {
        let mut tables = BTreeMap::new();
        for (&name, table) in &*locked(&self.tables) {
            let table = table.clone().ok_or_else(|| self.unfinished(name, "was not finished"))?;
            tables.insert(name.to_owned(), table);
        }
        let manifest = Manifest::new(
            &self.recipe,
            tables,
            locked(&self.files).clone(),
            summary.summary,
            summary.warnings,
        )?;
        let path = self.temporary.path().join(MANIFEST_NAME);
        File::create_new(&path)
            .and_then(|mut file| {
                file.write_all(manifest.to_text().map_err(io::Error::other)?.as_bytes())?;
                file.sync_all()
            })
            .map_err(ArtifactError::io("write", &path))?;
        self.put_into_place(&manifest)
    }

    fn put_into_place(self, ours: &Manifest) -> Result<Artifact, ArtifactError> {
        let guard = self.store.lock()?;
        let key = self.recipe.key();
        if let Some(theirs) = self.store.lookup(self.recipe.stage(), &key)? {
            return same_bytes(theirs, ours);
        }
        // Without its lock file the temporary looks dead; the store's lock keeps others from removing it.
        let lock_path = self.temporary.path().join(LOCK_NAME);
        fs::remove_file(&lock_path).map_err(ArtifactError::io("remove", &lock_path))?;
        sync_folder(self.temporary.path())?;
        fs::rename(self.temporary.path(), &self.folder).map_err(ArtifactError::io("publish", &self.folder))?;
        // It is no longer at its temporary path, so there is nothing left to remove there.
        let _ = self.temporary.keep();
        if let Some(parent) = self.folder.parent() {
            sync_folder(parent)?;
        }
        drop(guard);
        drop(self.lock);
        Artifact::open(&self.folder)
    }

    fn unfinished(&self, table: &str, reason: &'static str) -> ArtifactError {
        ArtifactError::Unfinished {
            folder: self.folder.clone(),
            table: table.to_owned(),
            reason,
        }
    }
}

fn same_bytes(theirs: Artifact, ours: &Manifest) -> Result<Artifact, ArtifactError> {
    let what = if theirs.manifest().tables != ours.tables {
        let differing = ours
            .tables
            .iter()
            .find(|(name, summary)| theirs.manifest().tables.get(*name) != Some(summary));
        format!("table {}", differing.map_or("list", |(name, _)| name))
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

/// Tables whose numbers are stored as they are: double precision of the simulator, of which zstd saves a fifth to two fifths
/// at several times the cost of all other work of ingest (with or without byte-stream splitting).
fn is_plain(spec: &TableSpec) -> bool {
    matches!((spec.name, spec.domain), ("frames", "space") | ("states", _))
}

/// Everything that decides the bytes of a Parquet file besides its rows.
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
        .set_max_row_group_row_count(Some(row_group_rows))
        .set_max_row_group_bytes(None)
        .set_statistics_enabled(EnabledStatistics::Page);
    for column in spec.columns {
        let path = ColumnPath::from(column.name);
        match column.kind {
            ColumnKind::F64 if is_plain(spec) => {
                builder = builder
                    .set_column_dictionary_enabled(path.clone(), false)
                    .set_column_compression(path.clone(), Compression::UNCOMPRESSED)
                    .set_column_statistics_enabled(path, EnabledStatistics::Chunk);
            }
            ColumnKind::F64List if is_plain(spec) => {
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
            // Continuous values repeat too rarely for a dictionary to pay.
            ColumnKind::F64 => builder = builder.set_column_dictionary_enabled(path, false),
            // Images are compressed already, and have no order worth a statistic.
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

/// A table being written, row group by row group. The bytes depend on the rows alone, not on how they are cut into
/// batches.
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
    /// Adds rows. Their columns have to be those of the table's description, in its order.
    ///
    /// # Errors
    /// [`ArtifactError::Rows`] when they are not, [`ArtifactError::Io`] when the disk refuses.
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

    /// Adds rows given column by column.
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

    /// Rows so far.
    pub fn rows(&self) -> u64 {
        self.rows + self.pending_rows as u64
    }

    /// Writes what is left and the footer, and makes the file durable.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] when the disk refuses.
    pub fn finish(mut self) -> Result<TableSummary, ArtifactError> {
        if self.pending_rows > 0 {
            let rows = concat_batches(&self.schema, &self.pending)
                .map_err(ParquetError::from)
                .map_err(ArtifactError::parquet("write", &self.path))?;
            self.write_group(&rows)?;
        }
        // `ArrowWriter::into_inner` would put a refusal of the operating system into words; `finish` hands it on.
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

/// Counts and hashes what goes to the file.
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

/// A thread that panicked while it held the list left it whole: entries are inserted in one step.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

//! Copies of samples, changes of their files, and what reading them gives.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{Array as _, ArrayRef, RecordBatch};
use arrow_schema::{Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::{ArrowReaderOptions, ParquetRecordBatchReaderBuilder};
use parquet::basic::{Compression, ZstdLevel};
use parquet::file::properties::WriterProperties;
use re4_lerobot::{Cameras, Dataset, Faults, LerobotError, Values};
use serde_json::{Map, Value};
use sha2::{Digest as _, Sha256};

/// The folder of the samples, if it is there; otherwise prints that the test is skipped.
pub(crate) fn samples() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("RE4_DATA")
        .map_or_else(beside, PathBuf::from)
        .join("lerobot");
    let there = folder.join("pusht-v3.0-image/meta/info.json").is_file();
    if !there {
        println!(
            "skipped: no samples in {}; set RE4_DATA to the folder of the datasets",
            folder.display()
        );
    }
    there.then_some(folder)
}

pub(crate) fn hex(bytes: impl AsRef<[u8]>) -> String {
    bytes.as_ref().iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

/// A copy of a sample that may be changed.
pub(crate) struct Copy {
    folder: tempfile::TempDir,
}

impl Copy {
    pub(crate) fn of(sample: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy_folder(sample, folder.path());
        Self { folder }
    }

    pub(crate) fn root(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.root().join(name)
    }

    pub(crate) fn info(&self, change: impl FnOnce(&mut Map<String, Value>)) {
        let path = self.path("meta/info.json");
        let mut map = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        change(&mut map);
        fs::write(path, serde_json::to_vec(&map).unwrap()).unwrap();
    }

    pub(crate) fn set(&self, key: &str, value: Value) {
        self.info(|map| {
            map.insert(key.to_owned(), value);
        });
    }

    /// Changes a key of a feature.
    pub(crate) fn set_feature(&self, feature: &str, key: &str, value: Value) {
        self.info(|map| map["features"][feature][key] = value);
    }

    pub(crate) fn lines(&self, name: &str, change: impl FnOnce(&mut Vec<String>)) {
        let text = fs::read_to_string(self.path(name)).unwrap();
        let mut lines = text.lines().map(str::to_owned).collect();
        change(&mut lines);
        fs::write(self.path(name), lines.join("\n")).unwrap();
    }

    pub(crate) fn bytes(&self, name: &str, change: impl FnOnce(&mut Vec<u8>)) {
        let mut bytes = fs::read(self.path(name)).unwrap();
        change(&mut bytes);
        fs::write(self.path(name), bytes).unwrap();
    }

    /// Writes a table again with other rows or columns.
    pub(crate) fn table(&self, name: &str, change: impl FnOnce(RecordBatch) -> RecordBatch) {
        let changed = change(read_table(&self.path(name)));
        write_table(&self.path(name), &changed);
    }

    pub(crate) fn column(&self, name: &str, column: &str, change: impl FnOnce(&ArrayRef) -> ArrayRef) {
        self.table(name, |table| {
            let array = change(table.column_by_name(column).unwrap());
            with_column(&table, column, array)
        });
    }

    pub(crate) fn remove(&self, name: &str) {
        fs::remove_file(self.path(name)).unwrap();
    }

    pub(crate) fn swap(&self, one: &str, other: &str) {
        let [first, second] = [one, other].map(|name| fs::read(self.path(name)).unwrap());
        fs::write(self.path(one), second).unwrap();
        fs::write(self.path(other), first).unwrap();
    }
}

/// Copies a folder; the copies may be written.
pub(crate) fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let copy = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy_folder(&path, &copy);
        } else {
            fs::write(copy, fs::read(&path).unwrap()).unwrap();
        }
    }
}

pub(crate) fn read_table(path: &Path) -> RecordBatch {
    let options = ArrowReaderOptions::new().with_skip_arrow_metadata(true);
    let file = fs::File::open(path).unwrap();
    let builder = ParquetRecordBatchReaderBuilder::try_new_with_options(file, options).unwrap();
    let mut batches = builder.with_batch_size(100_000).build().unwrap();
    batches.next().unwrap().unwrap()
}

pub(crate) fn write_table(path: &Path, table: &RecordBatch) {
    let zstd = Compression::ZSTD(ZstdLevel::default());
    let properties = WriterProperties::builder().set_compression(zstd).build();
    // Metadata of the first writer describes its own types, which the changed columns need not have.
    let fields: Vec<Field> = table
        .schema()
        .fields()
        .iter()
        .map(|field| field.as_ref().clone())
        .collect();
    let table = RecordBatch::try_new(Arc::new(Schema::new(fields)), table.columns().to_vec()).unwrap();
    let mut writer = ArrowWriter::try_new(fs::File::create(path).unwrap(), table.schema(), Some(properties)).unwrap();
    writer.write(&table).unwrap();
    writer.close().unwrap();
}

/// The table with a column replaced or added.
pub(crate) fn with_column(table: &RecordBatch, column: &str, array: ArrayRef) -> RecordBatch {
    let mut columns: Vec<(String, ArrayRef)> = named(table);
    match columns.iter_mut().find(|(name, _)| name == column) {
        Some(place) => place.1 = array,
        None => columns.push((column.to_owned(), array)),
    }
    of_columns(columns)
}

pub(crate) fn without(table: &RecordBatch, unwanted: impl Fn(&str) -> bool) -> RecordBatch {
    of_columns(named(table).into_iter().filter(|(name, _)| !unwanted(name)).collect())
}

pub(crate) fn named(table: &RecordBatch) -> Vec<(String, ArrayRef)> {
    let schema = table.schema();
    schema
        .fields()
        .iter()
        .map(|field| field.name().clone())
        .zip(table.columns().to_vec())
        .collect()
}

pub(crate) fn of_columns(columns: Vec<(String, ArrayRef)>) -> RecordBatch {
    let fields: Vec<Field> = columns
        .iter()
        .map(|(name, array)| Field::new(name, array.data_type().clone(), true))
        .collect();
    let arrays = columns.into_iter().map(|(_, array)| array).collect();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).unwrap()
}

/// The table with rows in another order; a row may be absent.
pub(crate) fn rows(table: &RecordBatch, order: &[usize]) -> RecordBatch {
    let pieces: Vec<RecordBatch> = order.iter().map(|&row| table.slice(row, 1)).collect();
    let path = tempfile::NamedTempFile::new().unwrap();
    // Parquet is the simplest concatenation without a further dependency.
    let mut writer = ArrowWriter::try_new(path.reopen().unwrap(), table.schema(), None).unwrap();
    for piece in &pieces {
        writer.write(piece).unwrap();
    }
    writer.close().unwrap();
    read_table(path.path())
}

/// What a dataset contains.
#[derive(Debug, PartialEq, Eq, Clone)]
pub(crate) struct Contents {
    /// Frames of each episode.
    pub(crate) lengths: Vec<usize>,
    /// Hash of all numbers, texts and tasks.
    pub(crate) numbers: String,
    /// Hash of all images; `None` if they were not decoded.
    pub(crate) images: Option<String>,
}

fn of_error(error: LerobotError) -> Faults {
    error.faults
}

/// Reads a whole dataset.
pub(crate) fn contents(root: &Path, images: bool) -> Result<Contents, Vec<re4_lerobot::Fault>> {
    let list = |faults: &Faults| faults.iter().cloned().collect::<Vec<_>>();
    let go = || false;
    let dataset = Dataset::open(root, &Cameras::All, &go).map_err(|error| list(&of_error(error)))?;
    let mut found = Vec::new();
    let mut hash = Sha256::new();
    let mut lengths = Vec::new();
    let all = || 0..dataset.episodes().len();
    dataset
        .read(all(), &go, |episode, frames| {
            lengths.push(episode.length);
            match frames {
                Ok(frames) => add(&mut hash, &dataset, &frames),
                Err(faults) => found.extend(list(&faults)),
            }
            Ok::<(), LerobotError>(())
        })
        .map_err(|error| list(&of_error(error)))?;
    let mut pixels = Sha256::new();
    for camera in dataset.cameras().iter().filter(|_| images) {
        let mut counts = vec![0; lengths.len()];
        dataset
            .images(camera, all(), &go, |block| {
                match block {
                    Ok(block) => {
                        assert_eq!(block.first, counts[block.episode]);
                        assert_eq!(block.bytes.len(), 3 * block.width * block.height * block.count);
                        counts[block.episode] += block.count;
                        pixels.update(&block.bytes);
                    }
                    Err((_, faults)) => found.extend(list(&faults)),
                }
                Ok::<(), LerobotError>(())
            })
            .map_err(|error| list(&of_error(error)))?;
        assert!(
            !found.is_empty() || counts == lengths,
            "{camera}: {counts:?} images for {lengths:?} frames"
        );
    }
    let images = images.then(|| hex(pixels.finalize()));
    if found.is_empty() {
        Ok(Contents {
            lengths,
            numbers: hex(hash.finalize()),
            images,
        })
    } else {
        Err(found)
    }
}

/// Adds the values of an episode to a hash, independent of the order and the type of columns.
fn add(hash: &mut Sha256, dataset: &Dataset, frames: &re4_lerobot::Frames) {
    let mut columns: Vec<_> = frames.columns.iter().collect();
    columns.sort_by(|a, b| a.name.cmp(&b.name));
    for column in columns {
        hash.update(&column.name);
        match &column.values {
            Values::Text(texts) => texts.iter().for_each(|text| hash.update(text)),
            numbers => (0..numbers.len()).for_each(|at| hash.update(numbers.number(at).unwrap().to_le_bytes())),
        }
    }
    for (time, task) in frames.timestamps.iter().zip(&frames.tasks) {
        hash.update(time.to_le_bytes());
        hash.update(&dataset.tasks()[task]);
    }
}

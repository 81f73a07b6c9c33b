//! Edits some files of an artifact, then opens, verifies and reads all of it.
//!
//! An input consists of flags (one byte: which hashes are corrected after the edits, as a forger would do) and edits, each with the
//! number of a file (one byte) and the bytes that `edits.rs` describes. Without corrected hashes, nearly every edit is found by the
//! first check. The hash of a table is corrected only if a whole table replaces another, because damaged Parquet bytes would only
//! test the Parquet library.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use re4_artifact::Row as _;
use re4_artifact::{
    Artifact, ArtifactSummary, ColumnKind, ColumnSpec, Columns, MANIFEST_NAME, Recipe, Stage, Store, TableSpec,
    canonical_json, canonical_text, col_binary, col_f64_list, col_text, verify,
};
use serde_json::{Map, Value, json};
use tempfile::TempDir;

use super::edits::{Input, edit};

const MOST_EDITS: usize = 6;
const ROWS: u32 = 5;
const ROWS_OF_A_GROUP: usize = 3;

/// A table that no stage writes, with a column of every kind. It is read by its name, as by programs that show any artifact.
const EVERY_KIND: TableSpec = TableSpec {
    name: "every_kind",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row an example.",
    columns: &[
        ColumnSpec::new("u32", ColumnKind::U32, "An id."),
        ColumnSpec::new("i64", ColumnKind::I64, "An offset."),
        ColumnSpec::new("f64", ColumnKind::F64, "A number that may be absent.").nullable(),
        ColumnSpec::new("bool", ColumnKind::Bool, "A flag."),
        ColumnSpec::new("category", ColumnKind::Category, "A category."),
        ColumnSpec::new("binary", ColumnKind::Binary, "Bytes."),
        ColumnSpec::new("list", ColumnKind::F64List, "A list."),
    ],
};

/// Flags for corrections: the lengths and hashes of tables, the key, and the manifest's own hash.
const MEND_TABLES: u8 = 1;
const MEND_KEY: u8 = 2;
const MEND_MANIFEST: u8 = 4;

/// The artifact that is edited.
pub(crate) struct Sample {
    path: PathBuf,
    files: BTreeMap<String, Vec<u8>>,
    _folder: TempDir,
}

impl Sample {
    /// Publishes an artifact with two small tables, so that reading it takes about a millisecond.
    pub(crate) fn new() -> Self {
        let folder = tempfile::Builder::new().prefix("re4-fuzz-").tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let recipe = Recipe::new(Stage::Ingest, 1)
            .config(&json!({"number": 0.5, "list": [1, 2], "text": "a"}))
            .unwrap()
            .input("raw", &re4_artifact::Key::from_bytes([7; 32]))
            .source(&[8; 32], json!({"format": "zarr"}));
        let writer = store.begin(&recipe).unwrap();
        for spec in [re4_index::ScaleRow::table(), &EVERY_KIND] {
            let mut table = writer.table_in_groups(spec, ROWS_OF_A_GROUP).unwrap();
            table.write_columns(rows(spec)).unwrap();
            table.finish().unwrap();
        }
        let summary = ArtifactSummary {
            summary: json!({"rows": ROWS}),
            warnings: vec![json!({"kind": "sample"})],
        };
        let path = writer.publish(summary).unwrap().path().to_owned();
        let files = fs::read_dir(&path)
            .unwrap()
            .map(|entry| {
                let path = entry.unwrap().path();
                let name = path.file_name().unwrap().to_str().unwrap().to_owned();
                (name, fs::read(path).unwrap())
            })
            .collect();
        Self {
            path,
            files,
            _folder: folder,
        }
    }

    /// Reads the artifact that the input describes. Returns the first error.
    pub(crate) fn run(&self, input: &[u8]) -> Result<(), String> {
        let mut input = Input(input);
        let flags = input.byte();
        let names: Vec<&String> = self.files.keys().collect();
        let mut edited: BTreeMap<&str, Option<Vec<u8>>> = BTreeMap::new();
        while !input.is_empty() && edited.len() < MOST_EDITS {
            let number = usize::from(input.byte());
            let name = names[number % names.len()];
            let donor = &self.files[names[(number + 1) % names.len()]];
            let content = edited.remove(name.as_str()).flatten();
            let content = edit(&mut input, content.as_ref().unwrap_or(&self.files[name]), donor);
            edited.insert(name, content);
        }
        if flags & MEND_MANIFEST != 0 {
            self.fix(flags, &mut edited);
        }
        for (name, content) in &edited {
            match content {
                Some(bytes) => fs::write(self.path.join(name), bytes).unwrap(),
                None => fs::remove_file(self.path.join(name)).unwrap(),
            }
        }
        let outcome = read(&self.path);
        for name in edited.into_keys() {
            fs::write(self.path.join(name), &self.files[name]).unwrap();
        }
        outcome
    }

    /// Corrects the manifest after the edits.
    fn fix(&self, flags: u8, edited: &mut BTreeMap<&str, Option<Vec<u8>>>) {
        let content = |name: &str| match edited.get(name) {
            Some(content) => content.as_deref(),
            None => self.files.get(name).map(Vec::as_slice),
        };
        let Some(Ok(Value::Object(mut manifest))) = content(MANIFEST_NAME).map(serde_json::from_slice) else {
            return;
        };
        if flags & MEND_TABLES != 0
            && let Some(Value::Object(tables)) = manifest.get_mut("tables")
        {
            for summary in tables.values_mut().filter_map(Value::as_object_mut) {
                if let Some(bytes) = summary.get("file").and_then(Value::as_str).and_then(content)
                    && self.files.values().any(|file| file == bytes)
                {
                    let hash = blake3::hash(bytes).to_hex().to_string();
                    summary.insert("bytes".to_owned(), bytes.len().into());
                    summary.insert("blake3".to_owned(), hash.into());
                }
            }
        }
        if flags & MEND_KEY != 0
            && let Some(key) = key(&manifest)
        {
            manifest.insert("key".to_owned(), key.into());
        }
        manifest.remove("manifest_blake3");
        let hash = blake3::hash(canonical_json(&manifest).unwrap().to_string().as_bytes());
        manifest.insert("manifest_blake3".to_owned(), hash.to_hex().to_string().into());
        let text = canonical_text(&Value::Object(manifest));
        edited.insert(MANIFEST_NAME, Some(text.into_bytes()));
    }
}

/// The key that follows from a manifest, if its recipe can be read.
fn key(manifest: &Map<String, Value>) -> Option<String> {
    let number = |name: &str| manifest.get(name)?.as_u64();
    let stage = Stage::from_name(manifest.get("stage")?.as_str()?)?;
    let mut recipe = Recipe::new(stage, number("code_version")?.try_into().ok()?)
        .config(manifest.get("config")?)
        .ok()?;
    for (name, key) in manifest.get("inputs")?.as_object()? {
        recipe = recipe.input(name, &key.as_str()?.parse().ok()?);
    }
    if let Some(source) = manifest.get("source_blake3").and_then(Value::as_str) {
        let hash: re4_artifact::Key = source.parse().ok()?;
        recipe = recipe.source(hash.as_bytes(), Value::Null);
    }
    Some(recipe.key().to_string())
}

/// Reads everything in an artifact, in all possible ways.
fn read(path: &Path) -> Result<(), String> {
    let verified = verify(path, &re4_stages::tables::described).map_err(|error| error.to_string());
    let artifact = Artifact::open(path).map_err(|error| error.to_string())?;
    // Every command does this before it reads tables.
    artifact.verify_bytes().map_err(|error| error.to_string())?;
    for name in artifact.manifest().tables.keys() {
        let table = match re4_stages::tables::described(&artifact, name) {
            Some(spec) => artifact.table(spec),
            None => artifact.table_named(name),
        };
        let table = table.map_err(|error| error.to_string())?;
        let rows = table.rows();
        let all = table.read_all().map_err(|error| error.to_string());
        if let Ok(all) = &all {
            assert_eq!(all.num_rows() as u64, rows);
            for field in all.schema_ref().fields() {
                let _ = (
                    col_text(all, field.name()),
                    col_binary(all, field.name()),
                    col_f64_list(all, field.name()),
                );
            }
        }
        let _ = table.read_rows(rows / 2..rows);
        let _ = table.read_row_group(table.row_groups().saturating_sub(1));
        if let Some(field) = table.schema().fields().last() {
            let _ = table.read_columns(&[field.name()]);
        }
        all?;
    }
    verified.map(|_| ())
}

/// Generates rows for any table.
fn rows(spec: &'static TableSpec) -> Columns {
    let mut columns = Columns::new(spec);
    for column in spec.columns {
        let name = column.name;
        let numbers = 0..ROWS;
        columns = match column.kind {
            ColumnKind::U32 => columns.u32(name, numbers.collect()),
            ColumnKind::U64 => columns.u64(name, numbers.map(u64::from).collect()),
            ColumnKind::I64 => columns.i64(name, numbers.map(i64::from).collect()),
            ColumnKind::F64 if column.nullable => {
                columns.f64_or_null(name, numbers.map(|i| (i % 2 == 0).then(|| f64::from(i))).collect())
            }
            ColumnKind::F64 => columns.f64(name, numbers.map(f64::from).collect()),
            ColumnKind::Bool => columns.bool(name, numbers.map(|i| i % 2 == 0).collect()),
            ColumnKind::Text | ColumnKind::Category => columns.text(name, numbers.map(|i| format!("word {}", i / 2))),
            ColumnKind::Binary => columns.binary(name, numbers.map(|i| vec![7; i as usize])),
            ColumnKind::F64List => columns.f64_list(name, numbers.map(|i| vec![0.5; i as usize % 3])),
            ColumnKind::F32List => columns.f32_rows(name, vec![0.5; 2 * ROWS as usize], 2),
        };
    }
    columns
}

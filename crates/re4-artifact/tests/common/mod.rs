//! Code that the tests share: a table with a column of every kind, and artifacts with that table.
#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    reason = "every test file uses only a part of this module"
)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use re4_artifact::{Artifact, ArtifactSummary, ColumnKind, ColumnSpec, Columns, Recipe, Stage, Store, TableSpec};
use serde_json::json;

/// A column of every kind, with and without nulls.
pub const EVERY_KIND: TableSpec = TableSpec {
    name: "every_kind",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row per example.",
    columns: &[
        ColumnSpec::new("episode", ColumnKind::U32, "An id."),
        ColumnSpec::new("count", ColumnKind::U64, "A count."),
        ColumnSpec::new("offset", ColumnKind::I64, "An offset.").unit("px"),
        ColumnSpec::new("eef_x", ColumnKind::F64, "A coordinate.")
            .unit("px")
            .frame("world"),
        ColumnSpec::new("maybe", ColumnKind::F64, "A coordinate that may be absent.").nullable(),
        ColumnSpec::new("moving", ColumnKind::Bool, "A flag.").nullable(),
        ColumnSpec::new("reason", ColumnKind::Text, "A text."),
        ColumnSpec::new("mode", ColumnKind::Category, "A category.").nullable(),
        ColumnSpec::new("image", ColumnKind::Binary, "Bytes."),
        ColumnSpec::new("list", ColumnKind::F64List, "A list."),
        ColumnSpec::new("demo", ColumnKind::U32, "An id that may be absent.").nullable(),
    ],
};

/// A small table.
pub const SCALES: TableSpec = TableSpec {
    name: "scales",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row per dimension.",
    columns: &[
        ColumnSpec::new("dimension", ColumnKind::Text, "A name."),
        ColumnSpec::new("minimum", ColumnKind::F64, "A number."),
        ColumnSpec::new("maximum", ColumnKind::F64, "A number."),
    ],
};

/// A row of [`EVERY_KIND`].
#[derive(Debug, Clone)]
pub struct Row {
    pub episode: u32,
    pub count: u64,
    pub offset: i64,
    pub eef_x: f64,
    pub maybe: Option<f64>,
    pub moving: Option<bool>,
    pub reason: String,
    pub mode: Option<String>,
    pub image: Vec<u8>,
    pub list: Vec<f64>,
    pub demo: Option<u32>,
}

/// The rows as columns.
pub fn columns(rows: &[Row]) -> Columns {
    Columns::new(&EVERY_KIND)
        .u32("episode", rows.iter().map(|r| r.episode).collect())
        .u64("count", rows.iter().map(|r| r.count).collect())
        .i64("offset", rows.iter().map(|r| r.offset).collect())
        .f64("eef_x", rows.iter().map(|r| r.eef_x).collect())
        .f64_or_null("maybe", rows.iter().map(|r| r.maybe).collect())
        .bool_or_null("moving", rows.iter().map(|r| r.moving).collect())
        .text("reason", rows.iter().map(|r| &r.reason))
        .text_or_null("mode", rows.iter().map(|r| r.mode.as_ref()))
        .binary("image", rows.iter().map(|r| &r.image))
        .f64_list("list", rows.iter().map(|r| &r.list))
        .u32_or_null("demo", rows.iter().map(|r| r.demo).collect())
}

/// Returns `count` rows, which are the same in every call.
pub fn sample_rows(count: u32) -> Vec<Row> {
    (0..count)
        .map(|i| Row {
            episode: i / 7,
            count: u64::MAX - u64::from(i),
            offset: -i64::from(i),
            eef_x: (f64::from(i) * 0.37).sin() * 512.0,
            maybe: (i % 3 != 0).then(|| f64::from(i).sqrt()),
            moving: (i % 4 != 0).then_some(i % 2 == 0),
            reason: format!("because of {i}"),
            mode: (i % 5 != 0).then(|| ["transit", "transfer"][(i % 2) as usize].to_owned()),
            image: (0..i % 40).map(|b| (b * i) as u8).collect(),
            list: (0..i % 4).map(f64::from).collect(),
            demo: (i % 2 == 0).then_some(i),
        })
        .collect()
}

/// Returns a recipe whose key depends on `number`.
pub fn recipe(number: u32) -> Recipe {
    Recipe::new(Stage::Segment, 1)
        .config(&json!({"number": number, "epsilon": 0.1}))
        .unwrap()
        .input("episodes", &re4_artifact::Key::from_bytes([7; 32]))
        .source(&[8; 32], json!({"format": "zarr"}))
}

/// Writes and publishes an artifact of sample rows.
pub fn publish_sample(store: &Store, number: u32, count: u32) -> Artifact {
    let writer = store.begin(&recipe(number)).unwrap();
    let mut table = writer.table_in_groups(&EVERY_KIND, 64).unwrap();
    table.write_columns(columns(&sample_rows(count))).unwrap();
    table.finish().unwrap();
    writer
        .publish(ArtifactSummary {
            summary: json!({"rows": count}),
            warnings: vec![json!({"kind": "sample"})],
        })
        .unwrap()
}

/// Returns every file in a folder and its subfolders with its bytes.
pub fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(&next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_path_buf();
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Returns the names of the artifacts of the sample's stage and of temporary files and folders, sorted.
pub fn artifact_names(root: &Path) -> Vec<String> {
    let names = |folder: &Path| -> Vec<String> {
        let listing = fs::read_dir(folder).into_iter().flatten();
        listing
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect()
    };
    let mut found = names(root);
    found.retain(|name| name.starts_with(".tmp-"));
    found.extend(names(&root.join(Stage::Segment.artifact())));
    found.sort();
    found
}

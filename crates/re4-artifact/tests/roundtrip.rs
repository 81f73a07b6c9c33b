//! Rows are read back bit for bit, and equal rows give equal bytes.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail by panicking"
)]

mod common;

use common::{EVERY_KIND, Row, SCALES, columns, files, publish_sample, recipe, sample_rows};
use proptest::prelude::*;
use re4_artifact::{
    Artifact, ArtifactError, ArtifactSummary, ColumnKind, ColumnSpec, Columns, Recipe, Row as _, Stage, Store,
    TableSpec, col_binary, col_bool, col_f64, col_f64_list, col_f64_or_null, col_i64, col_text, col_u32,
    col_u32_or_null, col_u64, json_description, table, verify,
};
use re4_fault::Remedy as _;
use serde_json::json;

fn any_bits() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<u64>().prop_map(f64::from_bits),
        Just(-0.0),
        Just(0.0),
        Just(f64::NAN),
        Just(-f64::NAN),
        Just(f64::INFINITY),
        Just(f64::from_bits(1)),
    ]
}

fn row() -> impl Strategy<Value = Row> {
    (
        (any::<u32>(), any::<u64>(), any::<i64>(), any_bits()),
        (
            proptest::option::of(any_bits()),
            proptest::option::of(any::<bool>()),
            "\\PC{0,6}",
        ),
        (
            proptest::option::of("[ab]{1,2}"),
            proptest::collection::vec(any::<u8>(), 0..50),
            proptest::collection::vec(any_bits(), 0..4),
            proptest::option::of(any::<u32>()),
        ),
    )
        .prop_map(
            |((episode, count, offset, eef_x), (maybe, moving, reason), (mode, image, list, demo))| Row {
                episode,
                count,
                offset,
                eef_x,
                maybe,
                moving,
                reason,
                mode,
                image,
                list,
                demo,
            },
        )
}

/// Writes the rows in several batches, split at `cuts`, with row groups of `group` rows.
fn write(store: &Store, rows: &[Row], cuts: &[usize], group: usize) -> Artifact {
    let writer = store.begin(&recipe(0)).unwrap();
    let mut table = writer.table_in_groups(&EVERY_KIND, group).unwrap();
    let mut first = 0;
    for end in cuts.iter().copied().chain([rows.len()]) {
        let end = end.clamp(first, rows.len());
        table.write_columns(columns(&rows[first..end])).unwrap();
        first = end;
    }
    assert_eq!(table.rows(), rows.len() as u64);
    table.finish().unwrap();
    writer.publish(ArtifactSummary::default()).unwrap()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn assert_same(batch: &arrow_array::RecordBatch, rows: &[Row]) {
    assert_eq!(batch.num_rows(), rows.len());
    let by = |f: fn(&Row) -> u32| rows.iter().map(f).collect::<Vec<_>>();
    assert_eq!(col_u32(batch, "episode").unwrap(), by(|r| r.episode));
    let counts: Vec<u64> = rows.iter().map(|r| r.count).collect();
    assert_eq!(col_u64(batch, "count").unwrap(), counts);
    let offsets: Vec<i64> = rows.iter().map(|r| r.offset).collect();
    assert_eq!(col_i64(batch, "offset").unwrap(), offsets);
    let xs: Vec<f64> = rows.iter().map(|r| r.eef_x).collect();
    assert_eq!(bits(col_f64(batch, "eef_x").unwrap()), bits(&xs));
    let maybe: Vec<Option<u64>> = rows.iter().map(|r| r.maybe.map(f64::to_bits)).collect();
    let found: Vec<Option<u64>> = col_f64_or_null(batch, "maybe")
        .unwrap()
        .into_iter()
        .map(|v| v.map(f64::to_bits))
        .collect();
    assert_eq!(found, maybe);
    let moving: Vec<Option<bool>> = rows.iter().map(|r| r.moving).collect();
    assert_eq!(col_bool(batch, "moving").unwrap().iter().collect::<Vec<_>>(), moving);
    let reasons: Vec<Option<&str>> = rows.iter().map(|r| Some(r.reason.as_str())).collect();
    assert_eq!(col_text(batch, "reason").unwrap(), reasons);
    let modes: Vec<Option<&str>> = rows.iter().map(|r| r.mode.as_deref()).collect();
    assert_eq!(col_text(batch, "mode").unwrap(), modes);
    let images: Vec<Option<&[u8]>> = rows.iter().map(|r| Some(r.image.as_slice())).collect();
    assert_eq!(col_binary(batch, "image").unwrap().iter().collect::<Vec<_>>(), images);
    let lists: Vec<Vec<u64>> = rows.iter().map(|r| bits(&r.list)).collect();
    let found: Vec<Vec<u64>> = col_f64_list(batch, "list").unwrap().iter().map(|l| bits(l)).collect();
    assert_eq!(found, lists);
    let demos: Vec<Option<u32>> = rows.iter().map(|r| r.demo).collect();
    assert_eq!(col_u32_or_null(batch, "demo").unwrap(), demos);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn rows_are_read_back_bit_for_bit_and_batches_do_not_change_the_file(
        rows in proptest::collection::vec(row(), 0..120),
        mut cuts in proptest::collection::vec(0usize..120, 0..6),
        group in 1usize..50,
        range in (0.0..1.0f64, 0.0..1.0f64),
    ) {
        cuts.sort_unstable();
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let artifact = write(&Store::open(one.path()).unwrap(), &rows, &[], group);
        let pieces = write(&Store::open(other.path()).unwrap(), &rows, &cuts, group);
        prop_assert_eq!(files(artifact.path()), files(pieces.path()));

        let table = artifact.table(&EVERY_KIND).unwrap();
        assert_same(&table.read_all().unwrap(), &rows);
        prop_assert_eq!(table.row_groups(), rows.len().div_ceil(group));
        for i in 0..table.row_groups() {
            let end = ((i + 1) * group).min(rows.len());
            assert_same(&table.read_row_group(i).unwrap(), &rows[i * group..end]);
        }
        let mut first = 0;
        for batch in table.batches().unwrap() {
            let batch = batch.unwrap();
            assert_same(&batch, &rows[first..first + batch.num_rows()]);
            first += batch.num_rows();
        }
        prop_assert_eq!(first, rows.len());
        let (a, b) = ((range.0 * rows.len() as f64) as usize, (range.1 * rows.len() as f64) as usize);
        let (a, b) = (a.min(b), a.max(b));
        assert_same(&table.read_rows(a as u64..b as u64).unwrap(), &rows[a..b]);
        verify(artifact.path(), &|_, _| None).unwrap();
    }
}

#[test]
fn the_same_input_gives_the_same_bytes_in_all_threads() {
    let trees: Vec<_> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..4)
            .map(|_| {
                scope.spawn(|| {
                    let root = tempfile::tempdir().unwrap();
                    files(publish_sample(&Store::open(root.path()).unwrap(), 1, 500).path())
                })
            })
            .collect();
        workers.into_iter().map(|worker| worker.join().unwrap()).collect()
    });
    assert!(trees.windows(2).all(|pair| pair[0] == pair[1]));
    assert_eq!(trees[0].len(), 2);
    let manifest = String::from_utf8(trees[0].get(std::path::Path::new("manifest.json")).unwrap().clone()).unwrap();
    assert!(!manifest.contains("/tmp"), "no absolute path may be in {manifest}");
}

#[test]
fn several_tables_can_be_written_at_the_same_time() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let writer = store.begin(&Recipe::new(Stage::Ingest, 1)).unwrap();
    let mut images = writer.rows_in_groups::<ImageRow>(10).unwrap();
    let mut episodes = writer.rows::<CountRow>().unwrap();
    for episode in 0..3u32 {
        let rows = (0..25).map(|frame| ImageRow {
            episode,
            frame,
            image: vec![frame as u8; 30],
        });
        images.extend(rows).unwrap();
        episodes.push(&CountRow { episode, frames: 25 }).unwrap();
    }
    images.finish().unwrap();
    episodes.finish().unwrap();
    let artifact = writer.publish(ArtifactSummary::default()).unwrap();
    let images = artifact.table(ImageRow::table()).unwrap();
    assert_eq!((images.rows(), images.row_groups()), (75, 8));
    let one: Vec<ImageRow> = images.read_range(33..34).unwrap();
    assert_eq!((one[0].episode, &one[0].image[..]), (1, &[8; 30][..]));
    let counts = artifact.table(CountRow::table()).unwrap();
    let counts = counts.read_columns(&["frames"]).unwrap();
    assert_eq!(
        (counts.num_columns(), col_u32(&counts, "frames").unwrap()),
        (1, &[25, 25, 25][..])
    );
}

table! {
    /// Images.
    #[table("images", version = 1)]
    pub struct ImageRow {
        /// Demonstration.
        pub episode: u32,
        /// Frame.
        pub frame: u32,
        /// Its image.
        pub image: Vec<u8>,
    }
}

table! {
    /// Lengths.
    #[table("counts", version = 1)]
    pub struct CountRow {
        /// Demonstration.
        pub episode: u32,
        /// Its frames.
        pub frames: u32,
    }
}

#[test]
fn files_contain_units_and_frames_of_reference() {
    let root = tempfile::tempdir().unwrap();
    let artifact = publish_sample(&Store::open(root.path()).unwrap(), 1, 5);
    let table = artifact.table_named("every_kind").unwrap();
    let schema = table.schema();
    let field = schema.field_with_name("eef_x").unwrap();
    assert_eq!(field.metadata().get("unit").map(String::as_str), Some("px"));
    assert_eq!(field.metadata().get("frame").map(String::as_str), Some("world"));
    assert_eq!(
        field.metadata().get("description").map(String::as_str),
        Some("A coordinate.")
    );
    assert_eq!(schema.metadata.get("re4.version").map(String::as_str), Some("1"));
    assert!(schema.metadata.get("re4.columns").unwrap().contains("\"unit\":\"px\""));
}

#[test]
fn json_descriptions_are_complete() {
    let description = json_description(&EVERY_KIND);
    assert_eq!(description["file"], "every_kind.parquet");
    assert_eq!(
        description["columns"][3],
        json!({
            "name": "eef_x", "kind": "f64", "arrow_type": "Float64", "nullable": false, "unit": "px", "frame": "world",
            "description": "A coordinate.", "since": 1, "formerly": ""
        })
    );
}

/// The first version of a table of which [`THIRD`] is a later version.
const FIRST: TableSpec = TableSpec {
    name: "grown",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row per example.",
    columns: &[ColumnSpec::new("frame", ColumnKind::U32, "A frame.")],
};
const THIRD: TableSpec = TableSpec {
    version: 3,
    columns: &[
        ColumnSpec::new("frame", ColumnKind::U32, "A frame."),
        ColumnSpec::new("depth", ColumnKind::F64, "Added in version 2.")
            .nullable()
            .since(2),
        ColumnSpec::new("label", ColumnKind::Category, "Added in version 3.")
            .nullable()
            .since(3),
    ],
    ..FIRST
};

#[test]
fn columns_missing_in_older_tables_are_null_and_newer_tables_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let publish = |number, spec: &'static TableSpec, rows: Columns| {
        let writer = store.begin(&recipe(number)).unwrap();
        let mut table = writer.table(spec).unwrap();
        table.write_columns(rows).unwrap();
        table.finish().unwrap();
        writer.publish(ArtifactSummary::default()).unwrap()
    };
    let old = publish(1, &FIRST, Columns::new(&FIRST).u32("frame", vec![4, 5]));
    let rows = old.table(&THIRD).unwrap().read_all().unwrap();
    assert_eq!(col_u32(&rows, "frame").unwrap(), [4, 5]);
    assert_eq!(col_f64_or_null(&rows, "depth").unwrap(), [None, None]);
    assert_eq!(col_text(&rows, "label").unwrap(), [None, None]);
    let some = old.table(&THIRD).unwrap().read_columns(&["depth", "frame"]).unwrap();
    assert_eq!(some.schema().field(0).name(), "depth");
    let batches: Vec<_> = old.table(&THIRD).unwrap().batches().unwrap().collect();
    assert_eq!(batches[0].as_ref().unwrap().num_columns(), 3);

    let new = publish(
        2,
        &THIRD,
        Columns::new(&THIRD)
            .u32("frame", vec![6])
            .f64("depth", vec![0.5])
            .text("label", ["far"]),
    );
    assert_eq!(
        col_text(&new.table(&THIRD).unwrap().read_all().unwrap(), "label").unwrap(),
        [Some("far")]
    );
    let refusal = new.table(&FIRST).unwrap_err().sentence();
    assert!(
        refusal.ends_with("table grown has schema version 3, but this build reads versions up to 1; update re4-pipe"),
        "{refusal}"
    );
}

#[test]
fn columns_that_do_not_match_the_description_are_refused() {
    let refused = |columns: Columns| match columns.finish().unwrap_err() {
        error @ ArtifactError::Rows { .. } => error.sentence(),
        other => panic!("{other}"),
    };
    let scales = || {
        Columns::new(&SCALES)
            .text("dimension", ["eef_x"])
            .f64("minimum", vec![0.0])
    };
    assert_eq!(
        refused(scales()),
        "cannot write table scales: column maximum is not given"
    );
    assert_eq!(
        refused(scales().f64("maximum", vec![1.0, 2.0])),
        "cannot write table scales: column maximum has 2 values, but the first column has 1"
    );
    assert_eq!(
        refused(scales().u32("maximum", vec![1])),
        "cannot write table scales: column maximum has type UInt32, not f64"
    );
    assert_eq!(
        refused(scales().f64_or_null("maximum", vec![None])),
        "cannot write table scales: column maximum is null in row 0"
    );
    assert_eq!(
        refused(scales().f64("maximum", vec![1.0]).f64("median", vec![1.0])),
        "cannot write table scales: the table has no column median"
    );
    assert_eq!(
        refused(scales().f64("minimum", vec![1.0])),
        "cannot write table scales: column minimum is given twice"
    );
}

#[test]
fn missing_columns_tables_and_rows_are_reported() {
    let root = tempfile::tempdir().unwrap();
    let artifact = publish_sample(&Store::open(root.path()).unwrap(), 1, 5);
    let table = artifact.table(&EVERY_KIND).unwrap();
    let rows = table.read_all().unwrap();
    let message = |result: Result<&[f64], ArtifactError>| result.unwrap_err().sentence();
    assert!(
        message(col_f64(&rows, "eef_z"))
            .starts_with("table every_kind has no column eef_z; use one of its columns: episode, count")
    );
    assert_eq!(
        message(col_f64(&rows, "episode")),
        "column episode of table every_kind has type UInt32, not f64"
    );
    assert_eq!(
        message(col_f64(&rows, "maybe")),
        "column maybe of table every_kind is null in row 0; read it as a nullable column"
    );
    let missing = artifact.table(ImageRow::table()).unwrap_err().sentence();
    assert!(
        missing.ends_with("has no table images; use one of its tables: every_kind"),
        "{missing}"
    );
    let beyond = table.read_rows(3..9).unwrap_err().sentence();
    assert!(
        beyond.contains("cannot read rows 3..9 of ") && beyond.ends_with("the table has 5 rows"),
        "{beyond}"
    );
    assert!(table.read_row_group(1).is_err());
    assert!(table.read_columns(&["eef_z"]).is_err());
    assert_eq!(table.read_rows(2..2).unwrap().num_rows(), 0);
    assert_eq!(sample_rows(5).len(), 5);
}

//! Artifacts in parts: read like artifacts of one part, the same whoever made them, and absent until they are complete.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail by panicking"
)]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Barrier;

use proptest::prelude::*;
use re4_artifact::{Artifact, ArtifactError, ArtifactSummary, Part, Recipe, Shard, Stage, Store, table, verify};
use re4_fault::Remedy as _;
use serde_json::json;

table! {
    /// Test rows.
    #[table("numbers", version = 1)]
    pub struct NumberRow {
        /// Running number.
        pub number: u32,
        /// Value.
        pub value: f64,
        /// Text.
        pub text: Option<String>,
    }
}

table! {
    /// Test rows that describe all parts.
    #[table("totals", version = 1)]
    pub struct TotalRow {
        /// Sum.
        pub sum: f64,
    }
}

const GROUP: usize = 7;

/// Damages the artifact in a folder.
type Damage<'a> = &'a dyn Fn(&Path);

fn recipe() -> Recipe {
    Recipe::new(Stage::Segment, 1)
}

fn row(number: u32) -> NumberRow {
    NumberRow {
        number,
        value: if number.is_multiple_of(3) {
            -0.0
        } else {
            f64::from(number) / 7.0
        },
        text: (!number.is_multiple_of(4)).then(|| format!("row {number}")),
    }
}

/// The rows of parts of these lengths.
fn rows_of(lengths: &[u32]) -> Vec<Vec<NumberRow>> {
    let mut next = 0;
    let part = |&length: &u32| {
        let rows = (next..next + length).map(row).collect();
        next += length;
        rows
    };
    lengths.iter().map(part).collect()
}

fn publish_part(store: &Store, number: u32, rows: &[NumberRow]) -> Result<Artifact, ArtifactError> {
    let writer = store.begin_part(&recipe(), Part::Numbered(number))?;
    // A part without rows has no table.
    if !rows.is_empty() {
        let mut table = writer.rows_in_groups(GROUP)?;
        table.extend(rows.iter().cloned())?;
        table.finish()?;
    }
    let summary = json!({ "rows": rows.len() });
    writer.publish(ArtifactSummary {
        summary,
        warnings: Vec::new(),
    })
}

fn merge(store: &Store, count: u32) -> Result<Artifact, ArtifactError> {
    let parts: Vec<Artifact> = (0..count)
        .map(|number| store.part(&recipe(), Part::Numbered(number)).map(Option::unwrap))
        .collect::<Result<_, _>>()?;
    let writer = store.begin_part(&recipe(), Part::Dataset)?;
    writer.write_rows([TotalRow { sum: 1.5 }])?;
    let dataset = writer.publish(ArtifactSummary::default())?;
    store.merge(&recipe(), &parts, Some(&dataset), ArtifactSummary::default())
}

fn made(root: &Path, parts: &[Vec<NumberRow>]) -> Artifact {
    let store = Store::open(root).unwrap();
    for (number, rows) in (0..).zip(parts) {
        publish_part(&store, number, rows).unwrap();
    }
    merge(&store, parts.len() as u32).unwrap()
}

/// All files below a folder, by their relative paths.
fn tree(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().display().to_string();
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn described(_: &Artifact, name: &str) -> Option<&'static re4_artifact::TableSpec> {
    use re4_artifact::Row as _;
    [NumberRow::table(), TotalRow::table()]
        .into_iter()
        .find(|spec| spec.name == name)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn a_table_in_parts_is_read_like_a_single_file(
        lengths in prop::collection::vec(0_u32..30, 1..6).prop_filter("no rows", |lengths| lengths.iter().sum::<u32>() > 0),
        bounds in (0.0..1.0_f64, 0.0..1.0_f64),
    ) {
        let root = tempfile::tempdir().unwrap();
        let parts = rows_of(&lengths);
        let all: Vec<NumberRow> = parts.concat();
        let artifact = made(root.path(), &parts);
        verify(artifact.path(), &described).unwrap();
        prop_assert_eq!(&artifact.read::<NumberRow>().unwrap(), &all);
        let table = {
            use re4_artifact::Row as _;
            artifact.table(NumberRow::table()).unwrap()
        };
        prop_assert_eq!(table.rows(), all.len() as u64);
        let streamed: Vec<NumberRow> = table.stream().unwrap().collect::<Result<_, _>>().unwrap();
        prop_assert_eq!(&streamed, &all);
        let place = |bound: f64| (bound * (all.len() + 1) as f64) as u64;
        let (a, b) = (place(bounds.0), place(bounds.1));
        let range = a.min(b)..a.max(b);
        let wanted = &all[range.start as usize..range.end as usize];
        prop_assert_eq!(&table.read_range::<NumberRow>(range).unwrap()[..], wanted);
        let groups = (0..table.row_groups()).map(|group| table.read_row_group(group).unwrap().num_rows());
        prop_assert_eq!(groups.sum::<usize>(), all.len());
        prop_assert!(table.read_row_group(table.row_groups()).is_err());
        prop_assert!(table.read_rows(0..all.len() as u64 + 1).is_err());
        for (number, rows) in (0..).zip(&parts) {
            let part = artifact.part(number).unwrap();
            if rows.is_empty() {
                prop_assert!(!part.has::<NumberRow>());
            } else {
                prop_assert_eq!(&part.read::<NumberRow>().unwrap(), rows);
            }
            prop_assert_eq!(part.read::<TotalRow>().unwrap().len(), 1);
        }
    }

    #[test]
    fn shares_cover_every_part_once(parts in 0_u32..5_000, count in 1_u32..300) {
        let mut next = 0;
        for index in 0..count {
            let shard: Shard = format!("{index}/{count}").parse().unwrap();
            let own = shard.parts(parts);
            prop_assert_eq!(own.start, next);
            prop_assert!(own.len() <= parts.div_ceil(count) as usize);
            next = own.end;
        }
        prop_assert_eq!(next, parts);
    }
}

#[test]
fn a_share_is_written_as_index_and_count() {
    for text in [
        "",
        "3",
        "8/8",
        "-1/8",
        "1/0",
        "0/0",
        "a/b",
        "1/8/2",
        "+1/8",
        "0/4294967295",
        " 1/8",
    ] {
        assert!(text.parse::<Shard>().unwrap_err().contains("such as 3/8"), "{text}");
    }
    assert_eq!("3/8".parse::<Shard>().unwrap().to_string(), "3/8");
}

#[test]
fn bytes_do_not_depend_on_who_makes_which_part_in_which_order() {
    let parts = rows_of(&[9, 0, 20, 7, 1]);
    let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    made(one.path(), &parts);
    for number in [3, 0, 4, 2, 1, 3] {
        // Each time as another process would.
        let store = Store::open(other.path()).unwrap();
        publish_part(&store, number, &parts[number as usize]).unwrap();
        assert!(store.lookup(Stage::Segment, &recipe().key()).unwrap().is_none());
    }
    let store = Store::open(other.path()).unwrap();
    merge(&store, 5).unwrap();
    // Merged twice, as by two processes.
    merge(&store, 5).unwrap();
    assert_eq!(tree(one.path()), tree(other.path()));
    assert!(store.lookup(Stage::Segment, &recipe().key()).unwrap().is_some());
}

#[test]
fn a_folder_that_is_only_begun_is_no_artifact() {
    // A process creates the folder of the artifact and then that of its parts, and may be killed in between.
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let folder = store.folder(Stage::Segment, &recipe().key());
    for begun in [folder.clone(), folder.join("parts")] {
        fs::create_dir_all(begun).unwrap();
        assert!(store.lookup(Stage::Segment, &recipe().key()).unwrap().is_none());
    }
    fs::write(folder.join("parts.txt"), "").unwrap();
    let error = store.lookup(Stage::Segment, &recipe().key()).unwrap_err().sentence();
    assert!(error.contains("it has no manifest.json"), "{error}");
}

#[test]
fn many_writers_of_one_part_and_of_the_manifest_agree() {
    let root = tempfile::tempdir().unwrap();
    let parts = rows_of(&[50, 50]);
    let barrier = Barrier::new(8);
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                let store = Store::open(root.path()).unwrap();
                barrier.wait();
                for (number, rows) in (0..).zip(&parts) {
                    publish_part(&store, number, rows).unwrap();
                }
                merge(&store, 2).unwrap();
            });
        }
    });
    let mut left = fs::read_dir(root.path()).unwrap();
    assert!(left.all(|entry| entry.unwrap().file_name() == Stage::Segment.artifact()));
    let artifact = Store::open(root.path())
        .unwrap()
        .lookup(Stage::Segment, &recipe().key())
        .unwrap()
        .unwrap();
    assert_eq!(artifact.read::<NumberRow>().unwrap(), parts.concat());
}

#[test]
fn other_bytes_of_a_part_or_of_the_manifest_are_an_error_that_names_the_folder() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    publish_part(&store, 0, &[row(1)]).unwrap();
    let error = publish_part(&store, 0, &[row(2)]).unwrap_err();
    assert!(matches!(error, ArtifactError::NotReproducible { .. }));
    let sentence = error.sentence();
    assert!(
        sentence.contains("parts/000000") && sentence.contains("table numbers"),
        "{sentence}"
    );
    let artifact = merge(&store, 1).unwrap();
    let part = store.part(&recipe(), Part::Numbered(0)).unwrap().unwrap();
    let other = ArtifactSummary {
        summary: json!({ "other": 1 }),
        warnings: Vec::new(),
    };
    let error = store.merge(&recipe(), &[part], None, other).unwrap_err();
    assert!(matches!(error, ArtifactError::NotReproducible { ref folder, .. } if folder == artifact.path()));
}

#[test]
fn damage_to_a_part_is_found_and_named() {
    let parts = rows_of(&[9, 9]);
    let damages: [(&str, Damage<'_>); 4] = [
        ("parts/000001/numbers.parquet is missing", &|folder| {
            fs::remove_file(folder.join("parts/000001/numbers.parquet")).unwrap();
        }),
        ("the content of parts/000001/numbers.parquet", &|folder| {
            let path = folder.join("parts/000001/numbers.parquet");
            let mut bytes = fs::read(&path).unwrap();
            bytes[40] ^= 1;
            fs::write(&path, bytes).unwrap();
        }),
        ("parts/000001/more is not part of it", &|folder| {
            fs::write(folder.join("parts/000001/more"), "x").unwrap();
        }),
        ("manifest.json", &|folder| {
            let path = folder.join("parts/000001/part.json");
            let text = fs::read_to_string(&path).unwrap().replace("\"rows\": 9", "\"rows\": 8");
            fs::write(&path, text).unwrap();
        }),
    ];
    for (what, damage) in damages {
        let root = tempfile::tempdir().unwrap();
        let artifact = made(root.path(), &parts);
        damage(artifact.path());
        let store = Store::open(root.path()).unwrap();
        let error = store.lookup(Stage::Segment, &recipe().key()).unwrap_err();
        assert!(error.sentence().contains(what), "{}", error.sentence());
        // A process that reads only another part does not read the damaged one.
        let found = Store::open(root.path())
            .unwrap()
            .verifying_by_part()
            .lookup(Stage::Segment, &recipe().key())
            .unwrap()
            .unwrap();
        assert_eq!(found.part(0).unwrap().read::<NumberRow>().unwrap(), parts[0]);
    }
    // A folder that a late process wrote is no damage.
    let root = tempfile::tempdir().unwrap();
    let artifact = made(root.path(), &parts);
    fs::create_dir(artifact.path().join("parts/000009")).unwrap();
    let store = Store::open(root.path()).unwrap();
    assert!(store.lookup(Stage::Segment, &recipe().key()).unwrap().is_some());
}

#[test]
fn a_part_belongs_to_its_number_and_its_key() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(root.path()).unwrap();
    let folder = publish_part(&store, 0, &[row(1)]).unwrap().path().to_path_buf();
    fs::rename(&folder, folder.with_file_name("000001")).unwrap();
    let error = store.part(&recipe(), Part::Numbered(1)).unwrap_err();
    assert!(
        error.sentence().contains("belongs to another part"),
        "{}",
        error.sentence()
    );
    let other = Recipe::new(Stage::Segment, 2);
    let moved = store.part_folder(&other, Part::Numbered(1));
    fs::create_dir_all(moved.parent().unwrap()).unwrap();
    fs::rename(folder.with_file_name("000001"), moved).unwrap();
    assert!(store.part(&other, Part::Numbered(1)).is_err());
}

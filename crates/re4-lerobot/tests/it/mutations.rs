//! Kinds of wrong and of unusual datasets. Each is refused with the file and the column or key at fault, or read as what it means.

use std::fs;
use std::sync::Arc;

use arrow_array::builder::{
    BooleanBuilder, FixedSizeListBuilder, Float32Builder, Int64Builder, LargeListBuilder, ListBuilder,
};
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int64Type};
use arrow_array::{
    Array, ArrayRef, BinaryArray, BooleanArray, Float32Array, Float64Array, Int32Array, Int64Array, StringArray,
    StructArray,
};
use arrow_schema::Field;
use re4_fault::Remedy as _;
use serde_json::{Value, json};

use super::support::{Contents, Copy, contents, named, of_columns, rows, samples, with_column, without};

const AV1: &str = "pusht-v3.0-video-av1";
const IMAGE: &str = "pusht-v3.0-image";
const MULTI: &str = "pusht-v3.0-multifile";
const OLD: &str = "pusht-v2.1-image";
const OLD_VIDEO: &str = "pusht-v2.1-video-h264";

const INFO: &str = "meta/info.json";
const DATA: &str = "data/chunk-000/file-000.parquet";
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";
const TASKS: &str = "meta/tasks.parquet";
const VIDEO: &str = "videos/observation.image/chunk-000/file-000.mp4";
const OLD_MP4: [&str; 2] = [
    "videos/chunk-000/observation.image/episode_000000.mp4",
    "videos/chunk-000/observation.image/episode_000001.mp4",
];
const OLD_DATA: [&str; 2] = [
    "data/chunk-000/episode_000000.parquet",
    "data/chunk-000/episode_000001.parquet",
];

/// What must come of a change.
enum Then {
    /// It is read like the original.
    Same,
    /// A fault names this file, and this object if it is not empty.
    Refused(&'static str, &'static str),
}

use Then::{Refused, Same};

/// A change of a sample: its name, the sample, the change and what must come of it.
type Case = (&'static str, &'static str, fn(&Copy), Then);

fn floats(array: &ArrayRef, change: impl Fn(usize, f64) -> f64) -> ArrayRef {
    let values = array.as_primitive::<Float64Type>();
    Arc::new(
        values
            .iter()
            .enumerate()
            .map(|(row, value)| value.map(|value| change(row, value)))
            .collect::<Float64Array>(),
    )
}

fn singles(array: &ArrayRef, change: impl Fn(usize, f32) -> f32) -> ArrayRef {
    let values = array.as_primitive::<Float32Type>();
    Arc::new(
        values
            .iter()
            .enumerate()
            .map(|(row, value)| value.map(|value| change(row, value)))
            .collect::<Float32Array>(),
    )
}

fn counts(array: &ArrayRef, change: impl Fn(usize, i64) -> i64) -> ArrayRef {
    let values = array.as_primitive::<Int64Type>();
    Arc::new(
        values
            .iter()
            .enumerate()
            .map(|(row, value)| value.map(|value| change(row, value)))
            .collect::<Int64Array>(),
    )
}

/// The pairs of a column of lists of two.
fn pairs(array: &ArrayRef) -> Vec<[f32; 2]> {
    let list = array.as_list::<i32>();
    let values = |row: usize| list.value(row).as_primitive::<Float32Type>().values().to_vec();
    (0..list.len()).map(|row| values(row).try_into().unwrap()).collect()
}

/// The struct column of images with other bytes.
fn images(array: &ArrayRef, change: impl Fn(usize, &[u8]) -> Option<Vec<u8>>) -> ArrayRef {
    let bytes = array.as_struct().column_by_name("bytes").unwrap().as_binary::<i32>();
    let bytes: BinaryArray = (0..bytes.len()).map(|row| change(row, bytes.value(row))).collect();
    let path: StringArray = (0..bytes.len()).map(|_| None::<&str>).collect();
    let field = |name: &str, array: &dyn Array| Arc::new(Field::new(name, array.data_type().clone(), true));
    Arc::new(StructArray::from(vec![
        (field("bytes", &bytes), Arc::new(bytes.clone()) as ArrayRef),
        (field("path", &path), Arc::new(path.clone()) as ArrayRef),
    ]))
}

fn replace(bytes: &mut [u8], from: &[u8], to: &[u8]) {
    let at = bytes.windows(from.len()).position(|window| window == from).unwrap();
    bytes[at..at + to.len()].copy_from_slice(to);
}

fn check(cases: Vec<Case>) {
    let Some(folder) = samples() else { return };
    let mut wrong = Vec::new();
    let mut originals: Vec<(&str, Contents)> = Vec::new();
    for (name, sample, change, then) in cases {
        if !originals.iter().any(|(known, _)| *known == sample) {
            originals.push((sample, contents(&folder.join(sample), true).unwrap()));
        }
        let original = &originals.iter().find(|(known, _)| *known == sample).unwrap().1;
        let copy = Copy::of(&folder.join(sample));
        change(&copy);
        let found = contents(copy.root(), true);
        let sentences = |faults: &[re4_lerobot::Fault]| {
            faults
                .iter()
                .map(|fault| fault.sentence())
                .collect::<Vec<_>>()
                .join("\n    ")
        };
        match (then, found) {
            (Same, Ok(found)) if found == *original => println!("{name}: read"),
            (Refused(file, object), Err(faults)) => {
                let names = |fault: &re4_lerobot::Fault| {
                    let of = fault.object.as_deref().unwrap_or_default();
                    fault.file == file && (object.is_empty() || of == object || of.ends_with(&format!(" {object}")))
                };
                println!("{name}: {}", sentences(&faults));
                let remedies = faults
                    .iter()
                    .all(|fault| !fault.fix.is_empty() && !fault.what.contains(';'));
                if !faults.iter().any(names) || !remedies {
                    wrong.push(format!(
                        "{name}: no fault names {file} {object}:\n    {}",
                        sentences(&faults)
                    ));
                }
            }
            (Same, Ok(_)) => wrong.push(format!("{name}: read with other contents")),
            (Same, Err(faults)) => wrong.push(format!("{name}: refused:\n    {}", sentences(&faults))),
            (Refused(..), Ok(found)) => {
                let how = if found == *original {
                    "like the original"
                } else {
                    "with other contents"
                };
                wrong.push(format!("{name}: read {how}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn statements_of_the_metadata() {
    check(vec![
        (
            "total_episodes too large",
            AV1,
            |c| c.set("total_episodes", json!(4)),
            Refused(INFO, "total_episodes"),
        ),
        (
            "total_frames wrong",
            AV1,
            |c| c.set("total_frames", json!(419)),
            Refused(INFO, "total_frames"),
        ),
        (
            "total_tasks wrong",
            AV1,
            |c| c.set("total_tasks", json!(2)),
            Refused(INFO, "total_tasks"),
        ),
        ("fps 10.0", AV1, |c| c.set("fps", json!(10.0)), Same),
        ("fps 12.5", AV1, |c| c.set("fps", json!(12.5)), Refused(VIDEO, "")),
        (
            "fps 12.5 without videos",
            IMAGE,
            |c| c.set("fps", json!(12.5)),
            Refused(DATA, "timestamp"),
        ),
        (
            "fps missing",
            AV1,
            |c| c.info(|map| drop(map.remove("fps"))),
            Refused(INFO, "fps"),
        ),
        ("fps is text", AV1, |c| c.set("fps", json!("10")), Refused(INFO, "fps")),
        ("version 3.0", AV1, |c| c.set("codebase_version", json!("3.0")), Same),
        ("version v3.1", AV1, |c| c.set("codebase_version", json!("v3.1")), Same),
        (
            "version v4.0",
            AV1,
            |c| c.set("codebase_version", json!("v4.0")),
            Refused(INFO, "codebase_version"),
        ),
        (
            "version missing",
            AV1,
            |c| c.info(|map| drop(map.remove("codebase_version"))),
            Same,
        ),
        (
            "v3.0 over files of v2",
            OLD,
            |c| c.set("codebase_version", json!("v3.0")),
            Same,
        ),
        (
            "v2.0",
            OLD,
            |c| {
                c.set("codebase_version", json!("v2.0"));
                c.remove("meta/episodes_stats.jsonl");
                fs::write(c.path("meta/stats.json"), "{\"action\": {\"min\": [NaN]}}").unwrap();
            },
            Same,
        ),
        (
            "only the keys without a default",
            AV1,
            |c| {
                c.info(|map| map.retain(|key, _| ["codebase_version", "fps", "features"].contains(&key)));
            },
            Same,
        ),
        (
            "unknown keys",
            AV1,
            |c| c.set("provenance", json!({"seed": [1, 2]})),
            Same,
        ),
        ("no statistics", AV1, |c| c.remove("meta/stats.json"), Same),
        (
            "splits beyond the data",
            AV1,
            |c| c.set("splits", json!({"train": "0:50"})),
            Same,
        ),
        (
            "names as an object",
            AV1,
            |c| c.set_feature("action", "names", json!({"axes": ["x", "y"]})),
            Same,
        ),
        (
            "names as a list of lists",
            AV1,
            |c| c.set_feature("action", "names", json!([["x", "y"]])),
            Same,
        ),
        (
            "codec stated wrongly",
            AV1,
            |c| c.set_feature("observation.image", "info", json!({"video.codec": "mp4v"})),
            Same,
        ),
        (
            "shape of images C,H,W",
            IMAGE,
            |c| c.set_feature("observation.image", "shape", json!([3, 96, 96])),
            Same,
        ),
        (
            "feature without a column",
            AV1,
            |c| {
                c.info(|map| map["features"]["ghost"] = json!({"dtype": "float32", "shape": [2]}));
            },
            Refused(DATA, "ghost"),
        ),
        (
            "wrong shape",
            AV1,
            |c| c.set_feature("action", "shape", json!([3])),
            Refused(DATA, "action"),
        ),
        (
            "wrong rank, same count",
            AV1,
            |c| c.set_feature("action", "shape", json!([1, 2])),
            Same,
        ),
        (
            "text for numbers",
            AV1,
            |c| c.set_feature("action", "dtype", json!("string")),
            Refused(DATA, "action"),
        ),
        (
            "unknown dtype",
            AV1,
            |c| c.set_feature("action", "dtype", json!("complex64")),
            Refused(INFO, "features.action.dtype"),
        ),
        (
            "dtype float64 for float32",
            AV1,
            |c| c.set_feature("action", "dtype", json!("float64")),
            Same,
        ),
        (
            "a slash in a name",
            AV1,
            |c| {
                c.info(|map| map["features"]["a/b"] = json!({"dtype": "float32", "shape": [2]}));
            },
            Refused(INFO, "features.a/b"),
        ),
        (
            "paths out of the dataset",
            AV1,
            |c| c.set("data_path", json!("../{file_index}.parquet")),
            Refused(INFO, "data_path"),
        ),
        (
            "not JSON",
            AV1,
            |c| c.bytes(INFO, |bytes| bytes.truncate(900)),
            Refused(INFO, ""),
        ),
        (
            "chunks_size of v2",
            OLD,
            |c| c.set("chunks_size", json!(2)),
            Refused("data/chunk-001/episode_000002.parquet", ""),
        ),
        (
            "several faults",
            AV1,
            |c| {
                c.set("total_frames", json!(1));
                c.remove(VIDEO);
            },
            Refused(INFO, "total_frames"),
        ),
        (
            "several faults, the other one",
            AV1,
            |c| {
                c.set("total_frames", json!(1));
                c.remove(VIDEO);
            },
            Refused(VIDEO, ""),
        ),
    ]);
}

#[test]
fn missing_and_stray_files() {
    check(vec![
        ("tasks missing", AV1, |c| c.remove(TASKS), Refused(TASKS, "")),
        ("video missing", AV1, |c| c.remove(VIDEO), Refused(VIDEO, "")),
        ("data missing", AV1, |c| c.remove(DATA), Refused(DATA, "")),
        ("episodes missing", AV1, |c| c.remove(EPISODES), Refused(EPISODES, "")),
        (
            "one of several files missing",
            MULTI,
            |c| c.remove("data/chunk-001/file-000.parquet"),
            Refused("data/chunk-001/file-000.parquet", ""),
        ),
        (
            "tasks of v2 missing",
            OLD,
            |c| c.remove("meta/tasks.jsonl"),
            Refused("meta/tasks.jsonl", ""),
        ),
        (
            "an episode of v2 missing",
            OLD,
            |c| c.remove(OLD_DATA[1]),
            Refused(OLD_DATA[1], ""),
        ),
        (
            "a video of v2 missing",
            OLD_VIDEO,
            |c| c.remove(OLD_MP4[1]),
            Refused(OLD_MP4[1], ""),
        ),
        (
            "stray data",
            AV1,
            |c| drop(fs::copy(c.path(DATA), c.path("data/chunk-000/file-001.parquet")).unwrap()),
            Refused("data/chunk-000/file-001.parquet", ""),
        ),
        (
            "stray video",
            AV1,
            |c| {
                drop(fs::copy(c.path(VIDEO), c.path("videos/observation.image/chunk-000/file-001.mp4")).unwrap());
            },
            Refused("videos/observation.image/chunk-000/file-001.mp4", ""),
        ),
        (
            "stray episodes",
            AV1,
            |c| {
                drop(fs::copy(c.path(EPISODES), c.path("meta/episodes/chunk-000/file-001.parquet")).unwrap());
            },
            Refused("meta/episodes/chunk-000/file-001.parquet", "meta/episodes/file_index"),
        ),
        (
            "stray episodes without their own place",
            AV1,
            |c| {
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("meta/")));
                drop(fs::copy(c.path(EPISODES), c.path("meta/episodes/chunk-000/file-001.parquet")).unwrap());
            },
            Refused("meta/episodes/chunk-000/file-001.parquet", "episode_index"),
        ),
        (
            "stray episode of v2",
            OLD,
            |c| {
                drop(fs::copy(c.path(OLD_DATA[0]), c.path("data/chunk-000/episode_000003.parquet")).unwrap());
            },
            Refused("data/chunk-000/episode_000003.parquet", ""),
        ),
        (
            "images of v2 beside the data",
            OLD,
            |c| {
                fs::create_dir_all(c.path("images/observation.image/episode_000000")).unwrap();
                fs::write(c.path("images/observation.image/episode_000000/frame_000000.png"), "").unwrap();
            },
            Same,
        ),
        (
            "data cut off",
            AV1,
            |c| c.bytes(DATA, |bytes| bytes.truncate(9000)),
            Refused(DATA, ""),
        ),
        ("data empty", AV1, |c| c.bytes(DATA, Vec::clear), Refused(DATA, "")),
        (
            "data is a placeholder",
            AV1,
            |c| {
                c.bytes(DATA, |bytes| {
                    *bytes = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n".to_vec()
                });
            },
            Refused(DATA, ""),
        ),
        (
            "video cut off",
            AV1,
            |c| c.bytes(VIDEO, |bytes| bytes.truncate(60_000)),
            Refused(VIDEO, ""),
        ),
        (
            "video without an index",
            AV1,
            |c| c.bytes(VIDEO, |bytes| replace(bytes, b"moov", b"free")),
            Refused(VIDEO, ""),
        ),
        (
            "video in MPEG-4 Part 2",
            AV1,
            |c| c.bytes(VIDEO, |bytes| replace(bytes, b"av01\0\0\0\0\0\0", b"mp4v")),
            Refused(VIDEO, ""),
        ),
        (
            "two videos swapped",
            OLD_VIDEO,
            |c| c.swap(OLD_MP4[0], OLD_MP4[1]),
            Refused(OLD_MP4[0], ""),
        ),
        (
            "two episodes swapped",
            OLD,
            |c| c.swap(OLD_DATA[0], OLD_DATA[1]),
            Refused(OLD_DATA[0], ""),
        ),
        (
            "two files of data swapped",
            MULTI,
            |c| c.swap(DATA, "data/chunk-000/file-001.parquet"),
            Refused(DATA, ""),
        ),
    ]);
}

#[test]
fn tables_of_episodes_and_tasks() {
    const FROM: &str = "videos/observation.image/from_timestamp";
    check(vec![
        (
            "no statistics of episodes",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("stats/"))),
            Same,
        ),
        (
            "no place in meta/episodes",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("meta/"))),
            Same,
        ),
        (
            "no place of the data",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("data/"))),
            Same,
        ),
        (
            "no place of the data in several files",
            MULTI,
            |c| {
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("data/")));
            },
            Same,
        ),
        (
            "half a place of the data",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name == "data/file_index")),
            Refused(EPISODES, "data/file_index"),
        ),
        (
            "no rows of the dataset",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("dataset_"))),
            Same,
        ),
        (
            "no place of the videos",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name.starts_with("videos/"))),
            Refused(EPISODES, "videos/observation.image/chunk_index"),
        ),
        (
            "no lengths",
            AV1,
            |c| c.table(EPISODES, |t| without(&t, |name| name == "length")),
            Refused(EPISODES, "length"),
        ),
        (
            "own columns",
            AV1,
            |c| {
                c.table(EPISODES, |t| {
                    with_column(&t, "re4/seed", Arc::new(Int64Array::from(vec![1, 2, 3])))
                });
            },
            Same,
        ),
        (
            "columns in another order",
            AV1,
            |c| c.table(EPISODES, |t| of_columns(named(&t).into_iter().rev().collect())),
            Same,
        ),
        (
            "episodes in another order",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[2, 0, 1])),
            Same,
        ),
        (
            "an episode not listed",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[0, 2])),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "the last episode not listed",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[0, 1])),
            Refused(INFO, "total_episodes"),
        ),
        (
            "an episode listed twice",
            AV1,
            |c| c.table(EPISODES, |t| rows(&t, &[0, 1, 1, 2])),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "episodes from 1",
            AV1,
            |c| c.column(EPISODES, "episode_index", |a| counts(a, |_, v| v + 1)),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "a negative episode",
            AV1,
            |c| c.column(EPISODES, "episode_index", |a| counts(a, |_, v| v - 1)),
            Refused(EPISODES, "episode_index"),
        ),
        (
            "a length wrong",
            AV1,
            |c| c.column(EPISODES, "length", |a| counts(a, |row, v| v + i64::from(row == 1))),
            Refused(EPISODES, "dataset_to_index"),
        ),
        (
            "two lengths wrong, the same sum",
            AV1,
            |c| {
                c.column(EPISODES, "length", |a| counts(a, |row, v| v + [1, -1, 0][row]));
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("dataset_")));
            },
            Refused(EPISODES, FROM),
        ),
        (
            "two lengths wrong without videos",
            IMAGE,
            |c| {
                c.column(EPISODES, "length", |a| counts(a, |row, v| v + [1, -1, 0][row]));
                c.table(EPISODES, |t| without(&t, |name| name.starts_with("dataset_")));
            },
            Refused(DATA, "episode_index"),
        ),
        (
            "a huge length",
            IMAGE,
            |c| {
                c.column(EPISODES, "length", |a| {
                    counts(a, |row, v| if row == 1 { i64::MAX } else { v })
                });
            },
            Refused(DATA, ""),
        ),
        (
            "an empty episode",
            IMAGE,
            |c| c.column(EPISODES, "length", |a| counts(a, |row, v| if row == 1 { 0 } else { v })),
            Refused(EPISODES, "length"),
        ),
        (
            "dataset_from_index wrong",
            AV1,
            |c| c.column(EPISODES, "dataset_from_index", |a| counts(a, |row, v| v + row as i64)),
            Refused(EPISODES, "dataset_from_index"),
        ),
        (
            "data/file_index wrong",
            AV1,
            |c| c.column(EPISODES, "data/file_index", |a| counts(a, |_, _| 7)),
            Refused("data/chunk-000/file-007.parquet", ""),
        ),
        (
            "data/chunk_index wrong",
            AV1,
            |c| {
                c.column(EPISODES, "data/chunk_index", |a| {
                    counts(a, |row, v| v + i64::from(row == 2))
                })
            },
            Refused("data/chunk-001/file-000.parquet", ""),
        ),
        (
            "file_index of a video wrong",
            AV1,
            |c| {
                c.column(EPISODES, "videos/observation.image/file_index", |a| counts(a, |_, _| 1));
            },
            Refused("videos/observation.image/chunk-000/file-001.mp4", ""),
        ),
        (
            "files of two videos swapped",
            MULTI,
            |c| {
                c.column(EPISODES, "videos/observation.image/file_index", |a| {
                    counts(a, |row, _| [1, 0, 0][row])
                });
            },
            Refused("videos/observation.image/chunk-000/file-001.mp4", ""),
        ),
        (
            "from_timestamp off by 5e-5",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |_, v| v + 5e-5)),
            Same,
        ),
        (
            "from_timestamp off by 2e-4",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |_, v| v + 2e-4)),
            Refused(EPISODES, FROM),
        ),
        (
            "from_timestamp swapped",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |row, v| [16.1, 0.0, v][row])),
            Refused(EPISODES, FROM),
        ),
        (
            "from_timestamp not a number",
            AV1,
            |c| c.column(EPISODES, FROM, |a| floats(a, |_, _| f64::NAN)),
            Refused(EPISODES, FROM),
        ),
        (
            "to_timestamp off by a frame",
            AV1,
            |c| {
                c.column(EPISODES, "videos/observation.image/to_timestamp", |a| {
                    floats(a, |row, v| v + [0.0, 0.1, 0.0][row])
                });
            },
            Refused(EPISODES, "videos/observation.image/to_timestamp"),
        ),
        (
            "tasks without the metadata of pandas",
            AV1,
            |c| c.table(TASKS, |t| t),
            Same,
        ),
        (
            "tasks under the name of an index",
            AV1,
            |c| {
                c.table(TASKS, |t| {
                    of_columns(
                        named(&t)
                            .into_iter()
                            .map(|(name, array)| {
                                (
                                    if name == "task" {
                                        "__index_level_0__".to_owned()
                                    } else {
                                        name
                                    },
                                    array,
                                )
                            })
                            .collect(),
                    )
                });
            },
            Same,
        ),
        (
            "another task",
            AV1,
            |c| c.column(TASKS, "task", |_| Arc::new(StringArray::from(vec!["Pull it."]))),
            Refused(DATA, "task_index"),
        ),
        (
            "tasks numbered from 1",
            AV1,
            |c| c.column(TASKS, "task_index", |a| counts(a, |_, v| v + 1)),
            Refused(DATA, "task_index"),
        ),
        (
            "tasks without numbers",
            AV1,
            |c| c.table(TASKS, |t| without(&t, |name| name == "task_index")),
            Refused(TASKS, "task_index"),
        ),
        (
            "a line of v2 missing",
            OLD,
            |c| c.lines("meta/episodes.jsonl", |lines| drop(lines.remove(1))),
            Refused("meta/episodes.jsonl", "episode_index"),
        ),
        (
            "a line of v2 broken",
            OLD,
            |c| c.lines("meta/episodes.jsonl", |lines| lines[1].truncate(20)),
            Refused("meta/episodes.jsonl", "2"),
        ),
        (
            "a length of v2 wrong",
            OLD,
            |c| {
                c.lines("meta/episodes.jsonl", |lines| lines[1] = lines[1].replace("118", "117"));
            },
            Refused(OLD_DATA[1], ""),
        ),
        (
            "a length of v2 missing",
            OLD,
            |c| {
                c.lines("meta/episodes.jsonl", |lines| {
                    lines[1] = lines[1].replace("\"length\"", "\"frames\"")
                });
            },
            Refused("meta/episodes.jsonl", "length"),
        ),
        (
            "lines of v2 in another order",
            OLD,
            |c| c.lines("meta/episodes.jsonl", |lines| lines.reverse()),
            Same,
        ),
        (
            "a task of v2 twice",
            OLD,
            |c| c.lines("meta/tasks.jsonl", |lines| lines.push(lines[0].clone())),
            Refused("meta/tasks.jsonl", "task_index"),
        ),
    ]);
}

fn lists(array: &ArrayRef, kind: &str) -> ArrayRef {
    let all = pairs(array);
    match kind {
        "fixed" => {
            let mut builder = FixedSizeListBuilder::new(Float32Builder::new(), 2);
            for pair in all {
                builder.values().append_slice(&pair);
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        "large" => {
            let mut builder = LargeListBuilder::new(Float32Builder::new());
            for pair in all {
                builder.values().append_slice(&pair);
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        // One row has one value, and the next one three.
        "ragged" => {
            let mut builder = ListBuilder::new(Float32Builder::new());
            for (row, pair) in all.into_iter().enumerate() {
                let count = [1, 3].get(row).copied().unwrap_or(2);
                builder.values().append_slice(&[pair[0], pair[1], pair[1]][..count]);
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        // A value is missing in row 200.
        "null" => {
            let mut builder = ListBuilder::new(Float32Builder::new());
            for (row, pair) in all.into_iter().enumerate() {
                builder.values().append_value(pair[0]);
                builder.values().append_option((row != 200).then_some(pair[1]));
                builder.append(true);
            }
            Arc::new(builder.finish())
        }
        _ => panic!("{kind}"),
    }
}

#[test]
fn columns_of_the_data() {
    check(vec![
        (
            "undeclared column",
            AV1,
            |c| {
                c.table(DATA, |t| {
                    with_column(&t, "extra", Arc::new(Int64Array::from(vec![0; 420])))
                });
            },
            Refused(DATA, "extra"),
        ),
        (
            "a feature removed from the metadata",
            AV1,
            |c| {
                c.info(|map| {
                    drop(map["features"].as_object_mut().unwrap().remove("action"));
                })
            },
            Refused(DATA, "action"),
        ),
        (
            "the index of pandas",
            AV1,
            |c| {
                c.table(DATA, |t| {
                    with_column(&t, "__index_level_0__", Arc::new(Int64Array::from_iter_values(0..420)))
                });
            },
            Same,
        ),
        (
            "a column missing",
            AV1,
            |c| c.table(DATA, |t| without(&t, |name| name == "action")),
            Refused(DATA, "action"),
        ),
        (
            "frame_index missing",
            AV1,
            |c| c.table(DATA, |t| without(&t, |name| name == "frame_index")),
            Refused(DATA, "frame_index"),
        ),
        (
            "columns in another order",
            AV1,
            |c| c.table(DATA, |t| of_columns(named(&t).into_iter().rev().collect())),
            Same,
        ),
        ("zstd, one row group, no metadata", AV1, |c| c.table(DATA, |t| t), Same),
        (
            "fixed-size lists",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "fixed")),
            Same,
        ),
        (
            "large lists",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "large")),
            Same,
        ),
        (
            "ragged lists",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "ragged")),
            Refused(DATA, "action"),
        ),
        (
            "a missing value",
            AV1,
            |c| c.column(DATA, "action", |a| lists(a, "null")),
            Refused(DATA, "action"),
        ),
        (
            "timestamps in double precision",
            AV1,
            |c| {
                c.column(DATA, "timestamp", |a| {
                    let singles = a.as_primitive::<Float32Type>();
                    Arc::new(singles.iter().map(|time| time.map(f64::from)).collect::<Float64Array>())
                })
            },
            Same,
        ),
        (
            "indices of 32 bits",
            AV1,
            |c| {
                c.column(DATA, "frame_index", |a| {
                    let values = a.as_primitive::<Int64Type>();
                    Arc::new(
                        values
                            .iter()
                            .map(|value| value.map(|value| value as i32))
                            .collect::<Int32Array>(),
                    )
                })
            },
            Same,
        ),
        (
            "indices as floating point",
            AV1,
            |c| {
                c.column(DATA, "index", |a| {
                    let values = a.as_primitive::<Int64Type>();
                    Arc::new(
                        values
                            .iter()
                            .map(|value| value.map(|value| value as f64))
                            .collect::<Float64Array>(),
                    )
                })
            },
            Same,
        ),
        (
            "a scalar as a list of one",
            AV1,
            |c| {
                c.column(DATA, "next.done", |a| {
                    let mut builder = ListBuilder::new(BooleanBuilder::new());
                    for value in a.as_boolean() {
                        builder.values().append_option(value);
                        builder.append(true);
                    }
                    Arc::new(builder.finish())
                })
            },
            Same,
        ),
        (
            "an index as a list of one",
            AV1,
            |c| {
                c.column(DATA, "index", |a| {
                    let mut builder = ListBuilder::new(Int64Builder::new());
                    for value in a.as_primitive::<Int64Type>() {
                        builder.values().append_option(value);
                        builder.append(true);
                    }
                    Arc::new(builder.finish())
                })
            },
            Same,
        ),
        (
            "a scalar for two values",
            AV1,
            |c| c.column(DATA, "action", |_| Arc::new(Float32Array::from(vec![1.0; 420]))),
            Refused(DATA, "action"),
        ),
        (
            "index from 1000",
            AV1,
            |c| c.column(DATA, "index", |a| counts(a, |_, v| v + 1000)),
            Refused(DATA, "index"),
        ),
        (
            "frame_index off by one",
            AV1,
            |c| c.column(DATA, "frame_index", |a| counts(a, |row, v| v + i64::from(row > 170))),
            Refused(DATA, "frame_index"),
        ),
        (
            "episode_index wrong in a row",
            AV1,
            |c| c.column(DATA, "episode_index", |a| counts(a, |row, v| v + i64::from(row == 160))),
            Refused(DATA, "episode_index"),
        ),
        (
            "an unknown task",
            AV1,
            |c| c.column(DATA, "task_index", |a| counts(a, |_, _| 3)),
            Refused(DATA, "task_index"),
        ),
        (
            "a negative task",
            AV1,
            |c| c.column(DATA, "task_index", |a| counts(a, |row, _| -i64::from(row == 9))),
            Refused(DATA, "task_index"),
        ),
        (
            "timestamps shifted",
            AV1,
            |c| c.column(DATA, "timestamp", |a| singles(a, |_, v| v + 0.05)),
            Refused(DATA, "timestamp"),
        ),
        (
            "a timestamp not a number",
            AV1,
            |c| {
                c.column(DATA, "timestamp", |a| {
                    singles(a, |row, v| if row == 300 { f32::NAN } else { v })
                })
            },
            Refused(DATA, "timestamp"),
        ),
        (
            "timestamps by the wall clock",
            AV1,
            |c| {
                c.column(DATA, "timestamp", |a| {
                    singles(a, |row, v| v * 1.001 + row as f32 * 1e-4)
                })
            },
            Refused(DATA, "timestamp"),
        ),
        (
            "the last row missing",
            AV1,
            |c| c.table(DATA, |t| t.slice(0, 419)),
            Refused(DATA, ""),
        ),
        (
            "a row twice",
            AV1,
            |c| {
                let order: Vec<usize> = (0..420).map(|row| if row == 50 { 49 } else { row }).collect();
                c.table(DATA, |t| rows(&t, &order));
            },
            Refused(DATA, "frame_index"),
        ),
        (
            "two rows swapped",
            AV1,
            |c| {
                let order: Vec<usize> = (0..420)
                    .map(|row| match row {
                        50 => 51,
                        51 => 50,
                        row => row,
                    })
                    .collect();
                c.table(DATA, |t| rows(&t, &order));
            },
            Refused(DATA, "index"),
        ),
        (
            "two episodes swapped",
            AV1,
            |c| {
                let order: Vec<usize> = (161..279).chain(0..161).chain(279..420).collect();
                c.table(DATA, |t| rows(&t, &order));
            },
            Refused(DATA, "episode_index"),
        ),
        (
            "true and false as numbers",
            AV1,
            |c| {
                c.column(DATA, "next.done", |a| {
                    Arc::new(
                        a.as_boolean()
                            .iter()
                            .map(|value| value.map(i64::from))
                            .collect::<Int64Array>(),
                    )
                })
            },
            Same,
        ),
        (
            "text for true and false",
            AV1,
            |c| c.column(DATA, "next.done", |_| Arc::new(StringArray::from(vec!["no"; 420]))),
            Refused(DATA, "next.done"),
        ),
        (
            "numbers for images",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |_| {
                    Arc::new(BooleanArray::from(vec![true; 420]))
                })
            },
            Refused(DATA, "observation.image"),
        ),
    ]);
}

#[test]
fn images_in_the_data() {
    check(vec![
        (
            "paths missing",
            IMAGE,
            |c| c.column(DATA, "observation.image", |a| images(a, |_, png| Some(png.to_vec()))),
            Same,
        ),
        (
            "plain binary values",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    Arc::clone(a.as_struct().column_by_name("bytes").unwrap())
                })
            },
            Same,
        ),
        (
            "an image missing",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| (row != 300).then(|| png.to_vec()))
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "an image cut off",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| {
                        Some(png[..if row == 7 { 500 } else { png.len() }].to_vec())
                    })
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "a byte of an image changed",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| {
                        let mut png = png.to_vec();
                        if row == 419 {
                            png[300] ^= 1;
                        }
                        Some(png)
                    })
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "JPEG",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |_, _| Some(vec![0xff, 0xd8, 0xff, 0xe0, 0, 16]))
                });
            },
            Refused(DATA, "observation.image"),
        ),
        (
            "an image of another size",
            IMAGE,
            |c| {
                c.column(DATA, "observation.image", |a| {
                    images(a, |row, png| {
                        let mut small = Vec::new();
                        let image = image::RgbImage::new(8, 8);
                        image
                            .write_to(&mut std::io::Cursor::new(&mut small), image::ImageFormat::Png)
                            .unwrap();
                        Some(if row == 200 { small } else { png.to_vec() })
                    })
                });
            },
            Refused(DATA, "observation.image"),
        ),
    ]);
}

/// Wrong statements about depth make no camera; what is wrong with a video that is not read does not matter.
#[test]
fn depth_cameras_are_skipped_and_refused_by_name() {
    let Some(folder) = samples() else { return };
    let copy = Copy::of(&folder.join(AV1));
    let depth = |key: &str| json!({ key: Value::Bool(true) });
    for key in ["is_depth_map", "video.is_depth_map"] {
        copy.set_feature("observation.image", "info", depth(key));
        let open = |cameras| re4_lerobot::Dataset::open(copy.root(), &cameras, &|| false);
        let dataset = open(re4_lerobot::Cameras::All).ok().unwrap();
        assert!(dataset.cameras().is_empty());
        assert_eq!(dataset.notes(), ["observation.image is a depth camera and is not read"]);
        let named = open(re4_lerobot::Cameras::Named(vec!["observation.image".to_owned()]));
        let text = named.err().unwrap().faults.to_string();
        assert!(
            text.starts_with("meta/info.json, key features.observation.image: depth images cannot be read;"),
            "{text}"
        );
    }
}

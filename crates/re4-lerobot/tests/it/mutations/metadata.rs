//! Statements of `meta/info.json`.

use std::fs;

use re4_lerobot::{Cameras, Dataset};
use serde_json::{Value, json};

use super::{AV1, Copy, DATA, IMAGE, INFO, OLD, Refused, Same, VIDEO, check, samples};

#[test]
fn statements_of_the_metadata() {
    check(&[
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
                c.info(|map| map.retain(|key, _| ["codebase_version", "fps", "features"].contains(&key.as_str())));
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

/// A depth camera is skipped with a note, and refused if it is named.
#[test]
fn depth_cameras_are_skipped_and_refused_by_name() {
    let Some(folder) = samples() else { return };
    let copy = Copy::of(&folder.join(AV1));
    let depth = |key: &str| json!({ key: Value::Bool(true) });
    for key in ["is_depth_map", "video.is_depth_map"] {
        copy.set_feature("observation.image", "info", depth(key));
        let open = |cameras| Dataset::open(copy.root(), &cameras, &|| false);
        let dataset = open(Cameras::All).ok().unwrap();
        assert!(dataset.cameras().is_empty());
        assert_eq!(dataset.notes(), ["observation.image is a depth camera and is not read"]);
        let named = open(Cameras::Named(vec!["observation.image".to_owned()]));
        let text = named.err().unwrap().faults.to_string();
        assert!(
            text.starts_with("meta/info.json, key features.observation.image: depth images cannot be read;"),
            "{text}"
        );
    }
}

//! LeRobot datasets end to end: ingest in the worker process, and `inspect` of every kind of dataset. The parts on samples are skipped
//! if they are not below `RE4_DATA`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use re4_artifact::{Artifact, Stage};
use re4_ingest::{Convention, ImageRow};
use serde_json::Value;

use crate::support::{Answer, Gate, Place, artifact_bytes, assert_same_bytes, real_data, repository};

const PIPELINE: &str = r#"
task = "pusht"

[ingest]
source = "set"

[segment]
rule = "always_transit"
"#;

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// A place with a copy of a sample at `data/set`, and `lerobot.toml`.
fn place(sample: &str) -> Option<Place> {
    let folder = real_data()?.join("lerobot").join(sample);
    if !folder.is_dir() {
        println!("skipped: no {}", folder.display());
        return None;
    }
    let place = Place::empty();
    copy_folder(&folder, &place.path().join("data/set"));
    place.write("lerobot.toml", PIPELINE);
    Some(place)
}

fn set(place: &Place, name: &str) -> PathBuf {
    place.path().join("data/set").join(name)
}

fn episodes(place: &Place) -> Artifact {
    place.artifact(Stage::Ingest)
}

#[test]
fn a_dataset_is_ingested_and_segmented() {
    let Some(place) = place("pusht-v3.0-multifile") else {
        return;
    };
    let answer = place.run("segment lerobot.toml --json --quiet").done();
    assert!(answer.json()["summary"].is_object(), "{}", answer.stdout);
    let artifact = episodes(&place);
    let summary = &artifact.manifest().summary;
    assert_eq!(
        (summary["episodes"].as_u64(), summary["images"].as_u64()),
        (Some(3), Some(420))
    );
    let coding = &summary["image_coding"]["img"];
    assert_eq!(
        (
            coding["codec"].as_str(),
            coding["lossy"].as_bool(),
            coding["rgb"].as_str()
        ),
        (Some("AV1"), Some(true), Some("BT.601, limited range, nearest chroma"))
    );
    let rows: Vec<Convention> = artifact.read().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| &*row.convention.0).collect();
    assert_eq!(names, ["object_pose", "reward", "action_kind"]);
    let images: Vec<ImageRow> = artifact.read().unwrap();
    assert!(
        images
            .iter()
            .all(|row| row.camera.as_ref().is_some_and(|camera| &*camera.0 == "img"))
    );
    // The same bytes with another number of threads, and nothing is made again.
    let bytes = artifact_bytes(&place.artifacts());
    let again = place.run("ingest lerobot.toml --jobs 1").done();
    assert!(again.stderr.contains("unchanged, skipped"), "{}", again.stderr);
    fs::remove_dir_all(place.artifacts()).unwrap();
    place.run("segment lerobot.toml --jobs 1").done();
    assert_same_bytes(&bytes, &artifact_bytes(&place.artifacts()));
}

#[test]
fn all_faults_of_a_dataset_are_reported_at_once() {
    let Some(place) = place("pusht-v2.1-video-av1") else {
        return;
    };
    fs::remove_file(set(&place, "data/chunk-000/episode_000001.parquet")).unwrap();
    let video = set(&place, "videos/chunk-000/observation.image/episode_000002.mp4");
    let bytes = fs::read(&video).unwrap();
    fs::write(&video, &bytes[..bytes.len() / 2]).unwrap();
    for command in ["ingest lerobot.toml", "inspect data/set"] {
        let error = place.run(command).refused_at_once();
        for part in ["data/chunk-000/episode_000001.parquet", "episode_000002.mp4"] {
            assert!(error.contains(part), "{command}: {error}");
        }
    }
    assert!(place.temporaries().is_empty());
    // Settings that do not fit.
    let error = place
        .run("ingest lerobot.toml --set ingest.filter=val")
        .refused_at_once();
    assert!(error.contains("episode_000001.parquet"), "{error}");
}

#[test]
fn settings_that_do_not_fit_are_refused() {
    let Some(place) = place("pusht-v3.0-image") else { return };
    let mut errors = Vec::new();
    for change in [
        "ingest.filter=val",
        "ingest.lerobot.state=agent",
        "ingest.lerobot.image=top",
        "ingest.lerobot.keypoint=a",
        "ingest.lerobot.gripper=[\"a\"]",
        "ingest.render=[\"image\"]",
        "task=can",
    ] {
        let error = place
            .run_each(&["ingest", "lerobot.toml", "--set", change])
            .refused_at_once();
        errors.push(format!("{change}: {error}"));
    }
    insta::assert_snapshot!(errors.join("\n"));
    let error = Place::new()
        .run("ingest small.toml --set ingest.lerobot.state=a")
        .refused_at_once();
    assert!(error.contains("applies only to LeRobot datasets; remove it"), "{error}");
}

#[test]
fn a_worker_that_ends_or_hangs_is_one_sentence() {
    let Some(place) = place("pusht-v3.0-image") else { return };
    let begin = |place: &Place| {
        let mut command = place.command();
        command
            .args(["ingest", "lerobot.toml", "--quiet"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let gate = Gate::before(&mut command, place, 1);
        (command, gate)
    };
    for (name, words) in [("KILL", "was killed (signal 9)"), ("SEGV", "crashed (signal 11)")] {
        let (mut command, gate) = begin(&place);
        let mut child = command.spawn().unwrap();
        gate.wait(&mut child).end_by(name);
        let error = Answer::new(&child.wait_with_output().unwrap(), place.path());
        // After a crash, a second worker reads cautiously and, here, finds nothing.
        if name == "KILL" {
            let error = error.refused_at_once();
            assert!(error.contains(words), "{error}");
        }
        assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
        let _ = fs::remove_dir_all(place.artifacts());
    }
    let (mut command, _gate) = begin(&place);
    let output = command.env("RE4_WORKER_PATIENCE", "1").output().unwrap();
    let error = Answer::new(&output, place.path()).refused_at_once();
    assert!(
        error.contains("the decoder of tables, images and videos made no progress for 1 s"),
        "{error}"
    );
}

#[test]
fn inspect_says_what_a_dataset_is() {
    let place = Place::new();
    let can = repository().join("data/can-sample.hdf5");
    let mut sets = vec![("zarr", place.dataset(), "pusht", true), ("hdf5", can, "can", true)];
    if let Some(data) = real_data().filter(|data| data.join("lerobot").is_dir()) {
        sets.push(("LeRobot v3.0", data.join("lerobot/pusht-v3.0-keypoints"), "pusht", true));
        sets.push((
            "LeRobot v2.1",
            data.join("lerobot/pusht-v2.1-video-h264"),
            "pusht",
            false,
        ));
    }
    for (format, path, task, poses) in sets {
        let path = path.to_str().unwrap();
        let text = place.run_each(&["inspect", path]).done().stdout;
        assert!(text.starts_with(format), "{text}");
        let about = place.run_each(&["inspect", path, "--json"]).done().json();
        let about = &about["dataset"];
        assert_eq!(about["task"], task, "{about}");
        let uses = about["uses"].as_array().unwrap();
        let commands: Vec<&str> = uses.iter().map(|each| each["command"].as_str().unwrap()).collect();
        assert_eq!(commands, ["audit", "segment", "index", "rollout"], "{about}");
        let possible: Vec<bool> = uses.iter().map(|each| each["possible"] == Value::Bool(true)).collect();
        // The demonstrations of the HDF5 sample have no models; without corners, the audit is that of an arm.
        let expected = match (format, poses) {
            ("hdf5", _) => [true, true, true, false],
            _ => [true; 4],
        };
        assert_eq!(possible, expected, "{about}");
        let audit = uses[0]["how"].as_str().unwrap();
        assert_eq!(audit.starts_with("task = \"arm\", "), !poses, "{about}");
        let refused = place.run_each(&["inspect", path, "--rows", "3"]).refused_at_once();
        assert!(
            refused.contains("it is a dataset, not an artifact; ingest it"),
            "{refused}"
        );
    }
}

#[test]
fn inspect_refuses_damaged_datasets_with_one_sentence() {
    let place = Place::new();
    place.write("data/short.hdf5", b"\x89HDF\r\n\x1a\n");
    place.write("data/text.h5", "no data");
    fs::create_dir_all(place.path().join("data/odd/meta")).unwrap();
    place.write("data/odd/meta/info.json", "{");
    fs::write(place.dataset().join("data/state/.zarray"), "{").unwrap();
    for name in ["short.hdf5", "text.h5", "odd", "small.zarr"] {
        let error = place.run(&format!("inspect data/{name}")).refused_at_once();
        assert!(error.contains("; "), "{name}: {error}");
    }
}

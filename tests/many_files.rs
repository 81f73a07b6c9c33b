//! Datasets of several HDF5 files: the frames of one file, the same bytes for any number of processes, and errors that name files.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{PROGRAM, Place, repository};
use re4_artifact::Artifact;
use re4_ingest::DemoRow;
use serde_json::Value;

/// Three parts of 256 demonstrations, the last one short.
const DEMOS: usize = 600;

/// Demonstrations in the files of `tests/make_split.py`.
const IN_FILES: [(&str, usize); 3] = [("a", 7), ("b", 294), ("c", 299)];

/// A folder with one file, the same in three, and changed copies; `None` without Python.
fn split() -> Option<Place> {
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
        return None;
    };
    let place = Place::empty();
    let data = place.path().join("data");
    let script = |name: &str, arguments: &[PathBuf], count: &[String]| {
        let status = Command::new(&python)
            .arg(repository().join("tests").join(name))
            .args(arguments)
            .args(count)
            .status()
            .unwrap();
        assert!(status.success());
    };
    let sample = repository().join("data/can-sample.hdf5");
    script("make_many.py", &[sample, data.clone()], &[DEMOS.to_string()]);
    script("make_split.py", &[data.join("many.hdf5"), data.clone()], &[]);
    pipeline(&place, "one", "\"many.hdf5\"", "");
    pipeline(&place, "split", "\"split\"", "");
    Some(place)
}

/// Writes a pipeline file whose source is this TOML value.
fn pipeline(place: &Place, name: &str, source: &str, more: &str) {
    let text = format!(
        "task = \"can\"\nvariant = \"state\"\n[ingest]\nsource = {source}\n{more}\n[segment]\n[index]\n[pose]\nsource = \"recorded\"\n\
         [policy]\nkind = \"paper\"\n[rollout]\nseeds = \"0..300\"\n"
    );
    place.write(&format!("{name}.toml"), text);
}

/// Runs the program with its artifacts in a folder of this name. Returns its exit code and its output with errors.
fn run(place: &Place, artifacts: &str, library: bool, arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new(PROGRAM);
    if library {
        command.env("RE4_HDF5", "library");
    }
    let output = command
        .current_dir(place.path())
        .args(arguments)
        .args(["--artifacts", artifacts, "--quiet"])
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code().unwrap(), String::from_utf8(text).unwrap())
}

fn succeeds(place: &Place, artifacts: &str, arguments: &[&str]) -> String {
    let (code, text) = run(place, artifacts, false, arguments);
    assert_eq!(code, 0, "{arguments:?}: {text}");
    text
}

/// The error of an ingest, for both readers.
fn refused(place: &Place, source: &str, more: &str) -> String {
    pipeline(place, "refused", source, more);
    let errors = [false, true].map(|library| {
        let (code, text) = run(place, "refused", library, &["ingest", "refused.toml"]);
        assert_eq!(code, 2, "{source}: {text}");
        text
    });
    assert_eq!(errors[0], errors[1]);
    errors[0].clone()
}

/// All files below a folder that end so, by their paths.
fn tree(root: &Path, end: &str) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(root).unwrap().to_path_buf();
            if path.is_dir() {
                folders.push(path);
            } else if !name.starts_with("runs") && path.to_string_lossy().ends_with(end) {
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn assert_same(place: &Place, one: &str, other: &str) {
    let [one, other] = [one, other].map(|name| tree(&place.path().join(name), ""));
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    let differing: Vec<_> = one.keys().filter(|path| one[*path] != other[*path]).collect();
    assert!(differing.is_empty(), "{differing:?}");
}

/// Folder of the only artifact of this kind.
fn only(place: &Place, artifacts: &str, kind: &str) -> PathBuf {
    let mut all = fs::read_dir(place.path().join(artifacts).join(kind)).unwrap();
    let path = all.next().unwrap().unwrap().path();
    assert!(all.next().is_none());
    path
}

fn names(place: &Place, artifacts: &str) -> Vec<String> {
    let artifact = Artifact::open(&only(place, artifacts, "episodes")).unwrap();
    let rows: Vec<DemoRow> = artifact.read().unwrap();
    rows.into_iter().map(|row| row.demo).collect()
}

#[test]
fn several_files_have_the_tables_of_one() {
    let Some(place) = split() else { return };
    for name in ["one", "split"] {
        succeeds(&place, name, &["index", &format!("{name}.toml")]);
    }
    let mut compared = 0;
    for kind in ["episodes", "modes", "index"] {
        let [one, split] = ["one", "split"].map(|name| tree(&only(&place, name, kind), ".parquet"));
        assert_eq!(one.keys().collect::<Vec<_>>(), split.keys().collect::<Vec<_>>());
        for (path, bytes) in &one {
            // Tables with the names and numbers of demonstrations in their files.
            if !["demos.parquet", "episodes.parquet"].contains(&path.file_name().unwrap().to_str().unwrap()) {
                assert!(split[path] == *bytes, "{kind}: {}", path.display());
                compared += 1;
            }
        }
    }
    assert!(compared > 12, "{compared}");
    let expected: Vec<String> = IN_FILES
        .iter()
        .flat_map(|(file, count)| (0..*count).map(move |number| format!("{file}/demo_{number}")))
        .collect();
    assert_eq!(names(&place, "split"), expected);

    // A list of the same files, and one file in a list.
    pipeline(
        &place,
        "list",
        "[\"split/a.hdf5\", \"split/b.hdf5\", \"split/c.hdf5\"]",
        "",
    );
    pipeline(&place, "single", "[\"many.hdf5\"]", "");
    for (name, same) in [("list", "split"), ("single", "one")] {
        succeeds(&place, name, &["ingest", &format!("{name}.toml")]);
        assert_eq!(
            only(&place, name, "episodes").file_name(),
            only(&place, same, "episodes").file_name()
        );
    }
    // Another order is another dataset, and another folder is the same one.
    pipeline(
        &place,
        "order",
        "[\"split/a.hdf5\", \"split/c.hdf5\", \"split/b.hdf5\"]",
        "",
    );
    succeeds(&place, "order", &["ingest", "order.toml"]);
    assert_ne!(
        only(&place, "order", "episodes").file_name(),
        only(&place, "split", "episodes").file_name()
    );
    fs::rename(place.path().join("data/split"), place.path().join("data/moved")).unwrap();
    pipeline(&place, "moved", "\"moved\"", "");
    let text = succeeds(&place, "split", &["ingest", "moved.toml"]);
    assert_eq!(
        tree(&place.path().join("split/episodes"), "manifest.json").len(),
        1,
        "{text}"
    );
}

#[test]
fn shares_of_several_files_have_the_bytes_of_one_process() {
    let Some(place) = split() else { return };
    succeeds(&place, "whole", &["ingest", "split.toml"]);
    for share in ["2/3", "0/3", "1/3"] {
        succeeds(&place, "shares", &["ingest", "split.toml", "--shard", share]);
    }
    succeeds(&place, "shares", &["merge", "ingest", "split.toml"]);
    assert_same(&place, "whole", "shares");
    let (code, text) = run(&place, "library", true, &["ingest", "split.toml"]);
    assert_eq!(code, 0, "{text}");
    assert_same(&place, "whole", "library");

    // With a plan, a task reads only the files of its demonstrations and those on which conventions are proven.
    let plan = succeeds(&place, "planned", &["plan", "split.toml", "--shards", "3", "--json"]);
    place.write("plan.json", plan.clone());
    let plan: Value = serde_json::from_str(&plan).unwrap();
    let counts = |plan: &Value| -> Vec<Value> {
        let files = plan["sources"].as_array().unwrap().iter();
        files.map(|file| file["surveyed"]["demonstrations"].clone()).collect()
    };
    assert_eq!(counts(&plan), [7, 294, 299]);
    let (code, text) = run(
        &place,
        "planned-library",
        true,
        &["plan", "split.toml", "--shards", "3", "--json"],
    );
    assert_eq!(code, 0, "{text}");
    let with_library: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(with_library["sources"], plan["sources"]);
    let path = place.path().join("data/split/c.hdf5");
    let bytes = fs::read(&path).unwrap();
    let time = fs::metadata(&path).unwrap().modified().unwrap();
    let write = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        fs::File::options()
            .append(true)
            .open(&path)
            .unwrap()
            .set_modified(time)
            .unwrap();
    };
    write(&vec![0; bytes.len()]);
    let task = |share: &str| {
        run(
            &place,
            "planned",
            false,
            &["ingest", "split.toml", "--shard", share, "--plan", "plan.json"],
        )
    };
    let (code, text) = task("0/3");
    assert_eq!(code, 0, "{text}");
    let (code, text) = task("1/3");
    assert!(code == 2 && text.contains("c.hdf5: it is not an HDF5 file"), "{text}");
    write(&bytes);
    for share in ["1/3", "2/3"] {
        let (code, text) = task(share);
        assert_eq!(code, 0, "{text}");
    }
    succeeds(&place, "planned", &["merge", "ingest", "split.toml"]);
    assert_same(&place, "whole", "planned");
}

#[test]
fn demonstrations_of_several_files_are_selected_by_name_and_filter() {
    let Some(place) = split() else { return };
    for (name, source, more, expected) in [
        (
            "named",
            "\"split\"",
            "select = { episodes = [\"c/demo_4\", \"a/demo_3\"] }",
            vec!["a/demo_3", "c/demo_4"],
        ),
        (
            "first",
            "\"split\"",
            "select = { first = 9 }",
            vec![
                "a/demo_0", "a/demo_1", "a/demo_2", "a/demo_3", "a/demo_4", "a/demo_5", "a/demo_6", "b/demo_0",
                "b/demo_1",
            ],
        ),
        (
            "filter",
            "[\"split/a.hdf5\", \"split/b.hdf5\"]",
            "filter = \"some\"",
            vec!["a/demo_1", "a/demo_2", "b/demo_1", "b/demo_2"],
        ),
    ] {
        pipeline(&place, name, source, more);
        succeeds(&place, name, &["ingest", &format!("{name}.toml")]);
        assert_eq!(names(&place, name), expected);
    }
    let error = refused(&place, "\"split\"", "filter = \"some\"");
    assert!(
        error.contains("split/c.hdf5: there is no filter key \"some\""),
        "{error}"
    );
    let error = refused(&place, "\"split\"", "select = { episodes = [3] }");
    assert!(
        error.contains("a/demo_3, b/demo_3, c/demo_3 all have that number"),
        "{error}"
    );
}

#[test]
fn files_that_differ_or_cannot_be_used_are_named() {
    let Some(place) = split() else { return };
    let two = |other: &str| refused(&place, &format!("[\"split/a.hdf5\", \"other/{other}.hdf5\"]"), "");
    for (other, parts) in [
        ("version", ["differ in the robosuite version", "and 1.2.0)"]),
        ("controller", ["differ in the controller's kp", "and 77.0)"]),
        ("camera", ["differ in the images", "agentview 8 x 8 x 3"]),
        ("gripper", ["contradicts the conventions of", "split/a.hdf5"]),
    ] {
        let error = two(other);
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        assert!(
            error.contains("split/a.hdf5") && error.contains(&format!("other/{other}.hdf5")),
            "{error}"
        );
    }
    let error = two("nan");
    assert!(
        error.contains("in data/other/nan.hdf5, dataset data/demo_3/actions has NaN in row 2"),
        "{error}"
    );
    pipeline(
        &place,
        "left",
        "[\"split/a.hdf5\", \"other/nan.hdf5\"]",
        "on_bad = \"leave_out\"",
    );
    succeeds(&place, "left", &["ingest", "left.toml"]);
    let names = names(&place, "left");
    assert!(names.len() == 300 && !names.contains(&"nan/demo_3".to_owned()));

    // All faults at once.
    let error = refused(
        &place,
        "[\"split/a.hdf5\", \"other/version.hdf5\", \"other/cut.hdf5\", \"split/a.hdf5\"]",
        "",
    );
    assert!(error.contains("split/a.hdf5: it is the same file as"), "{error}");
    let error = refused(
        &place,
        "[\"split/a.hdf5\", \"other/version.hdf5\", \"other/cut.hdf5\"]",
        "",
    );
    assert!(error.contains("2 faults in its 3 files: "), "{error}");
    assert!(
        error.contains("other/cut.hdf5 (") && error.contains("differ in the robosuite version"),
        "{error}"
    );
    fs::create_dir_all(place.path().join("data/empty/sub")).unwrap();
    let error = refused(&place, "\"empty\"", "");
    assert!(error.contains("only folders such as data/empty/sub; "), "{error}");
    let text = succeeds(&place, "split", &["inspect", "data/split"]);
    assert!(text.contains("3 HDF5 files") && text.contains("a.hdf5"), "{text}");
}

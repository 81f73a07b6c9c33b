//! End-to-end tests of robomimic's HDF5 files: values are bit-exact, and every error is one sentence.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Place, assert_same_bytes, filters, folders_in, repository};
use insta::{assert_snapshot, with_settings};
use re4_artifact::{Artifact, Row as _, Stage, col_text, col_u32};
use re4_ingest::{Convention, DemoRow, EpisodeRow};

const TASKS: [&str; 3] = ["lift", "can", "square"];

/// A folder with the sample of Can, and a pipeline file on it.
fn place() -> Place {
    let place = Place::empty();
    fs::copy(
        repository().join("data/can-sample.hdf5"),
        place.path().join("data/can.hdf5"),
    )
    .unwrap();
    pipeline(&place, "can", "can", "can.hdf5");
    place
}

fn pipeline(place: &Place, name: &str, task: &str, source: &str) {
    let text = format!("task = \"{task}\"\n[ingest]\nsource = \"{source}\"\n[segment]\n");
    place.write(&format!("{name}.toml"), text);
}

/// Python with h5py, numpy, polars and pillow.
fn python() -> Option<PathBuf> {
    let python = std::env::var_os("RE4_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
    }
    python
}

/// A folder of the real datasets, if it exists; otherwise prints that the test is skipped.
fn shared(name: &str) -> Option<PathBuf> {
    let beside = || repository().join("../shared/data");
    let path = std::env::var_os("RE4_DATA")
        .map_or_else(beside, PathBuf::from)
        .join(name);
    if !path.exists() {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            path.display()
        );
    }
    path.exists().then_some(path)
}

fn run_python(python: &Path, script: &str, arguments: &[&Path]) -> String {
    let output = Command::new(python)
        .arg(repository().join("tests").join(script))
        .args(arguments)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "{script} {arguments:?}: {text}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    text.trim().to_owned()
}

fn only(place: &Place) -> Artifact {
    place.artifact(Stage::Ingest)
}

#[test]
fn the_sample_is_ingested_once() {
    let place = place();
    let first = place.run("ingest can.toml").done();
    let mut filters = filters();
    filters.push((r"\b\d+ bytes", "[n] bytes"));
    filters.push((r" +\[n\] bytes", " [n] bytes"));
    // The residuals of exact relations are rounding errors, which differ between processors.
    filters.push((r"-?\d\.\d\de-1\d\b", "[rounding]"));
    with_settings!({ filters => filters }, {
        assert_snapshot!(first.stdout);
        assert_snapshot!("again", place.run("ingest can.toml").done().stderr);
    });
    let other = self::place();
    other.run("ingest can.toml --jobs 1").done();
    assert_same_bytes(&place.bytes(), &other.bytes());
    assert!(place.temporaries().is_empty());
}

#[test]
fn selections_apply_after_filters() {
    let place = place();
    let names = |arguments: &str| {
        let _ = fs::remove_dir_all(place.artifacts());
        place.run(&format!("ingest can.toml {arguments}")).done();
        let table = only(&place).table(DemoRow::table()).unwrap().read_all().unwrap();
        let names = col_text(&table, "demo").unwrap();
        names.into_iter().flatten().collect::<Vec<_>>().join(" ")
    };
    assert_eq!(names("--set ingest.filter=valid"), "demo_4 demo_17");
    assert_eq!(
        names("--set ingest.select={first=11}").split(' ').next_back(),
        Some("demo_10")
    );
    let train = names("--set ingest.filter=train --set ingest.select={episodes=[5,\"demo_6\"]}");
    assert_eq!(train, "demo_5 demo_6");
    let table = only(&place).table(EpisodeRow::table()).unwrap().read_all().unwrap();
    assert_eq!(col_u32(&table, "source_episode").unwrap(), &[5, 6]);
    let mut sentences = String::new();
    for arguments in [
        "--set ingest.filter=tran",
        "--set ingest.filter=valid --set ingest.select={first=3}",
        "--set ingest.cameras=[\"agentview\"]",
        "--set ingest.object=1",
        "--set ingest.conventions.gripper_sign=positive_opens",
        "--set ingest.conventions.gripper=1",
        "--set ingest.source=nowhere.hdf5",
        "--set task=lift",
        "--set task=robosuite",
        "--set ingest.compare=can.hdf5 --set ingest.source=small.toml",
    ] {
        writeln!(
            sentences,
            "{arguments}\n  {}",
            place.run(&format!("ingest can.toml {arguments}")).refused()
        )
        .unwrap();
    }
    with_settings!({ filters => filters() }, { assert_snapshot!(sentences) });
}

#[test]
fn damaged_files_are_refused_or_accepted_with_a_warning() {
    let Some(python) = python() else { return };
    let place = place();
    let folder = place.path().join("data/faults");
    run_python(
        &python,
        "make_robomimic.py",
        &[&repository().join("data/can-sample.hdf5"), &folder],
    );
    let mut outcomes = String::new();
    let mut files: Vec<PathBuf> = fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    for file in files {
        let name = file.file_stem().unwrap().to_str().unwrap();
        pipeline(&place, "fault", "can", &format!("faults/{name}.hdf5"));
        let _ = fs::remove_dir_all(place.artifacts());
        writeln!(outcomes, "{name}\n  {}", outcome_of(&place, "ingest fault.toml")).unwrap();
        let equal =
            only_artifact(&place).map(|artifact| run_python(&python, "robomimic_equal.py", &[&artifact, &file]));
        if let Some(equal) = equal {
            writeln!(outcomes, "  {equal}").unwrap();
        }
        assert!(place.temporaries().is_empty(), "{name}");
    }
    with_settings!({ filters => filters() }, { assert_snapshot!(outcomes) });
}

/// The error message, or the codes of the warnings.
fn outcome_of(place: &Place, arguments: &str) -> String {
    let answer = place.run(&format!("{arguments} --json --quiet"));
    if answer.code == Some(2) {
        return answer.refused();
    }
    let answer = answer.done().json();
    let warnings = answer["warnings"].as_array().unwrap().iter();
    let warnings = warnings.map(|warning| warning["message"].as_str().unwrap().to_owned());
    let warnings: Vec<String> = warnings.filter(|text| !text.starts_with("not ingested")).collect();
    format!(
        "accepted{}",
        if warnings.is_empty() {
            String::new()
        } else {
            format!(": {}", warnings.join("; "))
        }
    )
}

fn only_artifact(place: &Place) -> Option<PathBuf> {
    folders_in(&place.artifacts().join("episodes")).pop()
}

#[test]
fn changed_conventions_are_accepted_by_a_setting() {
    let Some(python) = python() else { return };
    let place = place();
    let folder = place.path().join("data/faults");
    let sample = repository().join("data/can-sample.hdf5");
    run_python(&python, "make_robomimic.py", &[&sample, &folder]);
    for (file, setting) in [
        ("permuted_layout", "object_layout=relative_first"),
        ("scalar_part_first", "eef_quaternion=wxyz"),
        ("other_gripper_sign", "gripper_sign=positive_opens"),
        ("actions_out_of_range", "allow_actions_beyond_range=true"),
    ] {
        pipeline(&place, "other", "can", &format!("faults/{file}.hdf5"));
        place.run("ingest other.toml").refused();
        place
            .run(&format!("ingest other.toml --set ingest.conventions.{setting}"))
            .done();
        let artifact = only(&place);
        let rows = artifact.table(Convention::table()).unwrap().read_all().unwrap();
        let values = col_text(&rows, "value").unwrap();
        let value = setting.split('=').next_back().unwrap();
        assert!(value == "true" || values.contains(&Some(value)), "{file}: {values:?}");
        fs::remove_dir_all(place.artifacts()).unwrap();
    }
}

#[test]
fn the_malformed_files_are_refused_or_accepted() {
    let Some(folder) = shared("malformed") else { return };
    let place = place();
    let mut outcomes = String::new();
    let mut files: Vec<PathBuf> = fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    for file in files
        .iter()
        .filter(|file| file.extension().is_some_and(|ending| ending == "hdf5"))
    {
        pipeline(&place, "malformed", "lift", file.to_str().unwrap());
        let name = file.file_name().unwrap().to_str().unwrap();
        let outcome = outcome_of(&place, "ingest malformed.toml").replace(folder.to_str().unwrap(), "[malformed]");
        writeln!(outcomes, "{name}\n  {outcome}").unwrap();
    }
    with_settings!({ filters => filters() }, { assert_snapshot!(outcomes) });
}

#[test]
fn raw_files_of_robosuite_are_ingested_from_their_states() {
    let Some(folder) = shared("robosuite") else { return };
    let place = place();
    let mut outcomes = String::new();
    for (file, task, more) in [
        ("robosuite-1.4.1-demos/lift/demo.hdf5", "lift", ""),
        (
            "robosuite-1.4.1-demos/lift/demo.hdf5",
            "lift",
            "--set ingest.conventions.allow_actions_beyond_range=true",
        ),
        ("robosuite-1.4.1-demos/handover/panda_panda/demo.hdf5", "robosuite", ""),
        ("robosuite-1.4.1-demos/wipe/panda/demo.hdf5", "robosuite", ""),
        ("robosuite-1.0.1-demos/door/panda/demo.hdf5", "robosuite", ""),
        ("robosuite-1.0.1-demos/lift/panda/demo.hdf5", "lift", ""),
        ("robosuite-1.0.1-demos/stack/panda/demo.hdf5", "robosuite", ""),
        (
            "robosuite-1.0.1-demos/stack/panda/demo.hdf5",
            "robosuite",
            "--set ingest.object=cubeA",
        ),
        (
            "robosuite-1.0.1-demos/stack/panda/demo.hdf5",
            "robosuite",
            "--set ingest.object=cubeC",
        ),
        ("robosuite-1.0.1-demos/pick-place/panda/demo.hdf5", "can", ""),
        (
            "robosuite-1.0.1-demos/pick-place/panda/demo.hdf5",
            "robosuite",
            "--set ingest.object=Can",
        ),
        (
            "robosuite-1.0.1-demos/nut-assembly/panda/demo.hdf5",
            "robosuite",
            "--set ingest.object=SquareNut",
        ),
    ] {
        pipeline(&place, "raw", task, folder.join(file).to_str().unwrap());
        let outcome =
            outcome_of(&place, &format!("ingest raw.toml {more}")).replace(folder.to_str().unwrap(), "[robosuite]");
        writeln!(outcomes, "{file} {task} {more}\n  {outcome}").unwrap();
    }
    with_settings!({ filters => filters() }, { assert_snapshot!(outcomes) });
}

#[test]
fn the_scripted_demonstrations_are_ingested_bit_for_bit() {
    let (Some(folder), Some(python)) = (shared("robomimic-scripted"), python()) else {
        return;
    };
    let place = place();
    for task in TASKS {
        for file in ["low_dim.hdf5", "low_dim_abs.hdf5", "image_5.hdf5"] {
            let source = folder.join(task).join(file);
            pipeline(&place, "scripted", task, source.to_str().unwrap());
            place.run("ingest scripted.toml").done();
            let artifact = only_artifact(&place).unwrap();
            println!(
                "{task}/{file}: {}",
                run_python(&python, "robomimic_equal.py", &[&artifact, &source])
            );
            fs::remove_dir_all(place.artifacts()).unwrap();
        }
    }
}

/// After the first step of a demonstration, 99 % of the goals are within 1 mm and 0.2 degrees of the controller's own.
#[test]
fn goals_from_deltas_match_those_of_the_controller() {
    let Some(folder) = shared("robomimic-scripted") else {
        return;
    };
    let place = place();
    for task in TASKS {
        let files = ["low_dim.hdf5", "low_dim_abs.hdf5"].map(|file| folder.join(task).join(file));
        let [delta, absolute] = files.each_ref().map(|file| file.to_str().unwrap());
        for (source, compare) in [(delta, absolute), (absolute, delta)] {
            pipeline(&place, "goals", task, source);
            let answer = place.run(&format!(
                "ingest goals.toml --json --quiet --set ingest.compare={compare}"
            ));
            let summary = &answer.done().json()["summary"]["goal_error"];
            println!("{task}: {summary}");
            assert!(summary["position_m"][2].as_f64().unwrap() <= 1e-3, "{task}: {summary}");
            assert!(
                summary["rotation_rad"][2].as_f64().unwrap() <= 0.2_f64.to_radians(),
                "{task}: {summary}"
            );
        }
    }
}

//! Demonstrations keep the names of their source from the selection to the rollout, independent of their position in a file or an
//! artifact.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Answer, Place, filters, repository, scripted_and_simulators};
use arrow_array::RecordBatch;
use insta::{assert_snapshot, with_settings};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, Stage, TableSpec, col_f64, col_text, col_u32, col_u32_or_null};
use re4_audit::{AuditedEpisodeRow, FindingRow};
use re4_ingest::{DemoRow, EpisodeRow, FrameRow, SpatialColumns};
use re4_segment::{ModeRow, SpatialEvidence};
use serde_json::Value;

fn pipeline(task: &str, source: &Path) -> String {
    format!(
        r#"task = "{task}"
variant = "state"
[ingest]
source = "{}"
[segment]
[pose]
source = "recorded"
[index]
leave_out = []
[rollout]
policy = "re4"
seeds = "200000..200002"
max_steps = 60
"#,
        source.display()
    )
}

/// A folder with a pipeline file on a dataset.
fn place(task: &str, source: &Path) -> Place {
    let place = Place::empty();
    place.write("p.toml", pipeline(task, source));
    place
}

/// As [`place`], with a copy of the dataset in the folder, so that messages name no other folder.
fn place_of(made: &Path, name: &str) -> Place {
    let place = place("can", Path::new(name));
    fs::copy(made.join(name), place.path().join("data").join(name)).unwrap();
    place
}

fn sample() -> PathBuf {
    repository().join("data/can-sample.hdf5")
}

/// The folder of the files that `make_gaps.py` writes; `None` without Python.
fn made(place: &Place) -> Option<PathBuf> {
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
        return None;
    };
    let folder = place.path().join("made");
    let output = Command::new(python)
        .arg(repository().join("tests/make_gaps.py"))
        .args([&sample(), &folder])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(folder)
}

/// A file made after a public report, if it exists; otherwise prints that the test is skipped.
fn reported(name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("RE4_DATA").map_or_else(|| repository().join("../shared/data"), PathBuf::from);
    let path = data.join(format!("foreign/{name}/{name}.hdf5"));
    if !path.exists() {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            path.display()
        );
        return None;
    }
    Some(path.canonicalize().unwrap())
}

fn rows(artifact: &Artifact, spec: &'static TableSpec) -> RecordBatch {
    artifact.table(spec).unwrap().read_all().unwrap()
}

fn texts(rows: &RecordBatch, column: &str) -> Vec<String> {
    let column = col_text(rows, column).unwrap();
    column
        .into_iter()
        .map(|text| text.unwrap_or_default().to_owned())
        .collect()
}

/// Names of the demonstrations of an `episodes` artifact, in its order.
fn names(episodes: &Artifact) -> Vec<String> {
    texts(&rows(episodes, DemoRow::table()), "demo")
}

/// The values of a column by frame, for each demonstration by its name.
fn by_name<T>(rows: &RecordBatch, names: &[String], values: Vec<T>) -> BTreeMap<String, Vec<T>> {
    let mut found: BTreeMap<String, Vec<T>> = BTreeMap::new();
    for (episode, value) in col_u32(rows, "episode").unwrap().iter().zip(values) {
        found.entry(names[*episode as usize].clone()).or_default().push(value);
    }
    found
}

fn numbers(rows: &RecordBatch, names: &[String], column: &str) -> BTreeMap<String, Vec<u64>> {
    let values = col_f64(rows, column).unwrap().iter().map(|value| value.to_bits());
    by_name(rows, names, values.collect())
}

/// The bits of the end effector's x position by frame, for each demonstration. They identify a demonstration of the sample,
/// except for its duplicate.
fn end_effectors(episodes: &Artifact) -> BTreeMap<String, Vec<u64>> {
    numbers(
        &rows(episodes, FrameRow::<SpatialColumns>::table()),
        &names(episodes),
        "eef_x",
    )
}

/// Deletes the artifacts, ingests with additional arguments and returns the end effector positions.
fn ingested(place: &Place, arguments: &str) -> BTreeMap<String, Vec<u64>> {
    let _ = fs::remove_dir_all(place.artifacts());
    place.run(&format!("ingest p.toml {arguments}")).done();
    end_effectors(&place.artifact(Stage::Ingest))
}

#[test]
fn a_file_with_gaps_keeps_its_names_from_ingest_to_the_index() {
    let whole = place("can", &sample());
    let Some(folder) = made(&whole) else { return };
    let gaps = place_of(&folder, "gaps.hdf5");
    for place in [&whole, &gaps] {
        place.run("index p.toml").done();
        place.run("audit p.toml").done();
    }
    let of = |place: &Place| place.artifact(Stage::Ingest);
    let known = names(&of(&gaps));
    assert_eq!(
        known.join(" "),
        "demo_1 demo_2 demo_4 demo_6 demo_7 demo_8 demo_9 demo_10 demo_11 demo_12 demo_14 demo_15 demo_16 demo_17 demo_18"
    );
    let listing = rows(&of(&gaps), EpisodeRow::table());
    let own = known
        .iter()
        .map(|name| name.trim_start_matches("demo_").parse::<u32>().unwrap());
    assert_eq!(col_u32(&listing, "source_episode").unwrap(), own.collect::<Vec<_>>());
    // In the whole sample, positions, numbers and names agree, so it serves as the reference.
    let whole_names = names(&of(&whole));
    assert!((0..19).all(|number| whole_names[number] == format!("demo_{number}")));
    let same = |what: &str, [whole, gaps]: [BTreeMap<String, Vec<u64>>; 2]| {
        assert_eq!(gaps.len(), 15, "{what}");
        for (name, values) in gaps {
            assert!(whole[&name] == values, "{what} of {name}");
        }
    };
    same("frames", [&whole, &gaps].map(|place| end_effectors(&of(place))));
    same(
        "modes",
        [&whole, &gaps].map(|place| {
            let modes = rows(&place.artifact(Stage::Segment), ModeRow::<SpatialEvidence>::table());
            numbers(&modes, &names(&of(place)), "finger_separation")
        }),
    );
    same(
        "the index",
        [&whole, &gaps].map(|place| {
            let index = rows(
                &place.artifact(Stage::Index),
                re4_index::IndexRow::<re4_index::SpatialState>::table(),
            );
            numbers(&index, &names(&of(place)), "eef_x")
        }),
    );
    let audit = gaps.artifact(Stage::Audit);
    assert_eq!(texts(&rows(&audit, AuditedEpisodeRow::table()), "demo"), known);
    let findings = rows(&audit, FindingRow::table());
    let places = col_u32(&findings, "episode").unwrap();
    let called = texts(&findings, "demo_name");
    assert!(
        places
            .iter()
            .zip(&called)
            .all(|(place, name)| known[*place as usize] == *name)
    );
    let reported: Vec<(String, String)> = called
        .into_iter()
        .zip(texts(&findings, "code").into_iter().zip(texts(&findings, "message")))
        .filter(|(_, (code, _))| code == "duplicate" || code == "no_transfer")
        .map(|(name, (_, message))| (name, message))
        .collect();
    assert_eq!(reported.len(), 2, "{reported:?}");
    assert_eq!(reported[0].0, "demo_10");
    assert_eq!(
        reported[1],
        ("demo_16".to_owned(), "identical to demo_2, bit for bit".to_owned())
    );
}

#[test]
fn selections_use_the_names_of_the_file() {
    let whole = place("can", &sample());
    let Some(folder) = made(&whole) else { return };
    let whole = ingested(&whole, "");
    let gaps = place_of(&folder, "gaps.hdf5");
    for (select, expected) in [
        ("episodes=[4]", "demo_4"),
        ("episodes=[\"demo_4\"]", "demo_4"),
        ("episodes=[18,2,\"demo_7\"]", "demo_18 demo_2 demo_7"),
        ("range=\"2..7\"", "demo_2 demo_4 demo_6"),
        ("first=3", "demo_1 demo_2 demo_4"),
        ("last=2", "demo_17 demo_18"),
    ] {
        let found = ingested(&gaps, &format!("--set ingest.select={{{select}}}"));
        assert_eq!(found.keys().map(String::as_str).collect::<Vec<_>>().join(" "), expected);
        assert!(found.iter().all(|(name, eef)| whole[name] == *eef), "{select}");
    }
    let mut sentences = String::new();
    for arguments in [
        "--set ingest.select={episodes=[3]}",
        "--set ingest.select={episodes=[4,\"demo_13\"]}",
        "--set ingest.select={episodes=[4,\"demo_4\"]}",
        "--set ingest.select={episodes=[-1]}",
        "--set ingest.select={episodes=[true]}",
        "--set ingest.select={range=\"15..25\"}",
        "--set ingest.select={range=\"3..4\"}",
        "--set ingest.select={first=16}",
        "--set ingest.filter=valid --set ingest.select={episodes=[6]}",
    ] {
        let refused = gaps.run(&format!("ingest p.toml {arguments}")).refused();
        writeln!(sentences, "{arguments}\n  {refused}").unwrap();
    }
    with_settings!({ filters => filters() }, { assert_snapshot!(sentences) });
}

#[test]
fn demonstrations_are_sorted_by_the_numbers_in_their_names() {
    let whole = place("can", &sample());
    let Some(folder) = made(&whole) else { return };
    let whole = ingested(&whole, "");
    let others = place_of(&folder, "names.hdf5");
    let found = ingested(&others, "");
    let episodes = others.artifact(Stage::Ingest);
    assert_eq!(
        names(&episodes).join(" "),
        "demo1 demo2 a_3 b_3 take-7 demo10 run_99999999999999999999 last"
    );
    let listing = rows(&episodes, EpisodeRow::table());
    // a_3 and b_3 have the same number; the number of the second-to-last name is too long; the last name has no number.
    let own = [Some(1), Some(2), None, None, Some(7), Some(10), None, None];
    assert_eq!(col_u32_or_null(&listing, "source_episode").unwrap(), own);
    let origins: BTreeMap<String, String> =
        serde_json::from_slice(&fs::read(folder.join("names.json")).unwrap()).unwrap();
    assert_eq!(found.len(), origins.len());
    for (name, eef) in &found {
        assert!(whole[&origins[name]] == *eef, "{name}");
    }
    let taken = |select: &str| {
        ingested(&others, &format!("--set ingest.select={{{select}}}"));
        names(&others.artifact(Stage::Ingest)).join(" ")
    };
    assert_eq!(taken("episodes=[10,\"last\",\"b_3\"]"), "b_3 demo10 last");
    assert_eq!(taken("range=\"2..8\""), "demo2 a_3 b_3 take-7");
    let refused = others.run("ingest p.toml --set ingest.select={episodes=[3]}").refused();
    assert!(refused.contains("a_3, b_3 all have that number"), "{refused}");
    let filtered = others
        .run("ingest p.toml --set ingest.filter=some --set ingest.select={first=2}")
        .done();
    assert!(filtered.stdout.contains("2 episodes") || filtered.stderr.contains("2 episodes"));
}

#[test]
fn reported_files_are_read_by_their_names() {
    let Some(unnumbered) = reported("h03_demo1_no_underscore") else {
        return;
    };
    let place = place("lift", &unnumbered);
    ingested(&place, "");
    let episodes = place.artifact(Stage::Ingest);
    let expected: Vec<String> = (1..=12).map(|number| format!("demo{number}")).collect();
    assert_eq!(names(&episodes), expected);
    let listing = rows(&episodes, EpisodeRow::table());
    assert_eq!(
        col_u32(&listing, "source_episode").unwrap(),
        (1..=12).collect::<Vec<u32>>()
    );
    let first = ingested(&place, "--set ingest.select={first=3}");
    assert_eq!(first.into_keys().collect::<Vec<_>>(), ["demo1", "demo2", "demo3"]);

    let Some(lost) = reported("h05_lost_demos_masks") else {
        return;
    };
    let place = self::place("lift", &lost);
    let all = ingested(&place, "");
    assert_eq!(
        all.keys().cloned().collect::<Vec<_>>().join(" "),
        "demo_0 demo_1 demo_3 demo_4 demo_6"
    );
    for number in [3, 6] {
        let one = ingested(&place, &format!("--set ingest.select={{episodes=[{number}]}}"));
        assert_eq!(one.len(), 1);
        let name = format!("demo_{number}");
        assert!(one[&name] == all[&name], "{name}");
    }
    let refused = place.run("ingest p.toml --set ingest.select={episodes=[2]}").refused();
    assert!(refused.contains("there is no demo_2"), "{refused}");
}

#[test]
fn replays_and_rollouts_name_their_demonstrations() {
    let (Some(source), Some((_, simulators))) = (reported("h05_lost_demos_masks"), scripted_and_simulators()) else {
        return;
    };
    let place = place("lift", &source);
    let run = |arguments: &str| -> Answer {
        let mut command = place.command();
        command
            .env("RE4_SIMULATORS", &simulators)
            .args(arguments.split_whitespace());
        Answer::new(&command.output().unwrap(), place.path())
    };
    let replayed = run("replay p.toml --json").done().json();
    run("rollout p.toml").done();
    let episodes = place.artifact(Stage::Ingest);
    let known = names(&episodes);
    assert_eq!(known, ["demo_0", "demo_1", "demo_3", "demo_4", "demo_6"]);
    let replays = rows(
        &place.artifact(Stage::Replay),
        re4_stages::ReplayRow::<re4_stages::SpatialReplay>::table(),
    );
    let places = col_u32(&replays, "episode").unwrap();
    let called = texts(&replays, "demo_name");
    assert_eq!(called.len(), 10);
    assert!(
        places
            .iter()
            .zip(&called)
            .all(|(place, name)| known[*place as usize] == *name)
    );
    let own: Vec<u32> = called
        .iter()
        .map(|name| name.trim_start_matches("demo_").parse().unwrap())
        .collect();
    assert_eq!(col_u32(&replays, "source_episode").unwrap(), own);
    let failed = replayed["summary"]["delta"]["failed_demonstrations"]
        .as_array()
        .unwrap();
    assert!(failed.iter().all(Value::is_string), "{failed:?}");

    let decisions = crate::support::decisions(&place.artifact(Stage::Rollout));
    let (demos, frames) = (
        col_u32_or_null(&decisions, "demo").unwrap(),
        col_u32_or_null(&decisions, "demo_frame").unwrap(),
    );
    let (called, reasons) = (texts(&decisions, "demo_name"), texts(&decisions, "reason"));
    for row in 0..decisions.num_rows() {
        match demos[row] {
            Some(demo) => {
                assert_eq!(called[row], known[demo as usize]);
                let start = format!("{} from frame {}: ", called[row], frames[row].unwrap());
                assert!(reasons[row].starts_with(&start), "{}", reasons[row]);
            }
            None => assert_eq!(called[row], ""),
        }
    }
    // A single demonstration, whose position in the file is 3.
    fs::remove_dir_all(place.artifacts()).unwrap();
    run("rollout p.toml --set ingest.select={episodes=[4]}").done();
    let decisions = crate::support::decisions(&place.artifact(Stage::Rollout));
    let mut called = texts(&decisions, "demo_name");
    called.retain(|name| !name.is_empty());
    called.dedup();
    assert_eq!(called, ["demo_4"]);
}

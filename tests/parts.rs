//! Pipelines in parts: the same bytes for any number of processes in any order, and nothing is published before it is complete.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Place, dataset, repository};
use re4_artifact::{Artifact, ByEpisode, Row as _, TableSpec};
use re4_audit::{
    AuditConfig, Basis, CHECKS, CheckRow, FindingRow, FingerUnit, GraspLimits, Observation, SpatialDemo, Thresholds,
    audit_copies, audit_spatial, observe_spatial,
};
use re4_episode::{Mode, PlanarFrame, SpatialEpisode};
use re4_geometry::{Point2, Pose2};
use re4_index::{AngleMetric, IndexRow, IndexedFrame, Normalization, PlanarState, Query, ScaleRow, retrieve_linear};
use re4_ingest::{DemoRow, EpisodeRow, FrameRow, PlanarColumns, SpatialColumns};
use re4_policy::kinds::PlaneRe4Row;
use re4_policy::{Chunk, DemoSet, collect_chunks};
use re4_pose::spatial::{Demonstration, GraspPhase, evaluate};
use re4_pose::{Estimate, Flag, PoseErrorRow, PoseRow, SpatialEstimate, between_clear};
use re4_rollout::PlaneDecisionRow;
use re4_scores::{Motion, ScoreRow, Sketch};
use re4_segment::{Evidence, GripperConfig, ModeRow, SegmentConfig, SpatialEvidence, segment_spatial};
use serde_json::Value;

/// Three parts of 256 demonstrations, the last one short.
const DEMOS: usize = 600;

/// The Python interpreter with h5py, if it is named.
fn python() -> Option<OsString> {
    let python = std::env::var_os("RE4_PYTHON");
    if python.is_none() {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
    }
    python
}

/// A folder with many demonstrations and a pipeline file on each dataset; `None` without Python.
pub(crate) fn many() -> Option<Place> {
    let python = python()?;
    let place = Place::empty();
    let status = Command::new(python)
        .arg(repository().join("tests/make_many.py"))
        .args([repository().join("data/can-sample.hdf5"), place.path().join("data")])
        .arg(DEMOS.to_string())
        .status()
        .unwrap();
    assert!(status.success());
    for (name, source) in [("many", "many"), ("bad", "some_bad"), ("good", "without_bad")] {
        let text = format!(
            "task = \"can\"\nvariant = \"state\"\n[ingest]\nsource = \"{source}.hdf5\"\non_bad = \"{}\"\n[segment]\n[index]\n[pose]\nsource = \"recorded\"\n\
             [policy]\nkind = \"paper\"\n[rollout]\nseeds = \"0..300\"\n",
            if name == "bad" { "leave_out" } else { "refuse" }
        );
        place.write(&format!("{name}.toml"), text);
    }
    Some(place)
}

/// A folder with many demonstrations with images and a pipeline file with an encoder; `None` without Python or the scripted demonstrations.
fn many_images() -> Option<Place> {
    let data = crate::support::scripted()?;
    let python = python()?;
    let place = Place::empty();
    let status = Command::new(python)
        .arg(repository().join("tests/make_many_images.py"))
        .args([data.join("lift/image_5.hdf5"), place.path().join("many.hdf5")])
        .arg(DEMOS.to_string())
        .status()
        .unwrap();
    assert!(status.success());
    place.write(
        "many.toml",
        "task = \"lift\"\nvariant = \"image\"\n[ingest]\nsource = \"many.hdf5\"\n[segment]\n[pose]\nsource = \"encoder\"\n\
         [pose.encoder]\npreset = \"re4\"\nepochs = 1\nsteps = 2\nbatch = 32\nheld_out = 0.2\ncrops = 2\n[index]\n\
         [policy]\nkind = \"re4\"\n[rollout]\nseeds = \"0..300\"\n",
    );
    Some(place)
}

/// Runs the program with its artifacts in a folder of this name. Returns its exit code and its output with errors.
fn run(place: &Place, artifacts: &str, arguments: &[&str]) -> (i32, String) {
    let output = Command::new(crate::support::PROGRAM)
        .current_dir(place.path())
        .args(arguments)
        .args(["--artifacts", artifacts, "--quiet"])
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.code().unwrap(), String::from_utf8(text).unwrap())
}

fn succeeds(place: &Place, artifacts: &str, arguments: &[&str]) -> String {
    let (code, text) = run(place, artifacts, arguments);
    assert_eq!(code, 0, "{arguments:?}: {text}");
    text
}

/// All files of the artifacts, by their paths. Records of runs contain times.
fn tree(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().to_path_buf();
                if !name.starts_with("runs") {
                    found.insert(name, fs::read(&path).unwrap());
                }
            }
        }
    }
    found
}

fn assert_same(place: &Place, one: &str, other: &str) {
    let (one, other) = (tree(&place.path().join(one)), tree(&place.path().join(other)));
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    let differing: Vec<_> = one.iter().filter(|(path, bytes)| other[*path] != **bytes).collect();
    assert!(
        differing.is_empty(),
        "{:?}",
        differing.iter().map(|(path, _)| path).collect::<Vec<_>>()
    );
}

/// The only artifact of this kind.
fn only(place: &Place, artifacts: &str, kind: &str) -> Artifact {
    let folders: Vec<_> = fs::read_dir(place.path().join(artifacts).join(kind)).unwrap().collect();
    assert_eq!(folders.len(), 1, "{kind}");
    Artifact::open(&folders[0].as_ref().unwrap().path()).unwrap()
}

#[test]
fn shares_in_any_order_and_number_give_the_bytes_of_one_process() {
    let Some(place) = many() else { return };
    succeeds(&place, "one", &["index", "many.toml", "--jobs", "2"]);
    let episodes = only(&place, "one", "episodes");
    assert_eq!(episodes.parts(), 3);
    assert_eq!(episodes.read::<DemoRow>().unwrap().len(), DEMOS);
    let numbers: Vec<u32> = episodes
        .read::<EpisodeRow>()
        .unwrap()
        .iter()
        .map(|row| row.episode)
        .collect();
    assert_eq!(numbers, (0..DEMOS as u32).collect::<Vec<_>>());
    succeeds(&place, "one", &["audit", "many.toml", "--jobs", "1"]);
    for stage in ["ingest", "segment", "index", "observe", "audit"] {
        // A share that is empty, others in reverse order, one of them twice, and one missing.
        for shard in ["0/7", "6/7", "4/7", "4/7"] {
            succeeds(&place, "parts", &[stage, "many.toml", "--shard", shard]);
        }
        let (code, text) = run(&place, "parts", &["merge", stage, "many.toml"]);
        assert_eq!(code, 3, "{text}");
        assert!(text.contains("1 of its 3 parts are missing: 0;"), "{text}");
        // Other processes with another number of shares.
        succeeds(&place, "parts", &[stage, "many.toml", "--shard", "0/2"]);
        succeeds(&place, "parts", &["merge", stage, "many.toml"]);
        succeeds(&place, "parts", &["merge", stage, "many.toml"]);
    }
    assert_same(&place, "one", "parts");
    succeeds(&place, "one", &["verify"]);
    audit_is_that_of_all_demonstrations_together(&place);
}

/// Compares the audit in parts with one that holds all demonstrations in memory.
fn audit_is_that_of_all_demonstrations_together(place: &Place) {
    let constant = |code: &str| {
        let check = CHECKS.iter().find(|check| check.code == code).unwrap();
        match check.basis {
            Basis::Constant { spatial, .. } => spatial,
            _ => panic!("{code} has no constant"),
        }
    };
    let limits = GraspLimits {
        closed: GripperConfig::default().closed,
        lost: constant("lost_grasp"),
        flicker: constant("flicker") as usize,
        frozen: constant("frozen_object") as usize,
        swapped: constant("swapped_object"),
        fingers: FingerUnit::Metres,
    };
    let episodes = only(place, "one", "episodes");
    let names = episodes.read::<DemoRow>().unwrap();
    let frames = ByEpisode::open(&episodes, |row: &FrameRow<SpatialColumns>| row.episode).unwrap();
    let demos: Vec<SpatialDemo> = frames
        .map(|rows| {
            let (number, rows) = rows.unwrap();
            let episode = SpatialEpisode {
                name: names[number as usize].demo.clone(),
                frames: rows.iter().map(|row| row.recorded.frame().unwrap()).collect(),
            };
            SpatialDemo {
                number,
                segmented: segment_spatial(&episode, &SegmentConfig::spatial()).unwrap(),
                episode,
            }
        })
        .collect();
    let observations: Vec<Observation> = demos.iter().map(|demo| observe_spatial(demo, &limits)).collect();
    let thresholds = Thresholds::derive(&observations, &AuditConfig::default(), false, limits.closed);
    // The sample has no recorded goals, so their seams are not checked.
    let thresholds = thresholds.with_recorded_goals(false);
    let mut findings = audit_copies(&observations, &thresholds);
    findings.extend(
        demos
            .iter()
            .flat_map(|demo| audit_spatial(demo, &thresholds, &limits).findings),
    );
    findings.sort_by(|a, b| (a.episode, a.frames.start, a.code).cmp(&(b.episode, b.frames.start, b.code)));
    let findings: Vec<FindingRow> = (0..)
        .zip(&findings)
        .map(|(number, finding)| FindingRow::new(number, finding))
        .collect();
    let audit = only(place, "one", "audit");
    assert_eq!(audit.parts(), 3);
    assert!(findings.iter().any(|row| row.other_episode.is_some()), "no copy");
    assert_eq!(audit.read::<FindingRow>().unwrap(), findings);
    let thresholds: Vec<_> = thresholds.iter().map(|(check, of)| (check.code, of.value)).collect();
    let checks = audit.read::<CheckRow>().unwrap();
    let found: Vec<_> = checks.iter().map(|row| (&*row.code, row.threshold)).collect();
    assert_eq!(found, thresholds);
    let sketch = |demo: &SpatialDemo| {
        let segments: Vec<_> = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
        Sketch::of(demo.number, &Motion::spatial(&demo.episode, &segments, 0.05))
    };
    let sketches: Vec<Sketch> = demos.iter().map(sketch).collect();
    assert_eq!(audit.read::<ScoreRow>().unwrap(), re4_scores::score(&sketches));
    assert_eq!(audit.manifest().summary["episodes"], DEMOS);
}

#[test]
fn estimates_in_parts_are_those_of_one_process() {
    let Some(place) = many_images() else { return };
    let plan = |more: &[&str]| -> Vec<(String, u64, Value)> {
        let arguments = [&["plan", "many.toml", "--shards", "2", "--json"], more].concat();
        let plan: Value = serde_json::from_str(&succeeds(&place, "parts", &arguments)).unwrap();
        let group = |group: &Value| {
            (
                group["id"].as_str().unwrap().to_owned(),
                group["count"].as_u64().unwrap(),
                group["indices"].clone(),
            )
        };
        plan["groups"].as_array().unwrap().iter().map(group).collect()
    };
    let all = |id: &str, count| (id.to_owned(), count, Value::Null);
    let later = [
        all("index", 2),
        all("index.merge", 1),
        all("rollout", 2),
        all("rollout.merge", 1),
    ];
    let estimated = [all("train-pose", 2), all("train-pose.merge", 1)];
    assert_eq!(
        plan(&[])[4..],
        [&[all("train-encoder", 1)], &estimated[..], &later].concat()
    );
    // The command makes the encoder and the poses.
    succeeds(&place, "one", &["train-pose", "many.toml", "--jobs", "2"]);
    succeeds(&place, "one", &["index", "many.toml"]);
    // A shard does not make the encoder again.
    succeeds(&place, "parts", &["train-encoder", "many.toml", "--jobs", "1"]);
    for stage in ["train-pose", "index"] {
        for shard in ["0/7", "6/7", "4/7", "4/7"] {
            succeeds(&place, "parts", &[stage, "many.toml", "--shard", shard]);
        }
        let (code, text) = run(&place, "parts", &["merge", stage, "many.toml"]);
        assert_eq!(code, 3, "{text}");
        assert!(text.contains("1 of its 3 parts are missing: 0;"), "{text}");
        if stage == "train-pose" {
            let missing = [
                ("train-pose".to_owned(), 2, serde_json::json!([0])),
                all("train-pose.merge", 1),
            ];
            assert_eq!(plan(&["--missing"]), [&missing[..], &later].concat());
        }
        succeeds(&place, "parts", &[stage, "many.toml", "--shard", "0/2"]);
        succeeds(&place, "parts", &["merge", stage, "many.toml"]);
    }
    assert_same(&place, "one", "parts");
    succeeds(&place, "one", &["verify"]);
    estimates_and_errors_are_those_of_all_demonstrations_together(&place);
}

/// Compares the estimates in parts with their demonstrations, and the errors with those of all demonstrations in memory.
fn estimates_and_errors_are_those_of_all_demonstrations_together(place: &Place) {
    let poses = only(place, "one", "poses");
    assert_eq!((poses.parts(), only(place, "one", "encoder").parts()), (3, 1));
    let frames = only(place, "one", "episodes")
        .read::<FrameRow<SpatialColumns>>()
        .unwrap();
    let modes = only(place, "one", "modes").read::<ModeRow<SpatialEvidence>>().unwrap();
    let estimates = poses.read::<PoseRow<SpatialEstimate>>().unwrap();
    let ids: Vec<_> = frames.iter().map(|row| (row.episode, row.frame)).collect();
    assert_eq!(
        estimates.iter().map(|row| (row.episode, row.frame)).collect::<Vec<_>>(),
        ids
    );
    let mut demos: Vec<Demonstration> = Vec::new();
    for ((frame, mode), row) in frames.iter().zip(&modes).zip(&estimates) {
        assert_eq!(row.estimate.trained_on, !row.episode.is_multiple_of(5));
        assert!(row.estimate.confidence.is_some());
        if demos.len() == row.episode as usize {
            let held: Vec<bool> = modes
                .iter()
                .filter(|mode| mode.episode == row.episode)
                .map(|mode| mode.mode == Mode::Transfer)
                .collect();
            demos.push(Demonstration {
                trained_on: row.estimate.trained_on,
                phases: GraspPhase::of(&held),
                estimated: Vec::new(),
                recorded: Vec::new(),
                eef: Vec::new(),
            });
        }
        assert_eq!((mode.episode, mode.frame), (row.episode, row.frame));
        let demo = demos.last_mut().unwrap();
        demo.estimated.push(row.estimate.object);
        demo.recorded.push(frame.recorded.object.unwrap());
        demo.eef.push(frame.recorded.eef);
    }
    let task: re4_stages::Task = serde_json::from_value("lift".into()).unwrap();
    // The demonstrations after the first five are copies of their frames, whose images give the same estimates.
    let copied = (5..10).map(|demo| (demos[demo].estimated[0], &demos[demo - 5].estimated));
    assert!(copied.into_iter().all(|(first, original)| original.contains(&first)));
    let measured = evaluate(&demos, task.symmetry()).unwrap();
    let measured = measured.estimates.unwrap();
    let errors = poses.read::<PoseErrorRow>().unwrap();
    assert_eq!(
        errors.iter().map(|row| (row.episode, row.frame)).collect::<Vec<_>>(),
        ids
    );
    let expected: Vec<_> = measured.errors.into_iter().flatten().flatten().collect();
    let found: Vec<_> = errors.iter().map(|row| row.error).collect();
    assert_eq!(found, expected);
    let summary = &poses.manifest().summary;
    assert_eq!(
        (&summary["episodes"], &summary["trained_on"]),
        (&DEMOS.into(), &480.into())
    );
    let held_out: Vec<f64> = errors
        .iter()
        .filter(|row| !row.trained_on)
        .map(|row| 1e3 * row.error.translation)
        .collect();
    let scores = &summary["evaluation"]["estimates"]["held_out"];
    assert_eq!(scores["demonstrations"], 120);
    assert_eq!(
        scores["overall"]["translation_mm"],
        re4_stats::spread(held_out, &[0.5, 0.9])
    );
}

#[test]
fn numbers_do_not_depend_on_demonstrations_that_are_left_out_of_other_parts() {
    let Some(place) = many() else { return };
    for shard in ["2/3", "0/3", "1/3"] {
        succeeds(&place, "bad", &["ingest", "bad.toml", "--shard", shard]);
    }
    succeeds(&place, "bad", &["merge", "ingest", "bad.toml"]);
    succeeds(&place, "whole", &["ingest", "bad.toml"]);
    assert_same(&place, "bad", "whole");
    // The demonstrations that were left out are the last part of the audit.
    succeeds(&place, "bad", &["segment", "bad.toml"]);
    succeeds(&place, "whole", &["segment", "bad.toml"]);
    for kind in ["observations", "audit"] {
        fs::remove_dir_all(only(&place, "bad", kind).path()).unwrap();
    }
    for stage in ["observe", "audit"] {
        succeeds(&place, "bad", &[stage, "bad.toml", "--shard", "0/2"]);
        let (code, text) = run(&place, "bad", &["merge", stage, "bad.toml"]);
        assert_eq!(code, 3, "{text}");
        succeeds(&place, "bad", &[stage, "bad.toml", "--shard", "1/2"]);
        succeeds(&place, "bad", &["merge", stage, "bad.toml"]);
    }
    assert_same(&place, "bad", "whole");
    let audit = only(&place, "whole", "audit");
    let left = audit.read::<FindingRow>().unwrap();
    let left = left.iter().filter(|row| &*row.code == "left_out").count();
    let listed = only(&place, "whole", "episodes").manifest().tables["left_out"].rows;
    assert_eq!(left as u64, listed);
    succeeds(&place, "bad", &["verify"]);
    succeeds(&place, "good", &["ingest", "good.toml"]);
    let (bad, good) = (only(&place, "bad", "episodes"), only(&place, "good", "episodes"));
    assert_eq!(bad.manifest().summary["left_out"], 3);
    let tables: [&'static TableSpec; 3] = [
        EpisodeRow::table(),
        FrameRow::<SpatialColumns>::table(),
        DemoRow::table(),
    ];
    for spec in tables {
        let read = |artifact: &Artifact| {
            let rows = artifact.table(spec).unwrap().read_all().unwrap();
            // The number of a model begins with another one in each part.
            let model = rows.schema().index_of("model");
            let mut rows = rows;
            if let Ok(model) = model {
                rows.remove_column(model);
            }
            rows
        };
        assert_eq!(read(&bad), read(&good), "{}", spec.name);
    }
    // The stages after it.
    succeeds(&place, "bad", &["index", "bad.toml"]);
    succeeds(&place, "good", &["index", "good.toml"]);
    let index = |artifacts: &str| only(&place, artifacts, "index").manifest().summary.clone();
    assert_eq!(index("bad"), index("good"));
    // A dataset that is to be refused names all bad demonstrations, of all parts.
    let (code, text) = run(
        &place,
        "refused",
        &["ingest", "bad.toml", "--set", "ingest.on_bad=refuse"],
    );
    assert_eq!(code, 2);
    for demo in ["demo_3", "demo_4", "demo_300"] {
        assert!(text.contains(demo), "{text}");
    }
}

#[test]
fn a_plan_lists_the_tasks_and_what_is_missing() {
    let Some(place) = many() else { return };
    let plan = |more: &[&str]| -> Value {
        let arguments = [&["plan", "many.toml", "--shards", "2", "--json"], more].concat();
        serde_json::from_str(&succeeds(&place, "artifacts", &arguments)).unwrap()
    };
    let ids = |plan: &Value| -> Vec<(String, u64)> {
        let groups = plan["groups"].as_array().unwrap();
        let id = |group: &Value| {
            (
                group["id"].as_str().unwrap().to_owned(),
                group["count"].as_u64().unwrap(),
            )
        };
        groups.iter().map(id).collect()
    };
    let whole = plan(&[]);
    let expected = [
        ("ingest", 2),
        ("ingest.merge", 1),
        ("segment", 2),
        ("segment.merge", 1),
        ("index", 2),
        ("index.merge", 1),
        ("rollout", 2),
        ("rollout.merge", 1),
    ];
    assert_eq!(ids(&whole), expected.map(|(id, count)| (id.to_owned(), count)));
    place.write("plan.json", whole.to_string());
    // Each command runs as it is written.
    for group in &whole["groups"].as_array().unwrap()[..5] {
        for index in 0..group["count"].as_u64().unwrap() {
            if (group["id"].as_str(), index) == (Some("index"), 0) {
                continue;
            }
            let words: Vec<String> = group["command"]
                .as_array()
                .unwrap()
                .iter()
                .map(|word| word.as_str().unwrap().replace("{index}", &index.to_string()))
                .map(|word| word.replace("{count}", &group["count"].to_string()))
                .collect();
            let output = Command::new(&words[0])
                .args(&words[1..])
                .args(["--plan", "plan.json", "-v"])
                .current_dir(place.path())
                .output()
                .unwrap();
            let log = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{words:?}: {log}");
            assert!(log.contains("hash of the source is known"), "{words:?}: {log}");
        }
    }
    let missing = plan(&["--missing"]);
    assert_eq!(ids(&missing)[0], ("index".to_owned(), 2));
    assert_eq!(missing["groups"][0]["indices"], serde_json::json!([0]));
    assert_eq!(missing["groups"][0]["after"], serde_json::json!([]));
    let status = succeeds(&place, "artifacts", &["status", "plan.json"]);
    assert!(status.contains("segment          3/3  done"), "{status}");
    assert!(status.contains("index            2/3  1 parts missing"), "{status}");
    assert!(
        status.contains("rollout          0/3  waiting for earlier stages"),
        "{status}"
    );
    // Looking does not merge, also if nothing else is missing.
    succeeds(&place, "artifacts", &["index", "many.toml", "--shard", "0/2"]);
    for _ in 0..2 {
        let status = succeeds(&place, "artifacts", &["status", "plan.json"]);
        assert!(
            status.contains("index            3/3  all parts made, not merged"),
            "{status}"
        );
    }
    assert_eq!(ids(&plan(&["--missing"]))[0], ("index.merge".to_owned(), 1));
}

#[test]
fn rollouts_in_parts_have_the_summary_of_all_rollouts() {
    let place = Place::new();
    let seeds = ["--seeds", "300000..301500"];
    let whole = succeeds(
        &place,
        "one",
        &[&["rollout", "small.toml", "--max-steps", "8", "--json"][..], &seeds].concat(),
    );
    let rollouts = only(&place, "one", "rollouts");
    assert_eq!(rollouts.parts(), 2);
    let rows: Vec<re4_rollout::PlaneResultRow> = rollouts.read().unwrap();
    assert_eq!(
        rows.iter().map(|row| row.core.episode).collect::<Vec<_>>(),
        (0..1500).collect::<Vec<_>>()
    );
    assert_eq!(
        rows.iter().map(|row| row.core.seed).collect::<Vec<_>>(),
        (300_000..301_500).collect::<Vec<_>>()
    );
    let mean = rows.iter().map(|row| row.score_max).sum::<f64>() / 1500.0;
    let whole: Value = serde_json::from_str(&whole).unwrap();
    assert!((whole["metrics"]["score_scaled_mean"]["value"].as_f64().unwrap() - mean).abs() < 1e-12);
    for shard in ["1/2", "0/2"] {
        succeeds(
            &place,
            "parts",
            &[
                &["rollout", "small.toml", "--max-steps", "8", "--shard", shard][..],
                &seeds,
            ]
            .concat(),
        );
    }
    succeeds(
        &place,
        "parts",
        &[&["merge", "rollout", "small.toml", "--max-steps", "8"][..], &seeds].concat(),
    );
    assert_same(&place, "one", "parts");
    // One of them is another artifact of one part, with the same rows.
    succeeds(
        &place,
        "few",
        &["rollout", "small.toml", "--max-steps", "8", "--seeds", "301024..301500"],
    );
    let few: Vec<re4_rollout::PlaneResultRow> = only(&place, "few", "rollouts").read().unwrap();
    assert_eq!(
        few.iter().map(|row| row.score_max).collect::<Vec<_>>(),
        rows[1024..].iter().map(|row| row.score_max).collect::<Vec<_>>()
    );
}

#[test]
fn a_stage_of_one_part_is_made_by_one_share() {
    let place = Place::new();
    let text = succeeds(&place, "artifacts", &["ingest", "small.toml", "--shard", "0/3"]);
    assert!(text.contains("made 0 of the parts 0..0"), "{text}");
    assert!(!place.path().join("artifacts/episodes").exists());
    let (code, text) = run(&place, "artifacts", &["merge", "ingest", "small.toml"]);
    assert_eq!(code, 3, "{text}");
    succeeds(&place, "artifacts", &["ingest", "small.toml", "--shard", "2/3"]);
    succeeds(&place, "artifacts", &["merge", "ingest", "small.toml"]);
    let (code, text) = run(&place, "artifacts", &["run", "small.toml", "--shard", "0/2"]);
    assert_eq!(code, 2);
    assert!(text.contains("--shard does not apply to this command"), "{text}");
}

/// More than two parts of 256 demonstrations of Push-T.
const PUSHES: u32 = 520;

/// What an index of Push-T must contain, from demonstrations in memory.
struct PlaneOracle {
    frames: Vec<IndexedFrame>,
    rows: Vec<IndexRow<PlanarState>>,
    chunks: Vec<Chunk>,
    normalization: Normalization,
}

/// Computes the index of all demonstrations together. `clear` is the pose of a frame; `None` if it has to be interpolated.
fn plane_oracle(place: &Place, artifacts: &str, clear: impl Fn(usize, Pose2) -> Option<Pose2>) -> PlaneOracle {
    let recorded = only(place, artifacts, "episodes")
        .read::<FrameRow<PlanarColumns>>()
        .unwrap();
    let modes = only(place, artifacts, "modes").read::<ModeRow<Evidence>>().unwrap();
    let (mut demos, mut blanks, mut frames, mut actions) = (Vec::new(), BTreeSet::new(), Vec::new(), Vec::new());
    let mut at = 0;
    for of in recorded.chunk_by(|a, b| a.episode == b.episode) {
        let number = of[0].episode;
        let known: Vec<_> = (at..)
            .zip(of)
            .map(|(at, row)| clear(at, row.recorded.object.unwrap()))
            .collect();
        let start = at;
        at += of.len();
        let Some(poses) = between_clear(&known) else { continue };
        blanks.extend(
            (0..)
                .zip(&known)
                .filter(|(_, pose)| pose.is_none())
                .map(|(frame, _)| (number, frame)),
        );
        let mut of_demo = Vec::new();
        for (place, (row, object)) in (start..).zip(of.iter().zip(poses)) {
            assert_eq!((modes[place].episode, modes[place].frame), (number, row.frame));
            frames.push(IndexedFrame {
                episode: number,
                frame: row.frame,
                mode: modes[place].mode,
                eef: row.recorded.eef,
                object,
            });
            actions.push(row.recorded.action);
            of_demo.push(PlanarFrame {
                eef: row.recorded.eef,
                object,
                action: row.recorded.action,
                contacts: f64::NAN,
            });
        }
        demos.push((number, of_demo));
    }
    let normalization = Normalization::over(&frames, AngleMetric::Periodic);
    let row = |(frame, action): (&IndexedFrame, &Point2)| IndexRow {
        episode: frame.episode,
        frame: frame.frame,
        mode: frame.mode,
        state: PlanarState {
            eef: frame.eef,
            object: frame.object,
            action: *action,
            q: normalization.frame(frame),
        },
        retrievable: Some(!blanks.contains(&(frame.episode, frame.frame))),
    };
    let mut chunks = collect_chunks(&DemoSet::new(demos), 128);
    chunks.retain(|chunk| (chunk.start..=chunk.end).all(|frame| !blanks.contains(&(chunk.demo, frame))));
    PlaneOracle {
        rows: frames.iter().zip(&actions).map(row).collect(),
        frames,
        chunks,
        normalization,
    }
}

/// Compares all tables and the summary of an index in parts with those of all demonstrations in memory.
fn index_is_that_of_all_demonstrations_together(index: &Artifact, oracle: &PlaneOracle) {
    let rows = index.read::<IndexRow<PlanarState>>().unwrap();
    assert_eq!(rows.len(), oracle.rows.len());
    let different = rows
        .iter()
        .zip(&oracle.rows)
        .find(|(found, expected)| found != expected);
    assert!(different.is_none(), "{different:?}");
    assert_eq!(index.read::<Chunk>().unwrap(), oracle.chunks);
    let scales = index.read::<ScaleRow>().unwrap();
    let scales: Vec<_> = scales.iter().map(|row| (row.minimum, row.maximum)).collect();
    let ranges = oracle.normalization.ranges.map(|range| (range.minimum, range.maximum));
    assert_eq!(scales, ranges);
    let episodes: BTreeSet<u32> = rows.iter().map(|row| row.episode).collect();
    let retrievable = rows.iter().filter(|row| row.retrievable == Some(true)).count();
    assert_eq!(
        index.manifest().summary,
        serde_json::json!({ "episodes": episodes.len(), "frames": retrievable, "chunks": oracle.chunks.len() })
    );
}

/// The groups of a plan with two shards: id, number of tasks, and the tasks that remain.
fn groups(place: &Place, pipeline: &str, more: &[&str]) -> Vec<(String, u64, Value)> {
    let arguments = [&["plan", pipeline, "--shards", "2", "--json"], more].concat();
    let plan: Value = serde_json::from_str(&succeeds(place, "parts", &arguments)).unwrap();
    let groups = plan["groups"].as_array().unwrap().iter();
    let group = |group: &Value| {
        (
            group["id"].as_str().unwrap().to_owned(),
            group["count"].as_u64().unwrap(),
            group["indices"].clone(),
        )
    };
    groups.map(group).collect()
}

fn group(id: &str, count: u64, indices: Value) -> (String, u64, Value) {
    (id.to_owned(), count, indices)
}

/// Makes the index in shards, of which one is missing at first, and compares it with that of one process.
fn index_in_shards(place: &Place, pipeline: &str) {
    succeeds(place, "one", &["index", pipeline, "--jobs", "2"]);
    let parts = only(place, "one", "index").parts();
    // It audits, too.
    succeeds(place, "one", &["segment", pipeline]);
    succeeds(place, "parts", &["segment", pipeline]);
    for shard in ["0/7", "6/7", "4/7", "4/7"] {
        succeeds(place, "parts", &["index", pipeline, "--shard", shard]);
    }
    let (code, text) = run(place, "parts", &["merge", "index", pipeline]);
    assert_eq!(code, 3, "{text}");
    assert!(
        text.contains(&format!("1 of its {parts} parts are missing: 0;")),
        "{text}"
    );
    let missing = groups(place, pipeline, &["--missing"]);
    assert_eq!(missing[0], group("index", 2, serde_json::json!([0])));
    succeeds(place, "parts", &["index", pipeline, "--shard", "0/2"]);
    succeeds(place, "parts", &["merge", "index", pipeline]);
    assert_same(place, "one", "parts");
    succeeds(place, "one", &["verify"]);
}

#[test]
fn the_index_of_push_t_in_parts_is_that_of_all_demonstrations() {
    let place = Place::empty();
    dataset::write(&place.dataset(), PUSHES, false);
    // The dataset is counted before it is ingested.
    let expected = [
        group("ingest", 1, Value::Null),
        group("segment", 1, Value::Null),
        group("index", 2, Value::Null),
        group("index.merge", 1, Value::Null),
        group("rollout", 1, Value::Null),
    ];
    assert_eq!(groups(&place, "small.toml", &[]), expected);
    succeeds(&place, "parts", &["ingest", "small.toml"]);
    assert_eq!(groups(&place, "small.toml", &["--missing"]), expected[1..]);
    index_in_shards(&place, "small.toml");
    let index = only(&place, "one", "index");
    assert_eq!((index.parts(), only(&place, "one", "episodes").parts()), (3, 1));
    // Each part has its own demonstrations.
    for part in 0..3 {
        let rows = index.part(part).unwrap().read::<IndexRow<PlanarState>>().unwrap();
        let numbers: BTreeSet<u32> = rows.iter().map(|row| row.episode).collect();
        assert_eq!(numbers, (part * 256..PUSHES.min((part + 1) * 256)).collect());
    }
    let oracle = plane_oracle(&place, "one", |_, pose| Some(pose));
    index_is_that_of_all_demonstrations_together(&index, &oracle);
    let paper = [
        "--set",
        "rollout.policy=paper",
        "--seeds",
        "500..530",
        "--max-steps",
        "40",
    ];
    succeeds(&place, "one", &[&["rollout", "small.toml"][..], &paper].concat());
    decisions_are_those_of_all_demonstrations_together(&only(&place, "one", "rollouts"), &oracle);
}

/// Compares every retrieved frame with that of a linear scan over all demonstrations in memory.
fn decisions_are_those_of_all_demonstrations_together(rollouts: &Artifact, oracle: &PlaneOracle) {
    let normalization = Normalization {
        angle: AngleMetric::Raw,
        ..oracle.normalization
    };
    let own = rollouts.read::<PlaneRe4Row>().unwrap();
    let mut parts = BTreeSet::new();
    for (decision, re4) in rollouts.read::<PlaneDecisionRow>().unwrap().iter().zip(own) {
        let query = Query {
            mode: re4.mode,
            eef: decision.query_eef,
            object: decision.query_object.unwrap(),
        };
        let found = retrieve_linear(&oracle.frames, &normalization, &query, 0.1)
            .unwrap()
            .unwrap();
        assert_eq!(
            (decision.core.demo, decision.core.demo_frame, re4.d_q, re4.d_o),
            (Some(found.episode), Some(found.frame), Some(found.d_q), Some(found.d_o))
        );
        parts.insert(found.episode / 256);
    }
    assert!(parts.len() > 1, "all decisions are from the parts {parts:?}");
}

#[test]
fn the_index_of_estimated_poses_in_parts_is_that_of_all_demonstrations() {
    let place = Place::empty();
    // The estimator needs images, which take long to render.
    dataset::write_short(&place.dataset(), 260, 4);
    let small = fs::read_to_string(place.path().join("small.toml")).unwrap();
    let image = small
        .replace("variant = \"state\"", "variant = \"image\"")
        .replace(
            "source = \"small.zarr\"",
            "source = \"small.zarr\"\nrender = [\"image\"]",
        )
        .replace("source = \"recorded\"", "source = \"log_polar\"");
    place.write("image.toml", image);
    succeeds(&place, "parts", &["train-pose", "image.toml"]);
    index_in_shards(&place, "image.toml");
    let poses = only(&place, "one", "poses");
    let index = only(&place, "one", "index");
    assert_eq!((index.parts(), poses.parts()), (2, 1));
    let estimates = poses.read::<PoseRow<Estimate>>().unwrap();
    let oracle = plane_oracle(&place, "one", |row, _| {
        let estimate = &estimates[row].estimate;
        estimate.pose.filter(|_| estimate.flag == Flag::Clear)
    });
    index_is_that_of_all_demonstrations_together(&index, &oracle);
}

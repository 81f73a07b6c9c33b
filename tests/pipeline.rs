//! End-to-end tests of the stages: what is built, what is skipped, and the results.

use std::fs;

use crate::compare::TWO_ROWS;
use crate::support::dataset::{LENGTH, SIDE, image};
use crate::support::{Answer, Place, artifact_bytes, assert_same_bytes, filters, folders_in};
use insta::{assert_snapshot, with_settings};
use re4_artifact::{Artifact, Row as _, Stage, col_binary, col_f64, col_f64_or_null, col_text, col_u32};
use re4_ingest::{EpisodeRow, FrameRow, ImageRow, PlanarColumns};
use serde_json::Value;

/// The stages in the order of the program's notes, and whether each was skipped.
fn stages(answer: &Answer) -> Vec<(&str, bool)> {
    answer
        .stderr
        .lines()
        // Lines without the path of an artifact are other notes of a stage.
        .filter(|line| line.contains("artifacts/"))
        .map(|line| {
            (
                line.split_whitespace().next().unwrap(),
                line.ends_with("unchanged, skipped"),
            )
        })
        .collect()
}

#[test]
fn a_run_builds_every_stage_and_a_second_one_skips_them() {
    let place = Place::new();
    let first = place.run("run small.toml").done();
    let bytes = place.bytes();
    let second = place.run("run small.toml").done();
    assert_same_bytes(&bytes, &place.bytes());
    assert_eq!(first.stdout, second.stdout);
    assert!(stages(&second).iter().all(|(_, skipped)| *skipped), "{}", second.stderr);
    let mut masks = filters();
    masks.extend([(r"\d\.\d{3}\b", "[figure]"), (r"\b\d+ chunks", "[n] chunks")]);
    with_settings!({filters => masks}, {
        assert_snapshot!("first_run", format!("{}---\n{}", first.stderr, first.stdout));
        assert_snapshot!("second_run", second.stderr);
    });
}

#[test]
fn json_output_is_one_object_with_the_documented_keys() {
    let place = Place::new();
    let answer = place.run("run small.toml --json").done();
    let object = answer.json();
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(
        keys(&object),
        [
            "task",
            "variant",
            "policy",
            "episodes",
            "max_steps",
            "metrics",
            "artifact",
            "warnings",
            "wall_s"
        ]
    );
    let metrics = &object["metrics"];
    assert_eq!(
        keys(metrics),
        ["score_scaled_mean", "coverage_raw_mean", "iou_mean", "success_rate"]
    );
    for (_, metric) in metrics.as_object().unwrap() {
        assert_eq!(keys(metric), ["value", "low", "high"]);
    }
    assert_eq!(object["task"], "pusht");
    assert_eq!(object["variant"], "state");
    assert_eq!(object["policy"], "re4");
    assert_eq!(object["episodes"], 6);
    assert_eq!(object["max_steps"], 60);
    assert!(object["wall_s"].as_f64().unwrap() > 0.0);

    let rollouts = place.artifact(Stage::Rollout);
    assert_eq!(
        object["artifact"].as_str().unwrap(),
        format!("artifacts/rollouts/{}", rollouts.key().short())
    );
    let results = crate::support::results(&rollouts);
    for (name, column) in [
        ("score_scaled_mean", "score_max"),
        ("coverage_raw_mean", "coverage_max"),
        ("iou_mean", "iou_max"),
    ] {
        let values = col_f64(&results, column).unwrap();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let [value, low, high] = ["value", "low", "high"].map(|key| metrics[name][key].as_f64().unwrap());
        assert!((value - mean).abs() < 1e-12, "{name}: {value} is not {mean}");
        let minimum = values.iter().copied().fold(f64::INFINITY, f64::min);
        let maximum = values.iter().copied().fold(0.0, f64::max);
        assert!(
            minimum <= low && low <= value && value <= high && high <= maximum,
            "{name}"
        );
    }
    let successes = re4_artifact::col_bool(&results, "success").unwrap().true_count() as f64;
    let count = results.num_rows() as f64;
    let rate = successes / count;
    // Wilson's interval with z = 1.96.
    let z2 = 1.96_f64.powi(2);
    let centre = (rate + z2 / (2.0 * count)) / (1.0 + z2 / count);
    let half = 1.96 / (1.0 + z2 / count) * (rate * (1.0 - rate) / count + z2 / (4.0 * count * count)).sqrt();
    let expected = [rate, (centre - half).max(0.0), (centre + half).min(1.0)];
    for (key, expected) in ["value", "low", "high"].into_iter().zip(expected) {
        let stated = metrics["success_rate"][key].as_f64().unwrap();
        assert!(
            (stated - expected).abs() < 1e-4,
            "success_rate.{key}: {stated} is not {expected}"
        );
    }
}

#[test]
fn json_output_of_every_command_is_one_object() {
    let place = Place::new();
    for (command, stage) in [
        ("ingest", "ingest"),
        ("segment", "segment"),
        ("index", "index"),
        ("replay", "replay"),
    ] {
        let answer = place.run(&format!("{command} small.toml --json --quiet")).done();
        assert_eq!(answer.stderr, "", "{command}");
        let object = answer.json();
        let keys: Vec<&String> = object.as_object().unwrap().keys().collect();
        let mut expected = vec!["stage", "artifact", "key", "skipped", "summary", "warnings", "wall_s"];
        // `segment` also runs the audit.
        expected.extend((command == "segment").then_some("audit"));
        assert_eq!(keys, expected);
        assert_eq!(object["stage"], stage);
        assert_eq!(object["skipped"], false);
        let again = place.run(&format!("{command} small.toml --json --quiet")).done().json();
        assert_eq!(again["skipped"], true);
        assert_eq!((&again["key"], &again["summary"]), (&object["key"], &object["summary"]));
    }
    assert_eq!(place.run("rollout small.toml --json").done().json()["episodes"], 6);
    let verified = place.run("verify --json").done().json();
    assert_eq!(verified["intact"].as_array().unwrap().len(), 6);
    assert_eq!(verified["damaged"], serde_json::json!([]));
}

#[test]
fn quiet_prints_only_the_result() {
    let place = Place::new();
    for _ in 0..2 {
        let answer = place.run("run small.toml --quiet").done();
        assert_eq!(answer.stderr, "");
        assert!(
            answer.stdout.starts_with("policy re4, 6 rollouts of at most 60 steps"),
            "{}",
            answer.stdout
        );
    }
}

#[test]
fn a_single_stage_builds_the_stages_it_needs() {
    let place = Place::new();
    assert_eq!(
        stages(&place.run("segment small.toml").done()),
        [("ingest", false), ("segment", false), ("audit", false)]
    );
    assert_eq!(
        stages(&place.run("index small.toml").done()),
        [("ingest", true), ("segment", true), ("index", false)]
    );
    assert_eq!(
        stages(&place.run("replay small.toml").done()),
        [("ingest", true), ("replay", false)]
    );
    let expected = [("ingest", true), ("segment", true), ("index", true), ("rollout", false)];
    assert_eq!(stages(&place.run("rollout small.toml").done()), expected);
}

#[test]
fn bytes_do_not_depend_on_threads_or_on_the_run() {
    let place = Place::new();
    let mut reference = None;
    for (name, jobs) in [
        ("one", "--jobs 1"),
        ("two", "--jobs 2"),
        ("four", "--jobs 4"),
        ("again", ""),
        ("last", ""),
    ] {
        place.run(&format!("run small.toml --artifacts {name} {jobs}")).done();
        place
            .run(&format!("replay small.toml --artifacts {name} {jobs}"))
            .done();
        let bytes = artifact_bytes(&place.path().join(name));
        assert_eq!(bytes.keys().filter(|file| file.ends_with("manifest.json")).count(), 5);
        assert_same_bytes(reference.get_or_insert(bytes.clone()), &bytes);
    }
    // A dataset with the same content in another folder gives the same bytes, too.
    let other = Place::new();
    other.run("run small.toml").done();
    other.run("replay small.toml").done();
    assert_same_bytes(&reference.unwrap(), &other.bytes());
}

#[test]
fn a_changed_setting_rebuilds_the_stages_after_it() {
    let place = Place::new();
    place.run("run small.toml").done();
    let built = |arguments: &str| -> Vec<String> {
        let answer = place.run(&format!("run small.toml {arguments}")).done();
        let names = stages(&answer).into_iter().filter(|(_, skipped)| !skipped);
        names.map(|(name, _)| name.to_owned()).collect()
    };
    assert_eq!(built("--max-steps 50"), ["rollout"]);
    assert_eq!(
        built("--set rollout.max_steps=50"),
        [""; 0],
        "the flag and the override are equivalent"
    );
    assert_eq!(built("--set rollout.replan.keepout=19"), ["rollout"]);
    assert_eq!(built("--policy paper"), ["rollout"]);
    assert_eq!(built("--set index.longest_chunk=64"), ["index", "rollout"]);
    assert_eq!(
        built("--set segment.minimum_motion=0.2"),
        ["segment", "index", "rollout"]
    );
    assert_eq!(
        built("--set ingest.select.first=11"),
        ["ingest", "segment", "index", "rollout"]
    );
    assert_eq!(built("--no-images"), ["ingest", "segment", "index", "rollout"]);
    assert_eq!(
        built("--set ingest.images=false"),
        [""; 0],
        "the flag and the override are equivalent"
    );
    assert_eq!(built(""), [""; 0]);
    fs::rename(place.dataset(), place.path().join("data/moved.zarr")).unwrap();
    assert_eq!(
        built("--set ingest.source=moved.zarr"),
        [""; 0],
        "the key depends on the content, not on the path"
    );
    let chunk = place.path().join("data/moved.zarr/data/img/0.0.0.0");
    let mut bytes = fs::read(&chunk).unwrap();
    bytes[1] ^= 1;
    fs::write(chunk, bytes).unwrap();
    assert_eq!(
        built("--set ingest.source=moved.zarr"),
        ["ingest", "segment", "index", "rollout"],
        "the key depends on every byte of the dataset"
    );
}

#[test]
fn episodes_are_selected_by_number() {
    let place = Place::new();
    place.run("ingest small.toml --artifacts all").done();
    let read = |artifacts: &str, table| {
        let folder = folders_in(&place.path().join(artifacts).join("episodes")).remove(0);
        let artifact = Artifact::open(&folder).unwrap();
        artifact.table(table).unwrap().read_all().unwrap()
    };
    let all = read("all", FrameRow::<PlanarColumns>::table());
    assert_eq!(all.num_rows(), 12 * LENGTH);
    for (name, selection, expected) in [
        ("first", "first=3", vec![0, 1, 2]),
        ("last", "last=2", vec![10, 11]),
        ("list", "episodes=[7,0,5]", vec![0, 5, 7]),
        ("range", "range=2..5", vec![2, 3, 4]),
    ] {
        place
            .run(&format!(
                "ingest small.toml --artifacts {name} --set ingest.select.{selection}"
            ))
            .done();
        let episodes = read(name, EpisodeRow::table());
        assert_eq!(col_u32(&episodes, "source_episode").unwrap(), expected, "{name}");
        assert_eq!(
            col_u32(&episodes, "frames").unwrap(),
            vec![LENGTH as u32; expected.len()],
            "{name}"
        );
        let (frames, images) = (
            read(name, FrameRow::<PlanarColumns>::table()),
            read(name, ImageRow::table()),
        );
        let images = col_binary(&images, "image").unwrap();
        assert_eq!(frames.num_rows(), expected.len() * LENGTH, "{name}");
        for (position, source) in expected.iter().map(|source| *source as usize).enumerate() {
            for column in ["eef_x", "object_theta", "action_y"] {
                let (selected, complete) = (col_f64(&frames, column).unwrap(), col_f64(&all, column).unwrap());
                assert_eq!(
                    selected[position * LENGTH..(position + 1) * LENGTH],
                    complete[source * LENGTH..(source + 1) * LENGTH],
                    "{name} {column}"
                );
            }
            let png = image::load_from_memory(images.value(position * LENGTH + 3)).unwrap();
            assert_eq!(
                png.into_rgb8().into_raw(),
                image(source * LENGTH + 3, 12 * LENGTH),
                "{name}"
            );
        }
    }
}

#[test]
fn images_are_stored_without_loss_or_left_out() {
    let place = Place::new();
    place.run("ingest small.toml").done();
    let with = place.artifact(Stage::Ingest);
    let images = with.table(ImageRow::table()).unwrap().read_all().unwrap();
    assert_eq!(images.num_rows(), 12 * LENGTH);
    let (episode, frame) = (col_u32(&images, "episode").unwrap(), col_u32(&images, "frame").unwrap());
    let pngs = col_binary(&images, "image").unwrap();
    for row in 0..images.num_rows() {
        assert_eq!(
            (episode[row] as usize, frame[row] as usize),
            (row / LENGTH, row % LENGTH)
        );
        let png = image::load_from_memory(pngs.value(row)).unwrap().into_rgb8();
        assert_eq!(png.dimensions(), (SIDE as u32, SIDE as u32));
        assert_eq!(png.into_raw(), image(row, 12 * LENGTH), "row {row}");
    }
    place.run("ingest small.toml --artifacts without --no-images").done();
    let folder = folders_in(&place.path().join("without/episodes")).remove(0);
    let without = Artifact::open(&folder).unwrap();
    assert!(!folder.join("images.parquet").exists());
    for table in ["frames", "episodes"] {
        let hash = |artifact: &Artifact| artifact.manifest().tables[table].blake3;
        assert_eq!(hash(&with), hash(&without), "{table}");
    }
}

#[test]
fn a_dataset_without_images_is_ingested_with_a_warning() {
    let place = Place::new();
    fs::remove_dir_all(place.dataset().join("data/img")).unwrap();
    let object = place.run("ingest small.toml --json").done().json();
    assert_eq!(object["summary"]["images"], 0);
    let codes: Vec<&str> = object["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|w| w["code"].as_str())
        .collect();
    assert!(codes.contains(&"no_images"), "{codes:?}");
}

#[test]
fn a_recording_is_a_dataset_of_the_rollouts() {
    let place = Place::new();
    place.run("run small.toml --record out.zarr").done();
    let rollouts = place.artifact(Stage::Rollout);
    let results = crate::support::results(&rollouts);
    let steps = crate::support::steps(&rollouts);

    let source = place.path().join("out.zarr");
    let again = format!(
        "ingest small.toml --artifacts recorded --set ingest.source={}",
        source.display()
    );
    place.run(&again).done();
    let folder = folders_in(&place.path().join("recorded/episodes")).remove(0);
    let recorded = Artifact::open(&folder).unwrap();
    let episodes = recorded.table(EpisodeRow::table()).unwrap().read_all().unwrap();
    let frames = recorded
        .table(FrameRow::<PlanarColumns>::table())
        .unwrap()
        .read_all()
        .unwrap();
    assert_eq!(
        col_u32(&episodes, "frames").unwrap(),
        col_u32(&results, "steps").unwrap()
    );
    assert_eq!(frames.num_rows(), steps.num_rows());

    let single = |value: f64| f64::from(value as f32);
    let contacts = col_f64_or_null(&frames, "contacts").unwrap();
    let number = col_u32(&frames, "frame").unwrap();
    let rollout = col_u32(&frames, "episode").unwrap();
    for row in 0..frames.num_rows() {
        // The state of a frame is the state after the previous step.
        let before = |in_results: &str, in_steps: &str| match number[row] {
            0 => col_f64(&results, in_results).unwrap()[rollout[row] as usize],
            _ => col_f64(&steps, in_steps).unwrap()[row - 1],
        };
        for (column, in_results, in_steps) in [
            ("eef_x", "eef_x", "eef_x"),
            ("eef_y", "eef_y", "eef_y"),
            ("object_x", "object_x", "object_x"),
            ("object_y", "object_y", "object_y"),
            ("object_theta", "object_theta", "object_theta"),
        ] {
            let found = col_f64(&frames, column).unwrap()[row];
            assert_eq!(found, single(before(in_results, in_steps)), "{column} of row {row}");
        }
        assert_eq!(contacts[row], Some(single(before("contacts", "contacts"))), "row {row}");
        for column in ["action_x", "action_y"] {
            let (found, executed) = (col_f64(&frames, column).unwrap(), col_f64(&steps, column).unwrap());
            assert_eq!(found[row], single(executed[row]), "{column} of row {row}");
        }
    }
    // A pipeline can use the recording as its dataset.
    place.run(&again.replacen("ingest", "run", 1)).done();
}

#[test]
fn a_recording_never_replaces_anything() {
    let place = Place::new();
    place.run("run small.toml --record out.zarr").done();
    let before = fs::read(place.path().join("out.zarr/data/state/0.0")).unwrap();
    let existing = place
        .run("run small.toml --seeds 900..902 --record out.zarr")
        .refused_at_once();
    assert_eq!(fs::read(place.path().join("out.zarr/data/state/0.0")).unwrap(), before);
    assert_eq!(
        folders_in(&place.artifacts().join("rollouts")).len(),
        1,
        "it is refused before any rollout"
    );
    let lost = place
        .run("run small.toml --quiet --record no/such/folder/out.zarr")
        .refused();
    assert_snapshot!(format!("{existing}\n{lost}"));
}

/// Tables that are not of Push-T: those of robosuite tasks, and that of unusable demonstrations.
const OTHERS: [&str; 26] = [
    "conventions",
    // Written by observe.
    "copies",
    "measured",
    "observations",
    "paths",
    "reference",
    "sketches",
    "thresholds",
    "usual",
    // Written by influence and curate.
    "curated",
    "curation_judged",
    "curation_rounds",
    "influence",
    "influence_pairs",
    "judged_episodes",
    "grasps",
    "labels",
    "left_out",
    "left_out_frames",
    "models",
    "pose_errors",
    "rule_agreement",
    "signals",
    "states",
    "training",
    // Written only by rollouts with other goals or disturbances.
    "worlds",
];

#[test]
fn inspect_shows_every_artifact() {
    let place = Place::new();
    place.run("run small.toml").done();
    place.run("replay small.toml").done();
    place.run("audit small.toml").done();
    place.write_sparse();
    place.run("scenes sparse.toml").done();
    let mut seen = Vec::new();
    let stages: Vec<(Stage, Artifact)> = [
        Stage::Ingest,
        Stage::Segment,
        Stage::Audit,
        Stage::Index,
        Stage::Scenes,
        Stage::Rollout,
        Stage::Replay,
    ]
    .map(|stage| (stage, place.artifact(stage)))
    .into();
    // Made afterwards, because they have other episodes or several rollouts.
    place.write_image();
    place.run("train-pose image.toml").done();
    place.write("suite.toml", TWO_ROWS);
    place.run("compare suite.toml").done();
    place
        .run("train small.toml --policy flow --set policy.training.steps=20 --set policy.training.batch=8")
        .done();
    let more = [Stage::TrainPose, Stage::Compare, Stage::Train].map(|stage| (stage, place.artifact(stage)));
    for (stage, artifact) in stages.into_iter().chain(more) {
        let path = artifact
            .path()
            .strip_prefix(place.path())
            .unwrap()
            .to_str()
            .unwrap()
            .to_owned();
        let text = place.run(&format!("inspect {path}")).done();
        assert_eq!(text.stderr, "");
        let object = place.run(&format!("inspect {path} --json")).done().json();
        assert_eq!(object["path"], path.as_str());
        assert_eq!(object["manifest"], serde_json::to_value(artifact.manifest()).unwrap());
        for (name, summary) in &artifact.manifest().tables {
            let heading = format!(
                "table {name} (version {}): {} rows",
                summary.schema_version, summary.rows
            );
            assert!(text.stdout.contains(&heading), "{heading}\n{}", text.stdout);
            let columns = object["tables"][name]["columns"].as_array().unwrap();
            let spec = re4_stages::tables::described(&artifact, name).unwrap();
            assert_eq!(columns.len(), spec.columns.len());
            for column in spec.columns {
                assert!(text.stdout.contains(&format!("  {} ", column.name)), "{}", column.name);
            }
            seen.push(name.clone());
        }
        let rows = place.run(&format!("inspect {path} --rows 2")).done().stdout;
        assert!(rows.contains("rows 0 to ") && rows.len() > text.stdout.len(), "{rows}");
        if stage == Stage::Segment {
            with_settings!({filters => filters()}, { assert_snapshot!("inspect_modes", text.stdout) });
        }
    }
    seen.sort();
    let mut known: Vec<&str> = re4_stages::tables::all()
        .map(|(_, spec)| spec.name)
        // Tables of policies other than RE4 are tested with these policies.
        .filter(|name| *name == "decisions_re4" || !name.starts_with("decisions_"))
        .filter(|name| !name.starts_with("spatial_") && !OTHERS.contains(name))
        .collect();
    known.sort_unstable();
    known.dedup();
    assert_eq!(seen, known);
    let refusals = [
        "inspect artifacts/modes/0000000000000000",
        "inspect small.toml",
        "inspect data",
    ]
    .map(|arguments| place.run(arguments).refused_at_once());
    assert_snapshot!("inspect_refusals", refusals.join("\n"));
}

#[test]
fn plots_of_rollouts_and_of_divergence_are_written() {
    let place = Place::new();
    place.run("run small.toml").done();
    let path = place.artifact(Stage::Rollout).path().display().to_string();
    place
        .run(&format!("inspect {path} --seed 502 --image rollout.svg"))
        .done();
    place.run("replay small.toml --plot divergence.svg").done();
    for name in ["rollout.svg", "divergence.svg"] {
        let svg = fs::read_to_string(place.path().join(name)).unwrap();
        assert!(svg.starts_with("<svg") || svg.starts_with("<?xml"), "{name}");
        assert!(svg.trim_end().ends_with("</svg>"), "{name}");
    }
    let refusals = [
        format!("inspect {path} --seed 999 --image other.svg"),
        format!("inspect {path} --seed 502 --image no/folder/other.svg"),
    ]
    .map(|arguments| place.run(&arguments).refused_at_once());
    with_settings!({filters => filters()}, { assert_snapshot!(refusals.join("\n")) });
    assert!(!place.path().join("other.svg").exists());
}

#[test]
fn verify_names_every_artifact() {
    let place = Place::new();
    place.run("run small.toml").done();
    let text = place.run("verify").done();
    let mut masks = filters();
    masks.push((r"\d+ bytes", "[n] bytes"));
    with_settings!({filters => masks}, { assert_snapshot!("verify", text.stdout) });
    let object = place.run("verify --json").done().json();
    let intact = object["intact"].as_array().unwrap();
    assert_eq!(intact.len(), 4);
    for artifact in intact {
        let path = place.path().join(artifact["artifact"].as_str().unwrap());
        let bytes: u64 = fs::read_dir(&path)
            .unwrap()
            .map(|file| file.unwrap().metadata().unwrap().len())
            .sum();
        assert_eq!(artifact["bytes"], bytes);
        assert_eq!(
            artifact["key"].as_str().unwrap()[..16],
            *path.file_name().unwrap().to_str().unwrap()
        );
    }
    let one = place.artifact(Stage::Index).path().display().to_string();
    assert_eq!(place.run(&format!("verify {one}")).done().stdout.lines().count(), 1);
    let refusals =
        ["verify --artifacts absent", "verify --artifacts data", "verify absent"].map(|arguments| place.run(arguments));
    let sentences: Vec<String> = refusals.into_iter().map(Answer::refused_at_once).collect();
    assert_snapshot!("verify_refusals", sentences.join("\n"));
}

#[test]
fn all_presets_record_their_decisions() {
    let place = Place::new();
    for (preset, plans, moves) in [("re4", true, true), ("paper", true, true), ("re2", false, false)] {
        place
            .run(&format!("run small.toml --policy {preset} --artifacts {preset}"))
            .done();
        let folder = folders_in(&place.path().join(preset).join("rollouts")).remove(0);
        let artifact = Artifact::open(&folder).unwrap();
        let decisions = crate::support::decisions(&artifact);
        let kinds = col_text(&decisions, "plan").unwrap();
        assert_eq!(kinds.iter().any(|kind| *kind != Some("off")), plans, "{preset}");
        let deltas = ["delta_x", "delta_y", "delta_theta"].map(|name| col_f64(&decisions, name).unwrap());
        assert_eq!(
            deltas.iter().any(|column| column.iter().any(|d| *d != 0.0)),
            moves,
            "{preset}"
        );
    }
}

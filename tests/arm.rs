//! End-to-end tests of the task `arm`: the sample of `data/`, read without its object.

use std::collections::BTreeSet;

use crate::support::{Answer, Place, real_data, repository};
use re4_segment::Rule;

/// `data/README.md` lists the faults. Of `demo_6` and `demo_8`, only the object shows the fault.
const FAULTS: [(&str, &str); 13] = [
    ("demo_3", "missed_grasp"),
    ("demo_3", "regrasp"),
    ("demo_5", "ends_before_success"),
    ("demo_5", "lost_grasp"),
    ("demo_8", "ends_before_success"),
    ("demo_10", "ends_before_success"),
    ("demo_10", "no_transfer"),
    ("demo_11", "flicker"),
    ("demo_13", "frozen"),
    ("demo_14", "saturated"),
    ("demo_14", "saturated_together"),
    ("demo_16", "duplicate"),
    ("demo_18", "discontinuity_eef"),
];

fn on_sample(place: &Place, command: &str, pipeline: &str, more: &[&str]) -> Answer {
    let output = place
        .command()
        .env("RE4_DATA", repository().join("data"))
        .arg(command)
        .arg(repository().join("pipelines").join(pipeline))
        .args(["--set", "ingest.source=can-sample.hdf5"])
        .args(more)
        .output()
        .unwrap();
    Answer::new(&output, place.path())
}

/// The modes of a `modes` artifact, in order.
fn modes(place: &Place, pipeline: &str, more: &[&str]) -> Vec<bool> {
    let answer = on_sample(place, "segment", pipeline, &[more, &["--json", "--quiet"]].concat());
    let folder = answer.done().json()["artifact"].as_str().unwrap().to_owned();
    let artifact = re4_artifact::Artifact::open(&place.path().join(folder)).unwrap();
    let rows = artifact.table_named("modes").unwrap().read_all().unwrap();
    let modes = re4_artifact::col_text(&rows, "mode").unwrap();
    modes.into_iter().map(|mode| mode == Some("transfer")).collect()
}

#[test]
fn modes_agree_with_those_of_the_rule_that_knows_the_gripper() {
    let place = Place::empty();
    let own = modes(&place, "arm-audit.toml", &[]);
    let rule = format!("segment.rule={}", Rule::Grasp.as_str());
    let known = modes(&place, "can-sample-audit.toml", &["--set", &rule]);
    let both = own.iter().zip(&known).filter(|(a, b)| **a && **b).count();
    let either = own.iter().chain(&known).filter(|transfer| **transfer).count();
    let f1 = 2.0 * both as f64 / either as f64;
    assert!(own.len() == known.len() && f1 > 0.98, "{f1}");
}

#[test]
fn faults_that_need_no_object_are_found() {
    let place = Place::empty();
    let answer = on_sample(&place, "audit", "arm-audit.toml", &["--json", "--quiet"])
        .done()
        .json();
    let found: BTreeSet<(&str, &str)> = answer["findings"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|finding| finding["severity"] != "note")
        .map(|finding| (finding["demo"].as_str().unwrap(), finding["code"].as_str().unwrap()))
        .collect();
    assert_eq!(found, BTreeSet::from(FAULTS));
    let without_object = answer["checks"].as_array().unwrap().iter().filter(|check| {
        let derivation = check["derivation"].as_str().unwrap();
        derivation == "not made: the dataset has no pose of an object"
    });
    assert_eq!(without_object.count(), 10);
}

/// The faults of the sample are found in the same way after an export to LeRobot, whose names say what its numbers are.
#[test]
fn an_exported_lerobot_dataset_is_audited() {
    for format in ["lerobot", "lerobot-v2.1"] {
        let place = Place::empty();
        let ingested = on_sample(&place, "ingest", "can-sample-audit.toml", &["--json", "--quiet"]).done();
        let episodes = ingested.json()["artifact"].as_str().unwrap().to_owned();
        place
            .run(&format!("export {episodes} data/set --format {format} --quiet"))
            .done();
        let set = place.path().join("data/set");
        let source = format!("ingest.source={}", set.display());
        let about = place.run_each(&["inspect", set.to_str().unwrap()]).done().stdout;
        // Long lines are wrapped.
        let about = about.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(
            about.contains(
                "task = \"arm\", segment.rule = \"gripper\"; the checks that do not need the pose of an object"
            ),
            "{about}"
        );
        let more = ["--set", &source, "--quiet", "--html", "page.html"];
        let text = on_sample(&place, "audit", "arm-audit.toml", &more).done().stdout;
        for line in [
            "\n  error    lost_grasp                       1      1  0.125 of the travel (default)\n",
            "\n  warning  saturated                        1      1  ",
            "\n  10 checks could not be made:\n    the dataset has no pose of an object: discontinuity_object, dropped, ",
            "\n    episode 18        5-6  the end effector jumps by 89 mm in one step\n",
        ] {
            assert!(text.contains(line), "{format}: {line:?} is not in {text}");
        }
        let page = std::fs::read_to_string(place.path().join("page.html")).unwrap();
        assert!(page.contains("because the dataset has no pose of an object"), "{page}");
        let answer = on_sample(
            &place,
            "audit",
            "arm-audit.toml",
            &["--set", &source, "--json", "--quiet"],
        )
        .done();
        let answer = answer.json();
        let found: BTreeSet<(u64, &str)> = answer["findings"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|finding| finding["severity"] != "note")
            .map(|finding| (finding["episode"].as_u64().unwrap(), finding["code"].as_str().unwrap()))
            .collect();
        let expected = FAULTS.map(|(demo, code)| (demo.trim_start_matches("demo_").parse().unwrap(), code));
        assert_eq!(found, BTreeSet::from(expected), "{format}");
    }
}

/// A file that the tasks of robosuite refuse is one of an arm all the same, and `inspect` says so.
#[test]
fn inspect_names_the_task_that_fits() {
    let place = Place::empty();
    let Some(data) = real_data() else { return };
    for (name, expected) in [
        ("h22_joint_actions_8", "task = \"arm\", segment.rule = \"gripper\"; "),
        ("h20_isaaclab_layout", "task = \"arm\", segment.rule = \"gripper\"; "),
        (
            "h21_two_arms",
            "task = \"arm\", segment.rule = \"gripper\", ingest.arm.arm = \"robot0\", ingest.arm.action_elements (its part of an action); ",
        ),
    ] {
        let file = data.join(format!("foreign/{name}/{name}.hdf5"));
        if !file.is_file() {
            println!("skipped: no {}", file.display());
            continue;
        }
        let path = file.to_str().unwrap();
        let about = place.run_each(&["inspect", path, "--json"]).done().json();
        let uses = about["dataset"]["uses"].as_array().unwrap();
        let how = |use_: usize| uses[use_]["how"].as_str().unwrap();
        assert!(how(0).starts_with(expected), "{name}: {}", how(0));
        let possible: Vec<bool> = uses.iter().map(|each| each["possible"] == true).collect();
        assert_eq!(possible, [true, true, false, false], "{name}");
        // The reasons why there are no rollouts remain.
        assert!(how(3).contains("; "), "{name}: {}", how(3));
    }
}

#[test]
fn commands_that_need_an_object_say_so() {
    let place = Place::empty();
    for command in [
        "index",
        "train-encoder",
        "train-pose",
        "train",
        "scenes",
        "rollout",
        "replay",
        "influence",
        "curate",
    ] {
        let said = on_sample(&place, command, "arm-audit.toml", &[]).refused();
        let what = "error: a dataset of the task \"arm\" has no object, so it can be audited and segmented, but this command needs object poses";
        assert!(said.starts_with(what), "{command}: {said}");
    }
}

#[test]
fn settings_that_do_not_fit_are_refused() {
    let place = Place::empty();
    for (setting, part) in [
        ("segment.rule=evidence", "set it to \"gripper\" for the task \"arm\""),
        ("ingest.object=Can", "ingest.object does not apply to the task \"arm\""),
        (
            "variant=state",
            "the pipeline file has variant; remove it and stop at the audit",
        ),
        (
            "ingest.arm.joints=q",
            "there is no dataset data/demo_0/obs/q; give one of object, robot0_eef_pos",
        ),
        ("ingest.arm.gripper_command=9", "an action has 7 elements; give 0 to 6"),
        (
            "ingest.arm.action_elements=[4, 2]",
            "give the first index and a larger end index",
        ),
        (
            "ingest.arm.arm=robot1",
            "no datasets of the observations begin with robot1_; give one of \"robot0\"",
        ),
    ] {
        let said = on_sample(&place, "segment", "arm-audit.toml", &["--set", setting]).refused();
        assert!(said.contains(part), "{setting}: {said}");
    }
}

#[test]
fn an_export_is_refused() {
    let place = Place::empty();
    let answer = on_sample(&place, "ingest", "arm-audit.toml", &["--json", "--quiet"]);
    let episodes = answer.done().json()["artifact"].as_str().unwrap().to_owned();
    for format in ["lerobot", "lerobot-v2.1", "robomimic", "pusht-zarr"] {
        let said = place.run(&format!("export {episodes} out --format {format}")).refused();
        assert!(
            said.contains("are of the task \"arm\", for which there is no export"),
            "{format}: {said}"
        );
        assert!(!place.path().join("out").exists());
    }
}

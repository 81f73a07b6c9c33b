//! End-to-end tests of the task `arm`: the sample of `data/`, read without its object.

use crate::support::{Answer, Place, repository};
use insta::assert_snapshot;
use re4_segment::Rule;

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
    (0..rows.num_rows()).map(|row| modes.value(row) == "transfer").collect()
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
    let severe = |finding: &&serde_json::Value| finding["severity"] != "note";
    let found = answer["findings"].as_array().unwrap().iter().filter(severe);
    let mut found: Vec<String> = found
        .map(|f| format!("{} {}", f["demo"].as_str().unwrap(), f["code"].as_str().unwrap()))
        .collect();
    found.sort();
    assert_snapshot!(found.join("\n"));
    let not_made = answer["checks"].as_array().unwrap().iter().filter(|check| {
        check["derivation"]
            .as_str()
            .unwrap()
            .starts_with("not made: the dataset has no pose of an object")
    });
    assert_eq!(not_made.count(), 11);
}

#[test]
fn commands_that_need_an_object_say_so() {
    let place = Place::empty();
    let mut said = String::new();
    for command in ["index", "train-pose", "train", "scenes", "rollout", "replay"] {
        said += &format!(
            "{command}: {}\n",
            on_sample(&place, command, "arm-audit.toml", &[]).refused()
        );
    }
    for settings in [
        "segment.rule=evidence",
        "ingest.object=Can",
        "variant=state",
        "ingest.arm.joints=q",
        "ingest.arm.gripper_command=9",
        "ingest.arm.action_elements=[4, 2]",
        "ingest.arm.arm=robot1",
    ] {
        let answer = on_sample(&place, "segment", "arm-audit.toml", &["--set", settings]);
        said += &format!("{settings}: {}\n", answer.refused());
    }
    assert_snapshot!(said);
}

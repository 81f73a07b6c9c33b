//! The schemas in `schemas/` are up to date and match the files that stages write.

use std::collections::BTreeSet;
use std::fs;

use crate::compare::{TWO_ROWS, is_suite};
use crate::support::{Answer, Place, compare_with_schemas, repository};

#[test]
fn the_committed_schemas_are_up_to_date() {
    let place = Place::empty();
    let folder = repository().join("schemas");
    let answer = place.run_each(&["schemas", folder.to_str().unwrap(), "--check"]);
    assert_eq!(answer.code, Some(0), "{}{}", answer.stdout, answer.stderr);
    let named: BTreeSet<String> = fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    place.run("schemas written").done();
    let written: BTreeSet<String> = fs::read_dir(place.path().join("written"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(named, written, "schemas/ has other files");
}

#[test]
fn the_committed_reference_pages_are_up_to_date() {
    let place = Place::empty();
    let folder = repository().join("docs/reference");
    let answer = place.run_each(&["reference", folder.to_str().unwrap(), "--check"]);
    assert_eq!(answer.code, Some(0), "{}{}", answer.stdout, answer.stderr);
}

#[test]
fn a_check_finds_stale_schemas_and_writes_nothing() {
    let place = Place::empty();
    place.run("schemas described").done();
    let file = place.path().join("described/frames-plane.json");
    let stale = fs::read_to_string(&file).unwrap().replace("px", "pixel");
    fs::write(&file, &stale).unwrap();
    fs::remove_file(place.path().join("described/modes-plane.json")).unwrap();
    let answer = place.run("schemas described --check");
    assert_eq!(answer.code, Some(1));
    assert_eq!(
        answer.stdout,
        "out of date in described: frames-plane.json, modes-plane.json; run re4-pipe schemas\n"
    );
    assert_eq!(fs::read_to_string(&file).unwrap(), stale);
    let object = place.run("schemas described --check --json").json();
    assert_eq!(
        object["stale"],
        serde_json::json!(["frames-plane.json", "modes-plane.json"])
    );
}

/// Reads the files with the Parquet library only, so that the schemas are compared with the files and not with the declarations
/// from which they were generated.
#[test]
fn the_schemas_match_the_written_columns() {
    let place = Place::new();
    place.run("run small.toml").done();
    place.run("replay small.toml").done();
    place.write_sparse();
    place.run("scenes sparse.toml").done();
    place.write_image();
    place.run("train-pose image.toml").done();
    place.run("audit small.toml").done();
    place.write("suite.toml", TWO_ROWS);
    place.run("compare suite.toml").done();
    place
        .run("train small.toml --policy flow --set policy.training.steps=20 --set policy.training.batch=8")
        .done();
    place
        .run("rollout small.toml --set rollout.goal=random --set rollout.seeds=500..502")
        .done();
    for (pipeline, settings) in [
        ("can-sample-audit.toml", &[][..]),
        ("arm-audit.toml", &["--set", "ingest.source=can-sample.hdf5"]),
    ] {
        let audited = place
            .command()
            .env("RE4_DATA", repository().join("data"))
            .args(["audit", "--quiet"])
            .arg(repository().join("pipelines").join(pipeline))
            .args(settings)
            .output()
            .unwrap();
        Answer::new(&audited, place.path()).done();
    }
    let sample = repository().join("data/can-sample.hdf5");
    place.write(
        "can.toml",
        format!(
            "task = \"can\"\n[ingest]\nsource = \"{}\"\n[segment]\n[pose]\nsource = \"recorded\"\n[index]\n",
            sample.display()
        ),
    );
    place.run("index can.toml").done();
    place.run("observe can.toml").done();
    let compared = compare_with_schemas(&place);
    let missing: Vec<String> = re4_stages::tables::all()
        .map(|(_, table)| table.title())
        .filter(|title| !compared.contains(title))
        .filter(|title| title.starts_with("decisions_re4") || !title.starts_with("decisions_"))
        .collect();
    // Tables of policies other than RE4 are tested with these policies. The synthetic demonstrations have neither simulator
    // states nor images; encoders and rollouts in robosuite's simulator are tested elsewhere.
    assert_eq!(
        missing,
        [
            "left_out",
            "left_out_frames-space",
            "states",
            "models",
            "training",
            "labels-space",
            "poses-space",
            "pose_errors",
            "results-space",
            "steps-space",
            "decisions-space",
            "worlds-space",
            "decisions_re4-space",
            "replays-space",
            "divergence-space",
            // Tested with the commands influence and curate.
            "influence",
            "judged_episodes",
            "influence_pairs",
            "curated",
            "curation_rounds",
            "curation_judged",
        ],
        "some tables were not written by any stage"
    );
}

#[test]
fn the_shipped_pipelines_are_accepted() {
    let place = Place::empty();
    let folder = repository().join("pipelines");
    let mut count = 0;
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    for path in paths.filter(|path| !is_suite(path)) {
        // Settings are checked before train-pose reports that there is nothing to train or that the dataset is missing.
        let sentence = place
            .run_each(&["train-pose", path.to_str().unwrap()])
            .refused_at_once();
        assert!(
            sentence.starts_with("error: nothing to train")
                || sentence.contains("has no table [pose]")
                || sentence.contains("has no object, so it can be audited and segmented")
                || sentence.contains("it was not found in"),
            "{sentence}"
        );
        count += 1;
    }
    assert!(count >= 2);
}

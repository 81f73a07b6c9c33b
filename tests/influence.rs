//! `influence` and `curate`: equal to brute force, refusals, outputs.

use re4_artifact::{Artifact, Stage};
use re4_influence::{CuratedRow, InfluenceRow, JudgedRow, PairRow};

use crate::support::Place;

#[test]
fn the_influence_is_that_of_brute_force_for_every_policy_by_retrieval() {
    for policy in ["re4", "paper", "re2", "nearest", "gpi", "vinn", "alt"] {
        let place = Place::new();
        let answer = place
            .run(&format!(
                "influence small.toml --policy {policy} --seeds 200000..200006 --starts 1 --check 100 --html page.html --json"
            ))
            .done()
            .json();
        assert_eq!(
            answer["check"]["differing"].as_array().unwrap().len(),
            0,
            "{policy}: {answer}"
        );
        assert!(answer["check"]["episodes"].as_u64().unwrap() > 0, "{policy}");
        let artifact = place.artifact(Stage::Influence);
        let rows: Vec<InfluenceRow> = artifact.read().unwrap();
        let pairs: Vec<PairRow> = artifact.read().unwrap();
        assert!(!pairs.is_empty() && rows.iter().any(|row| row.followed > 0), "{policy}");
        let page = std::fs::read_to_string(place.path().join("page.html")).unwrap();
        assert!(page.contains("Coverage of the start states"));
    }
}

#[test]
fn threads_do_not_change_the_influence() {
    let key = |jobs: u32| {
        let place = Place::new();
        place
            .run(&format!(
                "influence small.toml --policy paper --seeds 200000..200006 --jobs {jobs}"
            ))
            .done();
        let artifact = place.artifact(Stage::Influence);
        let rows: Vec<InfluenceRow> = artifact.read().unwrap();
        (*artifact.key(), rows)
    };
    assert_eq!(key(1), key(2));
}

#[test]
fn a_learned_policy_is_refused_before_it_is_trained() {
    let place = Place::new();
    let sentence = place.run("influence small.toml --policy diffusion").refused();
    assert!(
        sentence.contains("does not choose between demonstrations one by one"),
        "{sentence}"
    );
    assert!(!place.artifacts().join("policy").exists());
}

#[test]
fn a_choice_is_judged_on_other_seeds_and_written() {
    let place = Place::new();
    let overlap = place
        .run("curate small.toml --policy paper --seeds 200000..200004 --judge 200003..200006")
        .refused();
    assert!(overlap.contains("seed 200003"), "{overlap}");
    place
        .run(
            "curate small.toml --policy paper --seeds 200000..200006 --judge 200100..200104 --random 1 --keep-list keep.txt --setting set.toml --html page.html",
        )
        .done();
    let artifact: Artifact = place.artifact(Stage::Curate);
    let rows: Vec<CuratedRow> = artifact.read().unwrap();
    let judged: Vec<JudgedRow> = artifact.read().unwrap();
    assert_eq!(judged.len(), 9, "three sets with three measures");
    let kept: Vec<&str> = rows
        .iter()
        .filter(|row| row.kept)
        .map(|row| row.demo_name.as_str())
        .collect();
    let text = std::fs::read_to_string(place.path().join("keep.txt")).unwrap();
    assert_eq!(text.lines().collect::<Vec<_>>(), kept);
    let setting = std::fs::read_to_string(place.path().join("set.toml")).unwrap();
    assert!(setting.contains("select = { episodes = ["), "{setting}");
}

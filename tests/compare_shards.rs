//! Suites and influence by several processes: the same bytes as one process makes, and nothing is lost.

use std::collections::BTreeMap;
use std::fs;
use std::process::Command;

use re4_artifact::Stage;
use re4_influence::{InfluenceRow, JudgedEpisodeRow, PairRow};
use serde_json::{Value, json};

use crate::support::{Answer, Place, assert_same_bytes, folders_in, repository};

/// Seven cells: two of one part, two of two parts, one with settings that cannot be read, and two without data.
const SUITE: &str = r#"
title = "Shards"
baseline = "ours"
pipeline = "small.toml"
seeds = "500..508"
set = { rollout.max_steps = 8 }

[[row]]
name = "ours"

[[row]]
name = "RE2"
policy = "re2"

[[row]]
name = "later"
policy = "not_yet"

[[row]]
name = "no data"
set.ingest.source = "/nowhere.zarr"

[[column]]
name = "few"

[[column]]
name = "short"
set = { rollout = { max_steps = 4, seeds = "500..1600" } }

[[cell]]
rows = ["later"]
columns = ["short"]
leave_out = true
"#;

fn with_suite() -> Place {
    let place = Place::new();
    place.write("suite.toml", SUITE);
    place
}

/// The artifacts without those that only some commands make.
fn made_in(place: &Place) -> BTreeMap<String, Vec<u8>> {
    let mut bytes = place.bytes();
    bytes.retain(|name, _| !name.starts_with("audit/"));
    bytes
}

fn unsharded() -> (BTreeMap<String, Vec<u8>>, Value) {
    let place = with_suite();
    let answer = place.run("compare suite.toml --json");
    assert_eq!(answer.code, Some(1), "{}", answer.stderr);
    (made_in(&place), answer.json())
}

fn cells(answer: &Value) -> Value {
    json!([answer["key"], answer["failed"], answer["cells"], answer["differences"]])
}

fn plan(place: &Place, more: &str) -> Value {
    let mut plan = place
        .run(&format!("plan suite.toml --shards 4 --json {more}"))
        .done()
        .json();
    // `Answer` has replaced it.
    plan["directory"] = place.path().to_str().unwrap().into();
    plan
}

/// Ids of the groups, with the numbers of tasks or the tasks that are missing.
fn groups(plan: &Value) -> Vec<(String, Value)> {
    let groups = plan["groups"].as_array().unwrap();
    let of = |group: &Value| {
        let tasks = group.get("indices").unwrap_or(&group["count"]);
        (group["id"].as_str().unwrap().to_owned(), tasks.clone())
    };
    groups.iter().map(of).collect()
}

fn named(groups: &[(&str, Value)]) -> Vec<(String, Value)> {
    groups
        .iter()
        .map(|(id, tasks)| ((*id).to_owned(), tasks.clone()))
        .collect()
}

#[test]
fn shards_of_a_suite_in_any_number_and_order_give_the_bytes_of_one_process() {
    let (bytes, answer) = unsharded();
    assert_eq!(answer["failed"], 3, "{answer}");
    for (count, order) in [(3, vec![2, 0, 1]), (8, vec![7, 5, 3, 1, 0, 2, 4, 6])] {
        let place = with_suite();
        let (last, first) = order.split_last().unwrap();
        for index in first {
            place
                .run(&format!("compare suite.toml --shard {index}/{count} --quiet"))
                .done();
        }
        let missing = place.run("merge compare suite.toml");
        assert_eq!(missing.code, Some(3), "{}", missing.stderr);
        assert!(
            missing.stderr.contains("of its 7 cells are missing: "),
            "{}",
            missing.stderr
        );
        assert!(
            missing.stderr.contains("re4-pipe compare suite.toml and --shard"),
            "{}",
            missing.stderr
        );
        assert!(!place.artifacts().join("comparison").exists() && !place.path().join("suite.html").exists());
        let shard = place
            .run(&format!("compare suite.toml --shard {last}/{count} --json"))
            .done()
            .json();
        assert_eq!((&shard["all"], &shard["parts"]), (&json!(7), &json!(10)), "{shard}");
        let merged = place.run("merge compare suite.toml --json");
        assert_eq!(merged.code, Some(1), "{}", merged.stderr);
        assert_eq!(cells(&merged.json()), cells(&answer));
        assert_same_bytes(&made_in(&place), &bytes);
        assert!(place.path().join("suite.html").exists());
        // One process finds all that was made.
        let again = place.run("compare suite.toml --json");
        assert_eq!((&again.json()["skipped"], again.code), (&json!(true), Some(1)));
    }
}

#[test]
fn a_missing_part_of_a_cell_is_named() {
    let place = with_suite();
    for index in [0, 1, 2, 3, 4, 6, 7, 8, 9] {
        place
            .run(&format!("compare suite.toml --shard {index}/10 --quiet"))
            .done();
    }
    let parts = || {
        let rollouts = folders_in(&place.artifacts().join("rollouts"));
        rollouts
            .iter()
            .map(|folder| {
                folders_in(&folder.join("parts"))
                    .iter()
                    .filter(|part| !part.ends_with("dataset"))
                    .count()
            })
            .sum::<usize>()
    };
    let made = parts();
    let missing = place.run("merge compare suite.toml");
    assert_eq!(missing.code, Some(3), "{}", missing.stderr);
    assert_eq!(
        missing.stderr.lines().last().unwrap(),
        "error: cannot compare the cells of suite.toml: the rollouts of 1 of its 7 cells are missing: ours under short (parts 1 of 2); \
         run them with re4-pipe compare suite.toml and --shard, or run re4-pipe compare suite.toml to run all that is missing"
    );
    assert_eq!(parts(), made, "it rolled out");
    let expected = named(&[("compare", json!([2])), ("compare.merge", json!(1))]);
    assert_eq!(groups(&plan(&place, "--missing")), expected);
}

/// Why a cell cannot run is known to the process that makes the comparison, until the files of the cell change.
#[test]
fn a_cell_that_fails_late_has_the_sentence_of_one_process() {
    let place = Place::new();
    place.write(
        "suite.toml",
        "pipeline = \"small.toml\"\nseeds = \"500..502\"\n[[row]]\nname = \"a\"\n[[row]]\nname = \"b\"\n\
         set = { ingest.source = \"broken.zarr\", rollout.max_steps = 5 }\n[[column]]\nname = \"c\"\n",
    );
    let broken = place.path().join("data/broken.zarr");
    let copy = || {
        let _ = fs::remove_dir_all(&broken);
        let copied = Command::new("cp").arg("-r").args([&place.dataset(), &broken]).status();
        assert!(copied.unwrap().success());
    };
    copy();
    for chunk in fs::read_dir(broken.join("data/state")).unwrap() {
        let chunk = chunk.unwrap().path();
        if !chunk.file_name().unwrap().to_str().unwrap().starts_with('.') {
            fs::write(&chunk, "no chunk").unwrap();
        }
    }
    let shard = place.run("compare suite.toml --shard 1/2").done();
    assert!(shard.stdout.contains("cannot run: b under c"), "{}", shard.stdout);
    place.run("compare suite.toml --shard 0/2").done();
    let merged = place.run("merge compare suite.toml --json");
    assert_eq!(merged.code, Some(1), "{}", merged.stderr);
    let whole = place.run("compare suite.toml --json");
    assert_eq!(cells(&whole.json()), cells(&merged.json()));
    assert_eq!((whole.code, &whole.json()["skipped"]), (Some(1), &json!(true)));
    let sentences = whole.json()["cells"].to_string();
    assert!(sentences.contains("broken.zarr"), "{sentences}");
    copy();
    let missing = place.run("merge compare suite.toml");
    assert_eq!(missing.code, Some(3), "{}", missing.stderr);
    assert!(
        missing.stderr.contains("1 of its 2 cells are missing: b under c;"),
        "{}",
        missing.stderr
    );
}

#[test]
fn a_plan_of_a_suite_runs_and_is_looked_at() {
    let (bytes, answer) = unsharded();
    let place = with_suite();
    let whole = plan(&place, "");
    let all = [
        ("compare.inputs", json!(2)),
        ("compare", json!(4)),
        ("compare.merge", json!(1)),
    ];
    assert_eq!(groups(&whole), named(&all));
    assert_eq!(whole["groups"][1]["after"], json!(["compare.inputs"]));
    assert_eq!(whole["groups"][2]["after"], json!(["compare"]));
    place.write("plan.json", whole.to_string());
    let status = place.run("status plan.json --json").done().json();
    assert_eq!(status["done"], false);
    assert_eq!(status["stages"][0]["cells"].as_array().unwrap().len(), 7);
    place.run("compare suite.toml --inputs --shard 0/1 --quiet").done();
    assert!(!place.artifacts().join("rollouts").exists());
    place.run("compare suite.toml --shard 2/4 --quiet").done();
    let missing = plan(&place, "--missing");
    assert_eq!(
        groups(&missing),
        named(&[("compare", json!([0, 1, 3])), ("compare.merge", json!(1))])
    );
    place.write("missing.json", missing.to_string());
    let engine = Command::new(repository().join("scripts/engines/local"))
        .args(["missing.json", "--logs", "logs", "--jobs", "2"])
        .current_dir(place.path())
        .env("RE4_DATA", place.path().join("data"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let engine = Answer::new(&engine, place.path());
    // A comparison with cells that cannot run ends with 1, as without shards.
    assert!(
        engine.stdout.contains("compare          3 of 3 tasks done"),
        "{}",
        engine.stdout
    );
    assert!(engine.stdout.contains("3 cells cannot run"), "{}", engine.stdout);
    assert_same_bytes(&made_in(&place), &bytes);
    let status = place.run("status plan.json").done();
    assert!(status.stdout.contains("compare: done"), "{}", status.stdout);
    assert!(status.stdout.contains("cannot run"), "{}", status.stdout);
    assert_eq!(plan(&place, "--missing")["groups"], json!([]));
    // Cells, seeds and settings of the command line are those of all tasks.
    let few = plan(
        &place,
        "--rows ours,RE2 --columns few --seeds 500..503 --set rollout.max_steps=5",
    );
    let words: Vec<&str> = few["groups"][1]["command"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_str)
        .collect();
    assert_eq!(
        words[words.len() - 6..],
        ["--rows", "ours,RE2", "--columns", "few", "--seeds", "500..503"]
    );
    assert!(
        words.windows(2).any(|pair| pair == ["--set", "rollout.max_steps=5"]),
        "{words:?}"
    );
    assert_eq!(few["groups"][1]["count"], 2);
    assert_ne!(answer["key"], Value::Null);
    let refused = place.run("plan small.toml --shards 2 --rows ours").refused();
    assert!(refused.contains("which is no suite"), "{refused}");
}

#[test]
fn influence_in_parts_is_that_of_one_process() {
    let options = "small.toml --policy paper --seeds 200000..200125 --max-steps 6 --starts 1";
    let whole = Place::new();
    whole.run(&format!("influence {options} --check 2 --json")).done();
    let artifact = whole.artifact(Stage::Influence);
    assert_eq!(artifact.parts(), 2);
    let episodes: Vec<JudgedEpisodeRow> = artifact.read().unwrap();
    assert!(episodes.len() > 128 && episodes.is_sorted_by_key(|row| (row.scenes, row.seed)));
    let pairs: Vec<PairRow> = artifact.read().unwrap();
    let rows: Vec<InfluenceRow> = artifact.read().unwrap();
    for row in &rows {
        let own = || {
            pairs
                .iter()
                .filter(|pair| (pair.scenes, pair.demo) == (row.scenes, row.demo))
        };
        assert_eq!(row.depending as usize, own().count());
        assert_eq!(row.decisions, own().map(|pair| pair.decisions).sum::<u32>());
        let change: f64 = own().map(|pair| pair.score_without - pair.score).sum();
        assert!((row.score_change - change / f64::from(row.episodes)).abs() < 1e-12);
    }
    let place = Place::new();
    place.run(&format!("influence {options} --shard 1/2 --quiet")).done();
    let missing = place.run(&format!("merge influence {options}"));
    assert_eq!(missing.code, Some(3), "{}", missing.stderr);
    assert!(
        missing.stderr.contains("1 of its 2 parts are missing: 0;"),
        "{}",
        missing.stderr
    );
    place.run(&format!("influence {options} --shard 0/3 --quiet")).done();
    place.run(&format!("influence {options} --shard 1/3 --quiet")).done();
    place.run(&format!("merge influence {options}")).done();
    assert_same_bytes(&made_in(&place), &made_in(&whole));
    place.run("verify").done();
    let refused = place
        .run(&format!("influence {options} --shard 0/3 --check 1"))
        .refused();
    assert!(refused.contains("do not apply to a shard"), "{refused}");
}

//! `re4-pipe query`: the guide, the options, and errors.

use std::path::Path;
use std::process::Command;

use insta::assert_snapshot;
use re4_artifact::{Artifact, Stage};
use re4_rollout::{PlaneDecisionRow, PlaneResultRow};
use serde_json::json;

use crate::support::{Answer, PROGRAM, Place, repository};

/// The commands in the `sh` blocks of a guide.
fn commands(guide: &str) -> Vec<String> {
    let mut commands: Vec<String> = Vec::new();
    let mut inside = false;
    for line in guide.lines() {
        if line.starts_with("```") {
            inside = line == "```sh";
        } else if inside && line.starts_with("re4-pipe ") {
            commands.push(line.to_owned());
        } else if inside && let Some(last) = commands.last_mut() {
            *last = format!("{last}\n{line}");
        }
    }
    commands
}

/// Runs a command of a guide in a folder with the pipelines of the repository.
fn in_shell(folder: &Path, command: &str) -> Answer {
    let output = Command::new("sh")
        .args(["-c", &command.replace("re4-pipe ", &format!("{PROGRAM} "))])
        .current_dir(folder)
        .env("RE4_DATA", repository().join("data"))
        .env_remove("RUST_LOG")
        .env("COLUMNS", "120")
        .output()
        .unwrap();
    Answer::new(&output, folder)
}

/// A line of a table with one space between its values.
fn columns_of(line: &str) -> String {
    line.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn the_queries_of_the_guide_run_on_the_demo() {
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink(repository().join("pipelines"), folder.path().join("pipelines")).unwrap();
    let guide = std::fs::read_to_string(repository().join("docs/guides/query-artifacts.md")).unwrap();
    let mut shown = Vec::new();
    for command in commands(&guide) {
        let answer = in_shell(folder.path(), &command).done();
        if !command.starts_with("re4-pipe query") {
            continue;
        }
        // The header and the number of rows. The values change with presets and with the system's math library.
        let lines: Vec<&str> = answer.stdout.lines().collect();
        let ends = [lines.first(), lines.last()].map(|line| line.copied().unwrap_or_default());
        shown.push(format!("{command}\n\n{}\n", ends.map(columns_of).join("\n")));
    }
    assert_eq!(shown.len(), 13);
    assert_snapshot!(shown.join("\n"));
    let csv = std::fs::read_to_string(folder.path().join("results.csv")).unwrap();
    assert_eq!(csv.lines().count(), 101);
    assert!(folder.path().join("steps.parquet").exists());
}

/// Rollouts of `small.toml`, which are compared with their tables.
fn place() -> Place {
    let place = Place::new();
    place.run("run small.toml --quiet").done();
    place
}

#[test]
fn answers_equal_the_tables_for_every_number_of_threads() {
    let place = place();
    let artifact: Artifact = place.artifact(Stage::Rollout);
    let results: Vec<PlaneResultRow> = artifact.read().unwrap();
    let decisions: Vec<PlaneDecisionRow> = artifact.read().unwrap();
    let wanted: Vec<serde_json::Value> = results
        .iter()
        .map(|result| {
            let own = decisions
                .iter()
                .filter(|decision| decision.core.seed == result.core.seed);
            json!({
                "seed": result.core.seed,
                "steps": result.core.steps,
                "coverage_max": result.coverage_max,
                "decisions": own.clone().count(),
                "last": own.map(|decision| decision.core.step).max(),
            })
        })
        .collect();
    let sql = "select r.seed, r.steps, r.coverage_max, count(*) as decisions, max(d.step) as last \
               from results r join decisions d using (artifact, seed) group by r.seed, r.steps, r.coverage_max";
    let mut answers = Vec::new();
    for jobs in ["1", "2", "4"] {
        let answer = place
            .run_each(&["query", sql, "artifacts", "--json", "--jobs", jobs])
            .done();
        assert_eq!(answer.json()["rows"], json!(wanted), "--jobs {jobs}");
        answers.push(answer.stdout);
    }
    assert!(answers.iter().all(|answer| *answer == answers[0]));
}

#[test]
fn every_table_can_be_read() {
    let place = place();
    place.run("audit small.toml --quiet").done();
    let answer = place
        .run_each(&["query", "select distinct \"table\" from columns", "--json"])
        .done()
        .json();
    let tables: Vec<String> = answer["rows"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["table"].as_str().unwrap().to_owned())
        .collect();
    assert!(tables.len() >= 15, "{tables:?}");
    for table in tables {
        let rows = |sql: &str| place.run_each(&["query", sql, "--json"]).done().json()["rows"].clone();
        let count = rows(&format!("select count(*) as n from \"{table}\""))[0]["n"]
            .as_u64()
            .unwrap();
        assert_eq!(
            rows(&format!("select * from \"{table}\"")).as_array().unwrap().len() as u64,
            count,
            "{table}"
        );
    }
}

#[test]
fn errors_of_queries() {
    let place = place();
    std::fs::create_dir(place.path().join("empty")).unwrap();
    let artifact = place.artifact(Stage::Rollout);
    let inside = format!("artifacts/rollouts/{}/out.parquet", artifact.key().short());
    let mut sentences = Vec::new();
    for arguments in [
        vec!["query"],
        vec!["query", ""],
        vec!["query", "select * form results"],
        vec!["query", "select * from results where"],
        vec!["query", "delete from results"],
        vec!["query", "select * from result", "artifacts/rollouts"],
        vec!["query", "select sucess from results"],
        vec!["query", "select r.sucess from results r join decisions d using (seed)"],
        vec![
            "query",
            "select r.nothing, s.seed from results r join results s using (seed)",
        ],
        vec!["query", "select median_of(steps) from results"],
        vec!["query", "select * from read_parquet('x.parquet')"],
        vec!["query", "select * from results", "missing"],
        vec!["query", "select * from results", "empty"],
        vec!["query", "select * from results", "empty/*"],
        vec!["query", "select * from results", "small.toml"],
        vec!["query", "select * from results", "--artifacts", "empty"],
        vec!["query", "select * from results", "--csv", "--json"],
        vec!["query", "select * from results", "--parquet", "no/out.parquet"],
        vec!["query", "select * from results", "--parquet", &inside],
    ] {
        let shown = arguments.join(" ");
        sentences.push(format!(
            "re4-pipe {shown}\n  {}",
            place.run_each(&arguments).refused_at_once()
        ));
    }
    insta::with_settings!({ filters => [(r"rollouts/[0-9a-f]{16}", "rollouts/KEY")] }, {
        assert_snapshot!(sentences.join("\n\n"));
    });
}

#[test]
fn a_damaged_file_is_named() {
    let place = place();
    let file = place.artifact(Stage::Rollout).path().join("results.parquet");
    let mut bytes = std::fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    std::fs::write(&file, &bytes).unwrap();
    let answer = place.run_each(&["query", "select * from results"]);
    assert_eq!((answer.code, answer.stdout.as_str()), (Some(2), ""));
    assert!(
        answer.stderr.contains("the content of results.parquet does not match"),
        "{}",
        answer.stderr
    );
    // Other tables of the artifact do not depend on it.
    place.run_each(&["query", "select count(*) as n from decisions"]).done();
}

#[test]
fn a_parquet_file_has_the_rows_of_the_answer() {
    let place = place();
    let answer = place
        .run_each(&[
            "query",
            "select seed, coverage_max from results",
            "--parquet",
            "out.parquet",
        ])
        .done();
    assert_eq!(answer.stdout, "");
    assert!(
        answer.stderr.contains("table written to out.parquet"),
        "{}",
        answer.stderr
    );
    assert!(place.temporaries().is_empty());
    let file = std::fs::File::open(place.path().join("out.parquet")).unwrap();
    let reader = parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder::try_new(file)
        .unwrap()
        .build()
        .unwrap();
    let batches: Vec<_> = reader.map(Result::unwrap).collect();
    let seeds: Vec<i64> = batches
        .iter()
        .flat_map(|batch| {
            let seeds = batch
                .column(0)
                .as_any()
                .downcast_ref::<arrow_array::Int64Array>()
                .unwrap();
            seeds.values().to_vec()
        })
        .collect();
    let results: Vec<PlaneResultRow> = place.artifact(Stage::Rollout).read().unwrap();
    assert_eq!(
        seeds,
        results
            .iter()
            .map(|result| i64::from(result.core.seed))
            .collect::<Vec<_>>()
    );
}

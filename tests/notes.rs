//! What commands print for people: warnings of all stages, and `inspect` within the width of a terminal.

use std::fs;

use re4_artifact::Stage;

use crate::support::Place;

/// A user of `run` or `audit` never sees the output of `ingest`.
#[test]
fn later_commands_repeat_the_warnings_of_ingest() {
    let place = Place::new();
    fs::remove_dir_all(place.dataset().join("data/img")).unwrap();
    // The first time ingest runs, the second time it is skipped.
    for command in ["run small.toml", "run small.toml", "audit small.toml"] {
        let answer = place.run(command).done();
        let lines: Vec<&str> = answer
            .stderr
            .lines()
            .filter(|line| line.contains("warning  no_images: "))
            .collect();
        assert_eq!(lines.len(), 1, "{command}\n{}", answer.stderr);
        let object = place.run(&format!("{command} --json")).done().json();
        let warnings = object["warnings"].as_array().unwrap();
        let of_ingest = warnings
            .iter()
            .filter(|warning| warning["code"] == "no_images" && warning["stage"] == "ingest");
        assert_eq!(of_ingest.count(), 1, "{command}\n{object}");
    }
    assert_eq!(place.run("run small.toml --quiet").done().stderr, "");
}

#[test]
fn a_setting_without_effect_is_named() {
    let place = Place::new();
    let answer = place
        .run("run small.toml --set policy.replay.stride=2 --set policy.replay.tracking=path")
        .done();
    let sentence = "policy.replay.stride has no effect, because policy.replay.tracking is \"path\", not \"actions\"";
    assert!(answer.stderr.contains(sentence), "{}", answer.stderr);
    let used = place
        .run("run small.toml --set policy.replay.stride=2 --set policy.replay.tracking=actions")
        .done();
    assert!(!used.stderr.contains("has no effect"), "{}", used.stderr);
}

#[test]
fn inspect_fits_the_width_of_the_terminal() {
    let place = Place::new();
    place.run("run small.toml").done();
    let path = place.artifact(Stage::Rollout).path().to_str().unwrap().to_owned();
    for columns in [70, 100] {
        let output = place
            .command()
            .args(["inspect", &path, "--rows", "5"])
            .env("COLUMNS", columns.to_string())
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        // Keys of artifacts and hashes are one word of 64 digits, and are not broken.
        let wide = text
            .lines()
            .filter(|line| line.chars().count() > columns && !line.contains("input "))
            .count();
        let first = text.lines().next().unwrap();
        assert_eq!(wide, usize::from(first.chars().count() > columns), "{text}");
        assert!(text.contains("rows 0 to "), "{text}");
    }
}

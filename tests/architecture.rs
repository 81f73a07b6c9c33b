//! ARCHITECTURE.md lists all crates, and dependencies between crates follow its rules.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::support::repository;

/// The crates of the workspace, and for each the workspace crates that it depends on (without dev-dependencies).
fn crates() -> BTreeMap<String, BTreeSet<String>> {
    let output = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--format-version",
            "1",
            "--no-deps",
            "--locked",
            "--offline",
        ])
        .current_dir(repository())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let name = |package: &Value| package["name"].as_str().unwrap().to_owned();
    let members: BTreeSet<String> = packages.iter().map(name).collect();
    packages
        .iter()
        .map(|package| {
            let needs = package["dependencies"].as_array().unwrap().iter();
            let needs = needs.filter(|dependency| dependency["kind"] != "dev").map(name);
            // Every crate may depend on the crate of error messages.
            let needs = needs.filter(|need| members.contains(need) && !need.starts_with("re4-fault"));
            (name(package), needs.collect())
        })
        .collect()
}

/// Names of crates in backticks in the first column of the Markdown tables of a text.
fn listed(text: &str) -> Vec<String> {
    let cells = text
        .lines()
        .filter_map(|line| line.trim().strip_prefix('|')?.split('|').next());
    let names = cells.filter_map(|cell| cell.trim().strip_prefix('`')?.strip_suffix('`'));
    names
        .filter(|name| name.starts_with("re4-"))
        .map(str::to_owned)
        .collect()
}

#[test]
fn the_table_of_crates_is_complete() {
    let text = std::fs::read_to_string(repository().join("ARCHITECTURE.md")).unwrap();
    let names = listed(&text);
    let unique: BTreeSet<String> = names.iter().cloned().collect();
    assert_eq!(unique.len(), names.len(), "a crate is listed twice: {names:?}");
    assert_eq!(unique, crates().into_keys().collect());
}

#[test]
fn dependencies_point_down() {
    let crates = crates();
    let needs = |name: &str| &crates[name];
    for (name, needed) in &crates {
        assert!(!needed.contains("re4-pipe"), "{name} needs the program");
        assert!(
            ["re4-pipe", "re4-python"].contains(&name.as_str()) || !needed.contains("re4-stages"),
            "{name} needs re4-stages"
        );
    }
    let stages = ["re4-ingest", "re4-segment", "re4-index"];
    for stage in stages {
        for other in stages {
            assert!(!needs(stage).contains(other), "{stage} needs {other}");
        }
        assert!(!needs(stage).contains("re4-policy"), "{stage} needs re4-policy");
    }
    assert!(needs("re4-geometry").is_empty(), "re4-geometry is at the bottom");
    assert_eq!(needs("re4-task").iter().collect::<Vec<_>>(), ["re4-geometry"]);
    assert_eq!(needs("re4-episode").iter().collect::<Vec<_>>(), ["re4-geometry"]);
    // Pages are made from artifacts only.
    for maker in ["re4-mujoco", "re4-encoder"] {
        assert!(!needs("re4-report").contains(maker), "re4-report needs {maker}");
    }
    // Poses and modes are types of table cells; apart from these, the crate of artifacts does not depend on robotics crates.
    assert_eq!(
        needs("re4-artifact").iter().collect::<Vec<_>>(),
        ["re4-episode", "re4-geometry"]
    );
    for name in ["re4-fetch", "re4-stats"] {
        assert!(
            needs(name).is_empty(),
            "{name} depends on a robotics crate: {:?}",
            needs(name)
        );
    }
}

/// All Rust files below a folder, with their text.
fn sources(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(sources(&path));
        } else if path.extension().is_some_and(|end| end == "rs") {
            let text = std::fs::read_to_string(&path).unwrap();
            files.push((path, text));
        }
    }
    files
}

/// Stages exchange data only through artifacts. So a path that begins at `stages` has to name the file's own stage, and `super`
/// must not leave the stage.
#[test]
fn no_stage_imports_another() {
    let stages = repository().join("crates/re4-stages/src/stages");
    for (path, text) in sources(&stages) {
        let place = path.strip_prefix(&stages).unwrap();
        if place == Path::new("mod.rs") {
            continue;
        }
        let depth = place.components().count();
        let own = place.components().next().unwrap().as_os_str().to_str().unwrap();
        let own = own.trim_end_matches(".rs");
        for line in text.lines() {
            let named = line.split("stages::").nth(1);
            let foreign = named.is_some_and(|rest| !rest.starts_with(own));
            // In a file of depth 1, `super` is the module of all stages. A test module is one level deeper, so its `use super::*`
            // is fine.
            let leads_out = line.contains(&"super::".repeat(depth)) && !line.trim_start().starts_with("use super::*");
            assert!(
                !foreign && !leads_out,
                "{} imports another stage: {line}",
                place.display()
            );
        }
    }
}

/// The program crate contains only arguments, printing and exit codes: about 150 lines per command.
#[test]
fn the_program_is_thin() {
    let files = sources(&repository().join("crates/re4-pipe/src"));
    let lines: usize = files.iter().map(|(_, text)| text.lines().count()).sum();
    assert!(lines < 150 * crate::cli::COMMANDS.len(), "re4-pipe has {lines} lines");
}

/// Limits the length of all source files.
#[test]
fn source_files_are_short() {
    for package in crates().keys() {
        for (path, text) in sources(&repository().join("crates").join(package).join("src")) {
            let lines = text.lines().count();
            assert!(lines <= 600, "{} has {lines} lines", path.display());
        }
    }
}

#[test]
fn tables_are_read_by_their_first_column() {
    let text = "| crate | noun |\n|---|---|\n| `re4-a` | one |\n| `re4-b`| two `re4-c` |\n| other | |\ntext `re4-d`\n";
    assert_eq!(listed(text), ["re4-a", "re4-b"]);
}

//! The notebooks run from top to bottom on artifacts of the demo pipelines, and detect a wrong manifest.
//!
//! They are executed by the Python interpreter that the variable `RE4_PYTHON` names; `scripts/test.sh` sets it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Answer, Place, folders_in, repository};
use serde_json::{Value, json};

fn notebook(name: &str) -> PathBuf {
    repository().join("notebooks").join(name)
}

/// The interpreter; if none is named, prints that the test is skipped.
fn python() -> Option<PathBuf> {
    let python = std::env::var_os("RE4_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
    }
    python
}

/// Artifacts of the demo pipeline for two presets on a few scenes.
fn demo() -> Place {
    let place = Place::empty();
    for (preset, steps) in [("re4", 200), ("paper", 40)] {
        let output = place
            .command()
            .env("RE4_DATA", repository().join("data"))
            .arg("run")
            .arg(repository().join("pipelines/demo.toml"))
            .args(["--seeds", "500..506", "--policy", preset])
            .args(["--max-steps", &steps.to_string()])
            .output()
            .unwrap();
        Answer::new(&output, place.path()).done();
    }
    place
}

fn execute(python: &Path, place: &Place, name: &str) -> Answer {
    let output = Command::new(python)
        .arg(repository().join("tests/run_notebook.py"))
        .arg(notebook(name))
        .arg(place.path().join("executed.ipynb"))
        .env("RE4_ARTIFACTS", place.artifacts())
        .output()
        .unwrap();
    Answer::new(&output, place.path())
}

fn cells(path: &Path) -> Vec<Value> {
    let notebook: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    notebook["cells"].as_array().unwrap().clone()
}

/// Number of images in the executed notebook.
fn count_images(place: &Place) -> usize {
    cells(&place.path().join("executed.ipynb"))
        .iter()
        .filter_map(|cell| cell["outputs"].as_array())
        .flatten()
        .filter(|output| output["data"]["image/png"].is_string())
        .count()
}

#[test]
fn notebooks_are_stored_without_outputs() {
    for name in ["pusht.ipynb", "audit.ipynb", "keep-list.ipynb", "policy.ipynb"] {
        let cells = cells(&notebook(name));
        let code: Vec<&Value> = cells.iter().filter(|cell| cell["cell_type"] == "code").collect();
        assert!(
            code.len() >= 5 && code.len() < cells.len(),
            "a notebook has code and text"
        );
        for cell in &cells {
            assert_eq!(cell["metadata"], json!({}), "{name} {}", cell["id"]);
        }
        for cell in code {
            assert_eq!(cell["outputs"], json!([]), "{name} {} has outputs", cell["id"]);
            assert_eq!(
                cell["execution_count"],
                Value::Null,
                "{name} {} was saved after a run",
                cell["id"]
            );
        }
    }
}

#[test]
fn the_audit_notebook_runs_plots_and_checks_the_manifest() {
    let Some(python) = python() else { return };
    let place = Place::empty();
    let output = place
        .command()
        .env("RE4_DATA", repository().join("data"))
        .args(["audit", "--quiet"])
        .arg(repository().join("pipelines/can-sample-audit.toml"))
        .output()
        .unwrap();
    Answer::new(&output, place.path()).done();
    execute(&python, &place, "audit.ipynb").done();
    assert_eq!(count_images(&place), 4, "modes, findings, evidence, grasps");

    let path = folders_in(&place.artifacts().join("audit"))[0].join("manifest.json");
    let mut manifest: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    manifest["summary"]["warnings"] = json!(manifest["summary"]["warnings"].as_u64().unwrap() + 1);
    fs::write(&path, manifest.to_string()).unwrap();
    let answer = execute(&python, &place, "audit.ipynb");
    assert_eq!(answer.code, Some(1), "{}", answer.stderr);
    assert!(
        answer.stderr.contains("severity warning, the manifest states"),
        "{}",
        answer.stderr
    );
}

#[test]
fn the_pusht_notebook_runs_plots_and_checks_the_manifest() {
    let Some(python) = python() else { return };
    let place = demo();
    execute(&python, &place, "pusht.ipynb").done();
    assert_eq!(count_images(&place), 4, "scores, budgets, decisions, demonstrations");

    // Changes one end of one interval in the sixth digit.
    let artifacts = folders_in(&place.artifacts().join("rollouts"));
    assert_eq!(artifacts.len(), 2);
    for artifact in artifacts {
        let path = artifact.join("manifest.json");
        let original = fs::read(&path).unwrap();
        let mut manifest: Value = serde_json::from_slice(&original).unwrap();
        let low = &mut manifest["summary"]["metrics"]["coverage_raw_mean"]["low"];
        *low = json!(low.as_f64().unwrap() + 1e-6);
        fs::write(&path, manifest.to_string()).unwrap();
        let answer = execute(&python, &place, "pusht.ipynb");
        assert_eq!(answer.code, Some(1), "{}", answer.stderr);
        assert!(
            answer.stderr.contains("AssertionError") && answer.stderr.contains("coverage_raw_mean is"),
            "{}",
            answer.stderr
        );
        fs::write(&path, original).unwrap();
    }
}

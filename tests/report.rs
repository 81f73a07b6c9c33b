//! The HTML page of rollouts: its figures are those of the artifacts, it loads no other files, and it works in a browser.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Place, filters, folders_in, repository};
use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use insta::{assert_snapshot, with_settings};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, Stage, col_f64, col_u32};
use serde_json::Value;

/// Rollouts of two policies on the small dataset. Returns their folders relative to the test folder, `re4` first.
fn two_policies() -> (Place, [String; 2]) {
    let place = Place::new();
    let roll = |policy: &str| {
        let answer = place
            .run(&format!("run small.toml --no-images --policy {policy} --json"))
            .done();
        answer.json()["artifact"].as_str().unwrap().to_owned()
    };
    let folders = [roll("re4"), roll("re2")];
    (place, folders)
}

fn page_of(place: &Place, arguments: &str) -> String {
    place.run(&format!("report {arguments} --output page.html")).done();
    fs::read_to_string(place.path().join("page.html")).unwrap()
}

/// The data that the script of the page reads.
fn data(page: &str) -> Value {
    let (_, rest) = page.split_once("type=\"application/json\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

fn bytes(packed: &Value) -> Vec<u8> {
    BASE64_STANDARD.decode(packed["data"].as_str().unwrap()).unwrap()
}

fn f64s(packed: &Value) -> Vec<f64> {
    assert_eq!(packed["type"], "f64");
    let bytes = bytes(packed);
    bytes
        .chunks_exact(8)
        .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

fn f32s(packed: &Value) -> Vec<f32> {
    assert_eq!(packed["type"], "f32");
    let bytes = bytes(packed);
    bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

fn numbers(values: &Value) -> Vec<f64> {
    values
        .as_array()
        .unwrap()
        .iter()
        .map(|value| value.as_f64().unwrap())
        .collect()
}

/// The number in an attribute of the first element after all of these words, in order.
fn attribute(page: &str, words: &[&str], name: &str) -> f64 {
    let rest = words.iter().fold(page, |rest, word| {
        rest.split_once(word).unwrap_or_else(|| panic!("no {word}")).1
    });
    let (_, value) = rest.split_once(&format!("{name}=\"")).unwrap();
    value.split_once('"').unwrap().0.parse().unwrap()
}

#[test]
fn a_run_writes_the_page_that_report_makes() {
    let place = Place::new();
    let answer = place.run("run small.toml --no-images --report run.html --json").done();
    assert!(
        answer.stderr.contains("    report  run.html  6 rollouts in the viewer"),
        "{}",
        answer.stderr
    );
    let artifact = answer.json()["artifact"].as_str().unwrap().to_owned();
    let page = page_of(&place, &artifact);
    assert!(fs::read_to_string(place.path().join("run.html")).unwrap() == page);
    // A path that cannot be written is refused before any stage runs.
    for path in ["nowhere/run.html", "data"] {
        let refusal = place
            .run(&format!("run small.toml --report {path} --artifacts other"))
            .refused_at_once();
        assert!(
            refusal.contains(&format!("cannot write the report {path}")),
            "{refusal}"
        );
        assert!(folders_in(&place.path().join("other")).is_empty());
    }
}

#[test]
fn only_regular_files_are_replaced() {
    let place = Place::new();
    let artifact = place.run("run small.toml --no-images --json").done().json()["artifact"]
        .as_str()
        .unwrap()
        .to_owned();
    let before = place.bytes();
    fs::write(place.path().join("old.html"), "old").unwrap();
    std::os::unix::fs::symlink("old.html", place.path().join("link.html")).unwrap();
    for pipe in ["pipe.html", "pipe.gif", "pipe.svg"] {
        let made = Command::new("mkfifo").arg(place.path().join(pipe)).status().unwrap();
        assert!(made.success());
    }
    let refusals: Vec<String> = [
        format!("report {artifact} --output pipe.html"),
        format!("report {artifact} --output {artifact}/manifest.json"),
        format!("report {artifact} --output {artifact}/page.html"),
        format!("video {artifact} pipe.gif --seed 500"),
        format!("video {artifact} {artifact}/video.gif --seed 500"),
        format!("inspect {artifact} --seed 500 --image pipe.svg"),
        format!("inspect {artifact} --seed 500 --image {artifact}/results.parquet"),
        "run small.toml --no-images --report pipe.html".to_owned(),
    ]
    .iter()
    .map(|arguments| place.run(arguments).refused_at_once())
    .collect();
    with_settings!({ filters => filters() }, { assert_snapshot!(refusals.join("\n")) });
    assert!(place.bytes() == before, "an artifact was changed");
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
    // A symbolic link is kept, and its target is replaced.
    let page = page_of(&place, &artifact);
    place.run(&format!("report {artifact} --output link.html")).done();
    assert!(
        fs::symlink_metadata(place.path().join("link.html"))
            .unwrap()
            .is_symlink()
    );
    assert!(fs::read_to_string(place.path().join("old.html")).unwrap() == page);
}

#[test]
fn a_preset_with_changed_settings_is_not_the_preset() {
    let place = Place::new();
    let roll = |more: &str| {
        let answer = place
            .run(&format!("run small.toml --no-images --policy paper --json {more}"))
            .done();
        page_of(&place, answer.json()["artifact"].as_str().unwrap())
    };
    assert!(!roll("").contains("settings changed"));
    assert!(roll("--set rollout.reframe.enabled=false").contains("settings changed"));
}

#[test]
fn figures_match_the_artifacts() {
    let (place, folders) = two_policies();
    let page = page_of(&place, &folders.join(" "));
    let data = data(&page);
    for (number, folder) in folders.iter().enumerate() {
        let artifact = Artifact::open(&place.path().join(folder)).unwrap();
        let shown = &data["artifacts"][number];
        let counted = &artifact.manifest().summary["protocol"]["dataset"]["demonstrations"];
        assert!(page.contains(&format!("all {counted} demonstrations")));
        stated_metrics(&page, &artifact, number);
        budgets_are_equal(&artifact, &shown["curve"]);
        results_are_equal(&artifact, &shown["rollouts"]);
        traces_are_equal(&artifact, shown);
    }
}

fn stated_metrics(page: &str, artifact: &Artifact, number: usize) {
    let row = format!("data-artifact=\"{}\"", artifact.key());
    let metrics = &artifact.manifest().summary["metrics"];
    for name in ["score_scaled_mean", "coverage_raw_mean", "iou_mean", "success_rate"] {
        let cell = format!("data-metric=\"{name}\"");
        for part in ["value", "low", "high"] {
            let stated = metrics[name][part].as_f64().unwrap();
            assert_eq!(
                attribute(page, &[&row, &cell], &format!("data-{part}")),
                stated,
                "{name}"
            );
        }
    }
    // The last budget is the whole rollout, so mean and interval are the same.
    for (name, metric) in [("score", "score_scaled_mean"), ("coverage", "coverage_raw_mean")] {
        for part in ["value", "low", "high"] {
            let cell = [
                &format!("data-series=\"{number}\" data-budget=\"60\""),
                &format!("data-budget-metric=\"{name}\""),
            ];
            let cell = cell.map(String::as_str);
            assert_eq!(
                attribute(page, &cell, &format!("data-{part}")),
                metrics[metric][part].as_f64().unwrap(),
                "{name}"
            );
        }
    }
}

/// Table `budgets`, computed by the stage, equals the curve of the page, computed from the steps.
fn budgets_are_equal(artifact: &Artifact, curve: &Value) {
    let budgets = artifact
        .table(re4_stages::tables::of(re4_artifact::Stage::Rollout).pop().unwrap())
        .unwrap()
        .read_all()
        .unwrap();
    let steps: Vec<f64> = col_u32(&budgets, "budget")
        .unwrap()
        .iter()
        .map(|b| f64::from(*b))
        .collect();
    assert_eq!(numbers(&curve["budgets"]), steps);
    for measure in ["score", "coverage"] {
        for (part, column) in [("value", "mean"), ("low", "low"), ("high", "high")] {
            let shown: Vec<f64> = curve[measure]
                .as_array()
                .unwrap()
                .iter()
                .map(|interval| interval[part].as_f64().unwrap())
                .collect();
            assert_eq!(
                shown,
                col_f64(&budgets, &format!("{measure}_{column}")).unwrap(),
                "{measure} {part}"
            );
        }
    }
}

fn results_are_equal(artifact: &Artifact, shown: &Value) {
    let results = crate::support::results(artifact);
    for (name, column) in [
        ("score", "score_max"),
        ("coverage", "coverage_max"),
        ("iou", "iou_max"),
        ("coverage_final", "coverage_final"),
    ] {
        assert_eq!(numbers(&shown[name]), col_f64(&results, column).unwrap(), "{name}");
    }
    for name in ["seed", "steps", "decisions"] {
        let expected: Vec<f64> = col_u32(&results, name).unwrap().iter().map(|v| f64::from(*v)).collect();
        assert_eq!(numbers(&shown[name]), expected, "{name}");
    }
}

fn traces_are_equal(artifact: &Artifact, shown: &Value) {
    let steps = crate::support::steps(artifact);
    assert_eq!(f64s(&shown["steps"]["coverage"]), col_f64(&steps, "coverage").unwrap());
    let eef = f32s(&shown["steps"]["eef"]);
    let x: Vec<f32> = eef.iter().step_by(2).copied().collect();
    let expected: Vec<f32> = col_f64(&steps, "eef_x").unwrap().iter().map(|v| *v as f32).collect();
    assert_eq!(x, expected);
    let decisions = crate::support::decisions(artifact);
    assert_eq!(
        f64s(&shown["decisions"]["predicted_coverage"]),
        col_f64(&decisions, "predicted_coverage").unwrap()
    );
    let reasons = re4_artifact::col_text(&decisions, "reason").unwrap();
    let reasons: Vec<Value> = reasons.into_iter().map(|text| text.unwrap().into()).collect();
    assert_eq!(shown["decisions"]["reason"], Value::Array(reasons));
}

#[test]
fn the_page_has_the_demonstrations_of_the_decisions() {
    let (place, [folder, _]) = two_policies();
    let data = data(&page_of(&place, &folder));
    let index = place.artifact(Stage::Index);
    let shown = &data["demonstrations"][index.key().to_string()];
    let artifact = Artifact::open(&place.path().join(&folder)).unwrap();
    let decisions = crate::support::decisions(&artifact);
    let mut named = col_u32(&decisions, "demo").unwrap().to_vec();
    named.sort_unstable();
    named.dedup();
    assert_eq!(
        numbers(&shown["number"]),
        named.iter().map(|n| f64::from(*n)).collect::<Vec<_>>()
    );
    let frames = index
        .table(re4_index::IndexRow::<re4_index::PlanarState>::table())
        .unwrap()
        .read_all()
        .unwrap();
    let episodes = col_u32(&frames, "episode").unwrap();
    let theta = col_f64(&frames, "object_theta").unwrap();
    let expected: Vec<f32> = (0..episodes.len())
        .filter(|row| named.binary_search(&episodes[*row]).is_ok())
        .map(|row| theta[row] as f32)
        .collect();
    let packed = f32s(&shown["frames"]);
    assert_eq!(packed.iter().skip(4).step_by(5).copied().collect::<Vec<_>>(), expected);
}

#[test]
fn the_same_artifacts_give_the_same_page() {
    let (place, [one, two]) = two_policies();
    let page = page_of(&place, &format!("{one} {two}"));
    let absolute = place.path().join(&one);
    let again = page_of(&place, &format!("{} ./{two} --jobs 1", absolute.display()));
    assert!(page == again, "the page depends on the path of the artifacts");
    assert!(!page.contains(place.path().to_str().unwrap()));
    assert!(
        page != page_of(&place, &format!("{two} {one}")),
        "the page has the order of the arguments"
    );
    assert!(place.temporaries().is_empty());
}

#[test]
fn the_page_loads_no_other_files() {
    let (place, [folder, _]) = two_policies();
    let page = page_of(&place, &folder);
    // The only URL is the SVG namespace, which is a name and is not loaded.
    let addresses: Vec<&str> = page
        .match_indices("://")
        .map(|(at, _)| page[..at].rsplit(['"', '\'', ' ', '(']).next().unwrap_or_default())
        .collect();
    assert_eq!(addresses, ["http"], "{addresses:?}");
    assert!(page.contains("http://www.w3.org/2000/svg"));
    assert!(page.contains("default-src &#39;none&#39;") || page.contains("default-src 'none'"));
    assert!(!page.contains(" src="));
}

#[test]
fn seeds_limit_the_viewer_and_not_the_figures() {
    let (place, [folder, _]) = two_policies();
    let whole = page_of(&place, &folder);
    let answer = place
        .run(&format!(
            "report {folder} --seeds 501,503..505 --output page.html --json"
        ))
        .done();
    assert_eq!(answer.stderr, "");
    let answer = answer.json();
    let page = fs::read_to_string(place.path().join("page.html")).unwrap();
    assert_eq!(answer["report"], "page.html");
    assert_eq!(answer["bytes"], page.len());
    assert_eq!(answer["rollouts_in_viewer"], 3);
    assert!(page.len() < whole.len());
    let (page, whole) = (data(&page), data(&whole));
    assert_eq!(page["artifacts"][0]["shown"], serde_json::json!([1, 3, 4]));
    for part in ["rollouts", "curve"] {
        assert_eq!(page["artifacts"][0][part], whole["artifacts"][0][part]);
    }
}

#[test]
fn without_the_index_the_page_has_no_recorded_frames() {
    let (place, [folder, _]) = two_policies();
    fs::remove_dir_all(place.artifacts().join("index")).unwrap();
    let answer = place.run(&format!("report {folder} --output page.html")).done();
    with_settings!({ filters => filters() }, {
        assert_snapshot!(answer.stderr.trim_end(), @"warning: the page shows no recorded frames for artifacts/rollouts/[key]: its index artifact index/[key] is neither next to it nor in artifacts");
    });
    let page = fs::read_to_string(place.path().join("page.html")).unwrap();
    assert_eq!(data(&page)["demonstrations"], serde_json::json!({}));
}

#[test]
fn moved_artifacts_find_their_index_in_the_artifacts_folder() {
    let (place, [folder, _]) = two_policies();
    fs::rename(place.path().join(&folder), place.path().join("moved")).unwrap();
    let page = page_of(&place, "moved");
    assert_eq!(data(&page)["demonstrations"].as_object().unwrap().len(), 1);
}

#[test]
fn different_protocols_are_reported() {
    let (place, [folder, _]) = two_policies();
    place
        .run("run small.toml --no-images --seeds 600..603 --max-steps 30")
        .done();
    let folders = folders_in(&place.artifacts().join("rollouts"));
    let other = folders
        .iter()
        .find(|path| Artifact::open(path).unwrap().manifest().config["max_steps"] == 30)
        .unwrap();
    let page = page_of(&place, &format!("{folder} {}", other.display()));
    assert!(page.contains("data-differences=\"seeds max_steps\""));
    assert!(page.contains("These rollouts were not made under the same protocol."));
    assert_eq!(data(&page)["artifacts"][1]["label"], "re4 · seeds 600–602");
    assert!(!page_of(&place, &folder).contains("data-differences"));
}

#[test]
fn other_artifacts_than_rollouts_are_refused() {
    let (place, [folder, other]) = two_policies();
    let damaged = place.path().join(&other).join("steps.parquet");
    let mut content = fs::read(&damaged).unwrap();
    let middle = content.len() / 2;
    content[middle] ^= 1;
    fs::write(damaged, content).unwrap();
    fs::create_dir(place.path().join("folder")).unwrap();
    let index = place.artifact(Stage::Index).path().to_path_buf();
    let index = index.strip_prefix(place.path()).unwrap().display().to_string();
    let sentences: Vec<String> = [
        "missing".to_owned(),
        "small.toml".to_owned(),
        "folder".to_owned(),
        index.clone(),
        format!("{folder} {other}"),
        format!("{folder} ./{folder}"),
        format!("{folder} --seeds 7"),
        format!("{folder} --seeds seven"),
        format!("{folder} --output missing/page.html"),
        format!("{folder} --output folder"),
    ]
    .into_iter()
    .map(|arguments| {
        let sentence = place.run(&format!("report {arguments}")).refused_at_once();
        format!("report {arguments}\n  {sentence}")
    })
    .collect();
    assert!(
        !place.path().join("report.html").exists(),
        "a refused report left a page"
    );
    assert!(place.temporaries().is_empty());
    with_settings!({ filters => filters() }, {
        assert_snapshot!(sentences.join("\n"));
    });
    // A damaged index is an error; it is not left out as a missing one would be.
    let chunks = place.path().join(index).join("index.parquet");
    fs::write(chunks, "").unwrap();
    let sentence = place.run(&format!("report {folder}")).refused_at_once();
    assert!(sentence.contains("is damaged: index.parquet"), "{sentence}");
}

/// Opens the page of the demo pipeline in headless Chromium. `tests/report_page.py` has the checks.
#[test]
fn the_page_works_in_a_browser() {
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!(
            "skipped: RE4_PYTHON names no Python with selenium, polars and a Chromium beside it; run scripts/test.sh"
        );
        return;
    };
    let place = Place::empty();
    let demo = repository().join("pipelines/demo.toml");
    for policy in ["re4", "paper"] {
        let mut command = place.command();
        command.args(["run", demo.to_str().unwrap(), "--policy", policy]);
        let answer = command.env("RE4_DATA", repository().join("data")).output().unwrap();
        assert!(answer.status.success(), "{}", String::from_utf8_lossy(&answer.stderr));
    }
    let folders = folders_in(&place.artifacts().join("rollouts"));
    let paths: Vec<String> = folders.iter().map(|folder| folder.display().to_string()).collect();
    let page = page_of(&place, &paths.join(" "));
    assert!(page.len() < 5_000_000, "{} bytes", page.len());
    let look = |page: &Path, artifacts: &[PathBuf]| {
        let mut command = Command::new(&python);
        command
            .arg(repository().join("tests/report_page.py"))
            .arg(page)
            .args(artifacts);
        let answer = command.output().unwrap();
        assert!(
            answer.status.success(),
            "{}\n{}",
            String::from_utf8_lossy(&answer.stdout),
            String::from_utf8_lossy(&answer.stderr)
        );
    };
    look(&place.path().join("page.html"), &folders);
    // A page without recorded frames reports it, and works.
    fs::remove_dir_all(place.artifacts().join("index")).unwrap();
    page_of(&place, &paths[0]);
    look(&place.path().join("page.html"), &folders[..1]);
}

//! `compare`: the cells of a suite, a cell that cannot run, resuming after a kill, faults of the suite file, and the page.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

use insta::{assert_snapshot, with_settings};
use re4_artifact::{Artifact, Stage};
use re4_compare::{CellRow, CurveRow, DifferenceRow, Measure};
use re4_rollout::PlaneResultRow;
use serde_json::Value;

use crate::support::{Place, assert_same_bytes, filters, folders_in, repository, signal, wait_for};

/// Four rows, of which one names no policy, and two columns.
const SUITE: &str = r#"
title = "Small suite"
about = "Twelve scripted pushes."
printed_in = "no paper"
baseline = "ours"
seeds = "500..508"
curves = true

[[row]]
name = "ours"

[[row]]
name = "RE2"
policy = "re2"
set.policy.replay.horizon = 8

[[row]]
name = "nearest"
policy = "nearest"

[[row]]
name = "later"
policy = "not_yet"

[[column]]
name = "long"
pipeline = "small.toml"
printed = { RE2 = 0.25, later = 0.5 }

[[column]]
name = "short, success"
pipeline = "small.toml"
measures = ["success"]
set = { rollout.max_steps = 30 }

[[cell]]
rows = ["nearest"]
columns = ["short, success"]
leave_out = true
"#;

/// Two policies under `small.toml`.
pub(crate) const TWO_ROWS: &str = r#"
pipeline = "small.toml"
baseline = "re4"
curves = true

[[row]]
name = "re4"

[[row]]
name = "RE2"
policy = "re2"

[[column]]
name = "small"
"#;

/// The small dataset with a suite. Column names contain no comma, except in a test of that.
fn with_suite() -> Place {
    let place = Place::new();
    place.write("suite.toml", SUITE.replace("short, success", "short"));
    place
}

fn comparison(place: &Place) -> Artifact {
    place.artifact(Stage::Compare)
}

/// Results of the rollouts of a cell, by seed.
fn results(place: &Place, key: &str) -> BTreeMap<u32, PlaneResultRow> {
    let folder = place.artifacts().join("rollouts").join(&key[..16]);
    let rows: Vec<PlaneResultRow> = Artifact::open(&folder).unwrap().read().unwrap();
    rows.into_iter().map(|row| (row.core.seed, row)).collect()
}

fn value(row: &PlaneResultRow, measure: Measure) -> f64 {
    match measure {
        Measure::Score => row.score_max,
        Measure::Coverage => row.coverage_max,
        Measure::Iou => row.iou_max,
        Measure::Success => f64::from(u8::from(row.core.success)),
    }
}

#[test]
fn cells_and_differences_are_those_of_the_rollouts() {
    let place = with_suite();
    let answer = place.run("compare suite.toml --json");
    assert_eq!(answer.code, Some(1), "{}", answer.stderr);
    let json = answer.json();
    let artifact = comparison(&place);
    let cells: Vec<CellRow> = artifact.read().unwrap();
    // Three measures of four rows, and one measure of three rows.
    assert_eq!((cells.len(), json["cells"].as_array().unwrap().len()), (15, 15));
    assert_eq!(
        (&json["failed"], &json["skipped"]),
        (&Value::from(2), &Value::from(false))
    );
    let key = |row: &str, column: &str| {
        let cell = cells
            .iter()
            .find(|cell| cell.row == *row && cell.column == *column)
            .unwrap();
        cell.rollouts_key.clone().unwrap()
    };
    for cell in &cells {
        if cell.row == "later" {
            let sentence = cell.error.as_ref().unwrap();
            assert!(
                sentence.starts_with("unknown policy \"not_yet\" in policy.kind"),
                "{sentence}"
            );
            assert!(answer.stderr.contains(sentence), "{}", answer.stderr);
            assert_eq!(
                (cell.value, cell.rollouts, &cell.rollouts_key, cell.carried),
                (None, None, &None, None)
            );
            continue;
        }
        let rows = results(&place, &key(&cell.row, &cell.column));
        let mean = rows.values().map(|row| value(row, cell.measure)).sum::<f64>() / rows.len() as f64;
        assert!((cell.value.unwrap() - mean).abs() < 1e-12, "{cell:?}");
        assert!(cell.low.unwrap() <= mean && mean <= cell.high.unwrap());
        let steps = if cell.column == "short" { 30 } else { 60 };
        assert_eq!((cell.rollouts, cell.max_steps), (Some(8), Some(steps)));
        assert_eq!((cell.seeds.as_deref(), &cell.error), (Some("500..508"), &None));
        // All policies open the index, and nothing else.
        let index = place.artifact(Stage::Index);
        let files = fs::read_dir(index.path()).unwrap().map(|entry| entry.unwrap());
        let tables = files.filter(|entry| entry.file_name() != "manifest.json");
        let bytes: u64 = tables.map(|entry| entry.metadata().unwrap().len()).sum();
        assert_eq!(cell.carried, Some(bytes));
    }
    let printed: Vec<(&str, f64)> = cells
        .iter()
        .filter_map(|cell| Some((&*cell.row, cell.printed?)))
        .collect();
    assert_eq!(
        printed,
        [("RE2", 0.25), ("later", 0.5)],
        "only the first measure has a printed figure"
    );
    assert!(!cells.iter().any(|cell| cell.row == "nearest" && cell.column == "short"));
    let differences: Vec<DifferenceRow> = artifact.read().unwrap();
    let named: Vec<(&str, &str)> = differences.iter().map(|row| (&*row.column, &*row.row)).collect();
    assert_eq!(named[..3], [("long", "RE2"); 3]);
    assert_eq!(
        (named[3..6].to_vec(), named[6..].to_vec()),
        (vec![("long", "nearest"); 3], vec![("short", "RE2")])
    );
    for row in &differences {
        let (one, two) = (
            results(&place, &key(&row.row, &row.column)),
            results(&place, &key("ours", &row.column)),
        );
        let pairs: Vec<f64> = one
            .iter()
            .map(|(seed, a)| value(a, row.measure) - value(&two[seed], row.measure))
            .collect();
        assert!((row.difference - pairs.iter().sum::<f64>() / 8.0).abs() < 1e-12);
        let count = |sign: fn(f64) -> bool| pairs.iter().filter(|&&pair| sign(pair)).count() as u32;
        assert_eq!(
            (row.pairs, row.better, row.worse),
            (8, count(|d| d > 0.0), count(|d| d < 0.0))
        );
        assert_eq!(row.better + row.worse + row.equal, 8);
        assert!(row.low <= row.difference && row.difference <= row.high && (0.0..=1.0).contains(&row.p));
    }
    // The last budget of a curve is the whole episode.
    let curves: Vec<CurveRow> = artifact.read().unwrap();
    assert_eq!(curves.len(), 3 * 3 * 2 + 2, "{curves:?}");
    for point in curves.iter().filter(|point| point.budget != 50) {
        let same =
            |cell: &&CellRow| (&cell.row, &cell.column, cell.measure) == (&point.row, &point.column, point.measure);
        assert_eq!(cells.iter().find(same).unwrap().value, Some(point.value));
    }
}

/// Settings in the pipeline's [policy] belong to its own kind: another kind starts from its defaults.
#[test]
fn a_row_of_another_kind_does_not_take_the_settings_of_the_pipeline() {
    let place = Place::new();
    let small = fs::read_to_string(place.path().join("small.toml")).unwrap();
    let own = small.replace("policy = \"re4\"\n", "") + "[policy]\nkind = \"re4\"\nreplan.keepout = 21.0\n";
    place.write("own.toml", own);
    place.write(
        "suite.toml",
        "pipeline = \"own.toml\"\nseeds = \"500..502\"\n[[row]]\nname = \"a\"\npolicy = \"re4\"\n[[row]]\nname = \"b\"\npolicy = \"nearest\"\n[[column]]\nname = \"c\"\n",
    );
    place.run("compare suite.toml").done();
    let mut policies: Vec<Value> = folders_in(&place.artifacts().join("rollouts"))
        .iter()
        .map(|folder| Artifact::open(folder).unwrap().manifest().config["policy"].clone())
        .collect();
    policies.sort_by_key(|policy| policy["kind"].to_string());
    assert_eq!(policies[0]["kind"], "nearest");
    assert_eq!(policies[1]["replan"]["keepout"], 21.0);
}

#[test]
fn a_second_run_and_another_number_of_threads_give_the_same_bytes() {
    let place = with_suite();
    assert_eq!(place.run("compare suite.toml --jobs 1").code, Some(1));
    let bytes = place.bytes();
    let page = fs::read_to_string(place.path().join("suite.html")).unwrap();
    let again = place.run("compare suite.toml --json");
    assert_eq!(again.json()["skipped"], true);
    assert_same_bytes(&place.bytes(), &bytes);
    // The records of runs did not change either.
    assert!(fs::read_to_string(place.path().join("suite.html")).unwrap() == page);
    let other = with_suite();
    assert_eq!(other.run("compare suite.toml --jobs 2").code, Some(1));
    assert_same_bytes(&other.bytes(), &bytes);
    place.run("verify").done();
}

/// The times at which the rollouts of finished cells were written.
fn finished(place: &Place) -> BTreeMap<PathBuf, SystemTime> {
    let folders = folders_in(&place.artifacts().join("rollouts"));
    let published = folders
        .into_iter()
        .filter(|folder| folder.join("manifest.json").exists() && !name(folder).starts_with('.'));
    published
        .map(|folder| {
            let written = fs::metadata(folder.join("manifest.json")).unwrap().modified().unwrap();
            (folder, written)
        })
        .collect()
}

fn name(path: &Path) -> String {
    path.file_name().unwrap().to_string_lossy().into_owned()
}

#[test]
fn a_killed_comparison_continues_with_the_cells_that_are_missing() {
    let undisturbed = with_suite();
    undisturbed.run("compare suite.toml");
    let place = with_suite();
    for cells in 1..=3 {
        let mut child = place.start("compare suite.toml");
        wait_for("a finished cell", || {
            (finished(&place).len() >= cells || child.try_wait().unwrap().is_some()).then_some(())
        });
        child.kill().unwrap();
        child.wait().unwrap();
        let before = finished(&place);
        assert!(before.len() >= cells);
        assert!(!place.path().join("suite.html").exists() || cells == 3 || before.len() == 5);
    }
    let before = finished(&place);
    assert_eq!(place.run("compare suite.toml").code, Some(1));
    let after = finished(&place);
    assert!(
        before.iter().all(|(folder, written)| after[folder] == *written),
        "a finished cell ran again"
    );
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
    assert_same_bytes(&place.bytes(), &undisturbed.bytes());
}

#[test]
fn an_interrupted_comparison_leaves_nothing_half_written() {
    let place = with_suite();
    let child = place.start("compare suite.toml --seeds 0..100000");
    wait_for("the index", || {
        (!folders_in(&place.artifacts().join("index")).is_empty()).then_some(())
    });
    signal(&child, "INT");
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(75), "{message}");
    assert!(message.lines().last().unwrap().contains("was interrupted"), "{message}");
    assert!(place.temporaries().is_empty(), "{:?}", place.temporaries());
    assert!(!place.path().join("suite.html").exists() && !place.artifacts().join("comparison").exists());
}

#[test]
fn rows_and_columns_can_be_selected() {
    let place = with_suite();
    let answer = place
        .run("compare suite.toml --rows ours,RE2 --columns short --output one.html")
        .done();
    assert_eq!(comparison(&place).read::<CellRow>().unwrap().len(), 2);
    with_settings!({ filters => filters() }, { assert_snapshot!("selected", answer.stdout) });
    let page = fs::read_to_string(place.path().join("one.html")).unwrap();
    assert!(page.contains("data-column=\"short\"") && !page.contains("data-column=\"long\""));
    let refused = place.run("compare suite.toml --rows RE3").refused_at_once();
    assert!(
        refused.contains("--rows: there is no \"RE3\" (did you mean RE2?)"),
        "{refused}"
    );
}

#[test]
fn all_faults_of_a_suite_are_reported_at_once() {
    let place = Place::new();
    place.write("spatial.toml", "task = \"lift\"\nvariant = \"state\"\n[ingest]\nsource = \"x.hdf5\"\n[segment]\n[pose]\nsource = \"recorded\"\n[index]\n[policy]\nkind = \"re4\"\n[rollout]\nseeds = \"0..2\"\n");
    let rows = "[[row]]\nname = \"a\"\n[[row]]\nname = \"b\"\n";
    let column = "[[column]]\nname = \"c\"\npipeline = \"small.toml\"\n";
    let suites = [
        ("no rows", String::new()),
        (
            "unknown keys and a missing pipeline",
            format!(
                "baselin = \"a\"\n{rows}polcy = \"re2\"\n{column}[[column]]\nname = \"d\"\npipeline = \"missing.toml\"\n"
            ),
        ),
        (
            "two missing pipelines",
            format!(
                "{rows}[[column]]\nname = \"c\"\npipeline = \"one.toml\"\n[[column]]\nname = \"d\"\npipeline = \"two.toml\"\n[[column]]\nname = \"e\"\n"
            ),
        ),
        (
            "names",
            format!(
                "baseline = \"A\"\n{rows}{rows}{column}printed = {{ bb = 0.5 }}\n[[cell]]\nrows = [\"z\"]\ncolumns = [\"y\"]\n[[column]]\nname = \"d, e\"\npipeline = \"small.toml\"\n"
            ),
        ),
        (
            "a measure of another task",
            format!("{rows}[[column]]\nname = \"c\"\npipeline = \"spatial.toml\"\nmeasures = [\"coverage\"]\n"),
        ),
        (
            "other seeds",
            format!("baseline = \"a\"\n{rows}set.rollout.seeds = \"1..3\"\n{column}"),
        ),
        ("a wrong type", format!("{rows}{column}measures = \"speed\"\n")),
        ("a wrong word", format!("{rows}{column}measures = [\"speed\"]\n")),
        ("not TOML", "[[row\n".to_owned()),
        (
            "a pipeline without rollouts",
            format!("{rows}[[column]]\nname = \"c\"\npipeline = \"audit.toml\"\n"),
        ),
        ("nothing left", format!("{rows}{column}[[cell]]\nleave_out = true\n")),
    ];
    place.write(
        "audit.toml",
        "task = \"pusht\"\n[ingest]\nsource = \"small.zarr\"\n[segment]\nrule = \"always_transit\"\n",
    );
    let sentences: Vec<String> = suites
        .iter()
        .map(|(what, suite)| {
            place.write("bad.toml", suite);
            format!("{what}\n  {}", place.run("compare bad.toml").refused_at_once())
        })
        .chain([format!(
            "missing\n  {}",
            place.run("compare nowhere.toml").refused_at_once()
        )])
        .collect();
    assert!(!place.artifacts().exists(), "a refused suite ran a stage");
    with_settings!({ filters => filters() }, { assert_snapshot!("faults", sentences.join("\n")) });
    // A page that cannot be written is refused before any cell runs.
    place.write("suite.toml", SUITE.replace("short, success", "short"));
    for output in ["missing/page.html", "suite.toml", "small.toml"] {
        let refused = place
            .run(&format!("compare suite.toml --output {output}"))
            .refused_at_once();
        assert!(refused.contains("cannot write the page"), "{refused}");
    }
    assert!(!place.artifacts().exists());
}

/// An error in the settings or in the data of one cell is the sentence of that cell.
#[test]
fn other_cells_run_if_one_cannot() {
    let place = Place::new();
    place.write(
        "suite.toml",
        "pipeline = \"small.toml\"\nseeds = \"500..502\"\n[[row]]\nname = \"typing error\"\nset.policy.replay.horizn = 3\n[[row]]\nname = \"no data\"\nset.ingest.source = \"nowhere.zarr\"\n[[row]]\nname = \"re4\"\n[[column]]\nname = \"c\"\n",
    );
    let answer = place.run("compare suite.toml --quiet");
    assert_eq!((answer.code, answer.stderr.as_str()), (Some(1), ""));
    with_settings!({ filters => filters() }, { assert_snapshot!("cells_that_cannot_run", answer.stdout) });
}

#[test]
fn different_protocols_are_a_warning() {
    let place = Place::new();
    place.write(
        "suite.toml",
        "pipeline = \"small.toml\"\nbaseline = \"a\"\nseeds = \"500..502\"\n[[row]]\nname = \"a\"\n[[row]]\nname = \"b\"\nset.rollout.max_steps = 30\n[[column]]\nname = \"c\"\n",
    );
    let answer = place.run("compare suite.toml").done();
    let words = "in column \"c\", b and the baseline a have different protocols: rollout.max_steps is 30 and 60";
    assert!(answer.stderr.contains(words), "{}", answer.stderr);
    let page = fs::read_to_string(place.path().join("suite.html")).unwrap();
    assert!(page.contains("rollout.max_steps is 30 and 60"));
    assert_eq!(comparison(&place).manifest().warnings[0]["code"], "different_protocols");
}

#[test]
fn the_record_of_a_run_has_the_times_of_actions() {
    let place = with_suite();
    place.run("compare suite.toml --rows ours --columns long").done();
    let rollouts = place.artifact(Stage::Rollout);
    let path = place
        .artifacts()
        .join(format!("runs/rollout-{}.json", rollouts.key().short()));
    let record: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let rows: Vec<PlaneResultRow> = rollouts.read().unwrap();
    assert_eq!(
        record["actions"]["count"],
        rows.iter().map(|row| row.core.steps).sum::<u32>()
    );
    assert_eq!(
        record["decisions"]["count"],
        rows.iter().map(|row| row.core.decisions).sum::<u32>()
    );
    let time = |quantile: &str| record["actions"][quantile].as_f64().unwrap();
    assert!(0.0 < time("p50_us") && time("p50_us") <= time("p99_us") && time("p99_us") <= 1.005 * time("max_us"));
    assert!(record["threads"].as_u64().unwrap() > 0 && record["finished_unix_s"].as_u64().unwrap() > 1_700_000_000);
    // Without the record, the page says so, and shows everything else.
    let page = || fs::read_to_string(place.path().join("report.html")).unwrap();
    let folder = comparison(&place).path().to_owned();
    let report = format!("report {}", folder.display());
    place.run(&report).done();
    assert!(!page().contains("Some times have no record"));
    fs::remove_file(path).unwrap();
    place.run(&report).done();
    assert!(page().contains("Some times have no record"));
    let refused = place.run(&format!("{report} --seeds 500")).refused_at_once();
    assert!(
        refused.contains("it has a comparison artifact, not rollouts"),
        "{refused}"
    );
}

/// Without data, every cell of a shipped suite reports that the dataset or a simulator is missing, or that the policy is unknown.
/// Any other sentence is a fault of the suite.
#[test]
fn the_shipped_suites_are_accepted() {
    let place = Place::empty();
    let mut count = 0;
    for path in suites() {
        let answer = place.run_each(&["compare", path.to_str().unwrap(), "--json", "--quiet"]);
        assert_eq!(answer.code, Some(1), "{}", answer.stderr);
        for cell in answer.json()["cells"].as_array().unwrap() {
            let sentence = cell["error"].as_str().unwrap();
            let missing = ["was not found in", "simulators", "unknown policy"];
            assert!(
                missing.iter().any(|words| sentence.contains(words)),
                "{}: {sentence}",
                path.display()
            );
        }
        count += 1;
    }
    assert!(count >= 4);
}

/// The suites among the shipped pipelines.
pub(crate) fn suites() -> Vec<PathBuf> {
    let entries = fs::read_dir(repository().join("pipelines"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut suites: Vec<PathBuf> = entries.filter(|path| is_suite(path)).collect();
    suites.sort();
    suites
}

/// Whether a TOML file is a suite and not a pipeline.
pub(crate) fn is_suite(path: &Path) -> bool {
    fs::read_to_string(path).unwrap().contains("[[row]]")
}

/// Opens the page in headless Chromium. `tests/compare_page.py` has the checks.
#[test]
fn the_page_works_in_a_browser() {
    let Some(python) = std::env::var_os("RE4_PYTHON") else {
        println!(
            "skipped: RE4_PYTHON names no Python with selenium, polars and a Chromium beside it; run scripts/test.sh"
        );
        return;
    };
    let place = with_suite();
    place.run("compare suite.toml");
    let answer = Command::new(python)
        .arg(repository().join("tests/compare_page.py"))
        .arg(place.path().join("suite.html"))
        .arg(comparison(&place).path())
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(
        answer.status.success(),
        "{}\n{}",
        text(&answer.stdout),
        text(&answer.stderr)
    );
}

use std::collections::BTreeMap;

use re4_artifact::Label;

use super::*;

fn label(text: &str) -> Label {
    text.to_owned().into()
}

fn score(row: &str, column: &str, value: Option<f64>) -> CellRow {
    CellRow {
        row: label(row),
        column: label(column),
        pipeline: label("small.toml"),
        policy: Some(label("re4")),
        measure: Measure::Success,
        rollouts: value.map(|_| 4),
        value,
        low: value.map(|value| value / 2.0),
        high: value.map(|value| f64::midpoint(1.0, value)),
        printed: None,
        max_steps: Some(60),
        seeds: Some("0..4".to_owned()),
        carried: value.map(|_| 2_500_000),
        rollouts_key: value.map(|_| "ab".repeat(32)),
        error: value.is_none().then(|| "there is no <policy>; name one".to_owned()),
    }
}

fn comparison() -> Comparison {
    let times = Times {
        p50: 12.34,
        p99: 5600.0,
    };
    let cell = |row: &str, value| Cell {
        scores: vec![score(row, "c", value)],
        overrides: vec!["rollout.seeds=\"0..4\"".to_owned()],
        cost: Some(Cost {
            training: Training::Took(90.0),
            actions: Some(times),
            decisions: Some(times),
            threads: Some(2),
            finished: Some(0),
        }),
    };
    Comparison {
        tool_version: "0.0.0".to_owned(),
        key: "cd".repeat(32),
        title: "A <comparison>".to_owned(),
        about: String::new(),
        printed_in: "the paper".to_owned(),
        baseline: Some("ours".to_owned()),
        rows: ["ours", "other", "later"].map(str::to_owned).to_vec(),
        columns: vec![Column {
            name: "c".to_owned(),
            printed: BTreeMap::from([("other".to_owned(), 0.75)]),
        }],
        cells: vec![cell("ours", Some(1.0)), cell("other", Some(0.5)), cell("later", None)],
        differences: vec![DifferenceRow {
            row: label("other"),
            baseline: label("ours"),
            column: label("c"),
            measure: Measure::Success,
            pairs: 4,
            difference: -0.5,
            low: -1.0,
            high: 0.0,
            better: 0,
            worse: 2,
            equal: 2,
            p: 0.5,
        }],
        curves: Vec::new(),
        warnings: vec!["something differs".to_owned()],
    }
}

#[test]
fn the_page_states_scores_differences_costs_and_failures() {
    let html = page(&comparison());
    for expected in [
        "A &lt;comparison&gt;</h1>",
        "2 of 3 cells",
        "data-value=\"0.5\" data-low=\"0.25\" data-high=\"0.75\">0.500<",
        "printed 0.750",
        "there is no &lt;policy&gt;; name one",
        "−0.500",
        "[−1.000, 0.000]",
        "12.3 µs",
        "5.60 ms",
        "90 s",
        "2.5 MB",
        "1970-01-01 00:00 UTC",
        "Warning: something differs.",
        "rollout.seeds=&quot;0..4&quot;",
    ] {
        assert!(html.contains(expected), "{expected} is not in {html}");
    }
    assert_eq!(html.matches("cannot run</span>").count(), 1);
    assert!(!html.contains("figure difference behind"), "p is not below 0.05");
    assert!(!html.contains("Some times have no record") && !html.contains("Scores under smaller budgets"));
    assert_eq!(html, page(&comparison()));
}

#[test]
fn times_without_a_record_are_dashes_and_said_so() {
    let mut without = comparison();
    without.cells[1].cost = None;
    without.baseline = None;
    let html = page(&without);
    assert!(html.contains("Some times have no record"));
    assert!(!html.contains("Differences from"), "no differences without a baseline");
    let trained_elsewhere = |training| {
        let mut page_of = comparison();
        page_of.cells[0].cost.as_mut().unwrap().training = training;
        page(&page_of)
    };
    assert!(trained_elsewhere(Training::Unrecorded).contains("Some times have no record"));
    assert!(trained_elsewhere(Training::Nothing).contains(">none<"));
}

#[test]
fn curves_have_a_point_per_budget() {
    let mut with = comparison();
    with.curves = [50, 100]
        .map(|budget| CurveRow {
            row: label("ours"),
            column: label("c"),
            measure: Measure::Success,
            budget,
            value: 0.25,
            low: 0.1,
            high: 0.4,
        })
        .to_vec();
    let html = page(&with);
    assert!(html.contains("ours, 50 steps: 0.250 [0.100, 0.400]"));
    // A second class attribute would be ignored, and the curve would be black.
    assert!(html.contains("<g class=\"series series-0\" data-curve=\"ours\">"));
    assert_eq!(
        (
            html.matches("<circle class=\"point\"").count(),
            html.matches("data-budget=").count()
        ),
        (2, 2)
    );
}

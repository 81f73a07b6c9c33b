use std::collections::BTreeMap;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use re4_stats::mean;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use re4_rollout::Phase;

use super::super::summary::Summary;
use super::*;
use crate::html::rollouts::{Report, demo_name, page};

fn step(coverage: f64, replay: bool) -> PlaneStepRow {
    PlaneStepRow {
        core: StepCore {
            seed: 0,
            step: 0,
            decision: 0,
            phase: if replay { Phase::Replay } else { Phase::Plan },
            asked_object: None,
            asked_images: None,
        },
        action: Point2::new(100.5, 200.25),
        eef: Point2::new(101.0, 201.0),
        object: Pose2::new(256.0, 250.0, 0.5),
        contacts: 0.0,
        coverage,
        iou: coverage / 2.0,
        score: (coverage / 0.95).min(1.0),
        seen: None,
        pose_confidence: None,
        pose_flag: None,
    }
}

fn decision(reason: &str) -> Decided<Plane> {
    Decided {
        core: PlaneDecisionRow {
            core: DecisionCore {
                seed: 0,
                decision: 0,
                step: 0,
                kind: None,
                demo: Some(7),
                demo_frame: Some(1),
                demo_end: Some(2),
                reason: reason.to_owned(),
                demo_name: Some("episode 31".to_owned()),
            },
            query_eef: Point2::new(50.0, 60.0),
            query_object: Some(Pose2::new(256.0, 240.0, 0.5)),
        },
        detail: Some(PlaneRe4Row {
            seed: 0,
            decision: 0,
            mode: Mode::Transit,
            selector: Label::from("two_stage"),
            compared: 3,
            d_q: Some(0.125),
            d_o: None,
            delta: Pose2::new(1.0, 2.0, 0.1),
            set_point: Point2::new(10.0, 20.0),
            plan: Label::from("direct"),
            plan_steps: 1,
            plan_nodes: 0,
            plan_path: vec![1.0, 2.0, 10.0, 20.0],
            replay_steps: 2,
            predicted_object: Pose2::new(256.0, 256.0, 0.7),
            predicted_coverage: 0.875,
        }),
    }
}

pub(crate) fn rollout(seed: u32, coverage: &[f64]) -> Rollout<Plane> {
    let best = coverage.iter().copied().fold(0.0, f64::max);
    Rollout {
        result: PlaneResultRow {
            core: ResultCore {
                episode: 0,
                seed,
                success: best > 0.95,
                steps: coverage.len() as u32,
                decisions: 1,
                images: None,
            },
            eef: Point2::new(50.0, 60.0),
            object: Pose2::new(256.0, 240.0, 0.5),
            contacts: 0.0,
            score_max: (best / 0.95).min(1.0),
            coverage_max: best,
            iou_max: best / 2.0,
            coverage_final: *coverage.last().unwrap(),
        },
        shown: true,
        world: None,
        steps: coverage.iter().enumerate().map(|(i, &c)| step(c, i > 0)).collect(),
        decisions: vec![decision("nearest")],
    }
}

fn set(key: char, preset: &str) -> Rollouts<Plane> {
    let interval = Interval {
        value: 0.612_345_678_901_234_5,
        low: 0.5,
        high: 0.7,
    };
    Rollouts {
        key: String::from(key).repeat(64),
        index_key: "f".repeat(64),
        preset: preset.to_owned(),
        variant: "state".to_owned(),
        max_steps: 120,
        protocol: json!({"seeds": "500..502", "reset": "legacy", "dataset": {"episodes": 206}}),
        altered: false,
        settings: json!({"replay": {"horizon": 24}}),
        scene: Plane {
            demonstrations: Some(206),
            taken: Taken::All,
            in_dataset: Some(206),
            starts: Starts::Seeds,
            scenes: "seeds 500–501".to_owned(),
            metrics: Metrics {
                score_scaled_mean: interval,
                coverage_raw_mean: interval,
                iou_mean: interval,
                success_rate: interval,
            },
        },
        rollouts: vec![rollout(500, &[0.1, 0.4, 0.3]), rollout(501, &[0.2, 0.96])],
    }
}

fn report(artifacts: Vec<Rollouts<Plane>>) -> Report<Plane> {
    let demo = vec![vec![1.0, 2.0, 3.0, 4.0, 0.5]; 3];
    Report {
        tool_version: "0.1.0".to_owned(),
        artifacts,
        demonstrations: BTreeMap::from([("f".repeat(64), BTreeMap::from([(7, demo)]))]),
    }
}

/// The data of the page, as its script reads it.
fn data(page: &str) -> Value {
    let start = page.find("type=\"application/json\">").unwrap() + "type=\"application/json\">".len();
    let end = start + page[start..].find("</script>").unwrap();
    serde_json::from_str(&page[start..end]).unwrap()
}

fn f64s(packed: &Value) -> Vec<f64> {
    assert_eq!(packed["type"], "f64");
    let bytes = BASE64_STANDARD.decode(packed["data"].as_str().unwrap()).unwrap();
    bytes
        .chunks_exact(8)
        .map(|b| f64::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

#[test]
fn numbers_are_exactly_those_of_the_artifact() {
    let page = page(&report(vec![set('a', "re4")]));
    assert!(
        page.contains(
            r#"data-metric="score_scaled_mean" data-value="0.6123456789012345" data-low="0.5" data-high="0.7""#
        )
    );
    let artifact = &data(&page)["artifacts"][0];
    assert_eq!(f64s(&artifact["steps"]["coverage"]), [0.1, 0.4, 0.3, 0.2, 0.96]);
    assert_eq!(artifact["rollouts"]["score"][0].as_f64(), Some(0.4 / 0.95));
    let d_o = f64s(&artifact["decisions"]["d_o"]);
    assert!(d_o.iter().all(|value| value.is_nan()), "an absent distance is NaN");
    assert_eq!(f64s(&artifact["decisions"]["d_q"]), [0.125; 2]);
    assert_eq!(f64s(&artifact["decisions"]["delta"])[..3], [1.0, 2.0, 0.1]);
}

#[test]
fn texts_are_escaped() {
    let evil = "</script><script>alert(1)</script><!-- \u{2028} \" ' & ]]>";
    let mut set = set('a', evil);
    set.rollouts[0].decisions[0].core.core.reason = evil.to_owned();
    set.protocol = json!({ evil: evil });
    set.variant = evil.to_owned();
    let page = page(&report(vec![set]));
    assert_eq!(page.matches("<script").count(), 2, "data and script");
    assert_eq!(page.matches("</script>").count(), 2);
    assert!(!page.contains("<!--"));
    assert_eq!(data(&page)["artifacts"][0]["decisions"]["reason"][0], evil);
    assert!(page.contains("&lt;/script&gt;&lt;script&gt;alert(1)"));
}

#[test]
fn nothing_is_loaded_and_only_the_pages_script_may_run() {
    let page = page(&report(vec![set('a', "re4")]));
    for forbidden in [
        " src=",
        "@import",
        "url(",
        "import(",
        "fetch(",
        "XMLHttpRequest",
        "onclick",
    ] {
        assert!(!page.contains(forbidden), "{forbidden}");
    }
    let links: Vec<&str> = page
        .split("href=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    assert!(
        links.iter().all(|link| link.starts_with('#') || *link == "data:,"),
        "{links:?}"
    );
    let script = page
        .rsplit("<script>")
        .next()
        .unwrap()
        .split("</script>")
        .next()
        .unwrap();
    let hash = BASE64_STANDARD.encode(Sha256::digest(script.as_bytes()));
    assert!(
        page.contains(&format!("script-src &#39;sha256-{hash}&#39;"))
            || page.contains(&format!("script-src 'sha256-{hash}'"))
    );
}

#[test]
fn the_same_report_gives_the_same_bytes() {
    let make = || page(&report(vec![set('a', "re4"), set('b', "paper")]));
    assert_eq!(make(), make());
}

#[test]
fn differences_of_protocol_are_reported() {
    let (one, mut other) = (set('a', "re4"), set('b', "paper"));
    let same = page(&report(vec![one.clone(), other.clone()]));
    assert!(!same.contains("protocol-differs") && same.contains("All rollouts were made under the same protocol."));
    other.protocol["reset"] = json!("modern");
    other.protocol["further"] = json!(3);
    let page = page(&report(vec![one, other]));
    assert!(page.contains(r#"data-differences="reset further""#));
    assert!(page.contains("not made under the same protocol"));
}

#[test]
fn labels_distinguish_artifacts() {
    let labels = |sets: Vec<Rollouts<Plane>>| Summary::of(&report(sets)).labels;
    assert_eq!(labels(vec![set('a', "re4"), set('b', "paper")]), ["re4", "paper"]);
    let mut sparse = set('b', "re4");
    sparse.scene.demonstrations = Some(50);
    assert_eq!(
        labels(vec![set('a', "re4"), sparse, set('c', "re2")]),
        ["re4 · 206 demos", "re4 · 50 demos", "re2"]
    );
    assert_eq!(
        labels(vec![set('a', "re4"), set('b', "re4")]),
        ["re4 · aaaaaaaa", "re4 · bbbbbbbb"]
    );
}

#[test]
fn budgets_follow_from_the_steps() {
    let report = report(vec![set('a', "re4")]);
    let summary = Summary::of(&report);
    let curve = &summary.extras[0];
    assert_eq!(curve.budgets, [50, 100, 120]);
    assert_eq!(curve.coverage[0].value, mean(&[0.4, 0.96]));
    assert_eq!(curve.score[2].value, mean(&[0.4 / 0.95, 1.0]));
    assert_eq!(curve.steps.len(), 120);
    assert_eq!(
        curve.coverage_line[..3],
        [mean(&[0.1, 0.2]), mean(&[0.4, 0.96]), mean(&[0.4, 0.96])]
    );
}

#[test]
fn rollouts_that_are_not_shown_count_but_have_no_traces() {
    let mut set = set('a', "re4");
    set.rollouts[0].shown = false;
    let hidden = report(vec![set.clone()]);
    assert_eq!(Summary::of(&hidden).extras[0].coverage[0].value, mean(&[0.4, 0.96]));
    let artifact = &data(&page(&report(vec![set])))["artifacts"][0];
    assert_eq!(artifact["rollouts"]["seed"], json!([500, 501]));
    assert_eq!(artifact["shown"], json!([1]));
    assert_eq!(f64s(&artifact["steps"]["coverage"]), [0.2, 0.96]);
}

#[test]
fn estimated_poses_are_packed_if_there_are_any() {
    let mut set = set('a', "re4");
    let plain = data(&page(&report(vec![set.clone()])));
    assert!(plain["artifacts"][0]["steps"].get("observed").is_none());
    set.rollouts[0].steps[1].seen = Some(Pose2::new(1.0, 2.0, 3.0));
    set.rollouts[0].steps[1].pose_flag = Some(Label::from("clear"));
    set.rollouts[0].steps[1].pose_confidence = Some(0.75);
    set.rollouts[0].steps[2].pose_flag = Some(Label::from("held"));
    let steps = data(&page(&report(vec![set])))["artifacts"][0]["steps"].clone();
    assert_eq!(f64s(&steps["confidence"])[1], 0.75);
    assert!(f64s(&steps["confidence"])[0].is_nan());
    let bytes = BASE64_STANDARD
        .decode(steps["observed"]["data"].as_str().unwrap())
        .unwrap();
    assert_eq!(bytes.len(), 5 * 3 * 4);
    assert_eq!(steps["flag_words"], json!(["", "clear", "held"]));
    assert_eq!(
        BASE64_STANDARD.decode(steps["flag"]["data"].as_str().unwrap()).unwrap(),
        [0, 1, 2, 0, 0]
    );
    assert_eq!(bytes[12..16], 1.0f32.to_le_bytes());
}

#[test]
fn the_papers_results_are_shown_only_for_the_same_experiment() {
    let paper_result = |change: fn(&mut Rollouts<Plane>)| {
        let mut set = set('a', "re4");
        set.max_steps = 200;
        change(&mut set);
        let page = page(&report(vec![set]));
        let (_, table) = page.split_once("<tbody>").unwrap();
        let (_, figure) = table.split_once("</tbody>").unwrap().0.split_once("data-paper=\"")?;
        Some(figure.split_once('"').unwrap().0.to_owned())
    };
    assert_eq!(paper_result(|_| {}).as_deref(), Some("0.919"));
    assert_eq!(
        paper_result(|set| set.scene.taken = Taken::First(50)).as_deref(),
        Some("0.781")
    );
    assert_eq!(
        paper_result(|set| set.variant = "image".to_owned()).as_deref(),
        Some("0.883")
    );
    for change in [
        |set: &mut Rollouts<Plane>| set.scene.taken = Taken::First(40),
        |set: &mut Rollouts<Plane>| set.scene.taken = Taken::Other,
        |set: &mut Rollouts<Plane>| set.scene.in_dataset = Some(50),
        |set: &mut Rollouts<Plane>| set.scene.starts = Starts::Scenes,
        |set: &mut Rollouts<Plane>| set.max_steps = 300,
        |set: &mut Rollouts<Plane>| set.preset = "mine".to_owned(),
        |set: &mut Rollouts<Plane>| set.altered = true,
    ] {
        assert_eq!(paper_result(change), None);
    }
}

#[test]
fn decisions_of_older_versions_have_numbers_instead_of_names() {
    let mut core = decision("nearest").core.core;
    assert_eq!(demo_name(&core), "episode 31");
    core.demo_name = None;
    assert_eq!(demo_name(&core), "demonstration 7");
    core.demo = None;
    assert_eq!(demo_name(&core), "");
}

#[test]
fn decisions_of_other_policies_have_no_detail() {
    let mut set = set('a', "other");
    set.rollouts[0].decisions[0].detail = None;
    set.rollouts[0].decisions[0].core.core.demo = None;
    let decisions = data(&page(&report(vec![set])))["artifacts"][0]["decisions"].clone();
    let bytes = |name: &str| {
        BASE64_STANDARD
            .decode(decisions[name]["data"].as_str().unwrap())
            .unwrap()
    };
    assert_eq!(bytes("detailed"), [0, 1]);
    assert_eq!(bytes("demo"), [[0xff; 4], [7, 0, 0, 0]].concat());
    assert!(f64s(&decisions["d_q"])[0].is_nan());
}

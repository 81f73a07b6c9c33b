//! End-to-end tests of the audit: on the synthetic demonstrations in `data/`, whose errors are known, on Push-T, and on scripted
//! demonstrations if they are installed.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use crate::support::{Answer, Place, assert_same_bytes, real_data, repository};
use insta::assert_snapshot;
use re4_artifact::Stage;
use serde_json::Value;

/// Runs a command with a pipeline of the repository.
fn on(place: &Place, data: &Path, command: &str, pipeline: &str, more: &str) -> Answer {
    let output = place
        .command()
        .env("RE4_DATA", data)
        .arg(command)
        .arg(repository().join("pipelines").join(pipeline))
        .args(more.split_whitespace())
        .output()
        .unwrap();
    Answer::new(&output, place.path())
}

fn on_sample(place: &Place, command: &str, more: &str) -> Answer {
    on(
        place,
        &repository().join("data"),
        command,
        "can-sample-audit.toml",
        more,
    )
}

/// Codes of the findings with these severities, by demonstration.
fn codes(answer: &Value, severities: &[&str]) -> BTreeMap<String, Vec<String>> {
    let mut found: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for finding in answer["findings"].as_array().unwrap() {
        if severities.contains(&finding["severity"].as_str().unwrap()) {
            let code = finding["code"].as_str().unwrap().to_owned();
            found
                .entry(finding["demo"].as_str().unwrap().to_owned())
                .or_default()
                .push(code);
        }
    }
    for codes in found.values_mut() {
        codes.sort();
    }
    found
}

/// `data/README.md` lists the demonstrations with errors. All others have none, and get only notes.
#[test]
fn known_errors_are_found_and_nothing_else() {
    let place = Place::empty();
    let answer = on_sample(&place, "audit", "--json --quiet").done().json();
    let expected: BTreeMap<String, Vec<String>> = [
        ("demo_3", vec!["missed_grasp", "regrasp"]),
        ("demo_5", vec!["ends_before_success", "lost_grasp"]),
        ("demo_6", vec!["pushed_in_transit"]),
        (
            "demo_8",
            vec!["dropped", "early_release", "ends_before_success", "released_high"],
        ),
        ("demo_10", vec!["ends_before_success", "no_transfer"]),
        ("demo_11", vec!["flicker"]),
        ("demo_13", vec!["frozen"]),
        ("demo_14", vec!["saturated", "saturated_together"]),
        ("demo_16", vec!["duplicate"]),
        ("demo_18", vec!["discontinuity_eef"]),
    ]
    .into_iter()
    .map(|(demo, codes)| (demo.to_owned(), codes.into_iter().map(str::to_owned).collect()))
    .collect();
    assert_eq!(codes(&answer, &["error", "warning"]), expected);

    let notes = codes(&answer, &["note"]);
    let outliers: BTreeSet<&str> = notes
        .iter()
        .filter(|(_, codes)| codes.iter().any(|code| code == "outlier_length"))
        .map(|(demo, _)| demo.as_str())
        .collect();
    assert_eq!(outliers, BTreeSet::from(["demo_3", "demo_6", "demo_8", "demo_13"]));
    assert!(
        notes.values().flatten().all(|code| code == "outlier_length"),
        "the goals are not recorded, so that their rotation vectors have no seams: {notes:?}"
    );
}

#[test]
fn printed_audit() {
    let place = Place::empty();
    assert_snapshot!(on_sample(&place, "audit", "--quiet").done().stdout);
}

#[test]
fn a_failing_gate_still_writes_everything() {
    let place = Place::empty();
    for (gate, code) in [("", 0), ("--fail-on error", 1), ("--fail-on warning", 1)] {
        let answer = on_sample(&place, "audit", &format!("--json --quiet {gate}"));
        assert_eq!(answer.code, Some(code), "{gate}");
        assert!(!answer.json()["findings"].as_array().unwrap().is_empty());
    }
    place.artifact(Stage::Audit).verify_bytes().unwrap();

    let pushes = Place::new();
    let answer = pushes.run("audit small.toml --json --quiet --fail-on error");
    assert_eq!(answer.code, Some(0), "an error was found: {}", answer.stderr);
    assert_eq!(answer.json()["summary"]["errors"], 0);
}

#[test]
fn bytes_do_not_depend_on_the_number_of_threads() {
    let [one, three] = [1, 3].map(|jobs| {
        let place = Place::empty();
        on_sample(&place, "audit", &format!("--jobs {jobs}")).done();
        place
    });
    assert_same_bytes(&one.bytes(), &three.bytes());
}

#[test]
fn json_output_matches_the_tables() {
    let place = Place::empty();
    let answer = on_sample(&place, "audit", "--json --quiet").done().json();
    let findings = answer["findings"].as_array().unwrap();
    let summary = &answer["summary"];
    for (severity, key) in [("error", "errors"), ("warning", "warnings"), ("note", "notes")] {
        let count = findings
            .iter()
            .filter(|finding| finding["severity"] == severity)
            .count();
        assert_eq!(summary[key], count, "{key}");
    }
    for check in answer["checks"].as_array().unwrap() {
        let of_code: Vec<&Value> = findings
            .iter()
            .filter(|finding| finding["code"] == check["code"])
            .collect();
        let demos: BTreeSet<&str> = of_code
            .iter()
            .map(|finding| finding["demo"].as_str().unwrap())
            .collect();
        assert_eq!(check["findings"], of_code.len(), "{check}");
        assert_eq!(check["episodes"], demos.len(), "{check}");
        assert!(
            of_code.iter().all(|finding| finding["threshold"] == check["threshold"]),
            "{check}"
        );
    }
    assert_eq!(
        summary["grasps"]["outcomes"],
        serde_json::json!({ "held": 18, "lost": 1, "missed": 1 })
    );
    let frames: u64 = ["transit", "transfer"]
        .map(|mode| summary["modes"][mode]["frames"].as_u64().unwrap())
        .iter()
        .sum();
    assert_eq!(summary["frames"], frames);
}

#[test]
fn segment_also_runs_the_audit() {
    let place = Place::empty();
    let answer = on_sample(&place, "segment", "--quiet").done();
    let last = answer.stdout.lines().last().unwrap();
    assert_eq!(
        last,
        "audit: 4 errors in 4 demonstrations, 13 warnings, 4 notes; see re4-pipe audit"
    );
    place.artifact(Stage::Audit);
    let pushes = Place::new();
    let answer = pushes.run("segment small.toml --json --quiet").done().json();
    assert_eq!(answer["audit"]["stage"], "audit");
}

#[test]
fn thresholds_can_be_set_and_are_checked() {
    let place = Place::empty();
    let set = on_sample(
        &place,
        "audit",
        "--json --quiet --set audit.flicker=1 --set audit.pushed_in_transit=0.06",
    );
    let found = codes(&set.done().json(), &["error", "warning"]);
    assert!(!found.contains_key("demo_6"), "{found:?}");
    assert_eq!(
        found["demo_11"],
        ["regrasp"],
        "a grasp that is not a flicker is a second transfer"
    );
    let refusals = [
        on_sample(&place, "audit", "--set audit.flicker=-1").refused(),
        on_sample(&place, "audit", "--set audit.flikker=1").refused(),
        on_sample(&place, "audit", "--set segment.gripper.closed=-0.1").refused(),
        place
            .run("audit small.toml --set segment.rule=gripper_command")
            .refused(),
    ];
    assert_snapshot!(
        refusals
            .join("\n")
            .replace(repository().to_str().unwrap(), "[repository]")
    );
}

/// Retries in the scripted demonstrations, read off plots of fingers, heights and distances: first grasps that miss, and first
/// grasps that hold the object and release it again.
const MISSED: [(&str, &[u32]); 3] = [
    ("lift", &[1, 14, 32, 135, 149, 190, 198]),
    ("can", &[7, 63, 88, 93, 95, 102, 121, 145, 147, 152, 185, 186, 188]),
    ("square", &[36, 61, 73, 82, 89, 91, 152, 174, 181, 187]),
];
const LET_GO: [(&str, &[u32]); 3] = [
    ("lift", &[6, 42, 72, 130, 156, 172]),
    ("can", &[]),
    ("square", &[3, 9, 55, 160, 165]),
];

#[test]
fn retries_of_the_scripted_demonstrations_are_found_and_no_other_errors() {
    let Some(data) = real_data() else { return };
    if !data.join("robomimic-scripted").is_dir() {
        println!("skipped: no robomimic-scripted in RE4_DATA");
        return;
    }
    for ((task, missed), (_, let_go)) in MISSED.into_iter().zip(LET_GO) {
        let place = Place::empty();
        let answer = on(&place, &data, "audit", &format!("{task}-audit.toml"), "--json --quiet");
        let answer = answer.done().json();
        let demos = |code: &str| -> BTreeSet<u32> {
            let findings = answer["findings"].as_array().unwrap().iter();
            findings
                .filter(|finding| finding["code"] == code)
                .map(|finding| {
                    finding["demo"]
                        .as_str()
                        .unwrap()
                        .trim_start_matches("demo_")
                        .parse()
                        .unwrap()
                })
                .collect()
        };
        assert_eq!(demos("missed_grasp"), missed.iter().copied().collect(), "{task}");
        assert_eq!(
            demos("regrasp"),
            missed.iter().chain(let_go).copied().collect(),
            "{task}"
        );
        assert_eq!(answer["summary"]["errors"], missed.len(), "{task}");
    }
}

/// The demonstrations with planted faults, and their truth.
fn planted() -> Option<(std::path::PathBuf, Value)> {
    let data = real_data()?;
    let truth = data.join("audit-truth/lift_faults.json");
    if !truth.is_file() {
        println!("skipped: no audit-truth/lift_faults.json in RE4_DATA");
        return None;
    }
    Some((data, serde_json::from_slice(&fs::read(truth).unwrap()).unwrap()))
}

const PLANTED: &str = "--set ingest.source=audit-truth/lift_faults.hdf5";

/// A fault is found if a finding of a fitting code touches its frames, extended by 6 frames. `benches/audit_truth.py` prints the
/// same comparison as a table.
#[test]
fn planted_faults_are_found_and_clean_demonstrations_have_none() {
    let Some((data, truth)) = planted() else { return };
    let names: BTreeMap<String, Vec<String>> =
        serde_json::from_slice(&fs::read(repository().join("benches/audit_truth.json")).unwrap()).unwrap();
    let place = Place::empty();
    let answer = on(
        &place,
        &data,
        "audit",
        "lift-audit.toml",
        &format!("--json --quiet {PLANTED}"),
    );
    let answer = answer.done().json();
    let findings = answer["findings"].as_array().unwrap();
    let frame = |value: &Value, key: &str| value[key].as_i64().unwrap();
    let (mut missed, mut all) = (Vec::new(), 0);
    for (demo, own) in truth.as_object().unwrap() {
        let found = || findings.iter().filter(|finding| finding["demo"] == demo.as_str());
        for fault in own["faults"].as_array().unwrap() {
            let kind = fault["kind"].as_str().unwrap();
            let fits = |finding: &Value| names[kind].iter().any(|code| finding["code"] == code.as_str());
            let touches = |finding: &Value| {
                frame(finding, "first_frame") < frame(fault, "end") + 6
                    && frame(finding, "end_frame") > frame(fault, "first") - 6
            };
            // The finding of a copy can be on either twin.
            let twin = findings
                .iter()
                .any(|finding| fits(finding) && finding["other_demo"] == demo.as_str());
            all += 1;
            if !found().any(|finding| fits(finding) && touches(finding)) && !twin {
                missed.push(format!("{demo}: {fault}"));
            }
        }
        if own["clean"] == true {
            let severe = |finding: &&Value| finding["severity"] != "note" && finding["other_demo"].is_null();
            let severe: Vec<_> = found().filter(severe).collect();
            assert!(severe.is_empty(), "{demo} is clean: {severe:?}");
        }
    }
    assert!(
        all == 50 && 20 * missed.len() <= all,
        "{all} planted, missed: {missed:#?}"
    );
    // Every demonstration is audited, also those that contradict the conventions of the file.
    assert_eq!(answer["summary"]["episodes"], 64);
    assert_eq!(answer["summary"]["by_code"]["left_out"], 6);
    let rows: Vec<re4_audit::RuleAgreementRow> = place.artifact(Stage::Audit).read().unwrap();
    assert_eq!(rows.len(), 64 * 4);
    on(
        &place,
        &data,
        "audit",
        "lift-audit.toml",
        &format!("--quiet {PLANTED} --html audit.html"),
    )
    .done();
}

/// The F1 score of transfer against the frames in which both fingers touch the object.
#[test]
fn modes_match_the_true_grasps() {
    let Some((data, truth)) = planted() else { return };
    for (rule, least) in [("gripper_command", 0.8), ("grasp", 0.97), ("evidence", 0.97)] {
        let place = Place::empty();
        let settings = format!("--quiet {PLANTED} --set ingest.on_bad=leave_out --set segment.rule={rule}");
        on(&place, &data, "segment", "lift-audit.toml", &settings).done();
        let names: Vec<re4_artifact::episodes::DemoRow> = place.artifact(Stage::Ingest).read().unwrap();
        let modes: Vec<re4_segment::ModeRow<re4_segment::SpatialEvidence>> =
            place.artifact(Stage::Segment).read().unwrap();
        let (mut both, mut either) = (0, 0);
        for row in &modes {
            let grasp = truth[&names[row.episode as usize].demo]["grasp"][row.frame as usize] == 1;
            let transfer = row.mode == re4_episode::Mode::Transfer;
            both += 2 * usize::from(grasp && transfer);
            either += usize::from(grasp) + usize::from(transfer);
        }
        let score = both as f64 / either as f64;
        assert!(score >= least, "{rule}: {score}");
        let agreement: Vec<re4_audit::RuleAgreementRow> = place.artifact(Stage::Audit).read().unwrap();
        let own = agreement.iter().filter(|row| row.configured);
        assert!(own.clone().all(|row| &*row.rule == rule && row.agreement == 1.0));
        assert!(own.count() > 0);
    }
}

/// The table of checks in the documentation has to match the code; `RE4_UPDATE=1` updates it.
#[test]
fn documented_checks_are_up_to_date() {
    let path = repository().join("docs/reference/audit-checks.md");
    let text = fs::read_to_string(&path).unwrap();
    let (before, rest) = text.split_once("<!-- checks -->\n").unwrap();
    let (table, after) = rest.split_once("<!-- end of checks -->\n").unwrap();
    let current = re4_audit::markdown();
    if std::env::var_os("RE4_UPDATE").is_some() {
        fs::write(
            &path,
            format!("{before}<!-- checks -->\n{current}<!-- end of checks -->\n{after}"),
        )
        .unwrap();
    } else {
        assert_eq!(table, current, "run the test with RE4_UPDATE=1");
    }
}

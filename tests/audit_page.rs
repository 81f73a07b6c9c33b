//! The HTML page of an audit: its figures are those of the artifact, it loads no other files, and it works in a browser.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Place, repository, synthetic_audit};
use re4_artifact::Row as _;
use re4_artifact::episodes::{FrameRow, SpatialColumns};
use re4_artifact::{Artifact, Stage, TableSpec, col_f64_or_null, col_text, col_u32, col_u32_or_null};
use re4_audit::{AuditedEpisodeRow, Severity};
use re4_report::html::audit::{Audit, page};
use re4_segment::{Evidence, ModeRow, SpatialEvidence};
use serde_json::{Map, Value, json};

/// Maximum size of a page for 600 demonstrations of somewhat over 100 frames.
const LARGEST: usize = 8_000_000;

/// The expected contents, with which `tests/audit_page.py` compares the page.
fn expected(audit: &Audit) -> Value {
    let of = |severity| audit.findings.iter().filter(|f| f.severity == severity).count();
    let codes: Map<String, Value> = audit
        .checks
        .iter()
        .map(|check| (check.code.to_string(), json!([check.findings, check.episodes])))
        .collect();
    let mut outcomes = Map::new();
    for grasp in &audit.grasps {
        let count = outcomes.entry(grasp.outcome.clone()).or_insert(json!(0));
        *count = json!(count.as_u64().unwrap() + 1);
    }
    let severities = [Severity::Error, Severity::Warning, Severity::Note];
    let sum = |value: fn(&AuditedEpisodeRow) -> usize| audit.demos.iter().map(value).sum::<usize>();
    json!({
        "frames": sum(|d| d.frames),
        "transit_frames": sum(|d| d.transit_frames),
        "transfer_frames": sum(|d| d.transfer_frames),
        "severities": severities.map(|s| (s.as_str().to_owned(), of(s).into())).into_iter().collect::<Map<_, _>>(),
        "codes": codes,
        "grasps": audit.grasps.len(),
        "outcomes": outcomes,
        "demos": audit.demos.iter().map(|d| json!({
            "number": d.episode, "name": d.demo, "frames": d.frames, "transfer_frames": d.transfer_frames,
            "segments": d.segments, "grasp_frame": d.grasp_frame,
            "error": d.errors, "warning": d.warnings, "note": d.notes,
        })).collect::<Vec<_>>(),
        "panels": audit.panels.iter().map(|panel| json!({
            "title": panel.title,
            "values": panel.series.iter().map(|s| Some(s.values[2]).filter(|v| v.is_finite())).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
    })
}

fn python() -> Option<PathBuf> {
    let python = std::env::var_os("RE4_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped: RE4_PYTHON is not set; run scripts/setup-python.sh and set it to target/python/bin/python");
    }
    python
}

/// Checks a page in the browser. Returns the output of the script.
#[track_caller]
fn look(python: &Path, page: &Path, expected: &Value, more: &[&str]) -> String {
    let summary = page.with_extension("json");
    fs::write(&summary, expected.to_string()).unwrap();
    let output = Command::new(python)
        .arg(repository().join("tests/audit_page.py"))
        .args([page, &summary])
        .args(more)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{text}");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    text
}

#[test]
fn hundreds_of_demonstrations_work_in_a_browser() {
    let audit = synthetic_audit::audit(600);
    let text = page(&audit);
    println!("600 demonstrations: {} bytes", text.len());
    assert!(text.len() < LARGEST, "{} bytes", text.len());
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("synthetic.html");
    fs::write(&place, text).unwrap();
    look(&python, &place, &expected(&audit), &["--many"]);
}

#[test]
fn a_single_demonstration_works_in_a_browser() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("one.html");
    let audit = synthetic_audit::audit(1);
    fs::write(&place, page(&audit)).unwrap();
    look(&python, &place, &expected(&audit), &[]);
}

#[test]
fn the_page_loads_no_other_files() {
    let text = page(&synthetic_audit::audit(3));
    let addresses: Vec<&str> = text
        .match_indices("://")
        .map(|(at, _)| text[..at].rsplit(['"', '\'', ' ', '(']).next().unwrap_or_default())
        .collect();
    // The SVG namespace is a name and is not loaded.
    assert_eq!(addresses, ["http"], "{addresses:?}");
    assert!(text.contains("default-src 'none'"));
    assert!(!text.contains(" src="));
    // A finding that contains `</script>` must not end the script element: two script elements begin, and two end.
    assert_eq!(text.matches("</script>").count(), 2);
}

#[test]
fn the_same_audit_gives_the_same_page() {
    assert!(page(&synthetic_audit::audit(5)) == page(&synthetic_audit::audit(5)));
    assert!(page(&synthetic_audit::audit(5)) != page(&synthetic_audit::audit(6)));
}

/// A folder with the sample of pick-and-place demonstrations.
fn can() -> Place {
    let place = Place::empty();
    fs::copy(
        repository().join("data/can-sample.hdf5"),
        place.path().join("data/can-sample.hdf5"),
    )
    .unwrap();
    place.write(
        "can.toml",
        fs::read_to_string(repository().join("pipelines/can-sample-audit.toml")).unwrap(),
    );
    place
}

/// The expected contents of the page: counts from the output of `audit --json`, everything else from the tables.
fn expected_of(place: &Place, answer: &Value, panels: &[(&str, Stage, &'static TableSpec, &[&str])]) -> Value {
    let summary = &answer["summary"];
    let mut codes = Map::new();
    for check in answer["checks"].as_array().unwrap() {
        let code = check["code"].as_str().unwrap();
        codes.insert(code.to_owned(), json!([check["findings"], check["episodes"]]));
    }
    let mut found: BTreeMap<(u64, String), u64> = BTreeMap::new();
    for finding in answer["findings"].as_array().unwrap() {
        let severity = finding["severity"].as_str().unwrap().to_owned();
        *found
            .entry((finding["episode"].as_u64().unwrap(), severity))
            .or_default() += 1;
    }
    let rows = place
        .artifact(Stage::Audit)
        .table(AuditedEpisodeRow::table())
        .unwrap()
        .read_all()
        .unwrap();
    let number = |name| col_u32(&rows, name).unwrap();
    let names = col_text(&rows, "demo").unwrap();
    let grasps = col_u32_or_null(&rows, "grasp_frame").unwrap();
    let demos: Vec<Value> = (0..rows.num_rows())
        .map(|i| {
            let episode = number("episode")[i];
            let of = |severity: &str| {
                found
                    .get(&(u64::from(episode), severity.to_owned()))
                    .copied()
                    .unwrap_or(0)
            };
            json!({
                "number": episode, "name": names[i].unwrap(), "frames": number("frames")[i],
                "transfer_frames": number("transfer_frames")[i], "segments": number("segments")[i],
                "grasp_frame": grasps[i],
                "error": of("error"), "warning": of("warning"), "note": of("note"),
            })
        })
        .collect();
    let outcomes = summary["grasps"]["outcomes"].as_object().cloned().unwrap_or_default();
    json!({
        "frames": summary["frames"],
        "transit_frames": summary["modes"]["transit"]["frames"],
        "transfer_frames": summary["modes"]["transfer"]["frames"],
        "severities": { "error": summary["errors"], "warning": summary["warnings"], "note": summary["notes"] },
        "codes": codes,
        "contacts": summary.get("contacts"),
        "grasps": if outcomes.is_empty() { Value::Null } else { outcomes.values().map(|v| v.as_u64().unwrap()).sum::<u64>().into() },
        "outcomes": outcomes,
        "demos": demos,
        "panels": panels.iter().map(|(title, stage, table, columns)| {
            let rows = place.artifact(*stage).table(table).unwrap().read_all().unwrap();
            let values: Vec<_> = columns.iter().map(|column| col_f64_or_null(&rows, column).unwrap()[2]).collect();
            json!({ "title": title, "values": values })
        }).collect::<Vec<_>>(),
    })
}

#[test]
fn figures_match_the_printed_audit() {
    let place = can();
    let answer = place.run("audit can.toml --html page.html --json").done().json();
    let page = place.path().join("page.html");
    let modes = (Stage::Segment, ModeRow::<SpatialEvidence>::table());
    let of = |title, columns| (title, modes.0, modes.1, columns);
    let expected = expected_of(
        &place,
        &answer,
        &[
            of("Finger separation", &["finger_separation"][..]),
            (
                "Height",
                Stage::Ingest,
                FrameRow::<SpatialColumns>::table(),
                &["eef_z", "object_z"],
            ),
            of("Speed", &["eef_step", "object_step"]),
            of("Relative translation", &["relative_translation"]),
            of("Relative rotation", &["relative_rotation"]),
            of("Grip site to object", &["eef_object_distance"]),
        ],
    );
    // The sample has findings of several kinds, and missed grasps.
    assert!(expected["severities"]["error"].as_u64().unwrap() > 0, "{expected}");
    assert!(expected["outcomes"]["missed"].as_u64().unwrap() > 0, "{expected}");
    let text = fs::read_to_string(&page).unwrap();
    assert!(text.contains("re4-pipe audit can.toml"));
    for artifact in [Stage::Audit, Stage::Segment, Stage::Ingest].map(|stage| place.artifact(stage)) {
        assert!(text.contains(&format!("{}/{}", artifact.manifest().artifact, artifact.key().short())));
    }
    for finding in answer["findings"].as_array().unwrap() {
        let message = serde_json::to_string(&finding["message"]).unwrap();
        assert!(text.contains(&message), "{message} is not on the page");
    }
    for check in answer["checks"].as_array().unwrap() {
        if let Some(threshold) = check["threshold"].as_f64() {
            assert!(text.contains(&format!("data-value=\"{threshold}\"")), "{check}");
        }
    }
    let Some(python) = python() else { return };
    look(&python, &page, &expected, &[]);
}

#[test]
fn push_t_shows_contacts_instead_of_grasps() {
    let place = Place::new();
    let answer = place
        .run("audit small.toml --no-images --html page.html --json")
        .done()
        .json();
    let of = |title, columns| (title, Stage::Segment, ModeRow::<Evidence>::table(), columns);
    let expected = expected_of(
        &place,
        &answer,
        &[
            of("Contact points", &["contacts"][..]),
            of("Speed", &["eef_step", "object_step"]),
            of("Block rotation", &["object_rotation"]),
            of("Relative translation", &["relative_translation"]),
            of("Pusher to block", &["eef_object_distance"]),
        ],
    );
    assert!(expected["contacts"]["contact_and_motion"].as_u64().unwrap() > 0);
    let text = fs::read_to_string(place.path().join("page.html")).unwrap();
    assert!(text.contains("Where contact begins") && !text.contains("From above"));
    let Some(python) = python() else { return };
    look(&python, &place.path().join("page.html"), &expected, &[]);
}

#[test]
fn the_page_is_written_atomically() {
    let place = can();
    for path in ["nowhere/page.html", "data"] {
        let refusal = place.run(&format!("audit can.toml --html {path}")).refused_at_once();
        assert!(refusal.contains(&format!("cannot write the page {path}")), "{refusal}");
        assert!(!place.artifacts().exists(), "a stage ran before the error");
    }
    let first = place.run("audit can.toml --html page.html --json").done();
    let page = fs::read_to_string(place.path().join("page.html")).unwrap();
    assert!(first.stderr.contains("page  page.html  "), "{}", first.stderr);
    // The page has the same bytes if artifacts exist already, on one thread, if it replaces a file, and with a failing gate.
    fs::write(place.path().join("other.html"), "old").unwrap();
    let failed = place.run("audit can.toml --html other.html --jobs 1 --fail-on error");
    assert_eq!(failed.code, Some(1), "{}", failed.stderr);
    assert!(fs::read_to_string(place.path().join("other.html")).unwrap() == page);
    assert!(!page.contains(place.path().to_str().unwrap()));
    assert!(place.temporaries().is_empty());
    assert!(Artifact::open(place.artifact(Stage::Audit).path()).is_ok());
}

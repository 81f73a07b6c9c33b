//! The page of an audit: its figures are the artifact's, it needs nothing but itself, and it works in a browser.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may stop where it fails"
)]

mod support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use re4_report::html::audit::{Audit, Severity, page};
use serde_json::{Map, Value, json};
use support::{invented, repository};

/// The largest page for 600 demonstrations of a hundred and some frames.
const LARGEST: usize = 8_000_000;

/// What `tests/audit_page.py` compares the page with.
fn expected(audit: &Audit) -> Value {
    let of = |severity| audit.findings.iter().filter(|f| f.severity == severity).count();
    let codes: Map<String, Value> = audit
        .checks
        .iter()
        .map(|check| (check.code.clone(), json!([check.findings, check.episodes])))
        .collect();
    let mut outcomes = Map::new();
    for grasp in &audit.grasps {
        let count = outcomes.entry(grasp.outcome.clone()).or_insert(json!(0));
        *count = json!(count.as_u64().unwrap() + 1);
    }
    let sum = |value: fn(&re4_report::html::audit::Demo) -> u32| audit.demos.iter().map(value).sum::<u32>();
    json!({
        "frames": sum(|d| d.frames),
        "transit_frames": sum(|d| d.transit_frames),
        "transfer_frames": sum(|d| d.transfer_frames),
        "severities": Severity::ALL.map(|s| (s.as_str().to_owned(), of(s).into())).into_iter().collect::<Map<_, _>>(),
        "codes": codes,
        "grasps": audit.grasps.len(),
        "outcomes": outcomes,
        "demos": audit.demos.iter().map(|d| json!({
            "number": d.number, "name": d.name, "frames": d.frames, "transfer_frames": d.transfer_frames,
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

/// Looks at a page in the browser; what the script says.
#[track_caller]
fn look(python: &Path, page: &Path, expected: &Value, more: &[&str]) -> String {
    let facts = page.with_extension("json");
    fs::write(&facts, expected.to_string()).unwrap();
    let output = Command::new(python)
        .arg(repository().join("tests/audit_page.py"))
        .args([page, &facts])
        .args(more)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{said}");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    said
}

#[test]
fn hundreds_of_demonstrations_work_in_a_browser() {
    let audit = invented::audit(600);
    let text = page(&audit);
    println!("600 demonstrations: {} bytes", text.len());
    assert!(text.len() < LARGEST, "{} bytes", text.len());
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("invented.html");
    fs::write(&place, text).unwrap();
    look(&python, &place, &expected(&audit), &["--many"]);
}

#[test]
fn a_single_demonstration_works_in_a_browser() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("one.html");
    let audit = invented::audit(1);
    fs::write(&place, page(&audit)).unwrap();
    look(&python, &place, &expected(&audit), &[]);
}

#[test]
fn the_page_needs_nothing_but_itself() {
    let text = page(&invented::audit(3));
    let addresses: Vec<&str> = text
        .match_indices("://")
        .map(|(at, _)| text[..at].rsplit(['"', '\'', ' ', '(']).next().unwrap_or_default())
        .collect();
    // The name of the SVG language, which nothing loads.
    assert_eq!(addresses, ["http"], "{addresses:?}");
    assert!(text.contains("default-src 'none'"));
    assert!(!text.contains(" src="));
    // What a finding says cannot end the script that holds it: two scripts begin, two end.
    assert_eq!(text.matches("</script>").count(), 2);
}

#[test]
fn the_same_audit_gives_the_same_page() {
    assert!(page(&invented::audit(5)) == page(&invented::audit(5)));
    assert!(page(&invented::audit(5)) != page(&invented::audit(6)));
}

#[test]
fn writes() {
    for count in [1, 200, 600] {
        let audit = invented::audit(count);
        fs::write(format!("/tmp/re4/page-{count}.html"), page(&audit)).unwrap();
        fs::write(format!("/tmp/re4/page-{count}.json"), expected(&audit).to_string()).unwrap();
    }
}

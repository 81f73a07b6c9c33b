//! The data of the page's script: one JSON object, in which columns with one value per frame are packed as base64.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use re4_audit::{AuditedEpisodeRow, FindingRow, Severity};
use re4_scores::{Better, KINDS, ScoreRow, ranks};
use serde_json::{Value, json};

use super::{Audit, Flag, Grasp, Panel, SEVERITIES, Segment, Series, Shot};
use crate::html::pack::{Pack, f32s};

/// Code of a flag whose value is unknown at a frame. The known values are 0 and 1.
const UNKNOWN: u8 = 2;

/// Returns the data of the page.
pub(super) fn json(audit: &Audit) -> Value {
    // The script refers to demonstrations by their index in the list, not by their number in the artifact.
    let place = |episode: u32| {
        audit
            .demos
            .binary_search_by_key(&episode, |demo| demo.episode)
            .unwrap_or_default()
    };
    let mut data = json!({
        "dataset": audit.dataset,
        "frame_seconds": audit.frame_seconds,
        "length": { "unit": audit.length.unit, "factor": audit.length.factor },
        "severities": SEVERITIES.map(Severity::as_str),
        "checks": audit.checks.iter().map(|check| json!({
            "code": check.code.to_string(),
            "severity": severity(check.severity),
            "meaning": check.meaning,
        })).collect::<Vec<_>>(),
        "demos": demos(&audit.demos),
        "findings": findings(&audit.findings, place),
        "segments": segments(&audit.segments, place),
        "grasps": grasps(&audit.grasps, place),
        "outline": audit.outline,
        "flags": audit.flags.iter().map(flag).collect::<Vec<_>>(),
        "panels": audit.panels.iter().map(panel).collect::<Vec<_>>(),
        "scores": scores(&audit.scores, place),
        "shots": shots(&audit.shots),
    });
    if !audit.object {
        data["object"] = json!(false);
    }
    data
}

fn severity(severity: Severity) -> usize {
    SEVERITIES
        .iter()
        .position(|known| *known == severity)
        .unwrap_or_default()
}

fn demos(demos: &[AuditedEpisodeRow]) -> Value {
    Pack::of(demos)
        .list("number", |d| d.episode)
        .list("name", |d| d.demo.as_str())
        .list("frames", |d| d.frames)
        .list("transit", |d| d.transit_frames)
        .list("transfer", |d| d.transfer_frames)
        .list("segments", |d| d.segments)
        .list("transfers", |d| d.transfers)
        .list("grasp", |d| d.grasp_frame)
        .list("displacement", |d| d.object_displacement)
        .list("errors", |d| d.errors)
        .list("warnings", |d| d.warnings)
        .list("notes", |d| d.notes)
        .json()
}

fn findings(findings: &[FindingRow], place: impl Fn(u32) -> usize) -> Value {
    Pack::of(findings)
        .list("severity", |f| severity(f.severity))
        .list("code", |f| f.code.to_string())
        .list("demo", |f| place(f.episode))
        .list("first", |f| f.frames.start)
        .list("end", |f| f.frames.end)
        .list("value", |f| f.value)
        .list("threshold", |f| f.threshold)
        .list("unit", |f| f.unit.to_string())
        .list("message", |f| f.message.as_str())
        .json()
}

fn segments(segments: &[Segment], place: impl Fn(u32) -> usize) -> Value {
    Pack::of(segments)
        .list("demo", |s| place(s.episode))
        .list("number", |s| s.number)
        .list("transfer", |s| u8::from(s.transfer))
        .list("first", |s| s.first_frame)
        .list("end", |s| s.end_frame)
        .list("settled", |s| s.settled_frame)
        .list("separation", |s| s.finger_separation)
        .list("residual", |s| s.residual)
        .list("residual_rotation", |s| s.residual_rotation)
        .list("displacement", |s| s.object_displacement)
        .list("rise", |s| s.object_rise)
        .json()
}

fn grasps(grasps: &[Grasp], place: impl Fn(u32) -> usize) -> Value {
    Pack::of(grasps)
        .list("demo", |g| place(g.episode))
        .list("segment", |g| g.segment)
        .list("first", |g| g.first_frame)
        .list("end", |g| g.end_frame)
        .list("outcome", |g| g.outcome.as_str())
        .list("position", |g| g.position)
        .json()
}

/// The scores of the demonstrations, by column, each with its name, which values are better, values and ranks.
fn scores(rows: &[ScoreRow], place: impl Fn(u32) -> usize) -> Value {
    let column = |name: &str, title: &str, better: Better, value: &dyn Fn(&ScoreRow) -> [Option<f64>; 2]| {
        json!({
            "name": name,
            "title": title,
            "better": match better { Better::Higher => "higher", Better::Lower => "lower", Better::Neither => "neither" },
            "values": rows.iter().map(|row| value(row)[0]).collect::<Vec<_>>(),
            "ranks": rows.iter().map(|row| value(row)[1]).collect::<Vec<_>>(),
        })
    };
    let quality: Vec<Option<f64>> = rows.iter().map(|row| row.quality).collect();
    let quality_ranks = ranks(&quality, true);
    let mut overall = column("quality", "quality", Better::Higher, &|row| [row.quality, None]);
    overall["ranks"] = json!(quality_ranks);
    let kinds = KINDS.iter().map(|kind| {
        column(kind.column, kind.title, kind.better, &|row| {
            [(kind.value)(&row.scores), (kind.rank)(&row.rank)]
        })
    });
    json!({
        "demo": rows.iter().map(|row| place(row.episode)).collect::<Vec<_>>(),
        "nearest": rows.iter().map(|row| row.nearest.map(&place)).collect::<Vec<_>>(),
        "columns": std::iter::once(overall).chain(kinds).collect::<Vec<_>>(),
    })
}

fn shots(shots: &[Shot]) -> Value {
    Pack::of(shots)
        .list("finding", |shot| shot.finding)
        .list("frame", |shot| shot.frame)
        .list("png", |shot| BASE64_STANDARD.encode(&shot.png))
        .json()
}

fn flag(flag: &Flag) -> Value {
    let code = |value: &Option<bool>| value.map_or(UNKNOWN, u8::from);
    Pack::of(&flag.values)
        .u8("values", code)
        .with("label", json!(flag.label))
        .json()
}

fn panel(panel: &Panel) -> Value {
    let series = |series: &Series| json!({ "label": series.label, "values": f32s(series.values.iter().copied()) });
    json!({
        "title": panel.title,
        "unit": panel.measure.unit,
        "factor": panel.measure.factor,
        "series": panel.series.iter().map(series).collect::<Vec<_>>(),
    })
}

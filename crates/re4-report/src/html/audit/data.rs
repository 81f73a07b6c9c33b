//! The data that the page's script draws from: one JSON object, its columns by frame packed as base64.

use serde_json::{Value, json};

use super::{Audit, Demo, Finding, Flag, Grasp, Panel, Segment, Severity};
use crate::html::common::{f32s, u8s};

/// A flag that is not known at a frame.
const UNKNOWN: u8 = 2;

/// The JSON.
pub(super) fn json(audit: &Audit) -> Value {
    json!({
        "dataset": audit.dataset,
        "frame_seconds": audit.frame_seconds,
        "length": { "unit": audit.length.unit, "factor": audit.length.factor },
        "severities": Severity::ALL.map(Severity::as_str),
        "checks": audit.checks.iter().map(|check| json!({
            "code": check.code,
            "severity": severity(check.severity),
            "meaning": check.meaning,
        })).collect::<Vec<_>>(),
        "demos": demos(&audit.demos),
        "findings": findings(&audit.findings),
        "segments": segments(&audit.segments),
        "grasps": grasps(&audit.grasps),
        "outline": audit.outline,
        "flags": audit.flags.iter().map(flag).collect::<Vec<_>>(),
        "panels": audit.panels.iter().map(panel).collect::<Vec<_>>(),
    })
}

fn severity(severity: Severity) -> usize {
    severity as usize
}

fn demos(demos: &[Demo]) -> Value {
    let count = |value: fn(&Demo) -> u32| demos.iter().map(value).collect::<Vec<_>>();
    json!({
        "number": count(|d| d.number),
        "name": demos.iter().map(|d| d.name.as_str()).collect::<Vec<_>>(),
        "frames": count(|d| d.frames),
        "transit": count(|d| d.transit_frames),
        "transfer": count(|d| d.transfer_frames),
        "segments": count(|d| d.segments),
        "transfers": count(|d| d.transfers),
        "grasp": demos.iter().map(|d| d.grasp_frame).collect::<Vec<_>>(),
        "displacement": demos.iter().map(|d| d.object_displacement).collect::<Vec<_>>(),
        "errors": count(|d| d.errors),
        "warnings": count(|d| d.warnings),
        "notes": count(|d| d.notes),
    })
}

fn findings(findings: &[Finding]) -> Value {
    json!({
        "severity": findings.iter().map(|f| severity(f.severity)).collect::<Vec<_>>(),
        "code": findings.iter().map(|f| f.code.as_str()).collect::<Vec<_>>(),
        "demo": findings.iter().map(|f| f.demo).collect::<Vec<_>>(),
        "first": findings.iter().map(|f| f.first_frame).collect::<Vec<_>>(),
        "end": findings.iter().map(|f| f.end_frame).collect::<Vec<_>>(),
        "value": findings.iter().map(|f| f.value).collect::<Vec<_>>(),
        "threshold": findings.iter().map(|f| f.threshold).collect::<Vec<_>>(),
        "unit": findings.iter().map(|f| f.unit.as_str()).collect::<Vec<_>>(),
        "message": findings.iter().map(|f| f.message.as_str()).collect::<Vec<_>>(),
    })
}

fn segments(segments: &[Segment]) -> Value {
    let number = |value: fn(&Segment) -> Option<f64>| segments.iter().map(value).collect::<Vec<_>>();
    json!({
        "demo": segments.iter().map(|s| s.demo).collect::<Vec<_>>(),
        "number": segments.iter().map(|s| s.number).collect::<Vec<_>>(),
        "transfer": segments.iter().map(|s| u8::from(s.transfer)).collect::<Vec<_>>(),
        "first": segments.iter().map(|s| s.first_frame).collect::<Vec<_>>(),
        "end": segments.iter().map(|s| s.end_frame).collect::<Vec<_>>(),
        "settled": segments.iter().map(|s| s.settled_frame).collect::<Vec<_>>(),
        "separation": number(|s| s.finger_separation),
        "residual": number(|s| s.residual),
        "residual_rotation": number(|s| s.residual_rotation),
        "displacement": number(|s| Some(s.object_displacement)),
        "rise": number(|s| s.object_rise),
    })
}

fn grasps(grasps: &[Grasp]) -> Value {
    json!({
        "demo": grasps.iter().map(|g| g.demo).collect::<Vec<_>>(),
        "segment": grasps.iter().map(|g| g.segment).collect::<Vec<_>>(),
        "first": grasps.iter().map(|g| g.first_frame).collect::<Vec<_>>(),
        "end": grasps.iter().map(|g| g.end_frame).collect::<Vec<_>>(),
        "outcome": grasps.iter().map(|g| g.outcome.as_str()).collect::<Vec<_>>(),
        "position": grasps.iter().map(|g| g.position).collect::<Vec<_>>(),
    })
}

fn flag(flag: &Flag) -> Value {
    let codes: Vec<u8> = flag.values.iter().map(|v| v.map_or(UNKNOWN, u8::from)).collect();
    json!({ "label": flag.label, "values": u8s(&codes) })
}

fn panel(panel: &Panel) -> Value {
    json!({
        "title": panel.title,
        "unit": panel.measure.unit,
        "factor": panel.measure.factor,
        "series": panel.series.iter().map(|series| json!({
            "label": series.label,
            "values": f32s(series.values.iter().copied()),
        })).collect::<Vec<_>>(),
    })
}

//! The data that the page's script draws from: one JSON object, its long columns packed as base64 of little-endian numbers.
//!
//! Positions are packed as 32-bit floats (a pixel to five decimals); every number that the page prints is a 64-bit float,
//! the artifact's own.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use super::common::{f32s, f64s, u8s, u32s};
use super::facts::{Curve, Facts};
use super::{DecisionTrace, Demonstration, Report, Rollout, Rollouts, StepTrace};

/// The JSON.
pub(super) fn json(report: &Report, facts: &Facts) -> Value {
    let world = &report.world;
    let artifacts: Vec<Value> = report
        .artifacts
        .iter()
        .zip(&facts.labels)
        .zip(&facts.curves)
        .map(|((artifact, label), curve)| artifact_json(artifact, label, curve))
        .collect();
    let demonstrations: Map<String, Value> = report
        .demonstrations
        .iter()
        .map(|(key, demos)| (key.clone(), demonstrations_json(demos.iter())))
        .collect();
    json!({
        "world": {
            "side": world.side,
            "wall": world.wall,
            "goal": world.goal,
            "outline": world.outline,
            "pusher_radius": world.pusher_radius,
            "success_coverage": world.success_coverage,
        },
        "artifacts": artifacts,
        "demonstrations": demonstrations,
    })
}

fn artifact_json(artifact: &Rollouts, label: &str, curve: &Curve) -> Value {
    let rollouts = &artifact.rollouts;
    let of = |value: fn(&Rollout) -> f64| rollouts.iter().map(value).collect::<Vec<f64>>();
    let shown: Vec<usize> = (0..rollouts.len()).filter(|&i| rollouts[i].shown).collect();
    let traced = || rollouts.iter().filter(|rollout| rollout.shown);
    json!({
        "label": label,
        "key": artifact.key,
        "index": artifact.index_key,
        "noun": artifact.starts.noun(),
        "max_steps": artifact.max_steps,
        "rollouts": {
            "seed": rollouts.iter().map(|r| r.seed).collect::<Vec<_>>(),
            "score": of(|r| r.score),
            "coverage": of(|r| r.coverage),
            "iou": of(|r| r.iou),
            "coverage_final": of(|r| r.coverage_final),
            "success": rollouts.iter().map(|r| u8::from(r.success)).collect::<Vec<_>>(),
            "steps": rollouts.iter().map(|r| r.steps.len()).collect::<Vec<_>>(),
            "decisions": rollouts.iter().map(|r| r.decisions.len()).collect::<Vec<_>>(),
        },
        "shown": shown,
        "starts": f32s(traced().flat_map(|r| r.start)),
        "steps": steps_json(&traced().flat_map(|r| &r.steps).collect::<Vec<_>>()),
        "decisions": decisions_json(&traced().flat_map(|r| &r.decisions).collect::<Vec<_>>()),
        "curve": {
            "budgets": curve.budgets,
            "score": curve.score,
            "coverage": curve.coverage,
            "steps": curve.steps,
            "score_line": curve.score_line,
            "coverage_line": curve.coverage_line,
        },
    })
}

fn steps_json(steps: &[&StepTrace]) -> Value {
    let mut columns = json!({
        "action": f32s(steps.iter().flat_map(|s| s.action)),
        "eef": f32s(steps.iter().flat_map(|s| s.eef)),
        "object": f32s(steps.iter().flat_map(|s| s.object)),
        "coverage": f64s(steps.iter().map(|s| s.coverage)),
        "decision": u32s(steps.iter().map(|s| s.decision)),
        "replay": u8s(&steps.iter().map(|s| u8::from(s.replay)).collect::<Vec<_>>()),
    });
    if steps.iter().any(|s| s.observed.is_some()) {
        columns["observed"] = f32s(steps.iter().flat_map(|s| s.observed.unwrap_or([f64::NAN; 3])));
    }
    if steps.iter().any(|s| s.confidence.is_some()) {
        columns["confidence"] = f64s(steps.iter().map(|s| s.confidence.unwrap_or(f64::NAN)));
    }
    let words: BTreeSet<&str> = steps.iter().filter_map(|s| s.flag.as_deref()).collect();
    if !words.is_empty() {
        let words: Vec<&str> = [""].into_iter().chain(words).collect();
        let code = |flag: &str| words.iter().position(|word| *word == flag).unwrap_or(0) as u8;
        let codes: Vec<u8> = steps.iter().map(|s| code(s.flag.as_deref().unwrap_or(""))).collect();
        columns["flag"] = u8s(&codes);
        columns["flag_words"] = json!(words);
    }
    columns
}

fn decisions_json(decisions: &[&DecisionTrace]) -> Value {
    let number = |value: fn(&DecisionTrace) -> u32| u32s(decisions.iter().map(|d| value(d)));
    let of = |value: fn(&DecisionTrace) -> f64| f64s(decisions.iter().map(|d| value(d)));
    json!({
        "step": number(|d| d.step),
        "demo": number(|d| d.demo),
        "demo_frame": number(|d| d.demo_frame),
        "demo_end": number(|d| d.demo_end),
        "compared": number(|d| d.compared),
        "plan_steps": number(|d| d.plan_steps),
        "plan_nodes": number(|d| d.plan_nodes),
        "replay_steps": number(|d| d.replay_steps),
        "transfer": u8s(&decisions.iter().map(|d| u8::from(d.transfer)).collect::<Vec<_>>()),
        "d_q": of(|d| d.d_q.unwrap_or(f64::NAN)),
        "d_o": of(|d| d.d_o.unwrap_or(f64::NAN)),
        "predicted_coverage": of(|d| d.predicted_coverage),
        "delta": f64s(decisions.iter().flat_map(|d| d.delta)),
        "set_point": f64s(decisions.iter().flat_map(|d| d.set_point)),
        "object": f32s(decisions.iter().flat_map(|d| d.object)),
        "predicted": f32s(decisions.iter().flat_map(|d| d.predicted)),
        "path_length": u32s(decisions.iter().map(|d| (d.plan_path.len() / 2) as u32)),
        "path": f32s(decisions.iter().flat_map(|d| d.plan_path.iter().copied())),
        "plan": decisions.iter().map(|d| d.plan.as_str()).collect::<Vec<_>>(),
        "selector": decisions.iter().map(|d| d.selector.as_str()).collect::<Vec<_>>(),
        "reason": decisions.iter().map(|d| d.reason.as_str()).collect::<Vec<_>>(),
        "demo_name": decisions.iter().map(|d| d.demo_name.as_str()).collect::<Vec<_>>(),
    })
}

fn demonstrations_json<'a>(demos: impl Iterator<Item = (&'a u32, &'a Demonstration)> + Clone) -> Value {
    json!({
        "number": demos.clone().map(|(number, _)| *number).collect::<Vec<_>>(),
        "length": demos.clone().map(|(_, frames)| frames.len()).collect::<Vec<_>>(),
        "frames": f32s(demos.flat_map(|(_, frames)| frames.iter().flatten().copied())),
    })
}

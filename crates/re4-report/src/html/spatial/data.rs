//! The data that the page's script draws from: one JSON object, its long columns packed as base64 of little-endian numbers.
//!
//! Poses are packed as 32-bit floats (a hundredth of a micrometre); distances, set points and motions of decisions are the
//! artifact's own 64-bit floats.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Map, Value, json};

use super::{
    DecisionPicture, Pose, Solid, SpatialChosen, SpatialDecision, SpatialDemonstration, SpatialReport, SpatialRollouts,
};
use super::{SpatialStep, SpatialTrace};
use crate::html::common::{f32s, f64s, u8s, u32s};

/// A decision without a demonstration.
const NONE: u32 = u32::MAX;

/// The JSON.
pub(super) fn json(report: &SpatialReport, labels: &[String]) -> Value {
    let artifacts = report.artifacts.iter().zip(labels);
    let demonstrations: Map<String, Value> = report
        .demonstrations
        .iter()
        .map(|(key, demos)| (key.clone(), demonstrations_json(demos.iter())))
        .collect();
    json!({
        "artifacts": artifacts.map(|(artifact, label)| artifact_json(artifact, label)).collect::<Vec<_>>(),
        "demonstrations": demonstrations,
    })
}

fn artifact_json(artifact: &SpatialRollouts, label: &str) -> Value {
    let rollouts = &artifact.rollouts;
    let of = |value: fn(&SpatialTrace) -> usize| rollouts.iter().map(value).collect::<Vec<usize>>();
    let shown: Vec<usize> = (0..rollouts.len()).filter(|&i| rollouts[i].shown).collect();
    let traced = || rollouts.iter().filter(|rollout| rollout.shown);
    json!({
        "label": label,
        "key": artifact.key,
        "index": artifact.index_key,
        "noun": "seed",
        "task": artifact.world.task,
        "fixtures": artifact.world.fixtures.iter().map(solid).collect::<Vec<_>>(),
        "object": artifact.world.object.iter().map(solid).collect::<Vec<_>>(),
        "max_steps": artifact.max_steps,
        "rollouts": {
            "seed": of(|r| r.seed as usize),
            "success": of(|r| usize::from(r.success)),
            "steps": of(|r| r.steps.len()),
            "decisions": of(|r| r.decisions.len()),
            "demos": of(|r| r.demos as usize),
            "losses": of(|r| r.losses as usize),
            "banned": of(|r| r.banned as usize),
        },
        "shown": shown,
        "starts": f32s(traced().flat_map(|r| r.eef.into_iter().chain(r.object))),
        "steps": steps_json(&traced().collect::<Vec<_>>()),
        "decisions": decisions_json(&traced().flat_map(|r| &r.decisions).collect::<Vec<_>>()),
        "pictures": pictures_json(traced().flat_map(|r| &r.decisions)),
    })
}

fn solid(solid: &Solid) -> Value {
    json!({ "kind": solid.kind, "centre": solid.centre, "half": solid.half, "round": solid.round })
}

fn steps_json(traces: &[&SpatialTrace]) -> Value {
    let steps: Vec<&SpatialStep> = traces.iter().flat_map(|trace| &trace.steps).collect();
    let mut columns = json!({
        "goal": f32s(steps.iter().flat_map(|s| s.goal)),
        "eef": f32s(steps.iter().flat_map(|s| s.eef)),
        "object": f32s(steps.iter().flat_map(|s| s.object)),
        "fingers": f32s(steps.iter().map(|s| s.fingers)),
        "decision": u32s(steps.iter().map(|s| s.decision)),
        "phase": u8s(&steps.iter().map(|s| s.phase as u8).collect::<Vec<_>>()),
        "closing": u8s(&steps.iter().map(|s| u8::from(s.gripper > 0.0)).collect::<Vec<_>>()),
    });
    if traces.iter().any(|trace| told_otherwise(trace)) {
        columns["seen"] = f32s(steps.iter().flat_map(|s| s.seen));
    }
    columns
}

/// Whether the policy was told of another object pose than the simulator had.
fn told_otherwise(trace: &SpatialTrace) -> bool {
    let before = std::iter::once(&trace.object).chain(trace.steps.iter().map(|step| &step.object));
    let away = |a: &Pose, b: &Pose| a[..3].iter().zip(&b[..3]).any(|(a, b)| (a - b).abs() > 1e-6);
    trace
        .steps
        .iter()
        .zip(before)
        .any(|(step, before)| away(&step.seen, before))
}

fn decisions_json(decisions: &[&SpatialDecision]) -> Value {
    let number = |value: fn(&SpatialDecision) -> u32| u32s(decisions.iter().map(|d| value(d)));
    let flag =
        |value: fn(&SpatialDecision) -> bool| u8s(&decisions.iter().map(|d| u8::from(value(d))).collect::<Vec<_>>());
    let chosen =
        |value: fn(&SpatialChosen) -> u32| u32s(decisions.iter().map(|d| d.choice.as_ref().map_or(NONE, value)));
    let measured =
        |value: fn(&SpatialChosen) -> f64| f64s(decisions.iter().map(|d| d.choice.as_ref().map_or(f64::NAN, value)));
    json!({
        "step": number(|d| d.step),
        "banned": number(|d| d.banned),
        "transfer": flag(|d| d.transfer),
        "bridge": flag(|d| d.bridge),
        "fingers": f64s(decisions.iter().map(|d| d.fingers)),
        "object": f32s(decisions.iter().flat_map(|d| d.object)),
        "set_point": f64s(decisions.iter().flat_map(|d| d.set_point)),
        "demo": chosen(|c| c.demo),
        "demo_frame": chosen(|c| c.demo_frame),
        "demo_end": chosen(|c| c.demo_end),
        "compared": chosen(|c| c.compared),
        "replay_steps": chosen(|c| c.replay_steps),
        "d_q": measured(|c| c.d_q),
        "d_o": measured(|c| c.d_o),
        "d_e": measured(|c| c.d_e),
        "turn": measured(|c| c.turn),
        "delta": f64s(decisions.iter().flat_map(|d| d.choice.as_ref().map_or([f64::NAN; 6], |c| c.delta))),
        "kind": decisions.iter().map(|d| d.kind.as_str()).collect::<Vec<_>>(),
        "reason": decisions.iter().map(|d| d.reason.as_str()).collect::<Vec<_>>(),
        "demo_name": decisions.iter().map(|d| d.choice.as_ref().map_or("", |c| c.demo_name.as_str())).collect::<Vec<_>>(),
    })
}

/// Pictures of some decisions: the number of each decision, counted over all rollouts of the viewer, and 16 numbers each, the
/// places of both frames. Null where there are none.
fn pictures_json<'a>(decisions: impl Iterator<Item = &'a SpatialDecision>) -> Value {
    let shown: Vec<(u32, &DecisionPicture)> = (0..)
        .zip(decisions)
        .filter_map(|(number, decision)| Some((number, decision.picture.as_ref()?)))
        .collect();
    let Some((_, first)) = shown.first() else {
        return Value::Null;
    };
    let places = shown
        .iter()
        .flat_map(|(_, picture)| picture.told.iter().chain(&picture.simulated))
        .flat_map(|place| place.unwrap_or([f64::NAN; 2]));
    json!({
        "camera": first.camera,
        "side": first.side,
        "decision": u32s(shown.iter().map(|(number, _)| *number)),
        "places": f32s(places),
        "png": shown.iter().map(|(_, picture)| BASE64_STANDARD.encode(&picture.png)).collect::<Vec<_>>(),
    })
}

fn demonstrations_json<'a>(demos: impl Iterator<Item = (&'a u32, &'a SpatialDemonstration)> + Clone) -> Value {
    json!({
        "number": demos.clone().map(|(number, _)| *number).collect::<Vec<_>>(),
        "length": demos.clone().map(|(_, frames)| frames.len()).collect::<Vec<_>>(),
        "frames": f32s(demos.flat_map(|(_, frames)| frames.iter().flat_map(|(eef, object)| eef.iter().chain(object).copied()))),
    })
}

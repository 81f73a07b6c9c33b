//! Rollouts of Push-T.

use std::path::Path;

use anyhow::Result;
use re4_artifact::{Artifact, Stage};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_index::{IndexRow, PlanarState};
use re4_rollout::Phase;
use re4_sim::coverage;
use serde_json::Value;

use super::{Source, find_input, inclusive, stated, trace_of, traces};
use crate::html::rollouts::plane::{Plane, Starts, Taken};
use crate::html::rollouts::{Decided, Rollout, demo_name};
use crate::video::{VideoDecision, VideoRollout, VideoState};

impl Source for Plane {
    fn stated(artifact: &Artifact, _: Option<&Artifact>) -> Result<Self> {
        let manifest = artifact.manifest();
        let protocol = &manifest.summary["protocol"];
        let (taken, demonstrations) = demonstrations(protocol);
        let (starts, scenes) = starts(&manifest.config);
        Ok(Self {
            demonstrations,
            taken,
            in_dataset: in_dataset(protocol),
            starts,
            scenes,
            metrics: stated(artifact, "summary", &manifest.summary, "metrics")?,
        })
    }
}

/// Returns the number of demonstrations in the dataset. Older artifacts call them episodes.
fn in_dataset(protocol: &Value) -> Option<u64> {
    let dataset = &protocol["dataset"];
    dataset["demonstrations"]
        .as_u64()
        .or_else(|| dataset["episodes"].as_u64())
}

/// Returns which demonstrations were used, and their number, if it is known.
fn demonstrations(protocol: &Value) -> (Taken, Option<u64>) {
    let select = &protocol["demonstrations"]["select"];
    let in_dataset = in_dataset(protocol);
    let length = |range: &str| -> Option<u64> {
        let (start, end) = range.split_once("..")?;
        end.trim().parse::<u64>().ok()?.checked_sub(start.trim().parse().ok()?)
    };
    if select == "all" {
        (Taken::All, in_dataset)
    } else if let Some(count) = select["first"].as_u64() {
        (Taken::First(count), Some(count))
    } else {
        let listed = select["episodes"].as_array().map(|list| list.len() as u64);
        let count = select["last"].as_u64().or(listed);
        (
            Taken::Other,
            count.or_else(|| select["range"].as_str().and_then(length)),
        )
    }
}

/// Returns what the rollouts start from, and its description.
fn starts(config: &Value) -> (Starts, String) {
    match (&config["scenes"], &config["seeds"]) {
        (Value::Null, Value::String(seeds)) => (Starts::Seeds, format!("seeds {}", inclusive(seeds))),
        (Value::Null, seeds) => (Starts::Seeds, format!("seeds {seeds}")),
        (scenes, _) => {
            let kind = scenes["kind"].as_str().unwrap_or("chosen").replace('_', " ");
            (Starts::Scenes, format!("scenes: {kind}"))
        }
    }
}

/// Returns the Push-T rollout of a seed, to be rendered as an image.
///
/// # Errors
/// If the artifact has no rollout of that seed, or its tables cannot be read.
pub fn planar_rollout(artifact: &Artifact, seed: u32) -> Result<Rollout<Plane>> {
    Ok(trace_of(artifact, &traces(artifact)?, seed, "render")?.clone())
}

/// Returns the video content of the rollouts of some seeds, in that order, and whether it has the chunks. Chunks need the index
/// that they come from, in the folder of artifacts that contains the rollouts or in `store`.
///
/// # Errors
/// If the artifact has no rollout of one of the seeds, or tables cannot be read.
pub fn planar_videos(artifact: &Artifact, seeds: &[u32], store: &Path) -> Result<(Vec<VideoRollout>, bool)> {
    let traces = traces::<Plane>(artifact)?;
    let index = find_input(artifact, Stage::Index, store)?;
    let frames: Option<Vec<IndexRow<PlanarState>>> = index.map(|index| index.read()).transpose()?;
    let videos = seeds.iter().map(|&seed| {
        let trace = trace_of(artifact, &traces, seed, "make a video of")?;
        Ok(VideoRollout {
            seed,
            goal: trace.goal(),
            disturbance: trace.disturbance(),
            states: states(trace),
            decisions: trace.decisions.iter().map(|d| decision(d, frames.as_deref())).collect(),
        })
    });
    Ok((videos.collect::<Result<_>>()?, frames.is_some()))
}

/// Returns the states of a rollout, each with the action that follows it; the last state has the action before it.
fn states(trace: &Rollout<Plane>) -> Vec<VideoState> {
    let result = &trace.result;
    let first = (result.eef, result.object, coverage(result.object, trace.goal()));
    let after = trace.steps.iter().map(|step| (step.eef, step.object, step.coverage));
    let actions = trace.steps.iter().chain(trace.steps.last()).map(Some);
    let states = [first].into_iter().chain(after).zip(actions.chain([None]));
    states
        .map(|((pusher, block, coverage), action)| VideoState {
            pusher,
            block,
            coverage,
            decision: action.map_or(0, |step| step.core.decision as usize),
            replaying: action.is_some_and(|step| step.core.phase == Phase::Replay),
        })
        .collect()
}

fn decision(decision: &Decided<Plane>, frames: Option<&[IndexRow<PlanarState>]>) -> VideoDecision {
    // In transfer, the chunk is replayed where it was recorded, without reframing (see `reframe` in re4-policy).
    let carry = match &decision.detail {
        Some(detail) if detail.mode == Mode::Transit => detail.delta,
        _ => Pose2::IDENTITY,
    };
    let core = decision.core();
    let [demo, first, last] = [core.demo, core.demo_frame, core.demo_end].map(Option::unwrap_or_default);
    let chunk = frames.filter(|_| core.demo.is_some()).map_or(&[][..], |frames| {
        let start = frames.partition_point(|at| (at.episode, at.frame) < (demo, first));
        let end = frames.partition_point(|at| (at.episode, at.frame) <= (demo, last));
        frames.get(start..end).unwrap_or_default()
    });
    VideoDecision {
        demo: demo_name(core),
        frames: (first, last),
        plan: decision.path().map(|[x, y]| Point2::new(x, y)).collect(),
        chunk: chunk.iter().map(|row| carry.transform_point(row.state.eef)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn demonstrations_are_counted_in_artifacts_of_any_version() {
        let count = |dataset: Value, select: Value| {
            let protocol = json!({ "dataset": dataset, "demonstrations": { "select": select } });
            let (taken, count) = demonstrations(&protocol);
            (taken == Taken::All, count)
        };
        assert_eq!(count(json!({ "demonstrations": 206 }), json!("all")), (true, Some(206)));
        assert_eq!(count(json!({ "episodes": 206 }), json!("all")), (true, Some(206)));
        assert_eq!(count(json!({}), json!("all")), (true, None));
        assert_eq!(
            count(json!({ "demonstrations": 206 }), json!({ "first": 50 })),
            (false, Some(50))
        );
    }
}

//! Rollouts of robosuite's tasks.

use std::collections::BTreeMap;

use anyhow::Result;
use re4_artifact::Artifact;
use serde_json::Value;

use super::{Source, inclusive, stated, trace_of, traces};
use crate::html::rollouts::space::Space;
use crate::html::rollouts::{Decided, Rollout, demo_name};
use crate::video::{SceneRollout, SceneState};

impl Source for Space {
    fn stated(artifact: &Artifact, index: Option<&Artifact>) -> Result<Self> {
        let manifest = artifact.manifest();
        let (config, summary) = (&manifest.config, &manifest.summary);
        let protocol = &summary["protocol"];
        let seeds: String = stated(artifact, "config", config, "seeds")?;
        Ok(Self {
            task: stated(artifact, "config", config, "task")?,
            seeds: inclusive(&seeds),
            success_rate: stated(artifact, "summary.metrics", &summary["metrics"], "success_rate")?,
            successes: stated(artifact, "summary", summary, "successes")?,
            median_steps: summary["medians"]["steps_of_successes"].as_f64(),
            losses: stated(artifact, "summary", summary, "losses")?,
            demonstrations: demonstrations(&protocol["demonstrations"]["select"], index),
            dataset: dataset(protocol),
            simulator: simulator(protocol),
            images: BTreeMap::new(),
        })
    }
}

/// Describes which demonstrations were used.
fn demonstrations(select: &Value, index: Option<&Artifact>) -> String {
    let count = index.and_then(|index| index.manifest().summary["episodes"].as_u64());
    match (select == "all", count) {
        (true, Some(count)) => format!("all {count} demonstrations"),
        (true, None) => "all demonstrations of the file".to_owned(),
        (false, Some(count)) => format!("{count} selected demonstrations"),
        (false, None) => "selected demonstrations".to_owned(),
    }
}

fn dataset(protocol: &Value) -> String {
    let dataset = &protocol["dataset"];
    let word = |name: &str| dataset[name].as_str().unwrap_or("unknown").to_owned();
    let digest = protocol["dataset_blake3"].as_str().and_then(|digest| digest.get(..8));
    format!(
        "{} of {} (BLAKE3 {}), recorded with robosuite {}",
        word("file"),
        word("environment"),
        digest.unwrap_or("unknown"),
        word("robosuite_version")
    )
}

fn simulator(protocol: &Value) -> String {
    let mut words = format!(
        "{}, behaves as robosuite {}",
        protocol["physics"].as_str().unwrap_or("unknown physics"),
        protocol["robosuite"].as_str().unwrap_or("unknown")
    );
    if protocol["fidelity"] == "fast" {
        words += ", fast";
    }
    words
}

/// Returns the rollouts of some seeds, in that order, to be simulated again.
///
/// # Errors
/// If the artifact has no rollout of one of the seeds, or its tables cannot be read.
pub fn spatial_rollouts(artifact: &Artifact, seeds: &[u32]) -> Result<Vec<Rollout<Space>>> {
    let traces = traces(artifact)?;
    seeds
        .iter()
        .map(|&seed| Ok(trace_of(artifact, &traces, seed, "make a video of")?.clone()))
        .collect()
}

/// Converts a rollout to the content of a video's strip. Each state has the action that follows it; the last state has the action
/// before it.
pub fn scene_rollout(rollout: &Rollout<Space>) -> SceneRollout {
    let decisions: Vec<_> = rollout.decisions.iter().map(Decided::core).collect();
    let steps = rollout.steps.iter().chain(rollout.steps.last());
    let states = steps.map(|step| SceneState {
        demo: decisions
            .get(step.core.decision as usize)
            .and_then(|decision| decision.demo),
        phase: step.core.phase,
    });
    let names = decisions
        .iter()
        .filter_map(|decision| Some((decision.demo?, demo_name(decision))));
    SceneRollout {
        seed: rollout.core().seed,
        success: rollout.core().success,
        disturbance: rollout.disturbance().map(|(step, _)| step),
        states: states.collect(),
        names: names.collect(),
    }
}

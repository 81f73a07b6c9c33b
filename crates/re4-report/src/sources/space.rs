//! Rollouts of robosuite's tasks.

use anyhow::Result;
use re4_artifact::Artifact;
use re4_policy::spatial::SpatialPolicyConfig;
use re4_sim::robosuite::RobosuiteTask;
use serde_json::Value;

use super::{Source, inclusive, stated, trace_of, traces};
use crate::film::{SceneRollout, SceneState};
use crate::html::rollouts::Rollout;
use crate::html::rollouts::space::{Solid, Solids, Space};

impl Source for Space {
    fn stated(artifact: &Artifact, index: Option<&Artifact>) -> Result<Self> {
        let manifest = artifact.manifest();
        let (config, summary) = (&manifest.config, &manifest.summary);
        let protocol = &summary["protocol"];
        let seeds: String = stated(artifact, "config", config, "seeds")?;
        let (task, solids) = solids(stated(artifact, "config", config, "task")?);
        Ok(Self {
            task: task.to_owned(),
            solids,
            seeds: inclusive(&seeds),
            success_rate: stated(artifact, "summary.metrics", &summary["metrics"], "success_rate")?,
            successes: stated(artifact, "summary", summary, "successes")?,
            median_steps: summary["medians"]["steps_of_successes"].as_f64(),
            losses: stated(artifact, "summary", summary, "losses")?,
            demonstrations: demonstrations(&protocol["demonstrations"]["select"], index),
            dataset: dataset(protocol),
            simulator: simulator(protocol),
            pictures: std::collections::BTreeMap::new(),
        })
    }

    fn preset(name: &str) -> Option<Value> {
        serde_json::to_value(SpatialPolicyConfig::preset(name)?).ok()
    }
}

/// Which demonstrations were used.
fn demonstrations(select: &Value, index: Option<&Artifact>) -> String {
    let count = index.and_then(|index| index.manifest().summary["episodes"].as_u64());
    match (select == "all", count) {
        (true, Some(count)) => format!("all {count} demonstrations"),
        (true, None) => "all demonstrations of the file".to_owned(),
        (false, Some(count)) => format!("{count} chosen demonstrations"),
        (false, None) => "chosen demonstrations".to_owned(),
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

/// A task's name, and what is drawn of its scene: sizes of robosuite's models; the cube's are the middle of what seeds draw.
fn solids(task: RobosuiteTask) -> (&'static str, Solids) {
    let solid = |kind, centre, half| Solid {
        kind,
        centre,
        half,
        round: false,
    };
    let round = |kind, centre, radius, half| Solid {
        kind,
        centre,
        half: [radius, radius, half],
        round: true,
    };
    let table = |z| solid("table", [0.0, 0.0, z], [0.4, 0.4, 0.025]);
    let (name, fixtures, object) = match task {
        RobosuiteTask::Lift => (
            "Lift",
            vec![table(0.775)],
            vec![solid("object", [0.0; 3], [0.021, 0.021, 0.021])],
        ),
        RobosuiteTask::Can => {
            let bin = |y: f64| {
                let [x, z] = [0.1, 0.8];
                [
                    solid("table", [x, y, z], [0.2, 0.25, 0.02]),
                    solid("wall", [x, y + 0.25, z + 0.05], [0.21, 0.01, 0.05]),
                    solid("wall", [x, y - 0.25, z + 0.05], [0.21, 0.01, 0.05]),
                    solid("wall", [x + 0.2, y, z + 0.05], [0.01, 0.25, 0.05]),
                    solid("wall", [x - 0.2, y, z + 0.05], [0.01, 0.25, 0.05]),
                ]
            };
            let mut fixtures = [bin(-0.25), bin(0.28)].concat();
            // Where the success rule wants the can: a quarter of the second bin.
            fixtures.insert(0, solid("goal", [0.1975, 0.4025, 0.85], [0.0975, 0.1225, 0.05]));
            ("Can", fixtures, vec![round("object", [0.0; 3], 0.025, 0.04)])
        }
        RobosuiteTask::Square => (
            "Square",
            vec![
                table(0.795),
                solid("goal", [0.23, 0.1, 0.885], [0.016, 0.016, 0.065]),
                round("wall", [0.23, -0.1, 0.885], 0.02, 0.065),
            ],
            vec![
                solid("object", [-0.033_25, 0.0, 0.0], [0.0105, 0.043_75, 0.01]),
                solid("object", [0.033_25, 0.0, 0.0], [0.0105, 0.043_75, 0.01]),
                solid("object", [0.0, 0.033_25, 0.0], [0.031_25, 0.0105, 0.01]),
                solid("object", [0.0, -0.033_25, 0.0], [0.031_25, 0.0105, 0.01]),
                solid("object", [0.054, 0.0, 0.0], [0.025_25, 0.015_875, 0.01]),
            ],
        ),
    };
    (name, Solids { fixtures, object })
}

/// Rollouts of some seeds, in that order, to be simulated again.
///
/// # Errors
/// When the artifact has no such rollout, or its tables cannot be read.
pub fn spatial_rollouts(artifact: &Artifact, seeds: &[u32]) -> Result<Vec<Rollout<Space>>> {
    let traces = traces(artifact)?;
    seeds
        .iter()
        .map(|&seed| Ok(trace_of(artifact, &traces, seed, "film")?.clone()))
        .collect()
}

/// A rollout as the strip of a film takes it. States have the action that follows; the last one has that of the action before it.
pub fn scene_rollout(rollout: &Rollout<Space>) -> SceneRollout {
    let chosen = rollout
        .decisions
        .iter()
        .map(|decision| decision.choice.as_ref().map(|choice| choice.demo));
    let demos: Vec<Option<u32>> = chosen.collect();
    let steps = rollout.steps.iter().chain(rollout.steps.last());
    let names = demos.iter().zip(&rollout.decisions);
    SceneRollout {
        seed: rollout.result.seed,
        success: rollout.result.success,
        states: steps
            .map(|step| SceneState {
                demo: demos.get(step.decision as usize).copied().flatten(),
                phase: step.phase,
            })
            .collect(),
        names: names
            .filter_map(|(demo, decision)| Some(((*demo)?, decision.demo_name())))
            .collect(),
    }
}

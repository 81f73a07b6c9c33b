//! One self-contained HTML page over one or more sets of rollouts: scores, seeds, budgets, and a viewer that shows for
//! every step what was retrieved, how it was moved, what was planned, and why.
//!
//! The page loads nothing: style, script and data are inside of it, and a content security policy forbids the rest. Its
//! bytes follow from [`Report`] alone.

pub mod audit;
mod common;
mod data;
mod facts;
mod paper;
mod sections;
pub mod spatial;

use std::collections::BTreeMap;

use maud::{Markup, html};
use serde_json::Value;

use self::common::Document;
use re4_stats::Interval;

/// What the page shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// The task's plane.
    pub world: World,
    /// Sets of rollouts, in the order in which they are shown.
    pub artifacts: Vec<Rollouts>,
    /// Demonstrations that decisions refer to, by the key of their index. An index that could not be read is not in it.
    pub demonstrations: BTreeMap<String, BTreeMap<u32, Demonstration>>,
}

/// The plane of the task; pixels and radians, y down.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// Side of the square plane.
    pub side: f64,
    /// Distance of the walls from its edges.
    pub wall: f64,
    /// Goal pose of the block: x, y, angle.
    pub goal: [f64; 3],
    /// Corners of the block in its own frame, in order.
    pub outline: Vec<[f64; 2]>,
    /// Radius of the pusher.
    pub pusher_radius: f64,
    /// Coverage above which a rollout succeeds.
    pub success_coverage: f64,
}

/// One `rollouts` artifact.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollouts {
    /// Its key, 64 hexadecimal digits.
    pub key: String,
    /// Key of the index that demonstrations were retrieved from.
    pub index_key: String,
    /// Preset of the policy.
    pub preset: String,
    /// Whether single settings of the preset were changed.
    pub altered: bool,
    /// What the policy observed: state or image.
    pub variant: String,
    /// How many demonstrations it had, where that is known.
    pub demonstrations: Option<u64>,
    /// Which of the dataset's demonstrations these were.
    pub demonstrations_taken: Taken,
    /// Demonstrations in the whole dataset, where that is known.
    pub dataset_demonstrations: Option<u64>,
    /// What rollouts start from.
    pub starts: Starts,
    /// The starts in words.
    pub scenes: String,
    /// Control steps a rollout lasts at most.
    pub max_steps: u32,
    /// Figures that the artifact states.
    pub metrics: Metrics,
    /// The protocol that the artifact states, one entry a fact.
    pub protocol: Value,
    /// Settings of the policy.
    pub settings: Value,
    /// The rollouts.
    pub rollouts: Vec<Rollout>,
}

/// What rollouts start from, and so what their numbers mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Starts {
    /// Scenes made from seeds.
    Seeds,
    /// Chosen scenes.
    Scenes,
}

impl Starts {
    /// What one of them is called.
    fn noun(self) -> &'static str {
        match self {
            Self::Seeds => "seed",
            Self::Scenes => "scene",
        }
    }
}

/// Which demonstrations of the dataset were taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// All of them.
    All,
    /// The first so many.
    First(u64),
    /// Some other choice.
    Other,
}

/// Figures of a set of rollouts, each with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Metrics {
    /// Mean scaled score.
    pub score_scaled_mean: Interval,
    /// Mean raw coverage.
    pub coverage_raw_mean: Interval,
    /// Mean intersection over union.
    pub iou_mean: Interval,
    /// Share of rollouts that succeed.
    pub success_rate: Interval,
}

/// One rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollout {
    /// Seed of its scene, or number of its scene.
    pub seed: u32,
    /// Greatest scaled score.
    pub score: f64,
    /// Greatest coverage.
    pub coverage: f64,
    /// Greatest intersection over union.
    pub iou: f64,
    /// Coverage in the last state.
    pub coverage_final: f64,
    /// Whether it succeeded.
    pub success: bool,
    /// Whether the viewer holds it; if not, its figures alone are on the page.
    pub shown: bool,
    /// First state: pusher x, y, block x, y, angle.
    pub start: [f64; 5],
    /// Control steps.
    pub steps: Vec<StepTrace>,
    /// Decisions.
    pub decisions: Vec<DecisionTrace>,
}

/// A control step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepTrace {
    /// Target sent.
    pub action: [f64; 2],
    /// Pusher after the step.
    pub eef: [f64; 2],
    /// Block after the step.
    pub object: [f64; 3],
    /// Coverage after the step.
    pub coverage: f64,
    /// Scaled score after the step.
    pub score: f64,
    /// Decision that the action follows from.
    pub decision: u32,
    /// Whether it replays a chunk; else it follows a plan.
    pub replay: bool,
    /// Pose of the block that the policy was given before the step, where it was estimated.
    pub observed: Option<[f64; 3]>,
    /// Confidence of that estimate, 0 to 1.
    pub confidence: Option<f64>,
    /// What the estimator says of it, in a word.
    pub flag: Option<String>,
}

/// A decision.
#[derive(Debug, Clone, PartialEq)]
pub struct DecisionTrace {
    /// Control steps taken before it.
    pub step: u32,
    /// Rule that chose.
    pub selector: String,
    /// Whether the object is held, so that the chunk is replayed where it was recorded.
    pub transfer: bool,
    /// Pose of the block that the decision was taken on.
    pub object: [f64; 3],
    /// Retrieved demonstration, by its number in the index.
    pub demo: u32,
    /// Its name in its source.
    pub demo_name: String,
    /// First frame of the chunk.
    pub demo_frame: u32,
    /// Last frame of the chunk, included.
    pub demo_end: u32,
    /// Demonstrations or chunks compared.
    pub compared: u32,
    /// Distance of the states, where the rule has it.
    pub d_q: Option<f64>,
    /// Distance of the object poses, where the rule has it.
    pub d_o: Option<f64>,
    /// Motion that carries the demonstration's object onto ours.
    pub delta: [f64; 3],
    /// Where the chunk starts.
    pub set_point: [f64; 2],
    /// How it was planned to get there.
    pub plan: String,
    /// Control steps of the plan.
    pub plan_steps: u32,
    /// Nodes searched.
    pub plan_nodes: u32,
    /// The plan as a polyline: x and y by turns.
    pub plan_path: Vec<f64>,
    /// Control steps of the chunk.
    pub replay_steps: u32,
    /// Expected pose of the block after the chunk.
    pub predicted: [f64; 3],
    /// Coverage there.
    pub predicted_coverage: f64,
    /// The decision in words.
    pub reason: String,
}

/// Frames of a demonstration: pusher x, y, block x, y, angle.
pub type Demonstration = Vec<[f64; 5]>;

/// The script, part by part, after what all pages share.
const SCRIPT: [&str; 8] = [
    include_str!("script/data.js"),
    include_str!("script/selection.js"),
    include_str!("script/charts.js"),
    include_str!("script/seeds.js"),
    include_str!("script/scene.js"),
    include_str!("script/viewer.js"),
    include_str!("script/player.js"),
    include_str!("script/main.js"),
];

/// The page.
pub fn page(report: &Report) -> String {
    let facts = facts::Facts::of(report);
    Document {
        tool_version: &report.tool_version,
        title: format!("Push-T rollouts: {}", facts.labels.join(", ")),
        style: include_str!("page.css"),
        script: &SCRIPT,
        data: &data::json(report, &facts),
        body: body(report, &facts),
    }
    .render()
}

fn body(report: &Report, facts: &facts::Facts) -> Markup {
    html! {
        a.skip href="#viewer" { "Skip to the rollout viewer" }
        (sections::header(report, facts))
        main {
            (sections::scores(report, facts))
            (sections::plots(facts))
            (sections::viewer(report, facts))
            (sections::seeds(facts))
            (sections::protocol(report, facts))
        }
        (sections::footer(report, facts))
    }
}

#[cfg(test)]
mod tests;

//! One self-contained HTML page over rollouts of robosuite's tasks: how often the policy succeeds, every rollout, and a
//! viewer with the timeline of retrieved demonstrations (paper, Figure 2), the scene from above and from behind the robot,
//! and every decision with its reason.
//!
//! World frame, metres, radians; quaternions x, y, z, w. The page's bytes follow from [`SpatialReport`] alone.

mod data;
mod sections;

use std::collections::BTreeMap;

use maud::{Markup, html};
pub use re4_task::Solid;
use serde_json::Value;

use super::common::Document;
use super::facts::{Row, flatten, rows, told_apart};
use re4_stats::Interval;

/// Position and orientation: x, y, z, then the quaternion x, y, z, w.
pub type Pose = [f64; 7];

/// What the page shows.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialReport {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// Sets of rollouts, in the order in which they are shown.
    pub artifacts: Vec<SpatialRollouts>,
    /// Demonstrations that decisions refer to, by the key of their index. An index that could not be read is not in it.
    pub demonstrations: BTreeMap<String, BTreeMap<u32, SpatialDemonstration>>,
}

/// What of a task's scene is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialWorld {
    /// Name of the task on the page.
    pub task: String,
    /// What does not move, world frame.
    pub fixtures: Vec<Solid>,
    /// Parts of the manipulated object, in its own frame.
    pub object: Vec<Solid>,
}

/// One `rollouts` artifact of a robosuite task.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialRollouts {
    /// Its key, 64 hexadecimal digits.
    pub key: String,
    /// Key of the index that demonstrations were retrieved from.
    pub index_key: String,
    /// The scene.
    pub world: SpatialWorld,
    /// Preset of the policy.
    pub preset: String,
    /// Whether single settings of the preset were changed.
    pub altered: bool,
    /// What the policy observed.
    pub variant: String,
    /// The seeds in words.
    pub seeds: String,
    /// Control steps a rollout lasts at most.
    pub max_steps: u32,
    /// Share of rollouts that succeed, with its Wilson interval.
    pub success_rate: Interval,
    /// Rollouts that succeed.
    pub successes: u64,
    /// Median of the steps of those.
    pub median_steps: Option<f64>,
    /// How often a grasp was lost, all rollouts together.
    pub losses: u64,
    /// Which demonstrations were used, in words.
    pub demonstrations: String,
    /// The file that they come from, in words.
    pub dataset: String,
    /// What was simulated with what, in words.
    pub simulator: String,
    /// The protocol that the artifact states, one entry a fact.
    pub protocol: Value,
    /// Settings of the policy.
    pub settings: Value,
    /// The rollouts.
    pub rollouts: Vec<SpatialTrace>,
}

/// One rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialTrace {
    /// Seed of its placement.
    pub seed: u32,
    /// Whether it succeeded.
    pub success: bool,
    /// How often the grasp was lost.
    pub losses: u32,
    /// Demonstrations that were not followed again at the end.
    pub banned: u32,
    /// Demonstrations that were followed.
    pub demos: u32,
    /// Whether the viewer holds it; if not, its figures alone are on the page.
    pub shown: bool,
    /// End effector at the start. The artifact holds its position; its orientation is that of the first query.
    pub eef: Pose,
    /// Object at the start.
    pub object: Pose,
    /// Control steps.
    pub steps: Vec<SpatialStep>,
    /// Decisions.
    pub decisions: Vec<SpatialDecision>,
}

/// What an action is part of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SpatialPhase {
    /// The way to the chunk.
    Bridge,
    /// The chunk.
    Replay,
    /// The way back to the initial pose.
    Home,
}

impl SpatialPhase {
    /// The phase of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        [("bridge", Self::Bridge), ("replay", Self::Replay), ("home", Self::Home)]
            .into_iter()
            .find_map(|(known, phase)| (known == name).then_some(phase))
    }
}

/// A control step.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialStep {
    /// Commanded position of the end effector.
    pub goal: [f64; 3],
    /// Gripper command: below 0 opens, above 0 closes.
    pub gripper: f64,
    /// End effector after the step.
    pub eef: Pose,
    /// Object after the step.
    pub object: Pose,
    /// Distance between the fingers after the step.
    pub fingers: f64,
    /// Decision that the action belongs to.
    pub decision: u32,
    /// What the action is part of.
    pub phase: SpatialPhase,
    /// Object that the policy was told before the action.
    pub seen: Pose,
}

/// A decision.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialDecision {
    /// Control steps taken before it.
    pub step: u32,
    /// What was decided: `retrieve`, `continue`, `grasp_lost` or `demo_ended`.
    pub kind: String,
    /// Whether the object is held.
    pub transfer: bool,
    /// Object of the query.
    pub object: Pose,
    /// Distance between the fingers.
    pub fingers: f64,
    /// What was retrieved; nothing on the way home.
    pub choice: Option<SpatialChosen>,
    /// Where the end effector goes first.
    pub set_point: Pose,
    /// Whether a bridge, or the way home, leads there.
    pub bridge: bool,
    /// Demonstrations that are not followed again by now.
    pub banned: u32,
    /// The decision in words.
    pub reason: String,
    /// What the camera saw, where the page shows it.
    pub picture: Option<DecisionPicture>,
}

/// What a camera saw when a decision was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct DecisionPicture {
    /// Name of the camera.
    pub camera: &'static str,
    /// Its side in pixels.
    pub side: u32,
    /// The picture as the bytes of a PNG file.
    pub png: Vec<u8>,
    /// The object's frame as the policy was told it.
    pub told: FrameInPicture,
    /// The object's frame as it was in the simulator.
    pub simulated: FrameInPicture,
}

/// Origin and ends of the three axes of a frame in a picture, in pixels from its corner at the top left; none for what is
/// behind the camera.
pub type FrameInPicture = [Option<[f64; 2]>; 4];

/// What a decision retrieved.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialChosen {
    /// Demonstration, by its number in the index.
    pub demo: u32,
    /// Its name in its source.
    pub demo_name: String,
    /// First frame of the chunk.
    pub demo_frame: u32,
    /// Last frame of the chunk, included.
    pub demo_end: u32,
    /// Demonstrations compared.
    pub compared: u32,
    /// Distance of the full states.
    pub d_q: f64,
    /// Distance of the object poses.
    pub d_o: f64,
    /// Distance of the end effectors as seen from the object.
    pub d_e: f64,
    /// Motion that carries the demonstration's object onto the query's: translation, then rotation vector.
    pub delta: [f64; 6],
    /// Turn about the object's symmetry axis.
    pub turn: f64,
    /// Actions of the chunk.
    pub replay_steps: u32,
}

/// Frames of a demonstration: position of the end effector, and pose of the object.
pub type SpatialDemonstration = Vec<([f64; 3], Pose)>;

/// The script, part by part, after what all pages share.
const SCRIPT: [&str; 10] = [
    include_str!("script/data.js"),
    include_str!("../script/selection.js"),
    include_str!("script/grid.js"),
    include_str!("script/views.js"),
    include_str!("script/picture.js"),
    include_str!("script/decision.js"),
    include_str!("script/timeline.js"),
    include_str!("script/viewer.js"),
    include_str!("../script/player.js"),
    include_str!("script/main.js"),
];

const STYLE: &str = concat!(include_str!("../page.css"), include_str!("page.css"));

/// What follows from several artifacts together.
struct Together {
    labels: Vec<String>,
    tasks: Vec<String>,
    protocol: Vec<Row>,
    settings: Vec<Row>,
}

impl Together {
    fn of(report: &SpatialReport) -> Self {
        let artifacts = &report.artifacts;
        let words = |word: fn(&SpatialRollouts) -> String| artifacts.iter().map(word).collect::<Vec<String>>();
        let mut tasks = words(|artifact| artifact.world.task.clone());
        // Where there are several tasks, a policy's name alone says too little.
        let several = tasks.iter().any(|task| *task != tasks[0]);
        let presets = if several {
            words(|artifact| format!("{} {}", artifact.world.task, artifact.preset))
        } else {
            words(|artifact| artifact.preset.clone())
        };
        let labels = told_apart(
            presets,
            &[
                words(|artifact| artifact.simulator.clone()),
                words(|artifact| format!("seeds {}", artifact.seeds)),
                words(|artifact| artifact.demonstrations.clone()),
                words(|artifact| format!("{} steps", artifact.max_steps)),
                words(|artifact| artifact.key.chars().take(8).collect()),
            ],
        );
        tasks.dedup();
        let leaves = |value: fn(&SpatialRollouts) -> &Value| {
            rows(
                &artifacts
                    .iter()
                    .map(|artifact| flatten(value(artifact)))
                    .collect::<Vec<_>>(),
            )
        };
        Self {
            labels,
            tasks,
            protocol: leaves(|artifact| &artifact.protocol),
            settings: leaves(|artifact| &artifact.settings),
        }
    }
}

/// The page.
pub fn spatial_page(report: &SpatialReport) -> String {
    let together = Together::of(report);
    Document {
        tool_version: &report.tool_version,
        title: format!("{} rollouts: {}", together.tasks.join(", "), together.labels.join(", ")),
        style: STYLE,
        script: &SCRIPT,
        data: &data::json(report, &together.labels),
        body: body(report, &together),
    }
    .render()
}

fn body(report: &SpatialReport, together: &Together) -> Markup {
    html! {
        a.skip href="#viewer" { "Skip to the rollout viewer" }
        (sections::header(report, together))
        main {
            (sections::scores(report, together))
            (sections::grid(together))
            (sections::viewer(report, together))
            (sections::tables(together))
            (sections::protocol(together))
        }
        (sections::footer(report, together))
    }
}

#[cfg(test)]
mod tests;

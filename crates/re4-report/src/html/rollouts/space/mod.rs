//! Rollouts of robosuite's tasks: the timeline of retrieved demonstrations (paper, Figure 2), and the scene from above and from
//! behind the robot. Poses are in the world frame, in metres and radians; quaternions are x, y, z, w.

mod sections;

use std::collections::{BTreeMap, BTreeSet};

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use maud::Markup;
use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_index::{IndexRow, SpatialState};
use re4_policy::kinds::{SpacePolicy, SpaceRe4Row};
use re4_rollout::{DecisionCore, ResultCore, SpaceDecisionRow, SpaceResultRow, SpaceStepRow, SpaceWorldRow, StepCore};
use re4_stats::Interval;
use re4_task::{RobosuiteTask, Solid};
use serde_json::{Value, json};

use super::summary::distinct_labels;
use super::{Decided, NONE, Report, Rollout, Rollouts, Scene, Words};
use crate::html::pack::{Pack, f32s, u32s};
use crate::html::shell::plural;

/// Data of a set of rollouts of a robosuite task.
#[derive(Debug, Clone, PartialEq)]
pub struct Space {
    /// The task.
    pub task: RobosuiteTask,
    /// Description of the seeds.
    pub seeds: String,
    /// Fraction of rollouts that succeed, with its Wilson interval.
    pub success_rate: Interval,
    /// Number of rollouts that succeed.
    pub successes: u64,
    /// Median number of steps of the rollouts that succeed.
    pub median_steps: Option<f64>,
    /// Number of lost grasps in all rollouts.
    pub losses: u64,
    /// Description of the demonstrations that were used.
    pub demonstrations: String,
    /// Description of the file that contains them.
    pub dataset: String,
    /// Description of the simulator.
    pub simulator: String,
    /// Camera images at decisions, by seed and number of the decision.
    pub images: BTreeMap<(u32, u32), DecisionImage>,
}

/// The image of a camera at a decision.
#[derive(Debug, Clone, PartialEq)]
pub struct DecisionImage {
    /// Name of the camera.
    pub camera: &'static str,
    /// Width and height of the image in pixels.
    pub side: u32,
    /// The image as the bytes of a PNG file.
    pub png: Vec<u8>,
    /// The object's frame as the policy observed it.
    pub observed: FrameInImage,
    /// The object's frame in the simulator.
    pub simulated: FrameInImage,
}

/// The origin and the ends of the three axes of a frame in an image, in pixels from its top left corner; `None` for points behind
/// the camera.
pub type FrameInImage = [Option<[f64; 2]>; 4];

impl Decided<Space> {
    /// Returns an integer that RE4 records of the retrieval, or [`NONE`].
    fn count(&self, value: fn(&SpaceRe4Row) -> Option<u32>) -> u32 {
        self.detail.as_ref().and_then(value).unwrap_or(NONE)
    }

    /// Returns a number that RE4 records of the retrieval, or NaN.
    fn number(&self, value: fn(&SpaceRe4Row) -> Option<f64>) -> [f64; 1] {
        [self.detail.as_ref().and_then(value).unwrap_or(f64::NAN)]
    }
}

impl Rollout<Space> {
    /// Returns the pose of the object before a step.
    pub fn object_before(&self, step: usize) -> Isometry3<f64> {
        let before = step.checked_sub(1).and_then(|last| self.steps.get(last));
        before.map_or(self.result.object, |step| step.object)
    }

    /// Returns how often the grasp was lost.
    fn losses(&self) -> usize {
        let kinds = self
            .decisions
            .iter()
            .filter_map(|decision| decision.core().kind.as_ref());
        kinds.filter(|kind| **kind == "grasp_lost").count()
    }

    /// Returns the number of different demonstrations that were followed.
    fn demos(&self) -> usize {
        let followed: BTreeSet<u32> = self
            .decisions
            .iter()
            .filter_map(|decision| decision.core().demo)
            .collect();
        followed.len()
    }

    /// Returns the number of demonstrations that were excluded from retrieval at the end.
    fn banned(&self) -> u32 {
        let last = self.decisions.last().and_then(|decision| decision.detail.as_ref());
        last.map_or(0, |detail| detail.banned)
    }

    /// Whether the policy observed an object pose that differs from the one in the simulator, at any step.
    fn observed_differs(&self) -> bool {
        let differs =
            |a: Isometry3<f64>, b: Isometry3<f64>| (a.translation.vector - b.translation.vector).amax() > 1e-6;
        let mut steps = self.steps.iter().enumerate();
        steps.any(|(i, step)| step.seen.is_some_and(|seen| differs(seen, self.object_before(i))))
    }
}

/// Returns the position, then the quaternion.
fn pose(pose: Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

impl Scene for Space {
    type Result = SpaceResultRow;
    type Step = SpaceStepRow;
    type Decision = SpaceDecisionRow;
    type Detail = SpaceRe4Row;
    type World = SpaceWorldRow;
    type Frame = IndexRow<SpatialState>;
    type Policies = SpacePolicy;
    type Extra = ();

    const WORDS: Words = Words {
        of: " in robosuite’s scenes",
        scores: ["Success", "Success table", "scores spatial"],
        note: "A rollout succeeds, and ends, as soon as the task’s own success criterion is met after a control step. \
            Intervals are 95 % Wilson intervals. The control rate is 20 Hz.",
        score_columns: &[
            ("Policy", false),
            ("Success rate", true),
            ("Successes", true),
            ("Median steps", true),
            ("Grasps lost", true),
            ("Demonstrations and simulator", false),
        ],
        comparison: "Success rates of different protocols, or with different demonstrations, are not comparable.",
        stage: "stage spatial",
        columns: &[
            ("seed", "Seed", false),
            ("success", "Success", false),
            ("steps", "Steps", false),
            ("decisions", "Decisions", false),
            ("demos", "Demonstrations", false),
            ("losses", "Grasps lost", false),
            ("banned", "Excluded", false),
        ],
    };
    const STYLE: &'static str = include_str!("page.css");
    const SCRIPT: &'static [&'static str] = &[
        include_str!("script/data.js"),
        include_str!("script/grid.js"),
        include_str!("script/views.js"),
        include_str!("script/camera.js"),
        include_str!("script/decision.js"),
        include_str!("script/timeline.js"),
    ];

    fn noun(&self) -> &'static str {
        "seed"
    }

    fn title(artifacts: &[Rollouts<Self>]) -> String {
        let mut tasks: Vec<&str> = artifacts.iter().map(|artifact| artifact.scene.task.title).collect();
        tasks.dedup();
        tasks.join(", ")
    }

    fn labels(artifacts: &[Rollouts<Self>]) -> Vec<String> {
        // With several tasks, the label needs the task in addition to the policy.
        let several = artifacts
            .iter()
            .any(|artifact| artifact.scene.task != artifacts[0].scene.task);
        distinct_labels(
            artifacts,
            |artifact| {
                if several {
                    format!("{} {}", artifact.scene.task.title, artifact.preset)
                } else {
                    artifact.preset.clone()
                }
            },
            &[
                &|artifact| artifact.scene.simulator.clone(),
                &|artifact| format!("seeds {}", artifact.scene.seeds),
                &|artifact| artifact.scene.demonstrations.clone(),
            ],
        )
    }

    fn extra(_: &Rollouts<Self>) {}

    fn details(artifact: &Rollouts<Self>) -> Vec<String> {
        let steps = plural(artifact.max_steps as usize, "step", "steps");
        vec![
            format!(
                "{} · {}{}",
                artifact.scene.task.title,
                artifact.variant,
                artifact.changed()
            ),
            [
                vec![format!("seeds {}", artifact.scene.seeds), format!("at most {steps}")],
                artifact.conditions(),
            ]
            .concat()
            .join(" · "),
        ]
    }

    fn score_cells(artifact: &Rollouts<Self>) -> Markup {
        sections::score_cells(artifact)
    }

    fn overview(labels: &[String]) -> Markup {
        sections::grid(labels)
    }

    fn evidence(report: &Report<Self>) -> Markup {
        sections::evidence(report.artifacts.iter().any(|artifact| images(artifact) != Value::Null))
    }

    fn result(row: &SpaceResultRow) -> &ResultCore {
        &row.core
    }

    fn step(row: &SpaceStepRow) -> &StepCore {
        &row.core
    }

    fn decision(row: &SpaceDecisionRow) -> &DecisionCore {
        &row.core
    }

    fn frame(frame: &IndexRow<SpatialState>) -> (u32, u32, Vec<f64>) {
        let state = &frame.state;
        (
            frame.episode,
            frame.frame,
            [state.eef.translation.vector.as_slice(), &pose(state.object)].concat(),
        )
    }

    /// The artifact does not contain the orientation of the end effector at the start, so that of the first query is used.
    fn start(rollout: &Rollout<Self>) -> Vec<f64> {
        let first_query = rollout
            .decisions
            .first()
            .map_or(Isometry3::identity(), |decision| decision.core.query_eef);
        [
            rollout.result.eef.as_slice(),
            &pose(first_query)[3..],
            &pose(rollout.result.object),
        ]
        .concat()
    }

    fn pack_results(pack: Pack<'_, Rollout<Self>>) -> Pack<'_, Rollout<Self>> {
        pack.list("demos", Rollout::demos)
            .list("losses", Rollout::losses)
            .list("banned", Rollout::banned)
    }

    fn pack_steps<'a>(pack: Pack<'a, SpaceStepRow>, artifact: &Rollouts<Self>) -> Pack<'a, SpaceStepRow> {
        let pack = pack
            .f32("goal", |s| [s.action.0[0], s.action.0[1], s.action.0[2]])
            .f32("eef", |s| pose(s.eef))
            .f32("object", |s| pose(s.object))
            .f32("fingers", |s| [(s.finger[0] - s.finger[1]).abs()])
            .u8("closing", |s| u8::from(s.gripper > 0.0));
        if artifact.shown().any(Rollout::observed_differs) {
            return pack.f32("seen", |s| s.seen.map_or([f64::NAN; 7], pose));
        }
        pack
    }

    fn pack_decisions(pack: Pack<'_, Decided<Self>>) -> Pack<'_, Decided<Self>> {
        let detail = |d: &Decided<Self>, value: fn(&SpaceRe4Row) -> bool| d.detail.as_ref().is_some_and(value);
        pack.u32("banned", |d| d.count(|d| Some(d.banned)))
            .u8("transfer", |d| u8::from(detail(d, |d| d.mode == Mode::Transfer)))
            .u8("bridge", |d| u8::from(detail(d, |d| d.bridge)))
            .f64("fingers", |d| d.number(|d| Some(d.finger_separation)))
            .f32("object", |d| d.core.query_object.map_or([f64::NAN; 7], pose))
            .f64("set_point", |d| {
                d.detail.as_ref().map_or([f64::NAN; 7], |d| pose(d.set_point))
            })
            .u32("compared", |d| d.count(|d| d.compared))
            .u32("replay_steps", |d| d.count(|d| d.replay_steps))
            .f64("d_q", |d| d.number(|d| d.d_q))
            .f64("d_o", |d| d.number(|d| d.d_o))
            .f64("d_e", |d| d.number(|d| d.d_e))
            .f64("symmetry_rotation", |d| d.number(|d| d.symmetry_rotation))
            .f64("delta", |d| {
                d.detail
                    .as_ref()
                    .and_then(|d| d.delta)
                    .map_or([f64::NAN; 6], |delta| delta.0)
            })
    }

    fn pack_more<'a>(pack: Pack<'a, Self>, artifact: &Rollouts<Self>, (): &()) -> Pack<'a, Self> {
        let task = artifact.scene.task;
        pack.with("task", json!(task.title))
            .with("fixtures", solids(task.fixtures))
            .with("object", solids(task.shape))
            .with("images", images(artifact))
    }
}

fn solids(solids: &[Solid]) -> Value {
    let solid = |s: &Solid| json!({ "kind": s.kind, "centre": s.centre, "half": s.half, "round": s.round });
    solids.iter().map(solid).collect()
}

/// Returns the images of decisions: the number of each decision, counted over all rollouts of the viewer, and 16 numbers for
/// each, the positions of both frames in the image. Null if there are no images.
fn images(artifact: &Rollouts<Space>) -> Value {
    let decisions = artifact
        .shown()
        .flat_map(|r| (0..).zip(&r.decisions).map(|(i, _)| (r.core().seed, i)));
    let shown: Vec<(u32, &DecisionImage)> = (0..)
        .zip(decisions)
        .filter_map(|(number, place)| Some((number, artifact.scene.images.get(&place)?)))
        .collect();
    let Some((_, first)) = shown.first() else {
        return Value::Null;
    };
    let places = shown
        .iter()
        .flat_map(|(_, image)| image.observed.iter().chain(&image.simulated));
    json!({
        "camera": first.camera,
        "side": first.side,
        "decision": u32s(shown.iter().map(|(number, _)| *number)),
        "places": f32s(places.flat_map(|place| place.unwrap_or([f64::NAN; 2]))),
        "png": shown.iter().map(|(_, image)| BASE64_STANDARD.encode(&image.png)).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests;

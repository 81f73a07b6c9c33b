//! Rollouts of robosuite's tasks: the timeline of retrieved demonstrations (paper, Figure 2), the scene from above and from
//! behind the robot. World frame, metres, radians; quaternions x, y, z, w.

mod sections;

use std::collections::BTreeMap;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use maud::Markup;
use nalgebra::{Isometry3, Vector3};
use re4_artifact::{Label, SixAxis, TableSpec, Word, columns, tables};
use re4_episode::Mode;
use re4_stats::Interval;
use serde::Serialize;
use serde_json::{Value, json};

use super::facts::told_apart;
use super::{Report, Rollout, Rollouts, Scene, Table, Words, demo_name};
use crate::html::pack::{Pack, f32s, u32s};
use crate::html::shell::plural;

/// What an artifact states of rollouts in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Space {
    /// Name of the task on the page.
    pub task: String,
    /// What is drawn of its scene.
    pub solids: Solids,
    /// The seeds in words.
    pub seeds: String,
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
    /// What the camera saw at decisions, by seed and number of the decision.
    pub pictures: BTreeMap<(u32, u32), DecisionPicture>,
}

/// What of a task's scene is drawn.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solids {
    /// What does not move, world frame.
    pub fixtures: Vec<Solid>,
    /// Parts of the manipulated object, in its own frame.
    pub object: Vec<Solid>,
}

/// A box, or an upright cylinder, along the axes of its frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Solid {
    /// What it is: `table`, `wall`, `goal`, `object`.
    pub kind: &'static str,
    /// Its centre.
    pub centre: [f64; 3],
    /// Half its sides; of a cylinder the first two are the radius.
    pub half: [f64; 3],
    /// Whether it is a cylinder.
    pub round: bool,
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

/// What an action is part of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// The way to the chunk.
    Bridge,
    /// The chunk.
    Replay,
    /// The way back to the initial pose.
    Home,
}

impl Word for Phase {
    const ALL: &'static [Self] = &[Self::Bridge, Self::Replay, Self::Home];

    fn word(self) -> &'static str {
        match self {
            Self::Bridge => "bridge",
            Self::Replay => "replay",
            Self::Home => "home",
        }
    }
}

columns! {
    /// A rollout: its first state and its outcome.
    pub struct SpaceResult {
        /// Seed of its placement.
        pub seed: u32,
        /// Whether it succeeded.
        pub success: bool,
        /// Control steps.
        pub steps: u32,
        /// Decisions.
        pub decisions: u32,
        /// How often the grasp was lost.
        pub losses: u32,
        /// Demonstrations that were not followed again at the end.
        pub banned: u32,
        /// Demonstrations that were followed.
        pub demos: u32,
        /// End effector at the start. Its orientation is that of the first query.
        pub eef: Vector3<f64>,
        /// Object at the start.
        pub object: Isometry3<f64>,
        /// First state of the simulation: time, coordinates, velocities.
        pub state: Vec<f64>,
    }
}

columns! {
    /// A control step.
    pub struct SpaceStep {
        /// Rollout.
        pub seed: u32,
        /// Commanded pose of the end effector.
        pub action: SixAxis,
        /// Gripper command: below 0 opens, above 0 closes.
        pub gripper: f64,
        /// End effector after the step.
        pub eef: Isometry3<f64>,
        /// Object after the step.
        pub object: Isometry3<f64>,
        /// Positions of the fingers after the step.
        pub finger: [f64; 2],
        /// Decision that the action belongs to.
        pub decision: u32,
        /// What the action is part of.
        pub phase: Phase,
        /// Object that the policy was told before the action.
        pub seen: Isometry3<f64>,
    }
}

columns! {
    /// A decision.
    pub struct SpaceDecision {
        /// Rollout.
        pub seed: u32,
        /// Control steps taken before it.
        pub step: u32,
        /// What was decided: `retrieve`, `continue`, `grasp_lost` or `demo_ended`.
        pub kind: Label,
        /// Whether the object is held.
        pub mode: Mode,
        /// End effector of the query.
        pub query_eef: Isometry3<f64>,
        /// Object of the query.
        pub query_object: Isometry3<f64>,
        /// Distance between the fingers.
        pub finger_separation: f64,
        /// What was retrieved; nothing on the way home.
        #[prefix = ""]
        pub choice: Option<SpaceChoice>,
        /// Name of the demonstration in its source, where the artifact has names.
        pub demo_name: Option<String>,
        /// Where the end effector goes first.
        pub set_point: Isometry3<f64>,
        /// Whether a bridge, or the way home, leads there.
        pub bridge: bool,
        /// Demonstrations that are not followed again by now.
        pub banned: u32,
        /// The decision in words.
        pub reason: String,
    }
}

columns! {
    /// What a decision retrieved.
    pub struct SpaceChoice {
        /// Demonstration, by its number in the index.
        pub demo: u32,
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
        /// Motion that carries the demonstration's object onto the query's.
        pub delta: SixAxis,
        /// Turn about the object's symmetry axis.
        pub symmetry_turn: f64,
        /// Actions of the chunk.
        pub replay_steps: u32,
    }
}

columns! {
    /// A frame of a demonstration.
    pub struct SpaceFrame {
        /// Demonstration.
        pub episode: u32,
        /// End effector.
        pub eef: Vector3<f64>,
        /// Object.
        pub object: Isometry3<f64>,
    }
}

impl SpaceDecision {
    /// What the demonstration is called; nothing on the way home.
    pub(crate) fn demo_name(&self) -> String {
        demo_name(
            self.choice.as_ref().map(|choice| choice.demo),
            self.demo_name.as_deref(),
        )
    }

    /// A number of what was retrieved.
    fn chosen(&self, value: fn(&SpaceChoice) -> u32) -> u32 {
        self.choice.as_ref().map_or(u32::MAX, value)
    }

    fn measured(&self, value: fn(&SpaceChoice) -> f64) -> [f64; 1] {
        [self.choice.as_ref().map_or(f64::NAN, value)]
    }
}

impl Rollout<Space> {
    /// The object before a step.
    pub fn object_before(&self, step: usize) -> Isometry3<f64> {
        let before = step.checked_sub(1).and_then(|last| self.steps.get(last));
        before.map_or(self.result.object, |step| step.object)
    }

    /// Whether the policy was told of another object pose than the simulator had.
    fn told_otherwise(&self) -> bool {
        let away = |a: Isometry3<f64>, b: Isometry3<f64>| (a.translation.vector - b.translation.vector).amax() > 1e-6;
        let mut steps = self.steps.iter().enumerate();
        steps.any(|(i, step)| away(step.seen, self.object_before(i)))
    }
}

/// Position, then quaternion.
fn pose(pose: Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

impl Scene for Space {
    type Result = SpaceResult;
    type Step = SpaceStep;
    type Decision = SpaceDecision;
    type Frame = SpaceFrame;
    type Extra = ();

    const WORDS: Words = Words {
        of: " in robosuite’s scene",
        scores: ["Success", "Success table", "scores spatial"],
        note: "A rollout succeeds when the task’s own rule holds after any control step, which ends it. \
            Intervals are Wilson’s, at 95 %. A second holds 20 control steps.",
        score_columns: &[
            ("Policy", false),
            ("Success rate", true),
            ("Succeeded", true),
            ("Median steps", true),
            ("Grasps lost", true),
            ("Demonstrations and simulator", false),
        ],
        comparison: "Success rates of different protocols, or with other demonstrations, must not be compared.",
        stage: "stage spatial",
        columns: &[
            ("seed", "Seed", false),
            ("success", "Success", false),
            ("steps", "Steps", false),
            ("decisions", "Decisions", false),
            ("demos", "Demonstrations", false),
            ("losses", "Grasps lost", false),
            ("banned", "Not followed again", false),
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

    fn table(table: Table) -> &'static TableSpec {
        match table {
            Table::Results => &tables::SPATIAL_RESULTS,
            Table::Steps => &tables::SPATIAL_STEPS,
            Table::Decisions => &tables::SPATIAL_DECISIONS,
            Table::Index => &tables::SPATIAL_INDEX,
        }
    }

    fn noun(&self) -> &'static str {
        "seed"
    }

    fn title(artifacts: &[Rollouts<Self>]) -> String {
        let mut tasks: Vec<&str> = artifacts.iter().map(|artifact| artifact.scene.task.as_str()).collect();
        tasks.dedup();
        tasks.join(", ")
    }

    fn labels(artifacts: &[Rollouts<Self>]) -> Vec<String> {
        // Where there are several tasks, a policy's name alone says too little.
        let several = artifacts
            .iter()
            .any(|artifact| artifact.scene.task != artifacts[0].scene.task);
        told_apart(
            artifacts,
            |artifact| match several {
                true => format!("{} {}", artifact.scene.task, artifact.preset),
                false => artifact.preset.clone(),
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
            format!("{} · {}{}", artifact.scene.task, artifact.variant, artifact.changed()),
            format!("seeds {} · at most {steps}", artifact.scene.seeds),
        ]
    }

    fn score_cells(artifact: &Rollouts<Self>) -> Markup {
        sections::score_cells(artifact)
    }

    fn overview(labels: &[String]) -> Markup {
        sections::grid(labels)
    }

    fn evidence(report: &Report<Self>) -> Markup {
        sections::evidence(
            report
                .artifacts
                .iter()
                .any(|artifact| pictures(artifact) != Value::Null),
        )
    }

    fn counts(result: &SpaceResult) -> [u32; 3] {
        [result.seed, result.steps, result.decisions]
    }

    fn seed_of_step(step: &SpaceStep) -> u32 {
        step.seed
    }

    fn seed_of_decision(decision: &SpaceDecision) -> u32 {
        decision.seed
    }

    fn demo(decision: &SpaceDecision) -> Option<u32> {
        Some(decision.choice.as_ref()?.demo)
    }

    fn frame(frame: &SpaceFrame) -> (u32, Vec<f64>) {
        (frame.episode, [frame.eef.as_slice(), &pose(frame.object)].concat())
    }

    /// The artifact holds no orientation of the end effector at the start; it is that of the first query.
    fn start(rollout: &Rollout<Self>) -> Vec<f64> {
        let turned = rollout
            .decisions
            .first()
            .map_or(Isometry3::identity(), |decision| decision.query_eef);
        [
            rollout.result.eef.as_slice(),
            &pose(turned)[3..],
            &pose(rollout.result.object),
        ]
        .concat()
    }

    fn pack_results<'a>(pack: Pack<'a, Rollout<Self>>) -> Pack<'a, Rollout<Self>> {
        pack.list("success", |r| u8::from(r.result.success))
            .list("demos", |r| r.result.demos)
            .list("losses", |r| r.result.losses)
            .list("banned", |r| r.result.banned)
    }

    fn pack_steps<'a>(pack: Pack<'a, SpaceStep>, artifact: &Rollouts<Self>) -> Pack<'a, SpaceStep> {
        let pack = pack
            .f32("goal", |s| [s.action.0[0], s.action.0[1], s.action.0[2]])
            .f32("eef", |s| pose(s.eef))
            .f32("object", |s| pose(s.object))
            .f32("fingers", |s| [(s.finger[0] - s.finger[1]).abs()])
            .u32("decision", |s| s.decision)
            .u8("phase", |s| s.phase as u8)
            .u8("closing", |s| u8::from(s.gripper > 0.0));
        if artifact.shown().any(Rollout::told_otherwise) {
            return pack.f32("seen", |s| pose(s.seen));
        }
        pack
    }

    fn pack_decisions(pack: Pack<'_, SpaceDecision>) -> Pack<'_, SpaceDecision> {
        pack.u32("step", |d| d.step)
            .u32("banned", |d| d.banned)
            .u8("transfer", |d| u8::from(d.mode == Mode::Transfer))
            .u8("bridge", |d| u8::from(d.bridge))
            .f64("fingers", |d| [d.finger_separation])
            .f32("object", |d| pose(d.query_object))
            .f64("set_point", |d| pose(d.set_point))
            .u32("demo", |d| d.chosen(|c| c.demo))
            .u32("demo_frame", |d| d.chosen(|c| c.demo_frame))
            .u32("demo_end", |d| d.chosen(|c| c.demo_end))
            .u32("compared", |d| d.chosen(|c| c.compared))
            .u32("replay_steps", |d| d.chosen(|c| c.replay_steps))
            .f64("d_q", |d| d.measured(|c| c.d_q))
            .f64("d_o", |d| d.measured(|c| c.d_o))
            .f64("d_e", |d| d.measured(|c| c.d_e))
            .f64("turn", |d| d.measured(|c| c.symmetry_turn))
            .f64("delta", |d| d.choice.as_ref().map_or([f64::NAN; 6], |c| c.delta.0))
            .list("kind", |d| d.kind.to_string())
            .list("reason", |d| d.reason.as_str())
            .list("demo_name", SpaceDecision::demo_name)
    }

    fn pack_more<'a>(pack: Pack<'a, Self>, artifact: &Rollouts<Self>, (): &()) -> Pack<'a, Self> {
        pack.with("task", json!(artifact.scene.task))
            .with("fixtures", json!(artifact.scene.solids.fixtures))
            .with("object", json!(artifact.scene.solids.object))
            .with("pictures", pictures(artifact))
    }
}

/// Pictures of some decisions: the number of each decision, counted over all rollouts of the viewer, and 16 numbers each, the
/// places of both frames. Null where there are none.
fn pictures(artifact: &Rollouts<Space>) -> Value {
    let decisions = artifact
        .shown()
        .flat_map(|r| (0..).zip(&r.decisions).map(|(i, _)| (r.result.seed, i)));
    let shown: Vec<(u32, &DecisionPicture)> = (0..)
        .zip(decisions)
        .filter_map(|(number, place)| Some((number, artifact.scene.pictures.get(&place)?)))
        .collect();
    let Some((_, first)) = shown.first() else {
        return Value::Null;
    };
    let places = shown
        .iter()
        .flat_map(|(_, picture)| picture.told.iter().chain(&picture.simulated));
    json!({
        "camera": first.camera,
        "side": first.side,
        "decision": u32s(shown.iter().map(|(number, _)| *number)),
        "places": f32s(places.flat_map(|place| place.unwrap_or([f64::NAN; 2]))),
        "png": shown.iter().map(|(_, picture)| BASE64_STANDARD.encode(&picture.png)).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests;

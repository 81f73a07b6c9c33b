//! Rollouts of Push-T, in the plane; pixels and radians, y down.

mod curve;
mod paper;
mod sections;

use maud::Markup;
use re4_artifact::{Label, TableSpec, columns, tables};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_sim::{AGENT_RADIUS, GOAL, SUCCESS_COVERAGE};
use re4_stats::Interval;
use serde_json::json;

pub use self::curve::Curve;
use super::facts::told_apart;
use super::{Rollout, Rollouts, Scene, Table, Words, demo_name};
use crate::html::pack::Pack;
use crate::html::shell::plural;

/// What an artifact states of rollouts in the plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// How many demonstrations the policy had, where that is known.
    pub demonstrations: Option<u64>,
    /// Which of the dataset's demonstrations these were.
    pub taken: Taken,
    /// Demonstrations in the whole dataset, where that is known.
    pub in_dataset: Option<u64>,
    /// What rollouts start from.
    pub starts: Starts,
    /// The starts in words.
    pub scenes: String,
    /// Figures over all rollouts.
    pub metrics: Metrics,
}

/// What rollouts start from, and so what their numbers mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Starts {
    /// Scenes made from seeds.
    Seeds,
    /// Chosen scenes.
    Scenes,
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
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
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

columns! {
    /// A rollout: its first state and what it reached.
    pub struct PlaneResult {
        /// Seed of its scene, or number of its scene.
        pub seed: u32,
        /// Pusher in the first state.
        pub agent: Point2,
        /// Block in the first state.
        pub block: Pose2,
        /// Greatest coverage.
        pub coverage_max: f64,
        /// Greatest intersection over union.
        pub iou_max: f64,
        /// Greatest scaled score.
        pub score_max: f64,
        /// Coverage in the last state.
        pub coverage_final: f64,
        /// Whether it succeeded.
        pub success: bool,
        /// Control steps.
        pub steps: u32,
        /// Decisions.
        pub decisions: u32,
    }
}

columns! {
    /// A control step.
    pub struct PlaneStep {
        /// Rollout.
        pub seed: u32,
        /// Target sent.
        pub action: Point2,
        /// Pusher after the step.
        pub eef: Point2,
        /// Block after the step.
        pub object: Pose2,
        /// Coverage after the step.
        pub coverage: f64,
        /// Scaled score after the step.
        pub score: f64,
        /// Decision that the action follows from.
        pub decision: u32,
        /// What the action is part of: plan or replay.
        pub phase: Label,
        /// Pose of the block that the policy was given before the step, where it was estimated.
        pub observed_object: Option<Pose2>,
        /// Confidence of that estimate, 0 to 1.
        pub pose_confidence: Option<f64>,
        /// What the estimator says of it, in a word.
        pub pose_flag: Option<Label>,
    }
}

impl PlaneStep {
    /// Whether the action replays a chunk; else it follows a plan.
    pub(crate) fn replays(&self) -> bool {
        self.phase == "replay"
    }
}

columns! {
    /// A decision.
    pub struct PlaneDecision {
        /// Rollout.
        pub seed: u32,
        /// Control steps taken before it.
        pub step: u32,
        /// Mode of the demonstration; in transfer a chunk is replayed where it was recorded.
        pub mode: Mode,
        /// Rule that chose.
        pub selector: Label,
        /// Pose of the block that the decision was taken on.
        pub query_object: Pose2,
        /// Retrieved demonstration, by its number in the index.
        pub demo: u32,
        /// Its name in its source, where the artifact has names.
        pub demo_name: Option<String>,
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
        pub delta: Pose2,
        /// Where the chunk starts.
        pub set_point: Point2,
        /// How it was planned to get there.
        pub plan: Label,
        /// Control steps of the plan.
        pub plan_steps: u32,
        /// Nodes searched.
        pub plan_nodes: u32,
        /// The plan as a polyline: x and y by turns.
        pub plan_path: Vec<f64>,
        /// Control steps of the chunk.
        pub replay_steps: u32,
        /// Expected pose of the block after the chunk.
        pub predicted_object: Pose2,
        /// Coverage there.
        pub predicted_coverage: f64,
        /// The decision in words.
        pub reason: String,
    }
}

columns! {
    /// A frame of a demonstration.
    pub struct PlaneFrame {
        /// Demonstration.
        pub episode: u32,
        /// Its number in it.
        pub frame: u32,
        /// Pusher.
        pub eef: Point2,
        /// Block.
        pub object: Pose2,
    }
}

impl PlaneDecision {
    /// What the demonstration is called.
    pub(crate) fn demo_name(&self) -> String {
        demo_name(Some(self.demo), self.demo_name.as_deref())
    }

    /// The points of the plan.
    pub(crate) fn path(&self) -> impl Iterator<Item = [f64; 2]> {
        self.plan_path.as_chunks().0.iter().copied()
    }
}

fn point(point: Point2) -> [f64; 2] {
    [point.x, point.y]
}

fn pose(pose: Pose2) -> [f64; 3] {
    [pose.x, pose.y, pose.theta]
}

/// Corners of Push-T's block in its own frame, in order.
pub(crate) fn block_outline() -> Vec<[f64; 2]> {
    let [bar, stem] = re4_sim::tee_rectangles();
    let corners = [bar[0], bar[1], bar[2], stem[1], stem[2], stem[3], stem[0], bar[3]];
    corners.map(point).to_vec()
}

impl Scene for Plane {
    type Result = PlaneResult;
    type Step = PlaneStep;
    type Decision = PlaneDecision;
    type Frame = PlaneFrame;
    type Extra = Curve;

    const WORDS: Words = Words {
        of: "",
        scores: ["Scores", "Score table", "scores"],
        note: "Mean over rollouts of the greatest value within a rollout, with 95 % intervals. \
            Scaled score is min(coverage / 0.95, 1). The paper’s measure is its “maximum coverage per episode”, without intervals; \
            it is set beside the scaled score, which is what the field reports, and marked there in blue.",
        score_columns: &[
            ("Policy", false),
            ("Scaled score", true),
            ("Raw coverage", true),
            ("IoU", true),
            ("Success rate", true),
            ("The paper", true),
        ],
        comparison: "Scores of different protocols must not be compared.",
        stage: "stage",
        columns: &[
            ("seed", "Seed", false),
            ("score", "Scaled score", true),
            ("coverage", "Raw coverage", true),
            ("iou", "IoU", true),
            ("coverage_final", "Last coverage", true),
            ("steps", "Steps", false),
            ("decisions", "Decisions", false),
            ("success", "Success", false),
        ],
    };
    const STYLE: &'static str = "";
    const SCRIPT: &'static [&'static str] = &[
        include_str!("script/data.js"),
        include_str!("script/charts.js"),
        include_str!("script/scene.js"),
        include_str!("script/viewer.js"),
    ];

    fn table(table: Table) -> &'static TableSpec {
        match table {
            Table::Results => &tables::RESULTS,
            Table::Steps => &tables::STEPS,
            Table::Decisions => &tables::DECISIONS,
            Table::Index => &tables::INDEX,
        }
    }

    fn noun(&self) -> &'static str {
        match self.starts {
            Starts::Seeds => "seed",
            Starts::Scenes => "scene",
        }
    }

    fn title(_: &[Rollouts<Self>]) -> String {
        "Push-T".to_owned()
    }

    /// The preset, and as much more as it takes to tell the artifacts apart.
    fn labels(artifacts: &[Rollouts<Self>]) -> Vec<String> {
        let count = |demonstrations: Option<u64>| {
            demonstrations.map_or_else(|| "other demos".to_owned(), |count| format!("{count} demos"))
        };
        told_apart(
            artifacts,
            |artifact| artifact.preset.clone(),
            &[
                &|artifact| artifact.variant.clone(),
                &|artifact| count(artifact.scene.demonstrations),
                &|artifact| artifact.scene.scenes.clone(),
            ],
        )
    }

    fn extra(artifact: &Rollouts<Self>) -> Curve {
        Curve::of(artifact)
    }

    fn details(artifact: &Rollouts<Self>) -> Vec<String> {
        let demos = match (artifact.scene.taken, artifact.scene.demonstrations) {
            (Taken::All, Some(count)) => format!("all {count} demonstrations"),
            (Taken::First(count), _) => format!("first {count} demonstrations"),
            (Taken::Other, Some(count)) => format!("{count} chosen demonstrations"),
            (_, None) => "demonstrations not counted".to_owned(),
        };
        let steps = plural(artifact.max_steps as usize, "step", "steps");
        vec![
            format!("{} · {demos}{}", artifact.variant, artifact.changed()),
            format!("{} · {steps}", artifact.scene.scenes),
        ]
    }

    fn score_cells(artifact: &Rollouts<Self>) -> Markup {
        sections::score_cells(artifact)
    }

    fn overview(labels: &[String]) -> Markup {
        sections::plots(labels)
    }

    fn evidence(_: &super::Report<Self>) -> Markup {
        sections::evidence()
    }

    fn more_tables(labels: &[String], curves: &[Curve]) -> [Markup; 2] {
        [sections::paper_table(), sections::budgets(labels, curves)]
    }

    fn counts(result: &PlaneResult) -> [u32; 3] {
        [result.seed, result.steps, result.decisions]
    }

    fn seed_of_step(step: &PlaneStep) -> u32 {
        step.seed
    }

    fn seed_of_decision(decision: &PlaneDecision) -> u32 {
        decision.seed
    }

    fn demo(decision: &PlaneDecision) -> Option<u32> {
        Some(decision.demo)
    }

    fn frame(frame: &PlaneFrame) -> (u32, Vec<f64>) {
        (frame.episode, [&point(frame.eef)[..], &pose(frame.object)].concat())
    }

    fn start(rollout: &Rollout<Self>) -> Vec<f64> {
        let result = &rollout.result;
        [&point(result.agent)[..], &pose(result.block)].concat()
    }

    fn pack_results<'a>(pack: Pack<'a, Rollout<Self>>) -> Pack<'a, Rollout<Self>> {
        pack.list("score", |r| r.result.score_max)
            .list("coverage", |r| r.result.coverage_max)
            .list("iou", |r| r.result.iou_max)
            .list("coverage_final", |r| r.result.coverage_final)
            .list("success", |r| u8::from(r.result.success))
    }

    fn pack_steps<'a>(pack: Pack<'a, PlaneStep>, _: &Rollouts<Self>) -> Pack<'a, PlaneStep> {
        pack.f32("action", |s| point(s.action))
            .f32("eef", |s| point(s.eef))
            .f32("object", |s| pose(s.object))
            .f64("coverage", |s| [s.coverage])
            .u32("decision", |s| s.decision)
            .u8("replay", |s| u8::from(s.replays()))
            .where_any(
                |s| s.observed_object.is_some(),
                |pack| pack.f32("observed", |s| s.observed_object.map_or([f64::NAN; 3], pose)),
            )
            .where_any(
                |s| s.pose_confidence.is_some(),
                |pack| pack.f64("confidence", |s| [s.pose_confidence.unwrap_or(f64::NAN)]),
            )
            .where_any(
                |s| s.pose_flag.is_some(),
                |pack| pack.words("flag", "flag_words", |s| s.pose_flag.as_deref().unwrap_or("")),
            )
    }

    fn pack_decisions(pack: Pack<'_, PlaneDecision>) -> Pack<'_, PlaneDecision> {
        pack.u32("step", |d| d.step)
            .u32("demo", |d| d.demo)
            .u32("demo_frame", |d| d.demo_frame)
            .u32("demo_end", |d| d.demo_end)
            .u32("compared", |d| d.compared)
            .u32("plan_steps", |d| d.plan_steps)
            .u32("plan_nodes", |d| d.plan_nodes)
            .u32("replay_steps", |d| d.replay_steps)
            .u8("transfer", |d| u8::from(d.mode == Mode::Transfer))
            .f64("d_q", |d| [d.d_q.unwrap_or(f64::NAN)])
            .f64("d_o", |d| [d.d_o.unwrap_or(f64::NAN)])
            .f64("predicted_coverage", |d| [d.predicted_coverage])
            .f64("delta", |d| pose(d.delta))
            .f64("set_point", |d| point(d.set_point))
            .f32("object", |d| pose(d.query_object))
            .f32("predicted", |d| pose(d.predicted_object))
            .u32("path_length", |d| d.path().count() as u32)
            .f32s("path", |d| d.path().flatten())
            .list("plan", |d| d.plan.to_string())
            .list("selector", |d| d.selector.to_string())
            .list("reason", |d| d.reason.as_str())
            .list("demo_name", PlaneDecision::demo_name)
    }

    fn pack_more<'a>(pack: Pack<'a, Self>, _: &Rollouts<Self>, curve: &Curve) -> Pack<'a, Self> {
        // The walls' inner edges are where gym-pusht draws them, 5 px inside.
        let world = json!({
            "side": 512.0,
            "wall": 5.0,
            "goal": pose(GOAL),
            "outline": block_outline(),
            "pusher_radius": AGENT_RADIUS,
            "success_coverage": SUCCESS_COVERAGE,
        });
        pack.with("world", world).with("curve", json!(curve))
    }
}

#[cfg(test)]
pub(crate) mod tests;

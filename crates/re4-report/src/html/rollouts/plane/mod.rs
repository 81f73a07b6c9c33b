//! Rollouts of Push-T. Lengths are in pixels, angles in radians; the y axis points down.

mod curve;
mod paper;
mod sections;

use maud::Markup;
use re4_artifact::Label;
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_index::{IndexRow, PlanarState};
use re4_policy::kinds::{PlanePolicy, PlaneRe4Row};
use re4_rollout::{DecisionCore, PlaneDecisionRow, PlaneResultRow, PlaneStepRow, PlaneWorldRow, ResultCore, StepCore};
use re4_sim::{AGENT_RADIUS, GOAL, SUCCESS_COVERAGE};
use re4_stats::Interval;
use serde_json::json;

pub use self::curve::Curve;
use super::summary::distinct_labels;
use super::{Decided, NONE, Rollout, Rollouts, Scene, Words};
use crate::html::pack::Pack;
use crate::html::shell::plural;

/// Data of a set of Push-T rollouts.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane {
    /// Number of demonstrations that the policy had, if it is known.
    pub demonstrations: Option<u64>,
    /// Which demonstrations of the dataset the policy had.
    pub taken: Taken,
    /// Number of demonstrations in the whole dataset, if it is known.
    pub in_dataset: Option<u64>,
    /// What rollouts start from.
    pub starts: Starts,
    /// Description of the starts.
    pub scenes: String,
    /// Results over all rollouts.
    pub metrics: Metrics,
}

/// What rollouts start from. It determines what the numbers of rollouts mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Starts {
    /// Scenes that are generated from seeds.
    Seeds,
    /// Scenes of a `scenes` artifact.
    Scenes,
}

/// Which demonstrations of the dataset were used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// All of them.
    All,
    /// The first ones, of this number.
    First(u64),
    /// Another selection.
    Other,
}

/// Results of a set of rollouts, each with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
pub struct Metrics {
    /// Mean scaled score.
    pub score_scaled_mean: Interval,
    /// Mean raw coverage.
    pub coverage_raw_mean: Interval,
    /// Mean intersection over union.
    pub iou_mean: Interval,
    /// Fraction of rollouts that succeed.
    pub success_rate: Interval,
}

impl Rollout<Plane> {
    /// Returns the goal pose of the block.
    pub fn goal(&self) -> Pose2 {
        self.world.map_or(GOAL, |world| world.goal)
    }
}

impl Decided<Plane> {
    /// Returns an integer that RE4 records, or [`NONE`].
    fn count(&self, value: fn(&PlaneRe4Row) -> u32) -> u32 {
        self.detail.as_ref().map_or(NONE, value)
    }

    /// Returns numbers that RE4 records, or NaN.
    fn numbers<const N: usize>(&self, value: impl Fn(&PlaneRe4Row) -> [f64; N]) -> [f64; N] {
        self.detail.as_ref().map_or([f64::NAN; N], value)
    }

    /// Iterates over the points of the plan.
    pub(crate) fn path(&self) -> impl Iterator<Item = [f64; 2]> {
        let path = self.detail.iter().flat_map(|detail| detail.plan_path.as_chunks().0);
        path.copied()
    }
}

fn point(point: Point2) -> [f64; 2] {
    [point.x, point.y]
}

fn pose(pose: Pose2) -> [f64; 3] {
    [pose.x, pose.y, pose.theta]
}

/// Returns the corners of Push-T's block in its own frame, in order.
pub(crate) fn block_outline() -> Vec<[f64; 2]> {
    let [bar, stem] = re4_sim::tee_rectangles();
    let corners = [bar[0], bar[1], bar[2], stem[1], stem[2], stem[3], stem[0], bar[3]];
    corners.map(point).to_vec()
}

impl Scene for Plane {
    type Result = PlaneResultRow;
    type Step = PlaneStepRow;
    type Decision = PlaneDecisionRow;
    type Detail = PlaneRe4Row;
    type World = PlaneWorldRow;
    type Frame = IndexRow<PlanarState>;
    type Policies = PlanePolicy;
    type Extra = Curve;

    const WORDS: Words = Words {
        of: "",
        scores: ["Scores", "Score table", "scores"],
        note: "Mean over rollouts of the maximum value of each rollout, with 95 % intervals. \
            The scaled score is min(coverage / 0.95, 1). The paper reports its “maximum coverage per episode”, without intervals. \
            It is compared with the scaled score, which is the usual measure for Push-T; a blue tick marks it on the bar.",
        score_columns: &[
            ("Policy", false),
            ("Scaled score", true),
            ("Raw coverage", true),
            ("IoU", true),
            ("Success rate", true),
            ("RE4 paper", true),
        ],
        comparison: "Scores of different protocols are not comparable.",
        stage: "stage",
        columns: &[
            ("seed", "Seed", false),
            ("score", "Scaled score", true),
            ("coverage", "Raw coverage", true),
            ("iou", "IoU", true),
            ("coverage_final", "Final coverage", true),
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

    fn noun(&self) -> &'static str {
        match self.starts {
            Starts::Seeds => "seed",
            Starts::Scenes => "scene",
        }
    }

    fn title(_: &[Rollouts<Self>]) -> String {
        "Push-T".to_owned()
    }

    /// The preset, and as many further parts as are needed to distinguish the artifacts.
    fn labels(artifacts: &[Rollouts<Self>]) -> Vec<String> {
        let count = |demonstrations: Option<u64>| {
            demonstrations.map_or_else(|| "other demos".to_owned(), |count| format!("{count} demos"))
        };
        distinct_labels(
            artifacts,
            |artifact| artifact.preset.clone(),
            &[
                &|artifact| artifact.variant.clone(),
                &|artifact| count(artifact.scene.demonstrations),
                &|artifact| artifact.scene.scenes.clone(),
                &|artifact| artifact.conditions().join(", "),
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
            (Taken::Other, Some(count)) => format!("{count} selected demonstrations"),
            (_, None) => "unknown number of demonstrations".to_owned(),
        };
        let steps = plural(artifact.max_steps as usize, "step", "steps");
        vec![
            format!("{} · {demos}{}", artifact.variant, artifact.changed()),
            [vec![artifact.scene.scenes.clone(), steps], artifact.conditions()]
                .concat()
                .join(" · "),
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

    fn result(row: &PlaneResultRow) -> &ResultCore {
        &row.core
    }

    fn step(row: &PlaneStepRow) -> &StepCore {
        &row.core
    }

    fn decision(row: &PlaneDecisionRow) -> &DecisionCore {
        &row.core
    }

    fn frame(frame: &IndexRow<PlanarState>) -> (u32, u32, Vec<f64>) {
        (
            frame.episode,
            frame.frame,
            [&point(frame.state.eef)[..], &pose(frame.state.object)].concat(),
        )
    }

    fn start(rollout: &Rollout<Self>) -> Vec<f64> {
        let result = &rollout.result;
        [&point(result.eef)[..], &pose(result.object)].concat()
    }

    fn pack_results(pack: Pack<'_, Rollout<Self>>) -> Pack<'_, Rollout<Self>> {
        pack.list("score", |r| r.result.score_max)
            .list("coverage", |r| r.result.coverage_max)
            .list("iou", |r| r.result.iou_max)
            .list("coverage_final", |r| r.result.coverage_final)
            .where_any(|r| r.world.is_some(), |pack| pack.list("goal", |r| pose(r.goal())))
    }

    fn pack_steps<'a>(pack: Pack<'a, PlaneStepRow>, _: &Rollouts<Self>) -> Pack<'a, PlaneStepRow> {
        // Without a flag, the observed pose is the recorded one, which is in the data already.
        let observed = |s: &PlaneStepRow| s.seen.filter(|_| s.pose_flag.is_some());
        pack.f32("action", |s| point(s.action))
            .f32("eef", |s| point(s.eef))
            .f32("object", |s| pose(s.object))
            .f64("coverage", |s| [s.coverage])
            .where_any(
                |s| observed(s).is_some(),
                |pack| pack.f32("observed", |s| observed(s).map_or([f64::NAN; 3], pose)),
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

    fn pack_decisions(pack: Pack<'_, Decided<Self>>) -> Pack<'_, Decided<Self>> {
        let word = |word: fn(&PlaneRe4Row) -> &Label| {
            move |d: &Decided<Self>| {
                d.detail
                    .as_ref()
                    .map_or(String::new(), |detail| word(detail).to_string())
            }
        };
        pack.u32("compared", |d| d.count(|d| d.compared))
            .u32("plan_steps", |d| d.count(|d| d.plan_steps))
            .u32("plan_nodes", |d| d.count(|d| d.plan_nodes))
            .u32("replay_steps", |d| d.count(|d| d.replay_steps))
            .u8("transfer", |d| {
                u8::from(d.detail.as_ref().is_some_and(|d| d.mode == Mode::Transfer))
            })
            .f64("d_q", |d| d.numbers(|d| [d.d_q.unwrap_or(f64::NAN)]))
            .f64("d_o", |d| d.numbers(|d| [d.d_o.unwrap_or(f64::NAN)]))
            .f64("predicted_coverage", |d| d.numbers(|d| [d.predicted_coverage]))
            .f64("delta", |d| d.numbers(|d| pose(d.delta)))
            .f64("set_point", |d| d.numbers(|d| point(d.set_point)))
            .f32("object", |d| d.core.query_object.map_or([f64::NAN; 3], pose))
            .f32("predicted", |d| d.numbers(|d| pose(d.predicted_object)))
            .u32("path_length", |d| d.path().count() as u32)
            .f32s("path", |d| d.path().flatten())
            .list("plan", word(|d| &d.plan))
            .list("selector", word(|d| &d.selector))
    }

    fn pack_more<'a>(pack: Pack<'a, Self>, _: &Rollouts<Self>, curve: &Curve) -> Pack<'a, Self> {
        // gym-pusht renders the inner edges of the walls 5 px inside the workspace.
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

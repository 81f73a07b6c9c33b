//! Tables of rollouts: the columns that all policies and tasks share, and the columns of each domain.

use nalgebra::{Isometry3, Vector3};
use re4_artifact::{Label, Row, SixAxis, TableSpec, Word, columns, table};
use re4_geometry::{Point2, Pose2};

use crate::{ArmState, Displaced, Domain, Phase, Plane, Rollout, Space, SpaceFirst, StepRecord};

impl Word for Phase {
    const ALL: &'static [Self] = &[Self::Plan, Self::Bridge, Self::Replay, Self::Home];

    fn word(self) -> &'static str {
        self.as_str()
    }
}

columns! {
    /// Result of a rollout: the columns of all domains.
    #[derive(Copy)]
    pub struct ResultCore {
        /// Number of the rollout, from 0.
        pub episode: u32,
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Whether the task succeeded. Success ends the rollout.
        pub success: bool,
        /// Number of control steps taken.
        pub steps: u32,
        /// Number of decisions.
        pub decisions: u32,
        /// Number of images rendered for the policy or for the pose estimator. Null in older artifacts.
        #[since = 3]
        pub images: Option<u32>,
    }
}

table! {
    /// One row per rollout of Push-T: its initial scene and its result. Coverage is the fraction of the goal area that the block
    /// covers, IoU is the intersection over union of block and goal, and the score is coverage / 0.95, clipped to 1. Sorted by
    /// episode.
    #[table("results", version = 3)]
    pub struct PlaneResultRow {
        /// Result of the rollout.
        #[prefix = ""]
        pub core: ResultCore,
        /// Position of the pusher's centre after the reset.
        #[frame = "world"]
        #[formerly = "agent"]
        pub eef: Point2,
        /// Pose of the block after the reset.
        #[frame = "world"]
        #[formerly = "block"]
        pub object: Pose2,
        /// Contact points per physics step of the reset, rounded up.
        pub contacts: f64,
        /// Maximum coverage over the steps.
        pub coverage_max: f64,
        /// Maximum IoU over the steps.
        pub iou_max: f64,
        /// Maximum score over the steps.
        pub score_max: f64,
        /// Coverage after the last step.
        pub coverage_final: f64,
    }
}

table! {
    /// One row per rollout of a robosuite task. Sorted by episode.
    #[table("results", version = 3, formerly = "spatial_results")]
    pub struct SpaceResultRow {
        /// Result of the rollout.
        #[prefix = ""]
        pub core: ResultCore,
        /// Position of the grip site after the reset.
        #[frame = "world"]
        pub eef: Vector3<f64>,
        /// Pose of the object after the reset.
        #[frame = "world"]
        pub object: Isometry3<f64>,
        /// Flattened MuJoCo state after the reset: time, qpos, qvel.
        pub state: Vec<f64>,
    }
}

columns! {
    /// The rollout and decision that a step belongs to, and the observations that the policy requested before it.
    #[derive(Copy)]
    pub struct StepCore {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the control step in its rollout, from 0.
        pub step: u32,
        /// Number of the decision in the rollout that the action belongs to.
        pub decision: u32,
        /// Phase of the action: plan (planar tasks) or bridge (SE(3)) moves to the start of a chunk, replay executes a chunk, and
        /// home returns to the initial pose.
        pub phase: Phase,
        /// Whether the policy requested the object pose. Null in older artifacts.
        #[since = 3]
        pub asked_object: Option<bool>,
        /// Number of images rendered for the policy or for the pose estimator. Null in older artifacts.
        #[since = 3]
        pub asked_images: Option<u32>,
    }
}

table! {
    /// One row per control step of a rollout of Push-T: the executed action and the state after it. Sorted by seed and step.
    #[table("steps", version = 3)]
    pub struct PlaneStepRow {
        /// Rollout, decision and requested observations.
        #[prefix = ""]
        pub core: StepCore,
        /// Target position sent to the pusher.
        #[frame = "world"]
        pub action: Point2,
        /// Position of the pusher's centre after the step.
        #[frame = "world"]
        pub eef: Point2,
        /// Pose of the block after the step.
        #[frame = "world"]
        pub object: Pose2,
        /// Contact points per physics step, rounded up.
        pub contacts: f64,
        /// Coverage after the step.
        pub coverage: f64,
        /// IoU after the step.
        pub iou: f64,
        /// Score after the step.
        pub score: f64,
        /// Object pose on which the policy based the action: the observed pose or, if it did not request one, the pose that it
        /// assumed. Null if it used no pose, and in older artifacts if the pose was the recorded one.
        #[frame = "world"]
        #[since = 2]
        #[formerly = "observed_object"]
        pub seen: Option<Pose2>,
        /// Confidence of the pose estimate. Null if the pose was not estimated.
        #[since = 2]
        pub pose_confidence: Option<f64>,
        /// Flag of the pose estimate. If the flag is not clear, the policy receives the last clear pose instead, if there is one.
        #[since = 2]
        pub pose_flag: Option<Label>,
    }
}

table! {
    /// One row per control step of a rollout of a robosuite task: the absolute action, the state after it, and the decision that
    /// it belongs to. As in robosuite, poses after a step are those 2 ms before its end. Rollouts are in the order of table
    /// results, and steps are sorted by number.
    #[table("steps", version = 3, formerly = "spatial_steps")]
    pub struct SpaceStepRow {
        /// Rollout, decision and requested observations.
        #[prefix = ""]
        pub core: StepCore,
        /// Goal pose of the grip site.
        #[frame = "world"]
        pub action: SixAxis,
        /// Gripper command: below 0 opens, above 0 closes.
        pub gripper: f64,
        /// Pose of the grip site after the step.
        #[frame = "world"]
        pub eef: Isometry3<f64>,
        /// Pose of the object after the step.
        #[frame = "world"]
        pub object: Isometry3<f64>,
        /// Joint positions of the fingers after the step.
        #[unit = "m"]
        pub finger: [f64; 2],
        /// Whether the task succeeds after the step.
        pub success: bool,
        /// Object pose on which the policy based the action: the observed pose, including the errors that the pipeline simulates,
        /// or, if it did not request one, the last pose, assumed fixed in the world or in the gripper. Null if it used no pose.
        #[frame = "world"]
        pub seen: Option<Isometry3<f64>>,
    }
}

columns! {
    /// A decision of a policy: the columns of all domains.
    pub struct DecisionCore {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Number of control steps taken before the decision.
        pub step: u32,
        /// Kind of decision, such as retrieve. Every policy defines its own kinds. Null in older artifacts of Push-T.
        #[since = 3]
        pub kind: Option<Label>,
        /// Number of the demonstration that the policy follows: its episode in the index. Column demo_name has its name
        /// in the source. Null if the policy follows none.
        pub demo: Option<u32>,
        /// First frame of the part of the demonstration that the policy follows.
        pub demo_frame: Option<u32>,
        /// Last frame of this part, included.
        pub demo_end: Option<u32>,
        /// Reason for the decision in words.
        pub reason: String,
        /// Name of the demonstration in its source: for an HDF5 file, the group below /data, such as demo_12; for Push-T, the
        /// word episode and its number. Null in older artifacts.
        #[since = 2]
        pub demo_name: Option<String>,
    }
}

table! {
    /// One row per decision of a policy of Push-T: the observed state and the demonstration that the policy follows. A table of
    /// the policy, such as decisions_re4, has the policy-specific columns in the same row order. Sorted by seed and decision.
    #[table("decisions", version = 3)]
    pub struct PlaneDecisionRow {
        /// Shared columns of a decision.
        #[prefix = ""]
        pub core: DecisionCore,
        /// Position of the pusher's centre at the decision.
        #[frame = "world"]
        pub query_eef: Point2,
        /// Object pose on which the decision is based. Null if it uses no pose.
        #[frame = "world"]
        pub query_object: Option<Pose2>,
    }
}

table! {
    /// One row per decision of a policy of a robosuite task: the observed state and the demonstration that the policy follows. A
    /// table of the policy, such as decisions_re4, has the policy-specific columns in the same row order. Rollouts are in the
    /// order of table results, and decisions are sorted by number.
    #[table("decisions", version = 3, formerly = "spatial_decisions")]
    pub struct SpaceDecisionRow {
        /// Shared columns of a decision.
        #[prefix = ""]
        pub core: DecisionCore,
        /// Pose of the grip site at the decision.
        #[frame = "world"]
        pub query_eef: Isometry3<f64>,
        /// Object pose on which the decision is based, after filtering if the policy filters poses. Null if it uses no pose.
        #[frame = "world"]
        pub query_object: Option<Isometry3<f64>>,
    }
}

table! {
    /// One row per rollout of Push-T with a goal or a disturbance of its own: where the goal is, and what was disturbed. The table
    /// exists only if the pipeline sets rollout.goal or rollout.disturbance. Sorted like table results.
    #[table("worlds", version = 1)]
    #[derive(Copy)]
    pub struct PlaneWorldRow {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Goal pose of the block.
        #[frame = "world"]
        pub goal: Pose2,
        /// Number of control steps taken before the disturbance. Null if there was none.
        pub disturbance_step: Option<u32>,
        /// What the disturbance moved: object or pusher.
        pub disturbed: Option<Displaced>,
        /// Translation of the block's centre of gravity or of the pusher, and rotation of the block about it.
        #[frame = "world"]
        pub displacement: Option<Pose2>,
    }
}

table! {
    /// One row per rollout of a robosuite task: what was disturbed. The table exists only if the pipeline sets
    /// rollout.disturbance. Sorted like table results.
    #[table("worlds", version = 1)]
    #[derive(Copy)]
    pub struct SpaceWorldRow {
        /// Seed of the scene.
        pub seed: u32,
        /// Number of control steps taken before the disturbance. Null if there was none.
        pub disturbance_step: Option<u32>,
        /// What the disturbance moved: object.
        pub disturbed: Option<Displaced>,
        /// Translation of the object.
        #[frame = "world"]
        pub displacement: Option<Vector3<f64>>,
        /// Rotation of the object about the vertical axis.
        #[unit = "rad"]
        pub rotation: Option<f64>,
    }
}

/// Returns the tables that this module declares.
pub fn tables() -> [&'static TableSpec; 8] {
    [
        PlaneResultRow::table(),
        PlaneStepRow::table(),
        PlaneDecisionRow::table(),
        SpaceResultRow::table(),
        SpaceStepRow::table(),
        SpaceDecisionRow::table(),
        PlaneWorldRow::table(),
        SpaceWorldRow::table(),
    ]
}

/// A domain with its result, step and decision tables.
pub trait Recorded: Domain {
    /// Row type of table `results`.
    type ResultRow: Row;
    /// Row type of table `steps`.
    type StepRow: Row;
    /// Row type of table `decisions`.
    type DecisionRow: Row;
    /// Row type of table `worlds`.
    type WorldRow: Row;

    /// Builds the row of a rollout.
    fn result_row<X>(core: ResultCore, rollout: &Rollout<Self, X>) -> Self::ResultRow;

    /// The score of a rollout, from 0 to 1: for Push-T the maximum score over its steps, for robosuite tasks 1 if it succeeded.
    fn score<X>(rollout: &Rollout<Self, X>) -> f64;

    /// Horizontal position of the object after the reset, world frame, px or m.
    fn start(first: &Self::First) -> [f64; 2];

    /// Builds the row of table `worlds`.
    fn world_row<X>(rollout: &Rollout<Self, X>) -> Self::WorldRow;

    /// Builds the row of a step.
    fn step_row(core: StepCore, step: &StepRecord<Self>) -> Self::StepRow;

    /// Builds the row of a decision.
    fn decision_row(core: DecisionCore, proprio: &Self::Proprio, object: Option<Self::Pose>) -> Self::DecisionRow;
}

impl Recorded for Plane {
    type ResultRow = PlaneResultRow;
    type StepRow = PlaneStepRow;
    type DecisionRow = PlaneDecisionRow;
    type WorldRow = PlaneWorldRow;

    fn result_row<X>(core: ResultCore, rollout: &Rollout<Self, X>) -> PlaneResultRow {
        let first = &rollout.first;
        PlaneResultRow {
            core,
            eef: first.observation.agent,
            object: first.observation.block,
            contacts: f64::from(first.contacts),
            coverage_max: rollout.maximum(|step| step.coverage),
            iou_max: rollout.maximum(|step| step.iou),
            score_max: rollout.maximum(|step| step.score),
            coverage_final: rollout.steps.last().map_or(first.coverage, |step| step.after.coverage),
        }
    }

    fn score<X>(rollout: &Rollout<Self, X>) -> f64 {
        rollout.maximum(|step| step.score)
    }

    fn start(first: &Self::First) -> [f64; 2] {
        [first.observation.block.x, first.observation.block.y]
    }

    fn world_row<X>(rollout: &Rollout<Self, X>) -> PlaneWorldRow {
        let disturbance = rollout.disturbance;
        PlaneWorldRow {
            seed: rollout.start.seed,
            goal: rollout.start.scene.goal,
            disturbance_step: disturbance.map(|applied| applied.step),
            disturbed: disturbance.map(|applied| applied.displacement.what),
            displacement: disturbance.map(|applied| applied.displacement.motion),
        }
    }

    fn step_row(core: StepCore, step: &StepRecord<Self>) -> PlaneStepRow {
        let after = &step.after;
        PlaneStepRow {
            core,
            action: step.action,
            eef: after.observation.agent,
            object: after.observation.block,
            contacts: f64::from(after.contacts),
            coverage: after.coverage,
            iou: after.iou,
            score: after.score,
            seen: step.seen,
            pose_confidence: step.asked.object.and_then(|observed| observed.confidence),
            pose_flag: step.asked.object.and_then(|observed| observed.flag).map(Label::from),
        }
    }

    fn decision_row(core: DecisionCore, proprio: &Point2, object: Option<Pose2>) -> PlaneDecisionRow {
        PlaneDecisionRow {
            core,
            query_eef: *proprio,
            query_object: object,
        }
    }
}

impl Recorded for Space {
    type ResultRow = SpaceResultRow;
    type StepRow = SpaceStepRow;
    type DecisionRow = SpaceDecisionRow;
    type WorldRow = SpaceWorldRow;

    fn result_row<X>(core: ResultCore, rollout: &Rollout<Self, X>) -> SpaceResultRow {
        SpaceResultRow {
            core,
            eef: rollout.first.observation.grip_site.translation.vector,
            object: rollout.first.observation.object,
            state: rollout.first.state.clone(),
        }
    }

    fn score<X>(rollout: &Rollout<Self, X>) -> f64 {
        f64::from(u8::from(rollout.success()))
    }

    fn start(first: &SpaceFirst) -> [f64; 2] {
        let at = first.observation.object.translation;
        [at.x, at.y]
    }

    fn world_row<X>(rollout: &Rollout<Self, X>) -> SpaceWorldRow {
        let disturbance = rollout.disturbance;
        let motion = disturbance.map(|applied| applied.displacement.motion);
        SpaceWorldRow {
            seed: rollout.start.seed,
            disturbance_step: disturbance.map(|applied| applied.step),
            disturbed: disturbance.map(|applied| applied.displacement.what),
            displacement: motion.map(|motion| Vector3::new(motion.x, motion.y, 0.0)),
            rotation: motion.map(|motion| motion.theta),
        }
    }

    fn step_row(core: StepCore, step: &StepRecord<Self>) -> SpaceStepRow {
        let after = &step.after.observation;
        SpaceStepRow {
            core,
            action: SixAxis::from(&step.action.goal),
            gripper: step.action.gripper,
            eef: after.grip_site,
            object: after.object,
            finger: after.fingers,
            success: step.after.success,
            seen: step.seen,
        }
    }

    fn decision_row(core: DecisionCore, proprio: &ArmState, object: Option<Isometry3<f64>>) -> SpaceDecisionRow {
        SpaceDecisionRow {
            core,
            query_eef: proprio.eef,
            query_object: object,
        }
    }
}

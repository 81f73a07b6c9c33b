//! What is written of rollouts: the columns that every policy and task share, and those of a domain.

use nalgebra::{Isometry3, Vector3};
use re4_artifact::{Label, Row, SixAxis, TableSpec, Word, columns, table};
use re4_geometry::{Point2, Pose2};

use crate::{ArmState, Domain, Phase, Plane, Rollout, Space, StepRecord};

impl Word for Phase {
    const ALL: &'static [Self] = &[Self::Plan, Self::Bridge, Self::Replay, Self::Home];

    fn word(self) -> &'static str {
        self.as_str()
    }
}

columns! {
    /// How a rollout went, in every domain.
    #[derive(Copy)]
    pub struct ResultCore {
        /// Number of the rollout, from 0.
        pub episode: u32,
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Whether the task's success rule held after some control step, which ends the rollout.
        pub success: bool,
        /// Control steps taken.
        pub steps: u32,
        /// Decisions taken.
        pub decisions: u32,
        /// Images rendered for the policy, or for the estimator of the object's pose; null in older artifacts.
        #[since = 3]
        pub images: Option<u32>,
    }
}

table! {
    /// One row a rollout of Push-T: its scene and its outcome. Coverage is the part of the goal area that the block covers, IoU
    /// is intersection over union of the two, the score is coverage over 0.95, at most 1. Sorted by episode.
    #[table("results", version = 3)]
    pub struct PlaneResultRow {
        /// How it went.
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
        /// Maximum coverage after a step.
        pub coverage_max: f64,
        /// Maximum IoU after a step.
        pub iou_max: f64,
        /// Maximum score after a step.
        pub score_max: f64,
        /// Coverage after the last step.
        pub coverage_final: f64,
    }
}

table! {
    /// One row a rollout of a robosuite task. Sorted by episode.
    #[table("results", version = 3, formerly = "spatial_results")]
    pub struct SpaceResultRow {
        /// How it went.
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
    /// What a step belongs to, and what the policy asked for before it.
    #[derive(Copy)]
    pub struct StepCore {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the control step in its rollout, from 0.
        pub step: u32,
        /// Number of the decision, in the rollout, that the action belongs to.
        pub decision: u32,
        /// What the action is part of: plan or bridge, on the way to the start of a chunk; replay, a chunk; home, the way back.
        pub phase: Phase,
        /// Whether the policy asked where the object is; null in older artifacts.
        #[since = 3]
        pub asked_object: Option<bool>,
        /// Images rendered for the policy, or for the estimator of the object's pose; null in older artifacts.
        #[since = 3]
        pub asked_images: Option<u32>,
    }
}

table! {
    /// One row a control step of a rollout of Push-T: the action executed and the state that it led to. Sorted by seed and step.
    #[table("steps", version = 3)]
    pub struct PlaneStepRow {
        /// What it belongs to.
        #[prefix = ""]
        pub core: StepCore,
        /// Target sent to the pusher.
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
        /// Pose of the block that the policy was told before the action, or else went by; null where it went by none, and in
        /// older artifacts where it was the recorded one.
        #[frame = "world"]
        #[since = 2]
        #[formerly = "observed_object"]
        pub seen: Option<Pose2>,
        /// Confidence of the estimate behind it; null where the pose was recorded.
        #[since = 2]
        pub pose_confidence: Option<f64>,
        /// Flag of that estimate. A pose that is not clear was not told on: the last clear one was.
        #[since = 2]
        pub pose_flag: Option<Label>,
    }
}

table! {
    /// One row a control step of a rollout of a robosuite task: the absolute action, what it led to, and the decision that it
    /// follows from. As in robosuite, poses after a step are those of 2 ms before its end. Sorted by seed, as in table results,
    /// and step.
    #[table("steps", version = 3, formerly = "spatial_steps")]
    pub struct SpaceStepRow {
        /// What it belongs to.
        #[prefix = ""]
        pub core: StepCore,
        /// Goal of the grip site.
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
        /// Whether the success rule holds after the step.
        pub success: bool,
        /// Pose of the object that the policy was told before the action, with the errors that the pipeline asks for, or else
        /// went by: the last one, at rest in the world or in the gripper. Null where it went by none.
        #[frame = "world"]
        pub seen: Option<Isometry3<f64>>,
    }
}

columns! {
    /// What a policy decided, in every domain.
    pub struct DecisionCore {
        /// Seed of the scene, or its number in the table scenes.
        pub seed: u32,
        /// Number of the decision in its rollout, from 0.
        pub decision: u32,
        /// Control steps taken before it.
        pub step: u32,
        /// What was decided, in the policy's words, such as retrieve; null in older artifacts of Push-T.
        #[since = 3]
        pub kind: Option<Label>,
        /// Demonstration that is followed: its episode in the index, which is its place there; demo_name says what it is in the
        /// source. Null where none is.
        pub demo: Option<u32>,
        /// First frame of it.
        pub demo_frame: Option<u32>,
        /// Last frame of it, included.
        pub demo_end: Option<u32>,
        /// The decision in words.
        pub reason: String,
        /// Name of the demonstration in its source: the group below /data of an HDF5 file, such as demo_12; of Push-T the word
        /// episode and its number. Null in older artifacts.
        #[since = 2]
        pub demo_name: Option<String>,
    }
}

table! {
    /// One row a decision of a policy of Push-T: what it saw, and what it follows. What is particular to a policy is in a table
    /// of its own, such as decisions_re4, row by row. Sorted by seed and decision.
    #[table("decisions", version = 3)]
    pub struct PlaneDecisionRow {
        /// What was decided.
        #[prefix = ""]
        pub core: DecisionCore,
        /// Pusher's centre at the decision.
        #[frame = "world"]
        pub query_eef: Point2,
        /// Pose of the block that the decision goes by; null where it goes by none.
        #[frame = "world"]
        pub query_object: Option<Pose2>,
    }
}

table! {
    /// One row a decision of a policy of a robosuite task: what it saw, and what it follows. What is particular to a policy is in
    /// a table of its own, such as decisions_re4, row by row. Sorted by seed, as in table results, and decision.
    #[table("decisions", version = 3, formerly = "spatial_decisions")]
    pub struct SpaceDecisionRow {
        /// What was decided.
        #[prefix = ""]
        pub core: DecisionCore,
        /// Grip site at the decision.
        #[frame = "world"]
        pub query_eef: Isometry3<f64>,
        /// Pose of the object that the decision goes by, averaged where the policy averages; null where it goes by none.
        #[frame = "world"]
        pub query_object: Option<Isometry3<f64>>,
    }
}

/// The tables that are declared here.
pub fn tables() -> [&'static TableSpec; 6] {
    [
        PlaneResultRow::table(),
        PlaneStepRow::table(),
        PlaneDecisionRow::table(),
        SpaceResultRow::table(),
        SpaceStepRow::table(),
        SpaceDecisionRow::table(),
    ]
}

/// A domain with its tables.
pub trait Recorded: Domain {
    /// Row of table `results`.
    type ResultRow: Row;
    /// Row of table `steps`.
    type StepRow: Row;
    /// Row of table `decisions`.
    type DecisionRow: Row;

    /// The row of a rollout.
    fn result_row<X>(core: ResultCore, rollout: &Rollout<Self, X>) -> Self::ResultRow;

    /// The row of a step.
    fn step_row(core: StepCore, step: &StepRecord<Self>) -> Self::StepRow;

    /// The row of a decision.
    fn decision_row(core: DecisionCore, proprio: &Self::Proprio, object: Option<Self::Pose>) -> Self::DecisionRow;
}

impl Recorded for Plane {
    type ResultRow = PlaneResultRow;
    type StepRow = PlaneStepRow;
    type DecisionRow = PlaneDecisionRow;

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
            pose_confidence: step.asked.object.and_then(|told| told.confidence),
            pose_flag: step.asked.object.and_then(|told| told.flag).map(Label::from),
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

    fn result_row<X>(core: ResultCore, rollout: &Rollout<Self, X>) -> SpaceResultRow {
        SpaceResultRow {
            core,
            eef: rollout.first.observation.grip_site.translation.vector,
            object: rollout.first.observation.object,
            state: rollout.first.state.clone(),
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

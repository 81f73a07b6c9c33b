//! The types of observations, actions and outcomes of planar tasks and of tasks in SE(3).

use std::fmt::Debug;

use nalgebra::Isometry3;
use re4_geometry::{Point2, Pose2};
use re4_sim::robosuite::{self, Placement, RobosuiteAction, RobosuiteObservation, RobosuiteStep};
use re4_sim::{PushTObservation, ResetOrder, Scene, Step};

/// The types that a group of tasks shares.
pub trait Domain: Debug + Clone + Copy + PartialEq + Send + Sync + 'static {
    /// Proprioception, which is available without an image.
    type Proprio: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// Pose of the manipulated object in the world frame.
    type Pose: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// Action of a policy.
    type Action: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// Result of one control step.
    type Outcome: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// Initial scene of an episode.
    type Scene: Debug + Clone + PartialEq + Send + Sync;
    /// State after the reset, as it is recorded in table `results`.
    type First: Debug + Clone + PartialEq + Send + Sync;

    /// Returns whether the task succeeded, which ends the episode.
    fn success(outcome: &Self::Outcome) -> bool;
}

/// The domain of Push-T, in which a disc pushes a block in the plane. World frame, pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plane;

/// Initial state of a Push-T episode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneScene {
    /// Requested state.
    pub state: Scene,
    /// Order in which the reset sets the position and the angle of the block.
    pub order: ResetOrder,
}

impl Domain for Plane {
    /// Position of the pusher's centre in px.
    type Proprio = Point2;
    type Pose = Pose2;
    /// Absolute target position of the pusher in px.
    type Action = Point2;
    type Outcome = Step<PushTObservation>;
    type Scene = PlaneScene;
    type First = Step<PushTObservation>;

    fn success(outcome: &Self::Outcome) -> bool {
        outcome.success
    }
}

/// The domain of the robosuite tasks: an arm with a two-finger gripper and one object in SE(3). World frame, metres and radians;
/// the end-effector pose is always that of the grip site.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space;

/// Proprioception of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmState {
    /// Pose of the grip site in the world frame.
    pub eef: Isometry3<f64>,
    /// Joint positions of the two fingers in metres, with opposite signs.
    pub fingers: [f64; 2],
}

impl ArmState {
    /// Returns the distance between the fingers in metres.
    pub fn finger_separation(&self) -> f64 {
        (self.fingers[0] - self.fingers[1]).abs()
    }
}

impl From<&RobosuiteObservation> for ArmState {
    fn from(observation: &RobosuiteObservation) -> Self {
        Self {
            eef: observation.grip_site,
            fingers: observation.fingers,
        }
    }
}

/// Action of an arm with a gripper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmAction {
    /// Absolute goal pose of the grip site in the world frame.
    pub goal: Isometry3<f64>,
    /// Gripper command, of which only the sign matters: below 0 opens, above 0 closes, 0 leaves the gripper as it is.
    pub gripper: f64,
}

/// Converts an action to the form that robosuite's controller takes: the absolute goal of the grip site as position and rotation
/// vector.
pub fn robosuite_action(action: &ArmAction) -> RobosuiteAction {
    let (t, r) = (action.goal.translation.vector, action.goal.rotation.scaled_axis());
    RobosuiteAction {
        arm: robosuite::ArmAction::Absolute([t.x, t.y, t.z, r.x, r.y, r.z]),
        gripper: action.gripper,
    }
}

/// State of a robosuite task after the reset.
#[derive(Debug, Clone, PartialEq)]
pub struct SpaceFirst {
    /// The observation.
    pub observation: RobosuiteObservation,
    /// Flattened MuJoCo state: time, qpos, qvel.
    pub state: Vec<f64>,
}

impl Domain for Space {
    type Proprio = ArmState;
    type Pose = Isometry3<f64>;
    type Action = ArmAction;
    type Outcome = RobosuiteStep;
    type Scene = Placement;
    type First = SpaceFirst;

    fn success(outcome: &Self::Outcome) -> bool {
        outcome.success
    }
}

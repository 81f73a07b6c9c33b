//! What is felt, seen, commanded and led to, in the plane and in space.

use std::fmt::Debug;

use nalgebra::Isometry3;
use re4_geometry::{Point2, Pose2};
use re4_sim::robosuite::{self, Placement, RobosuiteAction, RobosuiteObservation, RobosuiteStep};
use re4_sim::{PushTObservation, ResetOrder, Scene, Step};

/// The types of a kind of task.
pub trait Domain: Debug + Clone + Copy + PartialEq + Send + Sync + 'static {
    /// What a policy feels of its own body, without looking.
    type Proprio: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// Pose of the manipulated object, world frame.
    type Pose: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// What a policy commands.
    type Action: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// What one control step led to.
    type Outcome: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// Where an episode starts.
    type Scene: Debug + Clone + PartialEq + Send + Sync;
    /// What is recorded of the state after the reset.
    type First: Debug + Clone + PartialEq + Send + Sync;

    /// Whether the task is done, which ends an episode.
    fn success(outcome: &Self::Outcome) -> bool;
}

/// Push-T: a disc pushes a block in the plane. World frame, pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Plane;

/// A state of Push-T to start from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneScene {
    /// State to ask for.
    pub state: Scene,
    /// In which order the reset sets position and angle.
    pub order: ResetOrder,
}

impl Domain for Plane {
    /// Centre of the pusher.
    type Proprio = Point2;
    type Pose = Pose2;
    /// Absolute target of the pusher.
    type Action = Point2;
    type Outcome = Step<PushTObservation>;
    type Scene = PlaneScene;
    type First = Step<PushTObservation>;

    fn success(outcome: &Self::Outcome) -> bool {
        outcome.success
    }
}

/// An arm with a two-finger gripper and one object: robosuite's tasks. World frame, metres and radians; the end effector is the
/// grip site throughout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Space;

/// What a policy feels of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmState {
    /// Pose of the grip site.
    pub eef: Isometry3<f64>,
    /// Joint positions of the two fingers, of opposite signs.
    pub fingers: [f64; 2],
}

impl ArmState {
    /// Distance between the fingers.
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

/// What a policy commands of an arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmAction {
    /// Absolute goal of the grip site.
    pub goal: Isometry3<f64>,
    /// Gripper command: -1 opens, +1 closes, 0 leaves it as it is.
    pub gripper: f64,
}

/// An action as robosuite's controller takes it: the absolute goal of the grip site.
pub fn robosuite_action(action: &ArmAction) -> RobosuiteAction {
    let (t, r) = (action.goal.translation.vector, action.goal.rotation.scaled_axis());
    RobosuiteAction {
        arm: robosuite::ArmAction::Absolute([t.x, t.y, t.z, r.x, r.y, r.z]),
        gripper: action.gripper,
    }
}

/// A robosuite task after the reset.
#[derive(Debug, Clone, PartialEq)]
pub struct SpaceFirst {
    /// What can be observed of it.
    pub observation: RobosuiteObservation,
    /// Time, coordinates and velocities.
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

//! The types of observations, actions and outcomes of planar tasks and of tasks in SE(3).

use std::fmt::Debug;

use nalgebra::Isometry3;
use re4_geometry::{Point2, Pose2};
use re4_sim::robosuite::{self, Placement, RobosuiteAction, RobosuiteObservation, RobosuiteStep};
use re4_sim::{GOAL, PushTObservation, ResetOrder, Scene, Shapes, Step, WINDOW};

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
    /// Rigid motion from one frame of reference to another.
    type Motion: Debug + Clone + Copy + PartialEq + Send + Sync;
    /// What an image of a state shows.
    type View: Debug + Clone;

    /// Returns whether the task succeeded, which ends the episode.
    fn success(outcome: &Self::Outcome) -> bool;

    /// Returns the motion from the world frame to the frame of a policy's observations and actions, or `None` if that is the
    /// world frame. With another goal than that of the demonstrations, it is the motion that takes the goal of the episode to the
    /// goal of the demonstrations.
    fn observed_from_world(scene: &Self::Scene) -> Option<Self::Motion>;

    /// Returns the inverse motion.
    fn inverse(motion: &Self::Motion) -> Self::Motion;

    /// Returns the proprioception in another frame.
    fn proprio_in(motion: &Self::Motion, proprio: &Self::Proprio) -> Self::Proprio;

    /// Returns the object pose in another frame.
    fn pose_in(motion: &Self::Motion, pose: &Self::Pose) -> Self::Pose;

    /// Returns the action of a policy in the world frame, limited to the actions that the task accepts.
    fn action_in_world(world_from_observed: &Self::Motion, action: &Self::Action) -> Self::Action;
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
    /// Goal pose of the block.
    pub goal: Pose2,
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
    type Motion = Pose2;
    type View = Shapes;

    fn success(outcome: &Self::Outcome) -> bool {
        outcome.success
    }

    fn observed_from_world(scene: &PlaneScene) -> Option<Pose2> {
        (scene.goal != GOAL).then(|| GOAL.compose(scene.goal.inverse()))
    }

    fn inverse(motion: &Pose2) -> Pose2 {
        motion.inverse()
    }

    fn proprio_in(motion: &Pose2, pusher: &Point2) -> Point2 {
        motion.transform_point(*pusher)
    }

    fn pose_in(motion: &Pose2, block: &Pose2) -> Pose2 {
        motion.compose(*block).normalized()
    }

    /// The target is limited to the window, as gym-pusht's space of actions is.
    fn action_in_world(world_from_observed: &Pose2, target: &Point2) -> Point2 {
        world_from_observed
            .transform_point(*target)
            .map(|at| at.clamp(0.0, WINDOW))
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
    type Motion = Isometry3<f64>;
    /// Flattened MuJoCo state: time, qpos, qvel.
    type View = Vec<f64>;

    fn success(outcome: &Self::Outcome) -> bool {
        outcome.success
    }

    /// The goals of robosuite's tasks are fixed.
    fn observed_from_world(_: &Placement) -> Option<Isometry3<f64>> {
        None
    }

    fn inverse(motion: &Isometry3<f64>) -> Isometry3<f64> {
        motion.inverse()
    }

    fn proprio_in(motion: &Isometry3<f64>, arm: &ArmState) -> ArmState {
        ArmState {
            eef: motion * arm.eef,
            ..*arm
        }
    }

    fn pose_in(motion: &Isometry3<f64>, object: &Isometry3<f64>) -> Isometry3<f64> {
        motion * object
    }

    fn action_in_world(world_from_observed: &Isometry3<f64>, action: &ArmAction) -> ArmAction {
        ArmAction {
            goal: world_from_observed * action.goal,
            ..*action
        }
    }
}

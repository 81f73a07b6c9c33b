//! RE4 for an arm with a two-finger gripper and one object, in SE(3): Lift, Can, Square.
//!
//! World frame, metres, radians. The end effector is the *grip site* throughout, in demonstrations, observations and actions:
//! where a dataset records the orientation of the hand's body, the caller turns it into the site's first. Actions are absolute
//! goals of the site and a gripper command, below 0 to open and above 0 to close; bridge and way home count as control steps.
//!
//! The mode of a query is transfer where the last gripper command closed, transit otherwise and before the first command
//! (paper, section "Manipulation Modes": for Robomimic, the sign of the last command).

mod bans;
mod config;
mod decision;
mod demos;
mod estimate;
mod noise;
mod observer;
mod policy;
mod reframe;
mod rollout;

pub use config::{
    BanConfig, EndOfDemo, GraspCheck, Measuring, PoseFilterConfig, SPATIAL_PRESETS, SettleConfig, SpatialConfigError,
    SpatialPolicyConfig, SpatialRecoveryConfig, SpatialReframeConfig, SpatialReplanConfig, SpatialReplayConfig,
    SpatialRetrieveConfig, TransferReplay, WhileHeld,
};
pub use decision::{SpatialChoice, SpatialDecision, SpatialDecisionKind};
pub use demos::{SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge};
pub use estimate::ObjectEstimate;
pub use noise::PoseNoise;
pub use observer::{MakeObserver, ObjectSight, Observer};
pub use policy::SpatialRe4;
pub use reframe::{Carry, reframe_spatial, without_reframe_spatial};
pub use rollout::{
    NoiseLevel, SpatialRollout, SpatialStart, SpatialStepRecord, observe, spatial_rollout, spatial_rollouts,
    to_robosuite,
};

use nalgebra::Isometry3;

use crate::PolicyError;

/// What a policy sees before a control step. World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialObservation {
    /// Pose of the grip site.
    pub eef: Isometry3<f64>,
    /// Pose of the manipulated object, as estimated or recorded.
    pub object: Isometry3<f64>,
    /// Joint positions of the two fingers, of opposite signs.
    pub fingers: [f64; 2],
}

impl SpatialObservation {
    /// Distance between the fingers.
    pub fn finger_separation(&self) -> f64 {
        (self.fingers[0] - self.fingers[1]).abs()
    }
}

/// What a policy feels of its own body before a control step, without looking. World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialBody {
    /// Pose of the grip site.
    pub eef: Isometry3<f64>,
    /// Joint positions of the two fingers, of opposite signs.
    pub fingers: [f64; 2],
}

/// What a policy commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialAction {
    /// Absolute goal of the grip site, world frame, metres.
    pub goal: Isometry3<f64>,
    /// Gripper command: -1 opens, +1 closes, 0 leaves it as it is.
    pub gripper: f64,
}

/// Which part of the loop an action belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SpatialPhase {
    /// On the way to the pose of the episode's beginning, the gripper open.
    Home,
    /// On the way to the start of the chunk (Replan).
    Bridge,
    /// Replaying the chunk.
    Replay,
}

impl SpatialPhase {
    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Home => "home",
            Self::Bridge => "bridge",
            Self::Replay => "replay",
        }
    }
}

/// One action, and why it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialAct {
    /// What to send.
    pub action: SpatialAction,
    /// Part of the loop that the action belongs to.
    pub phase: SpatialPhase,
    /// The decision that the action starts, if it starts one.
    pub decision: Option<SpatialDecision>,
    /// Where the policy takes the object to be at this step, world frame: the pose that it was told, or the average of those,
    /// or, where it was not told any at this step, the last of them, at rest in the world or in the gripper.
    pub object: Isometry3<f64>,
}

/// A policy in the middle of an episode in space.
pub trait SpatialPolicy {
    /// The next action for an observation.
    ///
    /// # Errors
    /// When the policy has no action for it.
    fn act(&mut self, observation: &SpatialObservation) -> Result<SpatialAct, PolicyError>;

    /// The next action, for a policy that is not told where the object is and has to look: `look` gives the object's pose as
    /// far as it can be seen now, world frame. It is called where the policy chooses what to do next, once a step at the most,
    /// and not at other steps.
    ///
    /// # Errors
    /// When the policy has no action, or nothing can be seen.
    fn act_looking(
        &mut self,
        body: &SpatialBody,
        look: &mut dyn FnMut() -> Result<Isometry3<f64>, PolicyError>,
    ) -> Result<SpatialAct, PolicyError>;
}

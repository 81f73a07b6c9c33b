//! RE4 in SE(3) for a robot arm with a two-finger gripper and one object: Lift, Can and Square.
//!
//! Poses are in the world frame, in metres and radians. The end-effector pose is always that of the *grip site*, in
//! demonstrations, observations and actions. If a dataset records the orientation of the hand body instead, the caller must
//! convert it to that of the grip site first. An action consists of an absolute goal pose of the grip site and a gripper command,
//! which is below 0 to open and above 0 to close. The bridge and the return to the home pose count as control steps.
//!
//! The mode of a query is transfer if the last gripper command closed the gripper, and transit otherwise, including before the
//! first command (paper, section "Manipulation Modes": for Robomimic, the sign of the last command).

mod bans;
mod chunk;
mod config;
mod decision;
mod demos;
mod estimate;
mod factory;
mod policy;
mod reframe;
mod retime;

pub use config::{
    BanConfig, EndOfDemo, GraspCheck, Measuring, PoseFilterConfig, RetimeConfig, SettleConfig, SpatialPolicyConfig,
    SpatialRecoveryConfig, SpatialReframeConfig, SpatialReplanConfig, SpatialReplayConfig, SpatialRetrieveConfig,
    TransferReplay, WhileHeld,
};
pub use decision::{SpatialChoice, SpatialDecision, SpatialDecisionKind};
pub use demos::{SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge};
pub use estimate::ObjectEstimate;
pub use factory::SpatialRe4Factory;
pub use policy::SpatialRe4;
pub use reframe::{Carry, reframe_spatial, without_reframe_spatial};

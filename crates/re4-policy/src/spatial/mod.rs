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
mod policy;
mod reframe;

pub use config::{
    BanConfig, EndOfDemo, GraspCheck, Measuring, PoseFilterConfig, SettleConfig, SpatialPolicyConfig,
    SpatialRecoveryConfig, SpatialReframeConfig, SpatialReplanConfig, SpatialReplayConfig, SpatialRetrieveConfig,
    TransferReplay, WhileHeld,
};
pub use decision::{SpatialChoice, SpatialDecision, SpatialDecisionKind};
pub use demos::{SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge};
pub use estimate::ObjectEstimate;
pub use policy::{SpatialRe4, SpatialRe4Factory};
pub use reframe::{Carry, reframe_spatial, without_reframe_spatial};

//! Reframe, Replan, Replay, the rollout loop and the baselines.

mod config;
mod demos;
mod names;
mod open_loop;
mod outcome;
mod path;
mod perception;
mod policy;
mod pusher;
mod reframe;
mod replan;
mod rollout;
pub mod spatial;
mod visibility;

pub use config::{
    PRESETS, Planner, PolicyConfig, ReframeConfig, ReplanConfig, ReplayConfig, RetrieveConfig, Selector, Tracking,
};
pub use demos::DemoSet;
pub use names::DemoNames;
pub use open_loop::{Divergence, OpenLoop, replay_open_loop};
pub use outcome::{Body, Chunk, ChunkLibrary, collect_chunks};
pub use perception::{Observation, Perception, Sight};
pub use policy::{Decision, Knowledge, Phase, Re4};
pub use pusher::{PusherModel, PusherState};
pub use reframe::{Reframed, reframe, without_reframe};
pub use replan::{Obstacle, Plan, PlanKind, plan};

pub use rollout::{EpisodeRollout, RolloutError, Start, StepRecord, rollout, rollouts};

use re4_episode::Mode;
use re4_geometry::Point2;
use thiserror::Error;

/// A policy in the middle of an episode of Push-T.
pub trait Policy {
    /// The next action for an observation.
    ///
    /// # Errors
    /// When the policy has no action for it.
    fn act(&mut self, observation: &Observation) -> Result<Act, PolicyError>;
}

/// One action, and why it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Act {
    /// Absolute target position of the pusher, world frame, pixels.
    pub target: Point2,
    /// Part of the loop that the action belongs to.
    pub phase: Phase,
    /// The decision that the action starts, if it starts one.
    pub decision: Option<Decision>,
}

/// Why a policy cannot act.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// Retrieve failed.
    #[error(transparent)]
    Retrieve(#[from] re4_index::IndexError),
    /// The index knows no frame of the mode that the query is in.
    #[error(
        "cannot retrieve: no indexed frame is in mode {mode}; segment the episodes so that it occurs, or index more of them"
    )]
    NoFrameOfMode {
        /// Mode of the query.
        mode: Mode,
    },
    /// What is retrieved is not among the demonstrations.
    #[error(
        "cannot replay {demo} at frame {frame}: the index names a frame that it does not hold; build the index again"
    )]
    UnknownDemo {
        /// Name of the demonstration that the index names.
        demo: String,
        /// Frame that the index names.
        frame: u32,
    },
    /// The outcome selector has nothing to choose from.
    #[error(
        "cannot retrieve by outcome: no demonstration holds a push that starts with the pusher clear of the object; use the two_stage selector"
    )]
    NoChunks,
    /// The search structure over chunks could not be built.
    #[error("cannot retrieve by outcome: {reason}; check the chunks table of the index artifact")]
    Chunks {
        /// What the tree library reports.
        reason: String,
    },
    /// A policy in space has nobody who tells it where the object is.
    #[error("cannot retrieve: the object's pose is not known, since {reason}")]
    Look {
        /// Why, in words that go on from there.
        reason: String,
    },
    /// A decision gave no command.
    #[error("cannot act: the decision gave no command; report this together with the pipeline file")]
    NothingToDo,
}

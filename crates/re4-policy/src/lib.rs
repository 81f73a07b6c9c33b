//! Reframe, Replan, Replay, and the baselines.

mod artifact;
mod config;
mod demos;
pub mod kinds;
mod open_loop;
mod outcome;
mod path;
mod policy;
mod pusher;
mod reframe;
mod replan;
pub mod spatial;
mod visibility;

pub use artifact::read_scales;
pub use config::{
    Planner, PolicyConfig, ReframeConfig, ReplanConfig, ReplayConfig, RetrieveConfig, Selector, Tracking,
};
pub use demos::DemoSet;
pub use open_loop::{Divergence, OpenLoop, replay_open_loop};
pub use outcome::{Body, Chunk, ChunkLibrary, collect_chunks};
pub use policy::{Decision, Knowledge, Re4, Re4Factory};
pub use pusher::{PusherModel, PusherState};
use re4_fault::Remedy;
pub use reframe::{Reframed, reframe, without_reframe};
pub use replan::{Obstacle, Plan, PlanKind, plan};

pub use re4_episode::DemoNames;

use re4_episode::Mode;
use re4_rollout::PolicyError;
use thiserror::Error;

/// Why a policy that looks demonstrations up has no action.
#[derive(Debug, Error, Remedy)]
pub enum LookupError {
    /// Retrieve failed.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Retrieve(#[from] re4_index::IndexError),
    /// The index knows no frame of the mode that the query is in.
    #[error("cannot retrieve: no indexed frame is in mode {mode}")]
    #[remedy("segment the episodes so that it occurs, or index more of them")]
    NoFrameOfMode {
        /// Mode of the query.
        mode: Mode,
    },
    /// What is retrieved is not among the demonstrations.
    #[error("cannot replay {demo} at frame {frame}: the index names a frame that it does not hold")]
    #[remedy("build the index again")]
    UnknownDemo {
        /// Name of the demonstration that the index names.
        demo: String,
        /// Frame that the index names.
        frame: u32,
    },
    /// The outcome selector has nothing to choose from.
    #[error(
        "cannot retrieve by outcome: no demonstration holds a push that starts with the pusher clear of the object"
    )]
    #[remedy("use the two_stage selector")]
    NoChunks,
    /// The search structure over chunks could not be built.
    #[error("cannot retrieve by outcome: {reason}")]
    #[remedy("check the chunks table of the index artifact")]
    Chunks {
        /// What the tree library reports.
        reason: String,
    },
    /// A decision gave no command.
    #[error("cannot act: the decision gave no command")]
    #[remedy("report this together with the pipeline file")]
    NothingToDo,
}

impl From<LookupError> for PolicyError {
    fn from(error: LookupError) -> Self {
        Self::Own(Box::new(error))
    }
}

//! The policies: RE4 (Retrieve, Reframe, Replan, Replay) in the plane and in SE(3), its presets, and the baselines `nearest`,
//! GPI, VINN and ALT.
//!
//! * [`kinds`] lists the policies that a pipeline file can select. Start there to add a policy.
//! * [`Re4`] is the planar policy for Push-T, with [`PolicyConfig`] as its settings.
//! * [`spatial`] contains the policy for the robosuite tasks in SE(3).
//! * [`replay_open_loop`] replays recorded actions without feedback, to check whether the simulator reproduces a recording.
//!
//! Retrieve itself is in crate `re4-index`, and the rollout harness is in crate `re4-rollout`.

mod artifact;
mod config;
mod decision;
mod demos;
pub mod kinds;
mod lookup;
mod open_loop;
mod outcome;
mod path;
mod policy;
mod pusher;
mod reframe;
mod replan;
pub mod spatial;
mod visibility;
mod workspace;

pub use artifact::read_scales;
pub use config::{
    Planner, PolicyConfig, ReframeConfig, ReplanConfig, ReplayConfig, RetrieveConfig, Selector, Tracking,
};
pub use decision::Decision;
pub use demos::DemoSet;
pub use open_loop::{Divergence, OpenLoop, replay_open_loop};
pub use outcome::{Body, Chunk, ChunkLibrary, collect_chunks};
pub use policy::{Knowledge, Re4, Re4Factory};
pub use pusher::{PusherModel, PusherState};
use re4_fault::Remedy;
pub use reframe::{Reframed, reframe, without_reframe};
pub use replan::{Obstacle, Plan, PlanKind, plan};
pub use workspace::Workspace;

pub use re4_episode::DemoNames;

use re4_episode::Mode;
use re4_rollout::PolicyError;
use thiserror::Error;

/// An error that prevents a policy from retrieving or replaying a demonstration.
#[derive(Debug, Error, Remedy)]
pub enum LookupError {
    /// The index rejected the query.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Retrieve(#[from] re4_index::IndexError),
    /// The index has no frame of the query's mode.
    #[error("cannot retrieve: no indexed frame is in mode {mode}")]
    #[remedy("change the segmentation so that the mode occurs, or index more episodes")]
    NoFrameOfMode {
        /// Mode of the query.
        mode: Mode,
    },
    /// The retrieved frame is not among the demonstrations.
    #[error("cannot replay {demo} from frame {frame}: the demonstration has no such frame")]
    #[remedy("build the index again")]
    UnknownDemo {
        /// Name of the demonstration to which the index refers.
        demo: String,
        /// Number of the frame to which the index refers.
        frame: u32,
    },
    /// The outcome selector has no chunks to select from.
    #[error(
        "cannot retrieve by outcome: no demonstration contains a push that starts with the pusher clear of the object"
    )]
    #[remedy("use the two_stage selector")]
    NoChunks,
    /// The search tree over the chunks could not be built.
    #[error("cannot retrieve by outcome: {reason}")]
    #[remedy("check the chunks table of the index artifact")]
    Chunks {
        /// The error of the tree library.
        reason: String,
    },
    /// The network cannot be applied.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Generative(#[from] re4_generative::GenerativeError),
    /// A decision produced no command.
    #[error("cannot act: the decision produced no command")]
    #[remedy("report this error together with the pipeline file")]
    NothingToDo,
}

impl From<LookupError> for PolicyError {
    fn from(error: LookupError) -> Self {
        Self::Own(Box::new(error))
    }
}

//! An episode to export, of either kind of artifact.

use re4_artifact::columns;
use re4_episode::Mode;

/// An episode: a demonstration or a rollout.
#[derive(Debug, Clone)]
pub struct Take<F> {
    /// Its number in the artifact, from 0.
    pub number: u32,
    /// Name of the demonstration in its source; `seed 500` for a rollout.
    pub name: String,
    /// The rollout, if it is one.
    pub rolled: Option<Rolled>,
    /// The frames: states with the action that follows.
    pub frames: Vec<F>,
}

/// What only rollouts have.
#[derive(Debug, Clone)]
pub struct Rolled {
    /// Seed of the scene.
    pub seed: u32,
    /// Whether the task succeeded.
    pub success: bool,
    /// The decision that each frame's action belongs to.
    pub followed: Vec<Followed>,
}

/// A decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Followed {
    /// Its number in the rollout.
    pub decision: u32,
    /// The demonstration that the policy follows, if it follows one, and the first frame of the part that it follows.
    pub demo: Option<(u32, u32)>,
}

/// Name of the rollout of a seed.
pub(crate) fn seed_name(seed: u32) -> String {
    format!("seed {seed}")
}

columns! {
    /// The columns of table `modes` that are exported.
    pub struct ModeOfFrame {
        /// Number of the demonstration.
        pub episode: u32,
        /// Number of the frame.
        pub frame: u32,
        /// Its mode.
        pub mode: Mode,
    }
}

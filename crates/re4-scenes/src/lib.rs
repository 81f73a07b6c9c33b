//! Chooses evaluation scenes that are far from the demonstrations.
//!
//! The paper's Sparse Observation Experiment (section "Sparse Data Benchmarks") starts Push-T from poses of the block that
//! are as far from every demonstration as the workspace allows. The coverage of a pose `s` is its distance to the nearest
//! frame of all demonstrations,
//!
//! ```text
//! rho(s) = min_i || s - s_i ||,
//! ```
//!
//! over the min-max-normalised `(x, y, theta)` of the block: the `d_o` of Retrieve. The algorithm evaluates a grid over the
//! padded ranges of the demonstrations, greedily chooses the `K` poses with the largest `rho` that keep a separation from each
//! other, and samples `J` positions of the pusher for each of them.
//!
//! Where the paper leaves a choice open, [`ScenesConfig`] has a setting, whose documentation gives the reason for the default.
//! The results are exact and do not depend on the number of threads.

mod config;
mod error;
mod pusher;
mod select;
mod sweep;

pub use config::{SceneKind, ScenesConfig};
pub use error::ScenesError;

use re4_artifact::{columns, table};
use re4_geometry::{Point2, Pose2};

/// The part of a demonstration's frame that scenes need: pixels and radians, world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectFrame {
    /// Episode number of the demonstration.
    pub episode: u32,
    /// Frame number in the demonstration.
    pub frame: u32,
    /// Pose of the block.
    pub object: Pose2,
}

columns! {
    /// A scene, with its distance to the demonstrations.
    #[derive(Copy)]
    pub struct SparseScene {
        /// Number of the block's pose, from 0 for the pose farthest from the demonstrations.
        pub pose: u32,
        /// Number of the pusher's position at this pose, from 0.
        pub pusher: u32,
        /// Position of the pusher's centre.
        #[frame = "world"]
        pub agent: Point2,
        /// Pose of the block, its angle in [0, 2 pi).
        #[frame = "world"]
        pub block: Pose2,
        /// Distance between the block's pose and that of the nearest frame of a demonstration, in normalised coordinates.
        pub rho: f64,
        /// Demonstration of that frame: its episode number in the episodes artifact.
        pub nearest_demo: u32,
        /// Number of that frame in its demonstration.
        pub nearest_frame: u32,
    }
}

table! {
    /// One row per scene in which rollouts start: a pose of the block far from those of all demonstrations, and a position of
    /// the pusher. Sorted by pose and pusher; poses are in descending order of rho.
    #[table("scenes", version = 1)]
    pub struct SceneRow {
        /// Number of the scene in this artifact, from 0.
        pub scene: u32,
        /// The scene and its distance to the demonstrations.
        #[prefix = ""]
        pub chosen: SparseScene,
    }
}

/// Chooses the scenes that `config` describes, sorted by pose and pusher.
///
/// `keep_going` is called once per (x, y) column of the grid; the choice stops when it returns `false`.
///
/// # Errors
/// When there are no frames or one is not finite, when too few poses keep the separation, when a pose leaves no free position
/// for the pusher, or when the caller interrupts the choice.
pub fn sparse_scenes(
    frames: &[ObjectFrame],
    config: &ScenesConfig,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<SparseScene>, ScenesError> {
    let sweep = sweep::Sweep::new(frames, config)?;
    let chosen = select::greedy(sweep.candidates(keep_going)?, &sweep, config)?;
    let mut scenes = Vec::new();
    for (pose, block) in (0..).zip(chosen) {
        let (rho, nearest_demo, nearest_frame) = sweep.nearest(block)?;
        for (pusher, agent) in (0..).zip(pusher::positions(block, pose, config)?) {
            scenes.push(SparseScene {
                pose,
                pusher,
                agent,
                block,
                rho,
                nearest_demo,
                nearest_frame,
            });
        }
    }
    Ok(scenes)
}

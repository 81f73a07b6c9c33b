//! Scenes to evaluate on, chosen by where the demonstrations are not.
//!
//! The paper's Sparse Observation Experiment (section "Sparse Data Benchmarks") starts Push-T from poses of the block that
//! are as far from every demonstration as the workspace allows. The coverage of a pose `s` is the distance to the nearest
//! of all frames of the demonstrations,
//!
//! ```text
//! rho(s) = min_i || s - s_i ||,
//! ```
//!
//! over the min-max-normalised `(x, y, theta)` of the block: the `d_o` of Retrieve. A grid over the ranges of the
//! demonstrations, padded, is swept; `K` poses of maximum `rho` that keep a separation from each other are chosen
//! greedily; `J` places of the pusher are drawn for each of them.
//!
//! Where the paper leaves a choice open, it is a setting of [`ScenesConfig`], which says what was chosen and why.
//! Everything is exact and the same for any number of threads.

mod config;
mod error;
mod pusher;
mod select;
mod sweep;

pub use config::{SceneKind, ScenesConfig};
pub use error::ScenesError;

use re4_artifact::{columns, table};
use re4_geometry::{Point2, Pose2};

/// A frame of a demonstration, as far as scenes need it: pixels and radians, world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectFrame {
    /// Demonstration.
    pub episode: u32,
    /// Frame inside the demonstration.
    pub frame: u32,
    /// Pose of the block.
    pub object: Pose2,
}

columns! {
    /// A scene, and why it was chosen.
    #[derive(Copy)]
    pub struct SparseScene {
        /// Number of the block's pose, from 0 for the one farthest from the demonstrations.
        pub pose: u32,
        /// Number of the pusher's position at this pose, from 0.
        pub pusher: u32,
        /// Position of the pusher's centre.
        #[frame = "world"]
        pub agent: Point2,
        /// Pose of the block, its angle in [0, 2 pi).
        #[frame = "world"]
        pub block: Pose2,
        /// Distance of the block's pose to that of the nearest frame of a demonstration, in normalised coordinates.
        pub rho: f64,
        /// Demonstration of that frame: its episode in the episodes artifact.
        pub nearest_demo: u32,
        /// That frame, in its demonstration.
        pub nearest_frame: u32,
    }
}

table! {
    /// One row a scene that rollouts start from: a pose of the block far from those of all demonstrations, and a place for the
    /// pusher. Sorted by pose and pusher; poses come in falling order of rho.
    #[table("scenes", version = 1)]
    pub struct SceneRow {
        /// Number of the scene in this artifact, from 0.
        pub scene: u32,
        /// The scene.
        #[prefix = ""]
        pub chosen: SparseScene,
    }
}

/// The scenes that `config` asks for, pose after pose.
///
/// `going` is called once a column of the grid and says whether to go on.
///
/// # Errors
/// When there are no frames or one is not finite, when too few poses keep the separation, when a pose leaves no place for
/// the pusher, or when the caller stops.
pub fn sparse_scenes(
    frames: &[ObjectFrame],
    config: &ScenesConfig,
    going: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<SparseScene>, ScenesError> {
    let sweep = sweep::Sweep::new(frames, config)?;
    let chosen = select::greedy(sweep.candidates(going)?, &sweep, config)?;
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

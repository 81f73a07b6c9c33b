//! Errors of the choice of scenes.

use re4_fault::Remedy;
use re4_index::IndexError;
use thiserror::Error;

/// Why scenes cannot be chosen.
#[derive(Debug, Error, PartialEq, Remedy)]
pub enum ScenesError {
    /// The frames of the demonstrations cannot be indexed.
    #[error("cannot choose scenes: {0}")]
    Frames(#[from] IndexError),
    /// The grid has too few poses that are far enough from each other.
    #[error(
        "cannot choose scenes: only {found} of the {wanted} requested poses keep a separation of {separation}, out of {candidates} on the grid"
    )]
    #[remedy("lower scenes.separation or scenes.poses")]
    TooFewPoses {
        /// Number of poses that keep the separation.
        found: u32,
        /// Number of requested poses.
        wanted: u32,
        /// Requested separation.
        separation: f64,
        /// Number of poses on the grid, without those that reach into a wall if `inside_walls` is set.
        candidates: usize,
    },
    /// There is no free position for the pusher.
    #[error(
        "cannot choose scenes: the block at ({x:.1}, {y:.1}) px with angle {theta:.2} rad leaves no free position for the pusher at a clearance of {clearance} px"
    )]
    #[remedy("lower scenes.clearance")]
    NoPosition {
        /// x of the block, px.
        x: f64,
        /// y of the block, px.
        y: f64,
        /// Angle of the block, rad.
        theta: f64,
        /// Requested clearance, px.
        clearance: f64,
    },
    /// The caller interrupted the choice.
    #[error("the choice of scenes was interrupted")]
    #[remedy("no unfinished artifact remains, so run the same command again to continue")]
    Interrupted,
}

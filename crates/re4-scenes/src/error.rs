//! What can go wrong.

use re4_fault::Remedy;
use re4_index::IndexError;
use thiserror::Error;

/// Why scenes could not be chosen.
#[derive(Debug, Error, PartialEq, Remedy)]
pub enum ScenesError {
    /// The frames cannot be searched.
    #[error("cannot choose scenes: {0}")]
    Frames(#[from] IndexError),
    /// The grid has too few poses that are far enough from each other.
    #[error(
        "cannot choose scenes: only {found} of the {wanted} poses asked for keep a separation of {separation}, out of {candidates} on the grid"
    )]
    #[remedy("lower scenes.separation or scenes.poses")]
    TooFewPoses {
        /// Poses that keep the separation.
        found: u32,
        /// Poses asked for.
        wanted: u32,
        /// Separation asked for.
        separation: f64,
        /// Poses on the grid, those that reach into a wall left out if asked for.
        candidates: usize,
    },
    /// There is no free place for the pusher.
    #[error(
        "cannot choose scenes: the block at ({x:.1}, {y:.1}) px, turned by {theta:.2} rad, leaves the pusher no place at a clearance of {clearance} px"
    )]
    #[remedy("lower scenes.clearance")]
    NoPlace {
        /// Position of the block, x.
        x: f64,
        /// Position of the block, y.
        y: f64,
        /// Angle of the block.
        theta: f64,
        /// Clearance asked for.
        clearance: f64,
    },
    /// The caller asked to stop.
    #[error("the choice of scenes was interrupted")]
    #[remedy("nothing was written, run it again")]
    Interrupted,
}

//! Two-stage Retrieve over the states of an arm and an object in space.
//!
//! The lookup is the paper's (section "Retrieve"; appendix "Robomimic" for the distances), exact, with the same ties as in
//! the plane: lowest demonstration, then lowest frame. There is no tolerance on `d_o`: the paper has one for Push-T alone.
//!
//! A tree bounds `d_o` from below. Consecutive frames in which the object hardly moves, such as all those before it is
//! grasped, are one entry of it: a box around the object's positions and a ball around its orientations. Entries are opened in
//! the order of their bounds, the demonstration of each is evaluated exactly, and the search ends when the bounds pass the best
//! answer.

mod linear;
mod metric;
mod search;
mod tree;

pub use linear::retrieve_spatial_linear;
pub use metric::{SpatialDistances, SpatialMetric, Stage2};
pub use search::SpatialIndex;

use nalgebra::Isometry3;
use re4_episode::Mode;

/// A frame of a demonstration as the index stores it: world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexedSpatialFrame {
    /// Demonstration.
    pub episode: u32,
    /// Frame inside the demonstration.
    pub frame: u32,
    /// Manipulation mode at the frame.
    pub mode: Mode,
    /// End-effector pose; in the same frame of the hand as the queries'.
    pub eef: Isometry3<f64>,
    /// Object pose.
    pub object: Isometry3<f64>,
}

/// An object-augmented state to retrieve for: world frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialQuery {
    /// Manipulation mode: only frames of this mode are admissible.
    pub mode: Mode,
    /// End-effector pose.
    pub eef: Isometry3<f64>,
    /// Object pose.
    pub object: Isometry3<f64>,
}

/// The frame that Retrieve chose, with the distances that led to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialRetrieved {
    /// Demonstration.
    pub episode: u32,
    /// Frame inside the demonstration.
    pub frame: u32,
    /// Distances between the query and the frame.
    pub distances: SpatialDistances,
}

//! Two-stage Retrieve in SE(3) over the states of a robot arm and one object.
//!
//! The lookup follows the paper (section "Retrieve"; appendix "Robomimic" for the distances). It is exact and resolves ties as
//! the planar lookup does: lowest demonstration number, then lowest frame number. There is no tolerance on `d_o`, because the
//! paper uses one only for Push-T.
//!
//! A tree gives lower bounds of `d_o`. Consecutive frames in which the object hardly moves, such as all frames before the grasp,
//! form one entry of the tree: a box around the object's positions and a ball around its orientations. The search opens the
//! entries in ascending order of their bounds, evaluates the demonstration of each entry exactly, and ends when the bounds exceed
//! the best answer.

mod linear;
mod metric;
mod search;
mod tree;

pub use linear::retrieve_spatial_linear;
pub use metric::{SpatialDistances, SpatialMetric, Stage2};
pub use search::SpatialIndex;

use nalgebra::Isometry3;
use re4_episode::Mode;

/// A frame of a demonstration as the index stores it, in the world frame, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexedSpatialFrame {
    /// Number of the demonstration.
    pub episode: u32,
    /// Number of the frame in the demonstration.
    pub frame: u32,
    /// Manipulation mode at the frame.
    pub mode: Mode,
    /// End-effector pose. Frames and queries must use the same body frame of the end effector.
    pub eef: Isometry3<f64>,
    /// Object pose.
    pub object: Isometry3<f64>,
}

/// The object-augmented state to retrieve a frame for, in the world frame, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialQuery {
    /// Manipulation mode. Only frames of this mode can be retrieved.
    pub mode: Mode,
    /// End-effector pose.
    pub eef: Isometry3<f64>,
    /// Object pose.
    pub object: Isometry3<f64>,
}

/// The frame that Retrieve selected, with its distances to the query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialRetrieved {
    /// Number of the demonstration.
    pub episode: u32,
    /// Number of the frame in the demonstration.
    pub frame: u32,
    /// Distances between the query and the frame.
    pub distances: SpatialDistances,
}

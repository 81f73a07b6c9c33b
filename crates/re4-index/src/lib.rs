//! Exact two-stage Retrieve over object-augmented states.
//!
//! Retrieve (paper, section "Retrieve") is two nested lookups, with the manipulation mode as a hard filter:
//!
//! 1. in every demonstration, the frame of the query's mode that minimises `d_q`, the distance over the full
//!    object-augmented state, among the frames whose `d_o` is within `epsilon` of that demonstration's minimum `d_o`;
//! 2. among these frames, one a demonstration, the one that minimises `d_o`, the distance over the object's pose alone.
//!
//! Ties go to the lowest demonstration, then to the lowest frame.
//!
//! For Push-T, `d_q` is the Euclidean distance over the min-max-normalised `(eef x, eef y, block x, block y, block θ)`
//! and `d_o` over its last three entries (paper, appendix "Push-T").
//!
//! One nearest neighbour over all frames is *not* the answer, since stage 1 is a minimum per demonstration. A tree over
//! object poses serves as a bound instead: the frame that stage 1 chooses is never nearer by `d_o` than the nearest frame
//! of its demonstration. Stage 1 is evaluated exactly for the demonstration nearest by `d_o`, then for those others that
//! have a frame within the best answer so far.
//!
//! Everything named `Spatial...` is the same lookup for an arm and an object in space: see [`SpatialMetric`] for its distances.

mod linear;
mod metric;
mod search;
mod spatial;
mod tables;
mod tree;

pub use linear::retrieve_linear;
pub use metric::{AngleMetric, Normalization, Range};
use re4_fault::Remedy;
pub use search::{RetrievalIndex, SearchStatistics};
pub use spatial::{
    IndexedSpatialFrame, SpatialDistances, SpatialIndex, SpatialMetric, SpatialQuery, SpatialRetrieved, Stage2,
    retrieve_spatial_linear,
};

pub use tables::{IndexRow, PlanarState, ScaleRow, SpatialState};

use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use thiserror::Error;

/// A frame of a demonstration as the index stores it: world frame, pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexedFrame {
    /// Demonstration.
    pub episode: u32,
    /// Frame inside the demonstration.
    pub frame: u32,
    /// Manipulation mode at the frame.
    pub mode: Mode,
    /// End-effector position.
    pub eef: Point2,
    /// Object pose.
    pub object: Pose2,
}

/// An object-augmented state to retrieve for: world frame, pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Query {
    /// Manipulation mode: only frames of this mode are admissible.
    pub mode: Mode,
    /// End-effector position.
    pub eef: Point2,
    /// Object pose.
    pub object: Pose2,
}

/// The frame that Retrieve chose, with the two distances (normalised, without unit) that led to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Retrieved {
    /// Demonstration.
    pub episode: u32,
    /// Frame inside the demonstration.
    pub frame: u32,
    /// Distance over the full object-augmented state.
    pub d_q: f64,
    /// Distance over the object pose alone.
    pub d_o: f64,
}

/// Why an index could not be built or queried.
#[derive(Debug, Clone, Error, PartialEq, Remedy)]
pub enum IndexError {
    /// There is nothing to retrieve from.
    #[error("cannot build the index: there are no frames")]
    #[remedy("select at least one episode")]
    Empty,
    /// A coordinate is not a finite number, or absurdly far from the ranges it is normalised by.
    #[error("cannot build the index: episode {episode}, frame {frame} has a coordinate that is not finite")]
    #[remedy("repair the episodes artifact")]
    NotFinite {
        /// Demonstration.
        episode: u32,
        /// Frame inside the demonstration.
        frame: u32,
    },
    /// What is wrong with a demonstration whose name is known: [`IndexError::NotFinite`] and [`IndexError::Duplicate`] become this.
    #[error("cannot build the index: frame {frame} of {demo} {problem}")]
    #[remedy("{remedy}")]
    Demonstration {
        /// Name of the demonstration in its source.
        demo: String,
        /// Frame inside the demonstration.
        frame: u32,
        /// What is wrong with it.
        problem: &'static str,
        /// How to fix it.
        remedy: &'static str,
    },
    /// More frames than 32-bit frame numbers reach.
    #[error("cannot build the index: {frames} frames are more than the {limit} that one index holds", limit = u32::MAX)]
    #[remedy("split the dataset")]
    TooLarge {
        /// Number of frames given.
        frames: usize,
    },
    /// Two frames with the same number, of which ties could choose either.
    #[error("cannot build the index: episode {episode} has frame {frame} twice")]
    #[remedy("give every frame once")]
    Duplicate {
        /// Demonstration.
        episode: u32,
        /// Frame inside the demonstration.
        frame: u32,
    },
    /// A scale that nothing can be divided by.
    #[error("cannot build the index: the {name} is {value}")]
    #[remedy("give a finite number above 0")]
    Scale {
        /// Which one, in words.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// A weight that turns a distance around.
    #[error("cannot build the index: the {name} is {value}")]
    #[remedy("give a finite number, 0 or more")]
    Weight {
        /// Which one, in words.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// A symmetry that is none.
    #[error("cannot build the index: {0}")]
    #[remedy(_0.remedy())]
    Symmetry(#[from] re4_geometry::spatial::SymmetryError),
    /// A query coordinate is not a finite number, or absurdly far from the demonstrations.
    #[error("cannot retrieve: the query has a coordinate that is not finite or absurdly far from every demonstration")]
    #[remedy("check the observation it was made from")]
    QueryNotFinite,
}

impl IndexError {
    /// The same error, with the demonstration called what its source calls it, where `name` knows that.
    #[must_use]
    pub fn named(self, name: impl Fn(u32) -> Option<String>) -> Self {
        let (episode, frame, problem, remedy) = match self {
            Self::NotFinite { episode, frame } => (
                episode,
                frame,
                "has a coordinate that is not finite",
                "repair the episodes artifact",
            ),
            Self::Duplicate { episode, frame } => (episode, frame, "is there twice", "give every frame once"),
            _ => return self,
        };
        match name(episode) {
            Some(demo) => Self::Demonstration {
                demo,
                frame,
                problem,
                remedy,
            },
            None => self,
        }
    }
}

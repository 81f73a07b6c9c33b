//! Exact two-stage Retrieve over object-augmented states.
//!
//! Retrieve (paper, section "Retrieve") consists of two nested lookups with the manipulation mode as a hard filter:
//!
//! 1. Stage 1 selects one frame per demonstration: the frame of the query's mode that minimises `d_q`, the distance over the full
//!    object-augmented state, among the frames whose `d_o` is within `epsilon` of the minimum `d_o` of that demonstration.
//! 2. Stage 2 selects one of these frames: the one that minimises `d_o`, the distance over the object pose only.
//!
//! Ties go to the lowest demonstration number, then to the lowest frame number.
//!
//! For Push-T, `d_q` is the Euclidean distance over the min-max-normalised `(eef x, eef y, block x, block y, block θ)`, and `d_o`
//! is the Euclidean distance over the last three of these entries (paper, appendix "Push-T").
//!
//! A nearest-neighbour search over all frames does *not* give this answer because stage 1 takes a minimum per demonstration. A
//! tree over object poses therefore only supplies lower bounds: the `d_o` of the frame that stage 1 selects is never smaller than
//! the minimum `d_o` of its demonstration. Stage 1 is evaluated exactly for the demonstration that is nearest by `d_o`, then for
//! every other demonstration that has a frame within the best `d_o` found so far.
//!
//! [`Partitioned`] gives the same answers over parts that hold some of the demonstrations each.
//!
//! The items named `Spatial...` implement the same lookup in SE(3) for a robot arm and one object. [`SpatialMetric`] defines
//! their distances.

mod linear;
mod metric;
mod partitioned;
mod search;
mod spatial;
mod tables;
mod tree;
pub mod trim;

pub use linear::retrieve_linear;
pub use metric::{AngleMetric, Normalization, Range};
pub use partitioned::{Candidate, Partitioned};
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

/// A frame of a demonstration as the index stores it, in the world frame, in pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexedFrame {
    /// Number of the demonstration.
    pub episode: u32,
    /// Number of the frame in the demonstration.
    pub frame: u32,
    /// Manipulation mode at the frame.
    pub mode: Mode,
    /// End-effector position.
    pub eef: Point2,
    /// Object pose.
    pub object: Pose2,
}

/// The object-augmented state to retrieve a frame for, in the world frame, in pixels and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Query {
    /// Manipulation mode. Only frames of this mode can be retrieved.
    pub mode: Mode,
    /// End-effector position.
    pub eef: Point2,
    /// Object pose.
    pub object: Pose2,
}

/// The frame that Retrieve selected, with its two distances to the query (normalised, dimensionless).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Retrieved {
    /// Number of the demonstration.
    pub episode: u32,
    /// Number of the frame in the demonstration.
    pub frame: u32,
    /// Distance over the full object-augmented state.
    pub d_q: f64,
    /// Distance over the object pose only.
    pub d_o: f64,
}

/// An error from building or querying an index.
#[derive(Debug, Clone, Error, PartialEq, Remedy)]
pub enum IndexError {
    /// No frames were given.
    #[error("cannot build the index: there are no frames")]
    #[remedy("select at least one episode")]
    Empty,
    /// A coordinate is not finite, or so far from the normalisation range that squared distances could overflow.
    #[error("cannot build the index: episode {episode}, frame {frame} has a coordinate that is not finite")]
    #[remedy("repair the episodes artifact")]
    NotFinite {
        /// Number of the demonstration.
        episode: u32,
        /// Number of the frame in the demonstration.
        frame: u32,
    },
    /// A problem in a demonstration whose name is known. [`IndexError::named`] converts [`IndexError::NotFinite`] and
    /// [`IndexError::Duplicate`] to this variant.
    #[error("cannot build the index: frame {frame} of {demo} {problem}")]
    #[remedy("{remedy}")]
    Demonstration {
        /// Name of the demonstration in its source.
        demo: String,
        /// Number of the frame in the demonstration.
        frame: u32,
        /// The problem, as the predicate of a sentence whose subject is the frame.
        problem: &'static str,
        /// How to fix it.
        remedy: &'static str,
    },
    /// There are more frames than 32-bit frame numbers can address.
    #[error("cannot build the index: there are {frames} frames, and one index stores at most {limit}", limit = u32::MAX)]
    #[remedy("split the dataset")]
    TooLarge {
        /// Number of frames given.
        frames: usize,
    },
    /// Two frames of an episode have the same number, so ties would not be resolved uniquely.
    #[error("cannot build the index: episode {episode} contains frame {frame} twice")]
    #[remedy("give every frame once")]
    Duplicate {
        /// Number of the demonstration.
        episode: u32,
        /// Number of the frame in the demonstration.
        frame: u32,
    },
    /// A scale of the metric is not a positive finite number.
    #[error("cannot build the index: the {name} is {value}")]
    #[remedy("give a finite number above 0")]
    Scale {
        /// Name of the scale in words.
        name: &'static str,
        /// The given value.
        value: f64,
    },
    /// A weight of the metric is negative or not finite.
    #[error("cannot build the index: the {name} is {value}")]
    #[remedy("give a finite number, 0 or more")]
    Weight {
        /// Name of the weight in words.
        name: &'static str,
        /// The given value.
        value: f64,
    },
    /// The description of the object's symmetry is invalid.
    #[error("cannot build the index: {0}")]
    #[remedy(_0.remedy())]
    Symmetry(#[from] re4_geometry::spatial::SymmetryError),
    /// A coordinate of the query is not finite, or so far from the demonstrations that squared distances could overflow.
    #[error(
        "cannot retrieve: the query has a coordinate that is not finite or is extremely far from every demonstration"
    )]
    #[remedy("check the observation that the query was made from")]
    QueryNotFinite,
}

impl IndexError {
    /// Replaces the number of the demonstration in the error by its name in the source.
    ///
    /// `name` maps the number of a demonstration to its name. The error stays unchanged if `name` returns `None` or if the error
    /// does not concern one demonstration.
    #[must_use]
    pub fn named(self, name: impl Fn(u32) -> Option<String>) -> Self {
        let (episode, frame, problem, remedy) = match self {
            Self::NotFinite { episode, frame } => (
                episode,
                frame,
                "has a coordinate that is not finite",
                "repair the episodes artifact",
            ),
            Self::Duplicate { episode, frame } => (episode, frame, "occurs twice", "give every frame once"),
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

//! Manipulation modes, segments and the evidence for them. No input or output.
//!
//! The mode of frame t is that of the step from frame t to frame t + 1; the last frame of an episode has the mode of the
//! step that led to it, and the only frame of an episode of one frame is transit.

mod config;
mod error;
mod motion;
mod planar;

pub use config::{ObjectDistance, Rule, SegmentConfig};
pub use error::SegmentError;
pub use motion::{Pair, SpatialPair, StepMotion, rigid_motion_modes};
pub use planar::{Evidence, SegmentFacts, SegmentedEpisode, segment_planar};

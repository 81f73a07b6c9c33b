//! Manipulation modes, segments and the evidence for them. No input or output.
//!
//! By rigid motion, the mode of frame t is that of the step from frame t to frame t + 1; the last frame of an episode has the mode of the
//! step that led to it, and the only frame of an episode of one frame is transit. By the gripper's command, it
//! is what the last command before the frame says, or the one at it.

mod config;
mod error;
mod motion;
mod planar;
mod spatial;
mod tables;

pub use config::{Command, GripperConfig, ObjectDistance, Rule, SegmentConfig};
pub use error::SegmentError;
pub use motion::{Pair, SpatialPair, StepMotion, rigid_motion_modes};
pub use planar::{Evidence, SegmentSummary, SegmentedEpisode, segment_planar};
pub use spatial::{Grasp, SegmentedSpatial, SpatialEvidence, SpatialSegment, segment_spatial};
pub use tables::{ModeRow, SegmentRow, Segmented};

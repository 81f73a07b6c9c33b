//! Manipulation modes, segments and the evidence for them. The crate does no input or output.
//!
//! With [`Rule::RigidMotion`], the mode of frame t is that of the step from frame t to frame t + 1. The last frame of an episode
//! has the mode of the step that led to it; the only frame of an episode of one frame is transit. With [`Rule::GripperCommand`],
//! the mode of a frame follows from the last gripper command before the frame, or from the command at the frame ([`Command`]).
//! [`Rule::Grasp`] and [`Rule::Evidence`] find the frames in which the fingers hold something ([`hold_modes`]).

mod arm;
mod config;
mod error;
mod gripper;
mod hold;
mod motion;
mod planar;
mod spatial;
mod tables;

pub use arm::{ArmEpisode, ArmEvidence, ArmSegment, SegmentedArm, segment_arm};
pub use config::{AnchorAt, Closes, Command, GripperConfig, ObjectDistance, OpeningConfig, Rule, SegmentConfig};
pub use error::SegmentError;
pub use gripper::{Commands, Gripper, GripperObservation, Known, Proof};
pub use hold::{Holding, hold_modes};
pub use motion::{Pair, SpatialPair, StepMotion, rigid_motion_modes};
pub use planar::{Evidence, SegmentSummary, SegmentedEpisode, segment_planar};
pub use spatial::{Grasp, SegmentedSpatial, SpatialEvidence, SpatialSegment, segment_spatial};
pub use tables::{ModeRow, SegmentRow, Segmented};

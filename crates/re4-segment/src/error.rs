//! What can go wrong with segmentation.

use re4_fault::Remedy;

/// Why an episode could not be segmented.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Remedy)]
#[non_exhaustive]
pub enum SegmentError {
    /// A threshold is out of range.
    #[error("cannot segment: segment.{field} is {value}")]
    #[remedy("set it to a finite number {range}")]
    Config {
        /// Name of the threshold.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The range it has to be in.
        range: &'static str,
    },
    /// A rule that asks for a gripper where there is none.
    #[error("cannot segment by the gripper's command: Push-T has no gripper")]
    #[remedy("set segment.rule to always_transit or rigid_motion")]
    NoGripper,
    /// An episode without frames.
    #[error("cannot segment {demo}: it has no frames")]
    #[remedy("leave it out by ingest.select")]
    Empty {
        /// Name of the demonstration in its source.
        demo: String,
    },
    /// A coordinate that is no number.
    #[error("cannot segment {demo}: {column} is {value} at frame {frame}")]
    #[remedy("repair that frame, or leave {demo} out by ingest.select")]
    NotFinite {
        /// Name of the demonstration in its source.
        demo: String,
        /// Frame in the episode, from 0.
        frame: usize,
        /// Name of the coordinate.
        column: &'static str,
        /// Its value.
        value: f64,
    },
}

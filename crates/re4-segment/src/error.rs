//! Errors of the segmentation.

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
        /// The allowed range, as it is named in the remedy.
        range: &'static str,
    },
    /// The configured rule needs a gripper, but Push-T has none.
    #[error("cannot segment by the gripper command: Push-T has no gripper")]
    #[remedy("set segment.rule to always_transit or rigid_motion")]
    NoGripper,
    /// The configured rule needs the pose of the block.
    #[error("cannot segment {demo} by rigid motion: the pose of the block was not recorded")]
    #[remedy("set segment.rule to always_transit")]
    NoObject {
        /// Name of the demonstration in its source.
        demo: String,
    },
    /// Nothing in the dataset states or proves which way the gripper closes.
    #[error("cannot segment by the gripper: which way it closes is not proven by the {what} ({why})")]
    #[remedy(
        "set segment.opening.closes to \"decreasing\" if the number falls when the gripper closes, or to \"increasing\" if it rises"
    )]
    ClosingUnknown {
        /// What was measured, as a part of the sentence.
        what: &'static str,
        /// Why it is not proven.
        why: String,
    },
    /// The dataset has neither an opening nor a command of a gripper.
    #[error("cannot segment by the gripper: the dataset has neither its opening nor a command for it")]
    #[remedy(
        "name the gripper in the table [ingest.arm], for LeRobot datasets [ingest.lerobot], or set segment.rule = \"always_transit\" if the arm has no gripper"
    )]
    NothingOfGripper,
    /// The episode has no frames.
    #[error("cannot segment {demo}: it has no frames")]
    #[remedy("leave it out with ingest.select")]
    Empty {
        /// Name of the demonstration in its source.
        demo: String,
    },
    /// A coordinate is NaN or infinite.
    #[error("cannot segment {demo}: {column} is {value} at frame {frame}")]
    #[remedy("repair that frame, or leave {demo} out with ingest.select")]
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

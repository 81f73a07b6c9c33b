//! Basic types that all stages share: modes, frames, episodes and segments. This crate does no input or output.

mod names;
pub mod pace;
mod spatial;

use std::fmt;
use std::ops::Range;

use re4_geometry::{Point2, Pose2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use names::DemoNames;
pub use spatial::{SpatialEpisode, SpatialFrame};

/// Manipulation mode of a frame (paper, section "Manipulation Modes").
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The end effector moves relative to the object.
    Transit,
    /// The object moves rigidly with the end effector.
    Transfer,
}

impl Mode {
    /// Every mode, in the order of their codes.
    pub const ALL: [Self; 2] = [Self::Transit, Self::Transfer];

    /// Name of the mode in tables and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Transit => "transit",
            Self::Transfer => "transfer",
        }
    }

    /// Returns the mode with this name, as returned by [`Mode::as_str`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.as_str() == name)
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A frame of a planar demonstration: the object-augmented state, the action and other recorded values. World frame, pixels and
/// radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarFrame {
    /// Position of the pusher's centre (the end effector).
    pub eef: Point2,
    /// Pose of the manipulated object; [`Self::UNKNOWN`] if it was not recorded.
    pub object: Pose2,
    /// Absolute target position commanded to the pusher at this frame.
    pub action: Point2,
    /// Number of contact points between pusher and block during the control step before this frame, as counted by the simulator.
    pub contacts: f64,
}

impl PlanarFrame {
    /// The pose of an object whose pose was not recorded.
    pub const UNKNOWN: Pose2 = Pose2 {
        x: f64::NAN,
        y: f64::NAN,
        theta: f64::NAN,
    };

    /// The pose of the manipulated object, if it was recorded.
    #[must_use]
    pub fn known_object(&self) -> Option<Pose2> {
        let pose = self.object;
        let unknown = pose.x.is_nan() && pose.y.is_nan() && pose.theta.is_nan();
        (!unknown).then_some(pose)
    }
}

/// A planar demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarEpisode {
    /// Number of the demonstration in its source dataset.
    pub source: u32,
    /// Frames in temporal order.
    pub frames: Vec<PlanarFrame>,
}

impl PlanarEpisode {
    /// Returns the name of the demonstration in tables, pages and messages: `episode 12`.
    pub fn name(&self) -> String {
        episode_name(self.source)
    }
}

/// Returns the name, in tables, pages and messages, of an episode of a dataset that numbers its episodes and does not name them.
pub fn episode_name(source: u32) -> String {
    format!("episode {source}")
}

/// A maximal range of consecutive frames of one mode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segment {
    /// Mode of every frame in the range.
    pub mode: Mode,
    /// The frames, end exclusive.
    pub frames: Range<usize>,
}

/// Splits a sequence of modes into segments.
pub fn segments(modes: &[Mode]) -> Vec<Segment> {
    let mut runs: Vec<Segment> = Vec::new();
    for (i, &mode) in modes.iter().enumerate() {
        match runs.last_mut() {
            Some(run) if run.mode == mode => run.frames.end = i + 1,
            _ => runs.push(Segment { mode, frames: i..i + 1 }),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_maximal_and_cover_all_frames() {
        use Mode::{Transfer as G, Transit as T};
        let runs = segments(&[T, T, G, T, T, T]);
        assert_eq!(
            runs.iter().map(|s| (s.mode, s.frames.clone())).collect::<Vec<_>>(),
            vec![(T, 0..2), (G, 2..3), (T, 3..6)]
        );
        assert!(segments(&[]).is_empty());
    }

    #[test]
    fn modes_are_parsed_from_their_names() {
        for mode in Mode::ALL {
            assert_eq!(Mode::from_name(mode.as_str()), Some(mode));
        }
        assert_eq!(Mode::from_name("push"), None);
    }
}

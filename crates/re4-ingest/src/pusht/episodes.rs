//! The numeric columns of the selected episodes.

use std::borrow::Cow;
use std::ops::Range;

use re4_episode::{PlanarEpisode, PlanarFrame};
use re4_geometry::{Point2, Pose2};

use crate::tables::KEYPOINTS;

/// The selected episodes, validated, as columns with one entry per frame. Episodes are in the order of the dataset.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PushtEpisodes {
    /// Number of each episode in the source dataset.
    pub sources: Vec<u32>,
    /// Rows of each episode in the dataset's arrays, as in [`super::ImageBlock::frames`].
    pub rows: Vec<Range<usize>>,
    /// Frames of each episode in the columns below, end exclusive.
    pub frames: Vec<Range<usize>>,
    /// `agent_x, agent_y` (pixels), `block_x, block_y` (pixels), `block_theta` (radians, as stored: 0 to 2π).
    pub state: Vec<[f64; 5]>,
    /// Absolute target of the agent, `x, y` (pixels).
    pub action: Vec<[f64; 2]>,
    /// Contact points counted by the simulator in the control step that led to the frame, if recorded.
    pub contacts: Option<Vec<f64>>,
    /// Keypoints of the block in window coordinates, `x, y` each (pixels), if recorded.
    pub keypoint: Option<Vec<[[f64; 2]; KEYPOINTS]>>,
    /// How the dataset records them.
    pub recorded: Recorded,
}

/// How a dataset records its numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    /// What its numbers are stored in: "array" of a zarr store, or "column".
    pub kind: &'static str,
    /// Where the states are.
    pub state: Cow<'static, str>,
    /// Where the actions are.
    pub action: Cow<'static, str>,
    /// Whether the pose of the block is known. If not, `state` has Push-T's goal pose in its place.
    pub block: bool,
    /// Whether the angle of the block is recorded, not computed.
    pub angle: bool,
}

impl Default for Recorded {
    /// A zarr store.
    fn default() -> Self {
        Self {
            kind: "array",
            state: Cow::Borrowed("data/state"),
            action: Cow::Borrowed("data/action"),
            block: true,
            angle: true,
        }
    }
}

impl Recorded {
    /// Whether it is a zarr store.
    pub(crate) fn is_zarr(&self) -> bool {
        self.kind == "array"
    }

    /// Where the states are, in words.
    pub(super) fn states(&self) -> String {
        format!("{} {}", self.kind, self.state)
    }

    /// Where the actions are, in words.
    pub(super) fn actions(&self) -> String {
        format!("{} {}", self.kind, self.action)
    }
}

impl PushtEpisodes {
    /// Number of episodes.
    pub fn episode_count(&self) -> usize {
        self.sources.len()
    }

    /// Number of frames over all episodes.
    pub fn frame_count(&self) -> usize {
        self.state.len()
    }

    /// Agent position of a frame.
    pub fn agent(&self, frame: usize) -> Point2 {
        Point2::new(self.state[frame][0], self.state[frame][1])
    }

    /// Block pose of a frame, angle as stored.
    pub fn block(&self, frame: usize) -> Pose2 {
        let [_, _, x, y, theta] = self.state[frame];
        Pose2::new(x, y, theta)
    }

    /// The episodes in the types of the pipeline. `contacts` is NaN (unknown, as opposed to 0) if contacts are not recorded.
    pub fn planar_episodes(&self) -> Vec<PlanarEpisode> {
        let frame = |i: usize| PlanarFrame {
            eef: self.agent(i),
            object: self.block(i),
            action: Point2::new(self.action[i][0], self.action[i][1]),
            contacts: self.contacts.as_ref().map_or(f64::NAN, |contacts| contacts[i]),
        };
        self.sources
            .iter()
            .zip(&self.frames)
            .map(|(&source, frames)| PlanarEpisode {
                source,
                frames: frames.clone().map(frame).collect(),
            })
            .collect()
    }
}

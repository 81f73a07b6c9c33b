//! The tables of a `modes` artifact.

use re4_artifact::{Cell, table};
use re4_episode::Mode;

table! {
    /// One row per frame: its manipulation mode and the evidence for it. Sorted by episode and frame.
    #[table("modes", version = 3, formerly = "spatial_modes")]
    pub struct ModeRow<E> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// Manipulation mode: transit or transfer.
        pub mode: Mode,
        /// Evidence for the mode.
        #[prefix = ""]
        pub evidence: E,
    }
}

table! {
    /// One row per segment: a maximal run of frames of one mode. Its motion is that from its first frame to the frame after its
    /// last one, or to the last frame of the episode. The grasp frame g(d) of a demonstration is its first transfer frame. Sorted
    /// by episode and segment.
    #[table("segments", version = 2, formerly = "spatial_segments")]
    pub struct SegmentRow<S> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the segment in its episode, from 0.
        pub segment: u32,
        /// Mode, frames and motion.
        #[prefix = ""]
        pub summary: S,
    }
}

/// Modes, evidence and segments of one demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct Segmented<E, S> {
    /// Mode of every frame.
    pub modes: Vec<Mode>,
    /// Evidence for or against the mode of every frame. It does not depend on the rule that assigned the modes.
    pub evidence: Vec<E>,
    /// Maximal runs of one mode, in order of time.
    pub segments: Vec<S>,
    /// The grasp frame g(d): the first transfer frame, if there is one (paper, appendix, "Anchors").
    pub grasp_frame: Option<usize>,
}

impl<E: Cell + Clone, S: Cell + Clone> Segmented<E, S> {
    /// Returns the rows of both tables; `episode` is the number of the demonstration in the artifact.
    pub fn rows(&self, episode: u32) -> (impl Iterator<Item = ModeRow<E>>, impl Iterator<Item = SegmentRow<S>>) {
        let frames = (0..).zip(self.modes.iter().zip(&self.evidence));
        let modes = frames.map(move |(frame, (&mode, evidence))| ModeRow {
            episode,
            frame,
            mode,
            evidence: evidence.clone(),
        });
        let segments = (0..).zip(&self.segments).map(move |(segment, summary)| SegmentRow {
            episode,
            segment,
            summary: summary.clone(),
        });
        (modes, segments)
    }

    /// Restores the segmentation of one demonstration from its rows, sorted by frame and by segment.
    pub fn from_rows(modes: Vec<ModeRow<E>>, segments: Vec<SegmentRow<S>>) -> Self {
        let (modes, evidence): (Vec<Mode>, _) = modes.into_iter().map(|row| (row.mode, row.evidence)).unzip();
        Self {
            grasp_frame: modes.iter().position(|mode| *mode == Mode::Transfer),
            modes,
            evidence,
            segments: segments.into_iter().map(|row| row.summary).collect(),
        }
    }
}

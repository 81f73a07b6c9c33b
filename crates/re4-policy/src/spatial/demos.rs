//! The demonstrations that a policy replays, and their index.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Translation3, Vector3};
use re4_episode::{Mode, SpatialFrame};
use re4_geometry::spatial::{Symmetry, SymmetryGroup, is_valid_pose, rotation_from_vector};
use re4_index::{IndexError, IndexedSpatialFrame, SpatialIndex};

use crate::DemoSet;
use crate::spatial::config::{RetimeConfig, SpatialRetrieveConfig};
use crate::spatial::retime::free_frames;

/// A frame that a policy can replay. World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialDemoFrame {
    /// Pose of the grip site.
    pub eef: Isometry3<f64>,
    /// Pose of the object.
    pub object: Isometry3<f64>,
    /// Absolute goal pose of the grip site that was commanded at this frame.
    pub goal: Isometry3<f64>,
    /// Gripper command at this frame: above 0 closes, below 0 opens. The recorded magnitude is kept.
    pub gripper: f64,
    /// Manipulation mode.
    pub mode: Mode,
}

impl SpatialDemoFrame {
    /// Creates a frame from a recorded frame, whose absolute action consists of the position and the rotation vector of the grip
    /// site's goal.
    pub fn new(frame: &SpatialFrame, mode: Mode) -> Self {
        let [x, y, z, rx, ry, rz] = frame.goal;
        let rotation = rotation_from_vector(Vector3::new(rx, ry, rz));
        Self {
            eef: frame.eef,
            object: frame.object,
            goal: Isometry3::from_parts(Translation3::new(x, y, z), rotation),
            gripper: frame.gripper,
            mode,
        }
    }
}

/// Frames of all demonstrations.
pub type SpatialDemoSet = DemoSet<SpatialDemoFrame>;

/// Returns the frame of the last release, which is the last transfer frame; its action opens the gripper. Returns `None` if the
/// object is never held, or is held until the end.
pub(crate) fn last_release(frames: &[SpatialDemoFrame]) -> Option<usize> {
    let last = frames.iter().rposition(|frame| frame.mode == Mode::Transfer)?;
    (last + 1 < frames.len()).then_some(last)
}

/// The read-only data of a policy in SE(3), which all rollouts share.
pub struct SpatialKnowledge {
    demos: SpatialDemoSet,
    index: SpatialIndex,
    group: SymmetryGroup,
    /// The numbers that frames have in the recording, by demonstration; only for demonstrations of which frames were cut.
    recorded: BTreeMap<u32, Vec<u32>>,
    /// Whether each frame may be replayed at the robot's pace, by demonstration.
    free: BTreeMap<u32, Vec<bool>>,
}

impl SpatialKnowledge {
    /// Indexes the frames of `demos` for an object with a symmetry. Frames for which `excluded` (demonstration, frame) is true
    /// are not retrieved, but they are replayed if a chunk contains them.
    ///
    /// # Errors
    /// If no frame is left, a frame has a number that is not finite, or the metric is invalid.
    pub fn new(
        demos: SpatialDemoSet,
        retrieve: &SpatialRetrieveConfig,
        symmetry: Symmetry,
        excluded: impl Fn(u32, u32) -> bool,
    ) -> Result<Self, IndexError> {
        let named = |error: IndexError| error.named(|episode| demos.names().get(episode).map(str::to_owned));
        let mut frames = Vec::new();
        for (episode, all) in demos.iter() {
            let end = match last_release(all) {
                Some(last) if !retrieve.tail => last + 1,
                _ => all.len(),
            };
            for (number, frame) in (0..).zip(all) {
                if !is_valid_pose(&frame.goal) || !frame.gripper.is_finite() {
                    return Err(named(IndexError::NotFinite { episode, frame: number }));
                }
                if (number as usize) < end && !excluded(episode, number) {
                    frames.push(IndexedSpatialFrame {
                        episode,
                        frame: number,
                        mode: frame.mode,
                        eef: frame.eef,
                        object: frame.object,
                    });
                }
            }
        }
        Ok(Self {
            index: SpatialIndex::build(frames, retrieve.metric(symmetry)).map_err(named)?,
            group: symmetry.group()?,
            demos,
            recorded: BTreeMap::new(),
            free: BTreeMap::new(),
        })
    }

    /// Sets the numbers that the frames of each demonstration have in the recording, of which some frames may have been cut.
    #[must_use]
    pub fn with_recorded_frames(mut self, recorded: BTreeMap<u32, Vec<u32>>) -> Self {
        self.recorded = recorded;
        self.recorded
            .retain(|_, numbers| !(0..).zip(&*numbers).all(|(place, number)| place == *number));
        self
    }

    /// Determines the frames that are replayed at the robot's pace.
    #[must_use]
    pub fn with_pace(mut self, retime: &RetimeConfig) -> Self {
        let free = self
            .demos
            .iter()
            .map(|(demo, frames)| (demo, free_frames(frames, retime)));
        self.free = free.collect();
        self
    }

    /// Returns whether each frame of a demonstration may be replayed at the robot's pace; empty if none may.
    pub(crate) fn free(&self, demo: u32) -> &[bool] {
        self.free.get(&demo).map_or(&[], Vec::as_slice)
    }

    /// Returns the number that a frame has in the recording.
    pub(crate) fn recorded_frame(&self, demo: u32, frame: usize) -> u32 {
        let number = self.recorded.get(&demo).and_then(|numbers| numbers.get(frame));
        number.copied().unwrap_or(frame as u32)
    }

    /// Returns the demonstrations with all their frames.
    pub fn demos(&self) -> &SpatialDemoSet {
        &self.demos
    }

    /// Returns the index for Retrieve.
    pub fn index(&self) -> &SpatialIndex {
        &self.index
    }

    /// Returns the symmetry group of the object.
    pub fn group(&self) -> &SymmetryGroup {
        &self.group
    }
}

//! The demonstrations that a policy replays from, and their index.

use nalgebra::{Isometry3, Translation3, Vector3};
use re4_episode::{Mode, SpatialFrame};
use re4_geometry::spatial::{Symmetry, SymmetryGroup, is_sound, rotation_from_vector};
use re4_index::{IndexError, IndexedSpatialFrame, SpatialIndex};

use crate::DemoSet;
use crate::spatial::config::SpatialRetrieveConfig;

/// A frame as a policy replays it. World frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialDemoFrame {
    /// Pose of the grip site.
    pub eef: Isometry3<f64>,
    /// Pose of the object.
    pub object: Isometry3<f64>,
    /// Absolute goal of the grip site commanded at this frame.
    pub goal: Isometry3<f64>,
    /// Gripper command at this frame: above 0 closes, below 0 opens, with the recorded size.
    pub gripper: f64,
    /// Manipulation mode.
    pub mode: Mode,
}

impl SpatialDemoFrame {
    /// Takes a recorded frame, whose absolute action is position and rotation vector of the grip site's goal.
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

/// The frame of the last release: the last transfer frame, whose action opens the gripper. None where the object is never
/// held, or held to the end.
pub(crate) fn last_release(frames: &[SpatialDemoFrame]) -> Option<usize> {
    let last = frames.iter().rposition(|frame| frame.mode == Mode::Transfer)?;
    (last + 1 < frames.len()).then_some(last)
}

/// What a policy in space knows. Shared between rollouts.
pub struct SpatialKnowledge {
    demos: SpatialDemoSet,
    index: SpatialIndex,
    group: SymmetryGroup,
}

impl SpatialKnowledge {
    /// Indexes the frames of `demos` but for those that `excluded` (demonstration, frame) names, for an object with a symmetry.
    /// Frames that are excluded are not retrieved, but are replayed where a chunk leads on to them.
    ///
    /// # Errors
    /// When no frame is left, a frame has a number that is not finite, or the metric is none.
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
                if !is_sound(&frame.goal) || !frame.gripper.is_finite() {
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
        })
    }

    /// Demonstrations, with all their frames.
    pub fn demos(&self) -> &SpatialDemoSet {
        &self.demos
    }

    /// Retrieve.
    pub fn index(&self) -> &SpatialIndex {
        &self.index
    }

    /// Turns after which the object looks the same.
    pub fn group(&self) -> &SymmetryGroup {
        &self.group
    }
}

//! The demonstrations of a task with their codes and phases.

use re4_artifact::Stage as ArtifactStage;
use re4_index::{IndexRow, SpatialState};
use re4_rollout::{ArmAction, ArmState};

use super::frames::{Frame, Space};
use super::phases::Phases;
use super::tuning::Tuning;
use crate::kinds::{Inputs, OpenError};
use crate::lookup::read_fingers;

/// Parts of the method that can be disabled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent parts of the method that can be disabled"
)]
pub(super) struct Switches {
    pub(super) gate: bool,
    pub(super) vote: bool,
    pub(super) rerank: bool,
    pub(super) flow: bool,
    /// Can: whether goals before the lift are relative to the object instead of the end effector.
    pub(super) reach: bool,
}

/// The read-only data of the policy.
pub(super) struct Library {
    pub(super) tuning: Tuning,
    pub(super) switches: Switches,
    pub(super) frames: Vec<Frame>,
    /// The coordinates of every frame.
    pub(super) codes: Vec<Vec<f64>>,
    /// Position of the last frame of each frame's demonstration.
    ends: Vec<usize>,
    pub(super) space: Space,
    pub(super) phases: Phases,
}

impl Library {
    pub(super) fn open(inputs: &Inputs<'_>, tuning: Tuning, switches: Switches) -> Result<Self, OpenError> {
        let rows: Vec<IndexRow<SpatialState>> = inputs.of(ArtifactStage::Index)?.read()?;
        let fingers = read_fingers(inputs)?;
        let frames = rows.into_iter().map(|row| Frame {
            demo: row.episode,
            frame: row.frame,
            retrievable: row.retrievable.unwrap_or(true),
            arm: ArmState {
                eef: row.state.eef,
                fingers: fingers.get(&(row.episode, row.frame)).copied().unwrap_or([f64::NAN; 2]),
            },
            object: row.state.object,
            action: ArmAction {
                goal: row.state.goal.into(),
                gripper: row.state.gripper,
            },
        });
        Ok(Self::build(frames.collect(), tuning, switches))
    }

    /// Builds the library from the frames of all demonstrations, sorted by demonstration and frame.
    pub(super) fn build(frames: Vec<Frame>, tuning: Tuning, switches: Switches) -> Self {
        let space = Space::fit(&tuning, &frames);
        let codes = frames
            .iter()
            .map(|frame| space.code(&frame.arm, &frame.object))
            .collect();
        let phases = Phases::fit(&tuning, space.target, &frames);
        let mut ends = Vec::with_capacity(frames.len());
        for demo in frames.chunk_by(|a, b| a.demo == b.demo) {
            let end = ends.len() + demo.len() - 1;
            ends.resize(end + 1, end);
        }
        Self {
            tuning,
            switches,
            frames,
            codes,
            ends,
            space,
            phases,
        }
    }

    /// Position of the last frame of a frame's demonstration.
    pub(super) fn end_of(&self, at: usize) -> usize {
        self.ends[at]
    }
}

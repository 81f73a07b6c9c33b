//! Parts of robosuite's observation of the object.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Order of the parts of `obs/object`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectLayout {
    /// Lift, robosuite 1.4 and before: position, quaternion, gripper minus cube position.
    LiftEefMinusCube,
    /// Lift, robosuite 1.5: position, quaternion, cube minus gripper position.
    LiftCubeMinusEef,
    /// Can and Square, robosuite 1.4 and before: object pose, then object pose in the hand's frame.
    PoseFirst,
    /// Can and Square, robosuite 1.5: object pose in the hand's frame, then object pose.
    RelativeFirst,
}

impl ObjectLayout {
    /// Columns of `obs/object`.
    #[must_use]
    pub fn columns(self) -> usize {
        if self.relates_rotations() { 14 } else { 10 }
    }

    /// Whether the relative part is a pose in the hand's frame, and not a difference of positions.
    #[must_use]
    pub fn relates_rotations(self) -> bool {
        matches!(self, Self::PoseFirst | Self::RelativeFirst)
    }

    /// First column of the object pose (position, then quaternion).
    #[must_use]
    pub fn pose_start(self) -> usize {
        if self == Self::RelativeFirst { 7 } else { 0 }
    }

    /// Whether a row's relative part is not yet there: robosuite 1.5 leaves zeros in the first row of a demo.
    #[must_use]
    pub fn pending(self, row: &[f64], frame: usize) -> bool {
        let late = matches!(self, Self::RelativeFirst | Self::LiftCubeMinusEef);
        let relative = row.iter().skip(self.relative_start()).take(self.columns() - 7);
        late && frame == 0 && relative.into_iter().all(|value| *value == 0.0)
    }

    /// First column of the relative part.
    #[must_use]
    pub fn relative_start(self) -> usize {
        if self == Self::RelativeFirst { 0 } else { 7 }
    }
}

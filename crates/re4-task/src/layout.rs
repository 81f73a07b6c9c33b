//! Layouts of robosuite's observation of the object.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Order of the parts of the dataset `obs/object`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectLayout {
    /// Lift up to robosuite 1.4: cube position, cube quaternion, gripper position minus cube position.
    LiftEefMinusCube,
    /// Lift from robosuite 1.5: cube position, cube quaternion, cube position minus gripper position.
    LiftCubeMinusEef,
    /// Can and Square up to robosuite 1.4: object pose, then object pose in the frame of the robot's hand.
    PoseFirst,
    /// Can and Square from robosuite 1.5: object pose in the frame of the robot's hand, then object pose.
    RelativeFirst,
}

impl ObjectLayout {
    /// Number of columns of `obs/object`.
    #[must_use]
    pub fn columns(self) -> usize {
        if self.relates_rotations() { 14 } else { 10 }
    }

    /// Whether the relative part is a pose in the hand's frame; otherwise it is a difference of positions.
    #[must_use]
    pub fn relates_rotations(self) -> bool {
        matches!(self, Self::PoseFirst | Self::RelativeFirst)
    }

    /// First column of the object pose (position, then quaternion x, y, z, w).
    #[must_use]
    pub fn pose_start(self) -> usize {
        if self == Self::RelativeFirst { 7 } else { 0 }
    }

    /// Whether the relative part of a row of `obs/object` is missing: robosuite 1.5 writes zeros in the first row of a
    /// demonstration. `frame` is the number of the row.
    #[must_use]
    pub fn pending(self, row: &[f64], frame: usize) -> bool {
        let since_1_5 = matches!(self, Self::RelativeFirst | Self::LiftCubeMinusEef);
        let relative = row.iter().skip(self.relative_start()).take(self.columns() - 7);
        since_1_5 && frame == 0 && relative.into_iter().all(|value| *value == 0.0)
    }

    /// First column of the relative part.
    #[must_use]
    pub fn relative_start(self) -> usize {
        if self == Self::RelativeFirst { 0 } else { 7 }
    }
}

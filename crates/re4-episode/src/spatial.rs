//! Demonstrations of an arm with a two-finger gripper.

use nalgebra::Isometry3;

/// A frame of a spatial demonstration: the object-augmented state and the action taken there. World frame, metres and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialFrame {
    /// Pose of the end effector, that is, of the grip site.
    pub eef: Isometry3<f64>,
    /// Pose of the manipulated object.
    pub object: Isometry3<f64>,
    /// Joint positions of the two fingers, of opposite signs.
    pub fingers: [f64; 2],
    /// Delta action: translation, then rotation vector, in parts of the controller's limits.
    pub delta: [f64; 6],
    /// Absolute action: goal position and goal orientation as a rotation vector.
    pub goal: [f64; 6],
    /// Gripper command: above 0 closes, below 0 opens, and 0 leaves the fingers as they are.
    pub gripper: f64,
    /// Reward of the step, where it was recorded.
    pub reward: Option<f64>,
}

impl SpatialFrame {
    /// Whether the gripper command closes.
    pub fn closes(&self) -> bool {
        self.gripper > 0.0
    }

    /// Distance between the fingers.
    pub fn finger_separation(&self) -> f64 {
        (self.fingers[0] - self.fingers[1]).abs()
    }
}

/// A spatial demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialEpisode {
    /// Name of the demonstration in its source: that of its group in an HDF5 file.
    pub name: String,
    /// Frames in the order of time.
    pub frames: Vec<SpatialFrame>,
}

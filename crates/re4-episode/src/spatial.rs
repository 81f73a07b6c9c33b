//! Demonstrations of an arm with a two-finger gripper.

use nalgebra::Isometry3;

/// A frame of a demonstration in SE(3): the object-augmented state and the action. World frame, metres and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialFrame {
    /// Pose of the end effector, which is the grip site.
    pub eef: Isometry3<f64>,
    /// Pose of the manipulated object.
    pub object: Isometry3<f64>,
    /// Joint positions of the two fingers in metres; they have opposite signs.
    pub fingers: [f64; 2],
    /// Delta action: translation, then rotation vector, as fractions of the controller's limits.
    pub delta: [f64; 6],
    /// Absolute action: goal position, then goal orientation as a rotation vector.
    pub goal: [f64; 6],
    /// Gripper command: above 0 closes, below 0 opens, 0 does not move the fingers.
    pub gripper: f64,
    /// Reward of the step, if it was recorded.
    pub reward: Option<f64>,
}

impl SpatialFrame {
    /// Whether the gripper command closes the gripper.
    pub fn closes(&self) -> bool {
        self.gripper > 0.0
    }

    /// Distance between the fingers in metres.
    pub fn finger_separation(&self) -> f64 {
        (self.fingers[0] - self.fingers[1]).abs()
    }
}

/// A demonstration in SE(3).
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialEpisode {
    /// Name of the demonstration in its source: the name of its group in the HDF5 file.
    pub name: String,
    /// Frames in temporal order.
    pub frames: Vec<SpatialFrame>,
}

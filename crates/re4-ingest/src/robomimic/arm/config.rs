//! Settings of the task `arm`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which arrays of a dataset of the task `arm` are read, for datasets whose names are not known by default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ArmConfig {
    /// Prefix of the names of one arm's arrays, such as `robot0`, in a dataset with several arms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arm: Option<String>,
    /// HDF5: dataset below `obs` with the joint positions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joints: Option<String>,
    /// HDF5: dataset below `obs` with the position of the end effector (x, y, z), in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eef_position: Option<String>,
    /// HDF5: dataset below `obs` with the orientation of the end effector: a quaternion (x, y, z, w) or a rotation vector in rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eef_orientation: Option<String>,
    /// HDF5: dataset below `obs` with the opening of the gripper, or with the positions of its two fingers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gripper: Option<String>,
    /// HDF5: dataset of a demonstration with the actions. Default: `actions`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actions: Option<String>,
    /// First and end index (exclusive) of the arm's elements of an action. Default: all elements.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_elements: Option<[usize; 2]>,
    /// Index of the gripper command among the arm's elements of an action, from 0. Default: the last one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gripper_command: Option<usize>,
    /// Frames per second, if the dataset does not state them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate: Option<f64>,
}

impl ArmConfig {
    /// Whether every setting has its default value.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Checks the ranges of the settings.
    ///
    /// # Errors
    /// Names the first setting that is out of range, and its remedy.
    pub fn check(&self) -> Result<(), String> {
        if let Some([first, end]) = self.action_elements
            && first >= end
        {
            return Err(format!(
                "action_elements is [{first}, {end}]; give the first index and a larger end index"
            ));
        }
        match self.rate {
            Some(rate) if !(rate.is_finite() && rate > 0.0) => Err(format!(
                "rate is {rate}; give the frames per second as a number above 0"
            )),
            _ => Ok(()),
        }
    }
}

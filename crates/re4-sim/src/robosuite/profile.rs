//! Differences between robosuite's versions.

use re4_mujoco::Version;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A version of robosuite whose behaviour is reproduced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
pub enum Profile {
    /// 1.4 (checked against 1.4.1 on MuJoCo 2.3.7).
    #[serde(rename = "1.4")]
    V1_4,
    /// 1.5 (checked against 1.5.1 on MuJoCo 3.2.7).
    #[serde(rename = "1.5")]
    V1_5,
}

impl Profile {
    /// All profiles.
    pub const ALL: [Self; 2] = [Self::V1_4, Self::V1_5];

    /// The profile of a version as dataset files declare it, such as `1.4.1`.
    #[must_use]
    pub fn of(version: &str) -> Option<Self> {
        let mut parts = version.split('.');
        match (parts.next(), parts.next()) {
            (Some("1"), Some("4")) => Some(Self::V1_4),
            (Some("1"), Some("5")) => Some(Self::V1_5),
            _ => None,
        }
    }

    /// The major and minor version number.
    pub fn version(self) -> (u32, u32) {
        match self {
            Self::V1_4 => (1, 4),
            Self::V1_5 => (1, 5),
        }
    }

    /// The MuJoCo version that this robosuite version is simulated with.
    #[must_use]
    pub fn mujoco(self) -> Version {
        match self {
            Self::V1_4 => Version::V2_3_7,
            Self::V1_5 => Version::V3_2_7,
        }
    }

    /// The name of the site that the controller tracks.
    pub(super) fn grip_site(self) -> &'static str {
        match self {
            Self::V1_4 => "gripper0_grip_site",
            Self::V1_5 => "gripper0_right_grip_site",
        }
    }

    /// The names of the joints of the two fingers.
    pub(super) fn finger_joints(self) -> [&'static str; 2] {
        match self {
            Self::V1_4 => ["gripper0_finger_joint1", "gripper0_finger_joint2"],
            Self::V1_5 => ["gripper0_right_finger_joint1", "gripper0_right_finger_joint2"],
        }
    }
}

/// How closely the simulation follows robosuite's computations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Fidelity {
    /// Bit-exact. With profile 1.4, forces are computed three times per simulation step: the last result counts, the
    /// others change the solver's warm start. Objects that the task has placed out of the way overlap and collide with each other.
    #[default]
    Robosuite,
    /// The same physics at lower cost: forces are computed once per simulation step, and objects that the task has placed out
    /// of the way do not collide. Forces agree within the solver's tolerance, but trajectories eventually diverge after contact.
    Fast,
}

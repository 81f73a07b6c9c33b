//! Cameras of the tasks.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Cameras of the tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Camera {
    /// Push-T's only camera: the whole scene from above, 96 x 96 pixels.
    Image,
    /// robosuite's camera in front of the robot and the table, 84 x 84 pixels.
    Agentview,
    /// robosuite's camera on the robot's hand, 84 x 84 pixels.
    #[serde(rename = "robot0_eye_in_hand")]
    EyeInHand,
}

impl Camera {
    /// Name of the camera in files and tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Agentview => "agentview",
            Self::EyeInHand => "robot0_eye_in_hand",
        }
    }

    /// Side of its square images in pixels, as in the datasets.
    #[must_use]
    pub const fn side(self) -> usize {
        match self {
            Self::Image => 96,
            Self::Agentview | Self::EyeInHand => 84,
        }
    }
}

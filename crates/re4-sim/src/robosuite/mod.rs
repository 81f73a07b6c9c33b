//! robosuite's Lift, `PickPlaceCan` and `NutAssemblySquare`.

mod placement;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use placement::{ObjectPlacement, Placement, with_cube_size};

/// A task of robosuite with one Panda arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RobosuiteTask {
    /// `Lift`: a cube is lifted off the table.
    Lift,
    /// `PickPlaceCan`: a can is carried from one bin to another.
    Can,
    /// `NutAssemblySquare`: a square nut is put onto a square peg.
    Square,
}

impl RobosuiteTask {
    /// robosuite's name of the environment.
    #[must_use]
    pub fn environment(self) -> &'static str {
        match self {
            Self::Lift => "Lift",
            Self::Can => "PickPlaceCan",
            Self::Square => "NutAssemblySquare",
        }
    }
}

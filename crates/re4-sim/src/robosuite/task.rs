//! The three tasks: what is manipulated, and when it is done.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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

/// Height of the table top of `Lift`.
const LIFT_TABLE: f64 = 0.8;
/// How far the cube has to be above it.
const LIFT_HEIGHT: f64 = 0.04;
/// Corner of the second bin of `PickPlaceCan`, and the sizes of the bin.
const BIN: [f64; 3] = [0.1, 0.28, 0.8];
const BIN_SIZE: [f64; 2] = [0.39, 0.49];
const BIN_HEIGHT: f64 = 0.1;
/// Height of the table top of `NutAssemblySquare`.
const NUT_TABLE: f64 = 0.82;
/// How far the nut's origin may be from the peg's axis along x and y, and above the table.
const PEG_TOLERANCE: f64 = 0.03;
const PEG_HEIGHT: f64 = 0.05;

impl RobosuiteTask {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Lift, Self::Can, Self::Square];

    /// robosuite's name of the environment.
    #[must_use]
    pub fn environment(self) -> &'static str {
        match self {
            Self::Lift => "Lift",
            Self::Can => "PickPlaceCan",
            Self::Square => "NutAssemblySquare",
        }
    }

    /// Name of the manipulated object in models and observations.
    #[must_use]
    pub fn object(self) -> &'static str {
        match self {
            Self::Lift => "cube",
            Self::Can => "Can",
            Self::Square => "SquareNut",
        }
    }

    /// Bodies of the objects in the scene that the task has put away.
    #[must_use]
    pub fn put_away(self) -> &'static [&'static str] {
        match self {
            Self::Lift => &[],
            Self::Can => &["Milk_main", "Bread_main", "Cereal_main"],
            Self::Square => &["RoundNut_main"],
        }
    }

    /// A body that the success rule looks at besides the object.
    pub(super) fn landmark(self) -> Option<&'static str> {
        match self {
            Self::Lift | Self::Can => None,
            Self::Square => Some("peg1"),
        }
    }

    /// The task's own success rule (`_check_success` of the environment), from the world positions, in metres, of the
    /// object's origin, of the grip site, and of the peg where there is one.
    #[must_use]
    pub fn success(self, object: &Vector3<f64>, grip_site: &Vector3<f64>, landmark: Option<&Vector3<f64>>) -> bool {
        // robosuite writes the distance rule as 1 - tanh(10 d) < 0.6: the gripper has let go and gone, by some 42 mm.
        let released = || 1.0 - (10.0 * (grip_site - object).norm()).tanh() < 0.6;
        match self {
            Self::Lift => object.z > LIFT_TABLE + LIFT_HEIGHT,
            Self::Can => {
                let within = |i: usize| BIN[i] < object[i] && object[i] < BIN[i] + BIN_SIZE[i] / 2.0;
                within(0) && within(1) && BIN[2] < object.z && object.z < BIN[2] + BIN_HEIGHT && released()
            }
            Self::Square => {
                landmark.is_some_and(|peg| {
                    (object.x - peg.x).abs() < PEG_TOLERANCE && (object.y - peg.y).abs() < PEG_TOLERANCE
                }) && object.z < NUT_TABLE + PEG_HEIGHT
                    && released()
            }
        }
    }
}

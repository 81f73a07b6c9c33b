//! Tasks, and what a policy observes of them.

use re4_geometry::spatial::Symmetry;
use re4_sim::robosuite::RobosuiteTask;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Tasks that this version knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TaskName {
    /// Push-T: a disc pushes a T-shaped block onto a goal pose in the plane.
    PushT,
    /// robosuite's `Lift`: a Panda lifts a cube.
    Lift,
    /// robosuite's `PickPlaceCan`: a Panda carries a can from one bin to another.
    Can,
    /// robosuite's `NutAssemblySquare`: a Panda puts a square nut onto a peg.
    Square,
    /// Any other robosuite environment of one arm with a two-finger gripper; `ingest.object` names the manipulated object.
    Robosuite,
}

impl TaskName {
    /// Whether it takes place in the plane.
    pub fn is_planar(self) -> bool {
        self == Self::PushT
    }

    /// The task in robosuite's simulator, where there is one.
    pub fn simulated(self) -> Option<RobosuiteTask> {
        match self {
            Self::Lift => Some(RobosuiteTask::Lift),
            Self::Can => Some(RobosuiteTask::Can),
            Self::Square => Some(RobosuiteTask::Square),
            Self::PushT | Self::Robosuite => None,
        }
    }

    /// Turns after which the manipulated object looks the same: four quarters of a turn for the cube, any turn for the can.
    pub fn symmetry(self) -> Symmetry {
        self.simulated().map_or(Symmetry::None, symmetry_of)
    }
}

/// Turns after which the object of a task looks the same, in its own frame.
pub(super) fn symmetry_of(task: RobosuiteTask) -> Symmetry {
    let axis = [0.0, 0.0, 1.0];
    match task {
        RobosuiteTask::Lift => Symmetry::Fold { axis, n: 4 },
        RobosuiteTask::Can => Symmetry::Full { axis },
        RobosuiteTask::Square => Symmetry::None,
    }
}

/// What the policy observes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Variant {
    /// End-effector state and the object's true pose.
    State,
    /// Pictures, and the end effector's state.
    Image,
}

//! The records of all tasks.
//!
//! To add a task, add its record here and to `RECORDS`, and its parity trace to `re4-sim` (`docs/guides/add-a-task.md`). Numbers
//! are those of robosuite's environments; the parity tests of `re4-sim` compare placement and success rule with robosuite
//! itself.

use re4_geometry::spatial::Symmetry;

use crate::names::Summary;
use crate::{Camera, Extent, ObjectLayout, ObjectRule, Positions, Solid, TaskSpec};

/// The robosuite tasks with a record.
pub(crate) static RECORDS: [TaskSpec; 4] = [LIFT, CAN, SQUARE, ROUND];

/// The planar task.
pub(crate) const PUSHT: Summary = Summary {
    name: "pusht",
    environment: "Push-T",
    about: "Push-T: a disc pushes a T-shaped block to a planar goal pose.",
    cameras: &[Camera::Image],
    control_rate: 10,
};

/// robosuite's environments without a record.
pub(crate) const ROBOSUITE: Summary = Summary {
    name: "robosuite",
    environment: "robosuite",
    about: "Any other robosuite environment of one arm with a two-finger gripper; `ingest.object` names the manipulated object.",
    cameras: ARM_CAMERAS,
    control_rate: ARM_RATE,
};

/// Any arm, without an object and without a simulation.
pub(crate) const ARM: Summary = Summary {
    name: "arm",
    environment: "arm",
    about: "Any dataset of one arm with a gripper, without the pose of an object: it can be audited and segmented, but neither indexed nor simulated.",
    cameras: &[],
    control_rate: ARM_RATE,
};

const ARM_CAMERAS: &[Camera] = &[Camera::Agentview, Camera::EyeInHand];
/// Control steps per second in robosuite's and robomimic's demonstrations.
const ARM_RATE: usize = 20;
/// The axis of an object that is vertical while the object rests on a table.
const UPRIGHT: [f64; 3] = [0.0, 0.0, 1.0];
/// Layouts of tasks whose observation contains the offset between gripper and object.
const OFFSET: [ObjectLayout; 2] = [ObjectLayout::LiftEefMinusCube, ObjectLayout::LiftCubeMinusEef];
/// Layouts of tasks whose observation contains the object's pose in the hand's frame.
const RELATIVE_POSE: [ObjectLayout; 2] = [ObjectLayout::PoseFirst, ObjectLayout::RelativeFirst];

/// A table whose top is 25 mm above `z`.
const fn table(z: f64) -> Solid {
    Solid::cuboid("table", [0.0, 0.0, z], [0.4, 0.4, 0.025])
}

/// Whether the gripper has released the object and is more than about 42 mm away from it.
///
/// robosuite writes this condition as `1 - tanh(10 d) < 0.6`; the same expression gives the same result at the limit.
fn released(at: &Positions<'_>) -> bool {
    1.0 - (10.0 * (at.grip_site - at.object).norm()).tanh() < 0.6
}

// ------------------------------------------------------------------------------------------------------------------ Lift

const LIFT: TaskSpec = TaskSpec {
    name: "lift",
    title: "Lift",
    about: "robosuite's `Lift`: a Panda lifts a cube.",
    environment: "Lift",
    mimicgen: None,
    object: "cube",
    symmetry: Symmetry::Fold { axis: UPRIGHT, n: 4 },
    layouts: OFFSET,
    placement: &[ObjectRule {
        object: "cube",
        used: true,
        x: [-0.03, 0.03],
        y: [-0.03, 0.03],
        reference: [0.0, 0.0, LIFT_TABLE],
        height: 0.01,
        extent: Extent::Box(CUBE),
    }],
    landmarks: &[],
    success: |at| at.object.z > LIFT_TABLE + 0.04,
    cameras: ARM_CAMERAS,
    control_rate: ARM_RATE,
    fixtures: &[table(0.775)],
    shape: &[Solid::cuboid("object", [0.0; 3], [CUBE_MIDDLE; 3])],
};

/// Height of the table's top, in metres.
const LIFT_TABLE: f64 = 0.8;
/// Range of the cube's half sizes, in metres.
const CUBE: [f64; 2] = [0.020, 0.022];
/// Middle of the range, which HTML pages show for all seeds.
const CUBE_MIDDLE: f64 = 0.021;

// ------------------------------------------------------------------------------------------------------------------- Can

const CAN: TaskSpec = TaskSpec {
    name: "can",
    title: "Can",
    about: "robosuite's `PickPlaceCan`: a Panda carries a can from one bin to another.",
    environment: "PickPlaceCan",
    mimicgen: Some("Can"),
    object: "Can",
    symmetry: Symmetry::Full { axis: UPRIGHT },
    layouts: RELATIVE_POSE,
    // All four objects are placed one after the other, the can last, so its position depends on the others'.
    placement: &[
        in_bin("Milk", false, 0.025, -0.085, 0.075),
        in_bin("Bread", false, 0.03, -0.045, 0.03),
        in_bin("Cereal", false, 0.04, -0.1, 0.03),
        in_bin("Can", true, 0.025, -0.06, 0.04),
    ],
    landmarks: &[],
    success: in_second_bin,
    cameras: ARM_CAMERAS,
    control_rate: ARM_RATE,
    fixtures: &[
        // The region of the success rule: a quarter of the second bin.
        Solid::cuboid("goal", [0.1975, 0.4025, 0.85], [0.0975, 0.1225, 0.05]),
        FIRST_BIN[0],
        FIRST_BIN[1],
        FIRST_BIN[2],
        FIRST_BIN[3],
        FIRST_BIN[4],
        SECOND_BIN[0],
        SECOND_BIN[1],
        SECOND_BIN[2],
        SECOND_BIN[3],
        SECOND_BIN[4],
    ],
    shape: &[Solid::cylinder("object", [0.0; 3], 0.025, 0.04)],
};

/// Inner sizes of a bin along x and y.
const BIN: [f64; 2] = [0.39, 0.49];
const FIRST_BIN: [Solid; 5] = bin(-0.25);
const SECOND_BIN: [Solid; 5] = bin(0.28);

/// The rule for an object in the first bin, at least 5 cm plus its radius away from the walls.
const fn in_bin(object: &'static str, used: bool, radius: f64, bottom: f64, top: f64) -> ObjectRule {
    let half = [BIN[0] / 2.0 - 0.05, BIN[1] / 2.0 - 0.05];
    ObjectRule {
        object,
        used,
        x: [-half[0] + radius, half[0] - radius],
        y: [-half[1] + radius, half[1] - radius],
        reference: [0.1, -0.25, 0.8],
        height: 0.0,
        extent: Extent::Fixed { bottom, top, radius },
    }
}

/// Whether the can is in its quarter of the second bin, below the upper edge, and the gripper has released it.
fn in_second_bin(at: &Positions<'_>) -> bool {
    let corner = [0.1, 0.28, 0.8];
    let within = |i: usize, size: f64| corner[i] < at.object[i] && at.object[i] < corner[i] + size;
    within(0, BIN[0] / 2.0) && within(1, BIN[1] / 2.0) && within(2, 0.1) && released(at)
}

/// The shapes of the bin with its centre at `y`: floor and four walls.
const fn bin(y: f64) -> [Solid; 5] {
    let [x, z] = [0.1, 0.8];
    [
        Solid::cuboid("table", [x, y, z], [0.2, 0.25, 0.02]),
        Solid::cuboid("wall", [x, y + 0.25, z + 0.05], [0.21, 0.01, 0.05]),
        Solid::cuboid("wall", [x, y - 0.25, z + 0.05], [0.21, 0.01, 0.05]),
        Solid::cuboid("wall", [x + 0.2, y, z + 0.05], [0.01, 0.25, 0.05]),
        Solid::cuboid("wall", [x - 0.2, y, z + 0.05], [0.01, 0.25, 0.05]),
    ]
}

// ------------------------------------------------------------------------------------------------------------------ nuts

const SQUARE: TaskSpec = TaskSpec {
    name: "square",
    title: "Square",
    about: "robosuite's `NutAssemblySquare`: a Panda puts a square nut onto a peg.",
    environment: "NutAssemblySquare",
    mimicgen: Some("Square"),
    object: "SquareNut",
    // Because of its handle.
    symmetry: Symmetry::None,
    layouts: RELATIVE_POSE,
    placement: &[square_nut(true), round_nut(false)],
    landmarks: &["peg1"],
    success: on_peg,
    cameras: ARM_CAMERAS,
    control_rate: ARM_RATE,
    fixtures: &[
        table(0.795),
        Solid::cuboid("goal", [0.23, 0.1, 0.885], [0.016, 0.016, 0.065]),
        Solid::cylinder("wall", [0.23, -0.1, 0.885], 0.02, 0.065),
    ],
    shape: &[
        Solid::cuboid("object", [-0.033_25, 0.0, 0.0], [0.0105, 0.043_75, 0.01]),
        Solid::cuboid("object", [0.033_25, 0.0, 0.0], [0.0105, 0.043_75, 0.01]),
        Solid::cuboid("object", [0.0, 0.033_25, 0.0], [0.031_25, 0.0105, 0.01]),
        Solid::cuboid("object", [0.0, -0.033_25, 0.0], [0.031_25, 0.0105, 0.01]),
        Solid::cuboid("object", [0.054, 0.0, 0.0], [0.025_25, 0.015_875, 0.01]),
    ],
};

const ROUND: TaskSpec = TaskSpec {
    name: "round",
    title: "Round",
    about: "robosuite's `NutAssemblyRound`: a Panda puts a round nut onto a peg.",
    environment: "NutAssemblyRound",
    mimicgen: None,
    object: "RoundNut",
    // Because of its handle.
    symmetry: Symmetry::None,
    layouts: RELATIVE_POSE,
    placement: &[square_nut(false), round_nut(true)],
    landmarks: &["peg2"],
    success: on_peg,
    cameras: ARM_CAMERAS,
    control_rate: ARM_RATE,
    fixtures: &[
        table(0.795),
        Solid::cuboid("wall", [0.23, 0.1, 0.885], [0.016, 0.016, 0.065]),
        Solid::cylinder("goal", [0.23, -0.1, 0.885], 0.02, 0.065),
    ],
    shape: &[
        Solid::cuboid("object", [-0.042_45, 0.0, 0.0], [0.011_25, 0.0225, 0.01]),
        Solid::cuboid("object", [0.042_45, 0.0, 0.0], [0.011_25, 0.0225, 0.01]),
        Solid::cuboid("object", [0.0, -0.042_45, 0.0], [0.0225, 0.011_25, 0.01]),
        Solid::cuboid("object", [0.0, 0.042_45, 0.0], [0.0225, 0.011_25, 0.01]),
        // The model has boxes at 45 degrees here, which a `Solid` cannot represent.
        Solid::cylinder("object", [-0.03, -0.03, 0.0], 0.016, 0.01),
        Solid::cylinder("object", [-0.03, 0.03, 0.0], 0.016, 0.01),
        Solid::cylinder("object", [0.03, -0.03, 0.0], 0.016, 0.01),
        Solid::cylinder("object", [0.03, 0.03, 0.0], 0.016, 0.01),
        Solid::cuboid("object", [0.06, 0.0, 0.0], [0.025_25, 0.015_875, 0.01]),
    ],
};

/// Height of the table's top in both nut tasks.
const NUT_TABLE: f64 = 0.82;

const fn square_nut(used: bool) -> ObjectRule {
    nut("SquareNut", used, [0.11, 0.225], 0.01)
}

const fn round_nut(used: bool) -> ObjectRule {
    nut("RoundNut", used, [-0.225, -0.11], 0.025)
}

/// The rule for a nut. Both nuts are in the scene of both tasks.
const fn nut(object: &'static str, used: bool, y: [f64; 2], top: f64) -> ObjectRule {
    ObjectRule {
        object,
        used,
        x: [-0.115, -0.11],
        y,
        reference: [0.0, 0.0, NUT_TABLE],
        height: 0.02,
        extent: Extent::Fixed {
            bottom: -0.05,
            top,
            radius: 0.11,
        },
    }
}

/// Whether the nut's origin is within 3 cm of the axis of the peg (the first landmark) along x and along y and less than 5 cm
/// above the table, and the gripper has released the nut.
fn on_peg(at: &Positions<'_>) -> bool {
    at.landmarks
        .first()
        .is_some_and(|peg| (at.object.x - peg.x).abs() < 0.03 && (at.object.y - peg.y).abs() < 0.03)
        && at.object.z < NUT_TABLE + 0.05
        && released(at)
}

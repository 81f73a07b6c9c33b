//! Tables of robosuite demonstrations: an arm with a two-finger gripper, and one manipulated object.
//!
//! The world frame is robosuite's: metres, z upwards. Frames are control steps of 0.05 s. Quaternions are unit quaternions in
//! the order x, y, z, w. The end effector's position is that of the grip site; what its orientation is that of (the hand
//! body, as robosuite's `robot0_eef_quat`, or the grip site) says row `eef_orientation` of table `conventions`.

use super::{EPISODE, category, flag, id, number};
use crate::spec::ColumnKind::{Binary, F64, F64List, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

/// A coordinate in the world frame, in metres.
pub(super) const fn world(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).unit("m").frame("world")
}

/// A part of a quaternion that leads to the world frame.
pub(super) const fn attitude(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).frame("world")
}

/// A length, the same in every frame of reference.
pub(super) const fn length(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).unit("m")
}

/// An angle, the same in every frame of reference.
pub(super) const fn turn(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).unit("rad")
}

const FRAME: ColumnSpec = id(
    "frame",
    "Number of the frame in its episode, from 0; one control step of 0.05 s each.",
);

/// Rows of a robosuite demonstration, one a frame.
pub const SPATIAL_FRAMES: TableSpec = TableSpec {
    name: "spatial_frames",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame of every demonstration of a robosuite task: the object-augmented state, the action in both conventions, and what was recorded beside it. Values that the dataset holds are copied bit for bit; which of the two action conventions it holds says row action_kind of table conventions, the other one is converted. Sorted by episode and frame.",
    columns: &[
        EPISODE,
        FRAME,
        world("eef_x", "Position of the grip site, x."),
        world("eef_y", "Position of the grip site, y."),
        world("eef_z", "Position of the grip site, z."),
        attitude("eef_qx", "Orientation of the end effector, quaternion part x."),
        attitude("eef_qy", "Orientation of the end effector, quaternion part y."),
        attitude("eef_qz", "Orientation of the end effector, quaternion part z."),
        attitude("eef_qw", "Orientation of the end effector, quaternion part w."),
        world("object_x", "Position of the manipulated object, x."),
        world("object_y", "Position of the manipulated object, y."),
        world("object_z", "Position of the manipulated object, z."),
        attitude("object_qx", "Orientation of the manipulated object, quaternion part x."),
        attitude("object_qy", "Orientation of the manipulated object, quaternion part y."),
        attitude("object_qz", "Orientation of the manipulated object, quaternion part z."),
        attitude("object_qw", "Orientation of the manipulated object, quaternion part w."),
        length("finger_0", "Joint position of the first finger, 0 closed to 0.04 open."),
        length(
            "finger_1",
            "Joint position of the second finger, 0 closed to -0.04 open.",
        ),
        number(
            "delta_x",
            "Delta action: translation of the goal along x, in [-1, 1]; 1 is the controller's output_max.",
        )
        .frame("world"),
        number("delta_y", "Delta action: translation of the goal along y.").frame("world"),
        number("delta_z", "Delta action: translation of the goal along z.").frame("world"),
        number(
            "delta_rx",
            "Delta action: rotation vector of the goal, x, in [-1, 1]; 1 is the controller's output_max.",
        )
        .frame("world"),
        number("delta_ry", "Delta action: rotation vector of the goal, y.").frame("world"),
        number("delta_rz", "Delta action: rotation vector of the goal, z.").frame("world"),
        world("goal_x", "Absolute action: goal position of the grip site, x."),
        world("goal_y", "Absolute action: goal position of the grip site, y."),
        world("goal_z", "Absolute action: goal position of the grip site, z."),
        turn(
            "goal_rx",
            "Absolute action: goal orientation of the grip site as a rotation vector, x.",
        )
        .frame("world"),
        turn(
            "goal_ry",
            "Absolute action: goal orientation of the grip site as a rotation vector, y.",
        )
        .frame("world"),
        turn(
            "goal_rz",
            "Absolute action: goal orientation of the grip site as a rotation vector, z.",
        )
        .frame("world"),
        number(
            "gripper",
            "Gripper command as recorded, 0 and 1 as -1 and 1 where row gripper_range of table conventions says so; what its sign means says row gripper_sign (robosuite: below 0 opens, above 0 closes).",
        ),
        number("reward", "Reward of the step; null where it was not recorded.").nullable(),
        flag(
            "done",
            "Whether the step was recorded as the last or as a success; null where it was not recorded.",
        )
        .nullable(),
    ],
};

/// Names of the demonstrations in an HDF5 file.
pub const DEMOS: TableSpec = TableSpec {
    name: "demos",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a demonstration of a robosuite task: its group in the HDF5 file and what was measured on it. Sorted by episode.",
    columns: &[
        EPISODE,
        ColumnSpec::new("demo", Text, "Name of its group below /data, such as demo_12."),
        ColumnSpec::new("filter_keys", Text, "Filter keys of /mask that list it, comma-separated; empty where none does."),
        ColumnSpec::new("model", U32, "Row of table models that holds its MJCF; null where it has none.").nullable(),
        length("goal_error_position", "Largest distance between the goal positions of the recorded absolute actions and those converted from delta actions, beyond the first step; null where only one kind is known.").nullable(),
        turn("goal_error_rotation", "Largest angle between the goal orientations, likewise.").nullable(),
    ],
};

/// Conventions of a dataset, each with its proof.
pub const CONVENTIONS: TableSpec = TableSpec {
    name: "conventions",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a convention of the dataset that its values depend on, with the evidence that it holds.",
    columns: &[
        category(
            "convention",
            "What it is about: object_layout, eef_orientation, eef_quaternion, action_kind, gripper_sign, ...",
        ),
        category("value", "How it is in this dataset."),
        category(
            "basis",
            "Why that is believed: proven, by the evidence of this row; setting, by an explicit setting of the pipeline; declared, by the file's own words where nothing depends on it.",
        ),
        ColumnSpec::new("evidence", Text, "The test that was made, in words."),
        ColumnSpec::new(
            "residual",
            F64,
            "What the test measured for this value; null where nothing was measured.",
        )
        .nullable(),
        ColumnSpec::new(
            "runner_up",
            F64,
            "What it measured for the next best value; null where there is none.",
        )
        .nullable(),
        ColumnSpec::new(
            "threshold",
            F64,
            "What the residual has to be below; null where nothing was measured.",
        )
        .nullable(),
        category("unit", "Unit of the three; empty for none."),
        id("frames", "Frames that the test was made on."),
    ],
};

/// Flattened simulator states.
pub const STATES: TableSpec = TableSpec {
    name: "states",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame, in the order of table spatial_frames: the recorded state of the simulator before the action.",
    columns: &[
        EPISODE,
        FRAME,
        ColumnSpec::new("state", F64List, "Flattened MuJoCo state: time, qpos, qvel."),
    ],
};

/// Simulator models.
pub const MODELS: TableSpec = TableSpec {
    name: "models",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a distinct MuJoCo model of the dataset, in the order of first use. Asset paths are those of the machine that recorded.",
    columns: &[
        id("model", "Number of the model, from 0."),
        ColumnSpec::new("mjcf", Text, "The model as MJCF."),
    ],
};

/// Pictures of several cameras.
pub const CAMERA_IMAGES: TableSpec = TableSpec {
    name: "camera_images",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a picture, sorted by camera, episode and frame: the recorded picture, or the one drawn from the recorded state where the summary of the artifact says so, lossless. The pictures of one camera are in the order of table spatial_frames. Row groups are small, so that a picture can be read alone.",
    columns: &[
        category("camera", "Name of the camera: agentview, robot0_eye_in_hand, ..."),
        EPISODE,
        FRAME,
        ColumnSpec::new(
            "image",
            Binary,
            "The picture as the bytes of a PNG file, 8 bits a channel, RGB, first row at the top.",
        ),
    ],
};

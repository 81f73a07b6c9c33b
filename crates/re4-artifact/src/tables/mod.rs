//! The tables of every artifact, described once, so that no stage needs to know another stage's code.
//!
//! Push-T: the world frame is the simulator's 512 x 512 plane, x to the right and y downwards in pictures, in pixels; a
//! growing angle turns clockwise on the screen. Angles are radians. Frames are control steps of 0.1 s.

mod left_out;
mod spatial;

use crate::spec::ColumnKind::{Binary, Bool, Category, F64, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

pub use left_out::LEFT_OUT;
pub use spatial::{CAMERA_IMAGES, CONVENTIONS, DEMOS, MODELS, SPATIAL_FRAMES, STATES};

const fn id(name: &'static str, description: &'static str) -> ColumnSpec {
    ColumnSpec::new(name, U32, description)
}

/// Without unit.
const fn number(name: &'static str, description: &'static str) -> ColumnSpec {
    ColumnSpec::new(name, F64, description)
}

/// A coordinate in the world frame.
const fn world(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).unit("px").frame("world")
}

/// An angle, the same in every frame of reference.
const fn turn(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).unit("rad")
}

/// The angle of a pose in the world frame.
const fn heading(name: &'static str, description: &'static str) -> ColumnSpec {
    turn(name, description).frame("world")
}

const fn flag(name: &'static str, description: &'static str) -> ColumnSpec {
    ColumnSpec::new(name, Bool, description)
}

const fn category(name: &'static str, description: &'static str) -> ColumnSpec {
    ColumnSpec::new(name, Category, description)
}

const EPISODE: ColumnSpec = id("episode", "Number of the demonstration in this artifact, from 0.");
const FRAME: ColumnSpec = id(
    "frame",
    "Number of the frame in its episode, from 0; one control step of 0.1 s each.",
);
const EEF_X: ColumnSpec = world("eef_x", "Position of the pusher's centre, x.");
const EEF_Y: ColumnSpec = world("eef_y", "Position of the pusher's centre, y.");
const OBJECT_X: ColumnSpec = world("object_x", "Origin of the block's frame, x.");
const OBJECT_Y: ColumnSpec = world("object_y", "Origin of the block's frame, y.");
const OBJECT_THETA: ColumnSpec = heading("object_theta", "Angle of the block.");
const ACTION_X: ColumnSpec = world("action_x", "Target position commanded to the pusher, x.");
const ACTION_Y: ColumnSpec = world("action_y", "Target position commanded to the pusher, y.");
const CONTACTS: ColumnSpec = number(
    "contacts",
    "Contact points between pusher and block counted during the control step that led to this frame.",
)
.nullable();

/// Rows of an episode's demonstration, one a frame.
pub const FRAMES: TableSpec = TableSpec {
    name: "frames",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame of every demonstration: the object-augmented state, the action and what was recorded beside it. Sorted by episode and frame.",
    columns: &[
        EPISODE,
        FRAME,
        EEF_X,
        EEF_Y,
        OBJECT_X,
        OBJECT_Y,
        OBJECT_THETA,
        ACTION_X,
        ACTION_Y,
        CONTACTS,
        world("keypoint_0_x", "Recorded keypoint 0 of the block, x.").nullable(),
        world("keypoint_0_y", "Recorded keypoint 0 of the block, y.").nullable(),
        world("keypoint_1_x", "Recorded keypoint 1 of the block, x.").nullable(),
        world("keypoint_1_y", "Recorded keypoint 1 of the block, y.").nullable(),
        world("keypoint_2_x", "Recorded keypoint 2 of the block, x.").nullable(),
        world("keypoint_2_y", "Recorded keypoint 2 of the block, y.").nullable(),
        world("keypoint_3_x", "Recorded keypoint 3 of the block, x.").nullable(),
        world("keypoint_3_y", "Recorded keypoint 3 of the block, y.").nullable(),
        world("keypoint_4_x", "Recorded keypoint 4 of the block, x.").nullable(),
        world("keypoint_4_y", "Recorded keypoint 4 of the block, y.").nullable(),
        world("keypoint_5_x", "Recorded keypoint 5 of the block, x.").nullable(),
        world("keypoint_5_y", "Recorded keypoint 5 of the block, y.").nullable(),
        world("keypoint_6_x", "Recorded keypoint 6 of the block, x.").nullable(),
        world("keypoint_6_y", "Recorded keypoint 6 of the block, y.").nullable(),
        world("keypoint_7_x", "Recorded keypoint 7 of the block, x.").nullable(),
        world("keypoint_7_y", "Recorded keypoint 7 of the block, y.").nullable(),
        world("keypoint_8_x", "Recorded keypoint 8 of the block, x.").nullable(),
        world("keypoint_8_y", "Recorded keypoint 8 of the block, y.").nullable(),
    ],
};

/// The demonstrations.
pub const EPISODES: TableSpec = TableSpec {
    name: "episodes",
    version: 2,
    domain: "",
    formerly: "",
    description: "One row a demonstration, in the order of the artifact.",
    columns: &[
        EPISODE,
        id(
            "source_episode",
            "Number of the demonstration in its source: of Push-T its place there, from 0; of an HDF5 file, whose demonstrations have names (table demos), the number that the name ends in, null where there is none, it exceeds 32 bits, or several have it. In artifacts of version 1 a place stands in for those numbers.",
        )
        .nullable(),
        id("frames", "Frames of the demonstration."),
    ],
};

/// The pictures.
pub const IMAGES: TableSpec = TableSpec {
    name: "images",
    version: 2,
    domain: "",
    formerly: "camera_images",
    description: "One row a picture, sorted by camera, episode and frame: the recorded picture, or the one rendered from the recorded state where the summary of the artifact says so, lossless. Row groups are small, so that a picture can be read alone.",
    columns: &[
        EPISODE,
        FRAME,
        ColumnSpec::new(
            "image",
            Binary,
            "The picture as the bytes of a PNG file, 8 bits a channel, RGB, first row at the top.",
        ),
        category("camera", "Name of the camera: agentview, robot0_eye_in_hand, ..., or img, the one of Push-T. Null in older artifacts of Push-T.")
            .nullable()
            .since(2),
    ],
};

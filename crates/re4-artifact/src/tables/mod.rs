//! The tables of every artifact, described once, so that no stage needs to know another stage's code.
//!
//! Push-T: the world frame is the simulator's 512 x 512 plane, x to the right and y downwards in pictures, in pixels; a
//! growing angle turns clockwise on the screen. Angles are radians. Frames are control steps of 0.1 s.

mod left_out;
mod spatial;
mod spatial_rollouts;

use crate::spec::ColumnKind::{Binary, Bool, Category, F64, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

pub use left_out::LEFT_OUT;
pub use spatial::{
    CAMERA_IMAGES, CONVENTIONS, DEMOS, MODELS, POSE_ERRORS, SPATIAL_FRAMES, SPATIAL_POSES, STATES, TRAINING,
};
pub use spatial_rollouts::{SPATIAL_DIVERGENCE, SPATIAL_REPLAYS};

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

/// A length, the same in every frame of reference.
const fn length(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).unit("px")
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
/// A second version's column beside a demonstration's number in the artifact.
const NAME_IN_SOURCE: ColumnSpec = ColumnSpec::new(
    "demo_name",
    Text,
    "Name of the demonstration in its source: the group below /data of an HDF5 file, such as demo_12; of Push-T the word episode and its number. Null in older artifacts.",
)
.nullable()
.since(2);
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

/// Poses estimated from pictures.
pub const POSES: TableSpec = TableSpec {
    name: "poses",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame of every demonstration: the object's pose as estimated from the frame's picture, and what to think of it. No recorded pose enters. Sorted by episode and frame.",
    columns: &[
        EPISODE,
        FRAME,
        world(
            "object_x",
            "Estimated origin of the block's frame, x; null where no block is seen.",
        )
        .nullable(),
        world(
            "object_y",
            "Estimated origin of the block's frame, y; null where no block is seen.",
        )
        .nullable(),
        heading(
            "object_theta",
            "Estimated angle of the block; null where no block is seen.",
        )
        .nullable(),
        number(
            "confidence",
            "Intersection over union of the block's outline at the pose with the block-coloured pixels that neither pusher nor contact marks hide, times the share of the outline in sight: 0 to 1.",
        ),
        category(
            "flag",
            "What to think of the pose: clear; or occluded, poor_fit or second_block, when it is a guess; or no_block, when there is none.",
        ),
    ],
};

/// The anchor of the log-polar pose estimator.
pub const ANCHOR: TableSpec = TableSpec {
    name: "anchor",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a pixel of the 96 x 96 pictures: how much of it the goal covers, as seen over the pictures. The goal pose is the pose of this mask; angles are measured from it. Sorted by row and column.",
    columns: &[
        id("row", "Row of the picture, from 0 at the top."),
        id("column", "Column of the picture, from 0 at the left."),
        number("goal_share", "Share of the pixel that has the goal's colour, 0 to 1."),
    ],
};

/// Open-loop replays of demonstrations.
pub const REPLAYS: TableSpec = TableSpec {
    name: "replays",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a demonstration whose actions were replayed open-loop from its own first state: how far the simulator strays from the recording. The distance between two poses of the block is the root mean square displacement of its points.",
    columns: &[
        EPISODE,
        id(
            "source_episode",
            "Number of the demonstration in the raw dataset, from 0.",
        ),
        id("frames", "Frames compared."),
        length(
            "pusher_max",
            "Greatest distance between the replayed and the recorded pusher.",
        ),
        length(
            "block_median",
            "Median distance between the replayed and the recorded block.",
        ),
        length(
            "block_max",
            "Greatest distance between the replayed and the recorded block.",
        ),
        length(
            "block_final",
            "Distance between the replayed and the recorded block at the last frame.",
        ),
        number("coverage_recorded", "Coverage of the goal at the last recorded frame."),
        number(
            "coverage_replayed",
            "Coverage of the goal at the same frame of the replay.",
        ),
        number(
            "coverage_after",
            "Coverage of the goal after the last action, which no recorded frame shows.",
        ),
    ],
};

/// Divergence of open-loop replays, frame by frame.
pub const DIVERGENCE: TableSpec = TableSpec {
    name: "divergence",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame of every replayed demonstration: the distance between the replay and the recording. Sorted by episode and frame.",
    columns: &[
        EPISODE,
        FRAME,
        length("pusher", "Distance between the replayed and the recorded pusher."),
        length("block_position", "Distance between the origins of the block's frame."),
        turn(
            "block_angle",
            "Difference of the block's angles, the short way round, at least 0.",
        ),
        length("block", "Root mean square displacement of the block's points."),
    ],
};

/// Scenes to evaluate a policy on, chosen by where the demonstrations are not.
pub const SCENES: TableSpec = TableSpec {
    name: "scenes",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a scene that rollouts start from: a pose of the block far from those of all demonstrations, and a place for the pusher. Sorted by pose and pusher; poses come in falling order of rho.",
    columns: &[
        id("scene", "Number of the scene in this artifact, from 0."),
        id(
            "pose",
            "Number of the block's pose, from 0 for the one farthest from the demonstrations.",
        ),
        id("pusher", "Number of the pusher's position at this pose, from 0."),
        world("agent_x", "Position of the pusher's centre, x."),
        world("agent_y", "Position of the pusher's centre, y."),
        world("block_x", "Origin of the block's frame, x."),
        world("block_y", "Origin of the block's frame, y."),
        heading("block_theta", "Angle of the block."),
        number(
            "rho",
            "Distance of the block's pose to that of the nearest frame of a demonstration, in normalised coordinates.",
        ),
        id(
            "nearest_demo",
            "Demonstration of that frame: its episode in the episodes artifact.",
        ),
        id("nearest_frame", "That frame, in its demonstration."),
    ],
};

//! Tables of the index, of replays and of rollouts of robosuite's tasks.
//!
//! World frame, metres, radians; quaternions in the order x, y, z, w. The end effector is the grip site, in position and in
//! orientation. A control step is 0.05 s.

use super::spatial::{length, turn};
use super::{EPISODE, NAME_IN_SOURCE, category, flag, id, number};
use crate::spec::ColumnKind::U32;
use crate::spec::{ColumnSpec, TableSpec};

const FRAME: ColumnSpec = id("frame", "Number of the frame in its episode, from 0.");

/// Open-loop replays of demonstrations.
pub const SPATIAL_REPLAYS: TableSpec = TableSpec {
    name: "spatial_replays",
    version: 2,
    domain: "",
    formerly: "",
    description: "One row a replay: a demonstration's actions, played open-loop in the simulator from its first recorded state. Distances are between the simulator's state and the recorded one before the same action. Sorted by episode and actions.",
    columns: &[
        EPISODE,
        id(
            "source_episode",
            "Number that the name of the demonstration ends in, as in table episodes.",
        )
        .nullable(),
        category("actions", "Which actions were played: delta or absolute."),
        category(
            "origin",
            "Where they come from: recorded, or converted from the other kind.",
        ),
        id("frames", "Actions played."),
        flag("success", "Whether the task's success rule held after some action."),
        ColumnSpec::new(
            "first_success",
            U32,
            "First action after which it held; null where it never did.",
        )
        .nullable(),
        flag("success_at_end", "Whether it held after the last one."),
        length(
            "object_max",
            "Largest distance of the object's origin from the recorded one.",
        ),
        length("object_final", "The same before the last action."),
        turn(
            "object_turn_max",
            "Largest angle between the object's orientation and the recorded one.",
        ),
        length("eef_max", "Largest distance of the grip site from the recorded one."),
        number("arm_max", "Largest difference of a joint position of the arm.").unit("rad"),
        NAME_IN_SOURCE,
    ],
};

/// Divergence of replays, frame by frame.
pub const SPATIAL_DIVERGENCE: TableSpec = TableSpec {
    name: "spatial_divergence",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame of every replay: how far the simulator is from the recording. Sorted by episode, actions and frame.",
    columns: &[
        EPISODE,
        category("actions", "Which actions were played: delta or absolute."),
        FRAME,
        length("object", "Distance of the object's origin from the recorded one."),
        turn(
            "object_turn",
            "Angle between the object's orientation and the recorded one.",
        ),
        length("eef", "Distance of the grip site from the recorded one."),
    ],
};

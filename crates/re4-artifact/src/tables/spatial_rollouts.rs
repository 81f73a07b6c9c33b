//! Tables of the index, of replays and of rollouts of robosuite's tasks.
//!
//! World frame, metres, radians; quaternions in the order x, y, z, w. The end effector is the grip site, in position and in
//! orientation. A control step is 0.05 s.

use super::spatial::{attitude, length, turn, world};
use super::{MODE, NAME_IN_SOURCE, SEED, category, flag, id, number};
use crate::spec::ColumnKind::{Bool, F64List, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

/// Outcomes of rollouts.
pub const SPATIAL_RESULTS: TableSpec = TableSpec {
    name: "spatial_results",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a rollout of a robosuite task. Sorted by episode.",
    columns: &[
        id("episode", "Number of the rollout, from 0."),
        SEED,
        ColumnSpec::new(
            "success",
            Bool,
            "Whether the task's own success rule held after some control step, which ends the rollout.",
        ),
        id("steps", "Control steps taken."),
        id("decisions", "Decisions taken."),
        id(
            "losses",
            "How often the grasp was lost, by the distance of the fingers.",
        ),
        id("banned", "Demonstrations that were not followed again at the end."),
        id("demos", "Demonstrations that were followed."),
        world("eef_x", "Position of the grip site after the reset, x."),
        world("eef_y", "Position of the grip site after the reset, y."),
        world("eef_z", "Position of the grip site after the reset, z."),
        world("object_x", "Position of the object after the reset, x."),
        world("object_y", "Position of the object after the reset, y."),
        world("object_z", "Position of the object after the reset, z."),
        attitude(
            "object_qx",
            "Orientation of the object after the reset, quaternion part x.",
        ),
        attitude(
            "object_qy",
            "Orientation of the object after the reset, quaternion part y.",
        ),
        attitude(
            "object_qz",
            "Orientation of the object after the reset, quaternion part z.",
        ),
        attitude(
            "object_qw",
            "Orientation of the object after the reset, quaternion part w.",
        ),
        ColumnSpec::new(
            "state",
            F64List,
            "Flattened MuJoCo state after the reset: time, qpos, qvel.",
        ),
    ],
};

/// Steps of rollouts.
pub const SPATIAL_STEPS: TableSpec = TableSpec {
    name: "spatial_steps",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a control step of every rollout: the absolute action, what it led to, and the decision that it follows from. As in robosuite, poses after a step are those of 2 ms before its end. Sorted by seed, as in table spatial_results, and step.",
    columns: &[
        SEED,
        id("step", "Number of the control step in its rollout, from 0."),
        world("action_x", "Goal position of the grip site, x."),
        world("action_y", "Goal position of the grip site, y."),
        world("action_z", "Goal position of the grip site, z."),
        turn(
            "action_rx",
            "Goal orientation of the grip site as a rotation vector, x.",
        )
        .frame("world"),
        turn("action_ry", "Goal orientation, y.").frame("world"),
        turn("action_rz", "Goal orientation, z.").frame("world"),
        number("gripper", "Gripper command: below 0 opens, above 0 closes."),
        world("eef_x", "Position of the grip site after the step, x."),
        world("eef_y", "Position of the grip site after the step, y."),
        world("eef_z", "Position of the grip site after the step, z."),
        attitude(
            "eef_qx",
            "Orientation of the grip site after the step, quaternion part x.",
        ),
        attitude(
            "eef_qy",
            "Orientation of the grip site after the step, quaternion part y.",
        ),
        attitude(
            "eef_qz",
            "Orientation of the grip site after the step, quaternion part z.",
        ),
        attitude(
            "eef_qw",
            "Orientation of the grip site after the step, quaternion part w.",
        ),
        world("object_x", "Position of the object after the step, x."),
        world("object_y", "Position of the object after the step, y."),
        world("object_z", "Position of the object after the step, z."),
        attitude(
            "object_qx",
            "Orientation of the object after the step, quaternion part x.",
        ),
        attitude(
            "object_qy",
            "Orientation of the object after the step, quaternion part y.",
        ),
        attitude(
            "object_qz",
            "Orientation of the object after the step, quaternion part z.",
        ),
        attitude(
            "object_qw",
            "Orientation of the object after the step, quaternion part w.",
        ),
        length("finger_0", "Joint position of the first finger after the step."),
        length("finger_1", "Joint position of the second finger after the step."),
        flag("success", "Whether the success rule holds after the step."),
        id(
            "decision",
            "Number of the decision, in the rollout, that the action belongs to.",
        ),
        category("phase", "What the action is part of: bridge, replay or home."),
        world(
            "seen_x",
            "Object position that the policy was told before the action, with the errors that the pipeline asks for, x.",
        ),
        world("seen_y", "The same, y."),
        world("seen_z", "The same, z."),
        attitude(
            "seen_qx",
            "Object orientation that the policy was told, quaternion part x.",
        ),
        attitude("seen_qy", "The same, part y."),
        attitude("seen_qz", "The same, part z."),
        attitude("seen_qw", "The same, part w."),
    ],
};

/// Decisions of rollouts.
pub const SPATIAL_DECISIONS: TableSpec = TableSpec {
    name: "spatial_decisions",
    version: 2,
    domain: "",
    formerly: "",
    description: "One row a decision of the policy: what it saw, what it retrieved, how it moved it, where it goes first and what it replays. Columns from demo to replay_steps, and demo_name, are null on the way home. Sorted by seed and decision.",
    columns: &[
        SEED,
        id("decision", "Number of the decision in its rollout, from 0."),
        id("step", "Control step at which it was taken."),
        category(
            "kind",
            "What was decided: retrieve; continue, the demonstration that is followed further; grasp_lost or demo_ended, back to the initial pose.",
        ),
        MODE,
        world("query_eef_x", "Grip site of the query, x."),
        world("query_eef_y", "Grip site of the query, y."),
        world("query_eef_z", "Grip site of the query, z."),
        attitude("query_eef_qx", "Grip site of the query, quaternion part x."),
        attitude("query_eef_qy", "Grip site of the query, quaternion part y."),
        attitude("query_eef_qz", "Grip site of the query, quaternion part z."),
        attitude("query_eef_qw", "Grip site of the query, quaternion part w."),
        world(
            "query_object_x",
            "Object of the query, averaged where the policy averages, x.",
        ),
        world("query_object_y", "Object of the query, y."),
        world("query_object_z", "Object of the query, z."),
        attitude("query_object_qx", "Object of the query, quaternion part x."),
        attitude("query_object_qy", "Object of the query, quaternion part y."),
        attitude("query_object_qz", "Object of the query, quaternion part z."),
        attitude("query_object_qw", "Object of the query, quaternion part w."),
        length("finger_separation", "Distance between the fingers."),
        ColumnSpec::new(
            "demo",
            U32,
            "Retrieved demonstration: its episode in the index, which is its place there; demo_name says what it is in the source.",
        )
        .nullable(),
        ColumnSpec::new("demo_frame", U32, "Retrieved frame, where the chunk starts.").nullable(),
        ColumnSpec::new("demo_end", U32, "Last frame of the chunk, included.").nullable(),
        ColumnSpec::new("compared", U32, "Demonstrations compared.").nullable(),
        number("d_q", "Distance over the full object-augmented state, without unit.").nullable(),
        number("d_o", "Distance over the object's pose alone.").nullable(),
        number("d_e", "Distance over the end effector's pose as seen from the object.").nullable(),
        world(
            "delta_x",
            "Translation of the motion that carries the demonstration's object onto the query's, x.",
        )
        .nullable(),
        world("delta_y", "Translation of that motion, y.").nullable(),
        world("delta_z", "Translation of that motion, z.").nullable(),
        turn(
            "delta_rx",
            "Rotation of that motion about the world's origin, before the translation, as a rotation vector, x.",
        )
        .frame("world")
        .nullable(),
        turn("delta_ry", "Rotation of that motion, y.")
            .frame("world")
            .nullable(),
        turn("delta_rz", "Rotation of that motion, z.")
            .frame("world")
            .nullable(),
        turn(
            "symmetry_turn",
            "Turn about the object's symmetry axis that was applied to the query's object; 0 without symmetry.",
        )
        .nullable(),
        ColumnSpec::new(
            "replay_steps",
            U32,
            "Actions of the chunk; fewer are executed when the next decision comes earlier.",
        )
        .nullable(),
        world("set_point_x", "Where the grip site goes first, x."),
        world("set_point_y", "Where the grip site goes first, y."),
        world("set_point_z", "Where the grip site goes first, z."),
        attitude("set_point_qx", "Where the grip site goes first, quaternion part x."),
        attitude("set_point_qy", "The same, part y."),
        attitude("set_point_qz", "The same, part z."),
        attitude("set_point_qw", "The same, part w."),
        flag(
            "bridge",
            "Whether a bridge, or the way home, leads there; else the chunk is replayed from where the grip site is.",
        ),
        id("banned", "Demonstrations that are not followed again by now."),
        ColumnSpec::new("reason", Text, "The decision in words."),
        NAME_IN_SOURCE,
    ],
};

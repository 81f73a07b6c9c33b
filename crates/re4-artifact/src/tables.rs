//! The tables of every artifact, described once, so that no stage needs to know another stage's code.
//!
//! Push-T: the world frame is the simulator's 512 x 512 plane, x to the right and y downwards in pictures, in pixels; a
//! growing angle turns clockwise on the screen. Angles are radians. Frames are control steps of 0.1 s.

use crate::key::Stage;
use crate::spec::ColumnKind::{Binary, Bool, Category, F64, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

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

/// A coordinate in the frame of the manipulated object.
const fn in_object(name: &'static str, description: &'static str) -> ColumnSpec {
    number(name, description).unit("px").frame("object")
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
const MODE: ColumnSpec = category("mode", "Manipulation mode: transit or transfer.");

/// Rows of an episode's demonstration, one a frame.
pub const FRAMES: TableSpec = TableSpec {
    name: "frames",
    version: 1,
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
    version: 1,
    description: "One row a demonstration, in the order of the artifact.",
    columns: &[
        EPISODE,
        id(
            "source_episode",
            "Number of the demonstration in the raw dataset, from 0.",
        ),
        id("frames", "Frames of the demonstration."),
    ],
};

/// The recorded pictures.
pub const IMAGES: TableSpec = TableSpec {
    name: "images",
    version: 1,
    description: "One row a frame, in the order of the frames table: the recorded picture, lossless. Row groups are small, so that a picture can be read alone.",
    columns: &[
        EPISODE,
        FRAME,
        ColumnSpec::new(
            "image",
            Binary,
            "The picture as the bytes of a PNG file, 8 bits a channel, RGB.",
        ),
    ],
};

/// Modes and the evidence for them.
pub const MODES: TableSpec = TableSpec {
    name: "modes",
    version: 1,
    description: "One row a frame: its manipulation mode and the evidence for it. Steps and turns lead from the frame to the next one of its episode and are null at the last.",
    columns: &[
        EPISODE,
        FRAME,
        MODE,
        CONTACTS,
        flag(
            "contact",
            "Whether any contact was counted; null where contacts were not recorded.",
        )
        .nullable(),
        length("eef_step", "Distance that the pusher moves.").nullable(),
        length("object_step", "Distance that the origin of the block's frame moves.").nullable(),
        turn(
            "object_turn",
            "Angle that the block turns, the short way round, in [-pi, pi).",
        )
        .nullable(),
        length(
            "relative_translation",
            "Distance that the pusher moves as seen from the block: |o'^-1 x' - o^-1 x|.",
        )
        .nullable(),
        turn(
            "relative_rotation",
            "Angle that the end effector turns as seen from the object; null where it is a point, as the pusher is.",
        )
        .nullable(),
        length(
            "eef_object_distance",
            "Distance from the pusher's centre to the origin of the block's frame.",
        ),
        flag(
            "object_moving",
            "Whether the object moves further, or turns further, than the configured motion thresholds.",
        )
        .nullable(),
    ],
};

/// Maximal runs of one mode.
pub const SEGMENTS: TableSpec = TableSpec {
    name: "segments",
    version: 1,
    description: "One row a segment: a maximal run of frames of one mode. The grasp frame g(d) of a demonstration is its first transfer frame.",
    columns: &[
        EPISODE,
        id("segment", "Number of the segment in its episode, from 0."),
        MODE,
        id("first_frame", "First frame of the segment."),
        id("end_frame", "Frame after the last one of the segment."),
        world(
            "anchor_x",
            "Anchor of the demonstration, x: the end effector's position at g(d). Null in segments after the first transfer segment and in demonstrations without one.",
        )
        .nullable(),
        world("anchor_y", "Anchor of the demonstration, y; null as anchor_x is.").nullable(),
        in_object("grasp_x", "End effector in the object's frame at the first frame of a transfer segment, x; null in transit.")
            .nullable(),
        in_object("grasp_y", "End effector in the object's frame at the first frame of a transfer segment, y; null in transit.")
            .nullable(),
        length(
            "rigidity_residual",
            "Largest distance, over a transfer segment, of the end effector in the object's frame from where it was at the segment's first frame; null in transit.",
        )
        .nullable(),
        length("object_displacement", "Distance of the object's frame at the end of the segment from where it was at its start."),
        turn("object_rotation", "Sum of the object's turns over the segment."),
    ],
};

/// States that Retrieve searches.
pub const INDEX: TableSpec = TableSpec {
    name: "index",
    version: 1,
    description: "One row a retrievable frame: its object-augmented state, its action and its normalised coordinates. Sorted by episode and frame.",
    columns: &[
        EPISODE,
        FRAME,
        MODE,
        EEF_X,
        EEF_Y,
        OBJECT_X,
        OBJECT_Y,
        OBJECT_THETA,
        ACTION_X,
        ACTION_Y,
        number("q_0", "Normalised eef_x."),
        number("q_1", "Normalised eef_y."),
        number("q_2", "Normalised object_x."),
        number("q_3", "Normalised object_y."),
        number("q_4", "Normalised object_theta."),
    ],
};

/// Ranges that the index is normalised by.
pub const SCALES: TableSpec = TableSpec {
    name: "scales",
    version: 1,
    description: "One row a dimension of the object-augmented state: the range that it is normalised by.",
    columns: &[
        ColumnSpec::new("dimension", Text, "Name of the dimension, a column of the index table."),
        number("minimum", "Least value, in the dimension's own unit."),
        number("maximum", "Greatest value, in the dimension's own unit."),
    ],
};

const SEED: ColumnSpec = id("seed", "Seed of the scene.");

/// Outcomes of rollouts.
pub const RESULTS: TableSpec = TableSpec {
    name: "results",
    version: 1,
    description: "One row a rollout: its scene and its outcome. Coverage is the part of the goal area that the block covers, IoU is intersection over union of the two, the score is coverage over 0.95, at most 1.",
    columns: &[
        id("episode", "Number of the rollout in this artifact, from 0."),
        SEED,
        world("agent_x", "Position of the pusher in the first state, x."),
        world("agent_y", "Position of the pusher in the first state, y."),
        world("block_x", "Origin of the block's frame in the first state, x."),
        world("block_y", "Origin of the block's frame in the first state, y."),
        heading("block_theta", "Angle of the block in the first state."),
        number("coverage_max", "Greatest coverage of the rollout."),
        number("iou_max", "Greatest IoU of the rollout."),
        number(
            "score_max",
            "Greatest score of the rollout; the figure that the field reports.",
        ),
        number("coverage_final", "Coverage in the last state."),
        id("steps", "Control steps executed."),
        flag("success", "Whether coverage passed 0.95."),
        id("decisions", "Decisions taken."),
    ],
};

/// Steps of rollouts.
pub const STEPS: TableSpec = TableSpec {
    name: "steps",
    version: 1,
    description: "One row a control step of a rollout: the action executed and the state that it led to. Sorted by seed and step.",
    columns: &[
        SEED,
        id("step", "Number of the control step in its rollout, from 0."),
        ACTION_X,
        ACTION_Y,
        world("eef_x", "Position of the pusher's centre after the step, x."),
        world("eef_y", "Position of the pusher's centre after the step, y."),
        world("object_x", "Origin of the block's frame after the step, x."),
        world("object_y", "Origin of the block's frame after the step, y."),
        heading("object_theta", "Angle of the block after the step."),
        number("contacts", "Contact points counted during the step."),
        number("coverage", "Coverage after the step."),
        number("iou", "IoU after the step."),
        number("score", "Score after the step."),
        id(
            "decision",
            "Number of the decision, in the rollout, that the action belongs to.",
        ),
        category("phase", "What the action is part of: plan, replay or hold."),
    ],
};

/// Decisions of rollouts: the reason for every action.
pub const DECISIONS: TableSpec = TableSpec {
    name: "decisions",
    version: 1,
    description: "One row a decision of the policy: what it saw, what it retrieved, how it moved it, what it planned and what it executed. Sorted by seed and decision.",
    columns: &[
        SEED,
        id("decision", "Number of the decision in its rollout, from 0."),
        id("step", "Control step at which it was taken."),
        MODE,
        ColumnSpec::new("selector", Text, "Rule that chose among the retrieved candidates."),
        world("query_eef_x", "Observed position of the pusher, x."),
        world("query_eef_y", "Observed position of the pusher, y."),
        world("query_object_x", "Observed origin of the block's frame, x."),
        world("query_object_y", "Observed origin of the block's frame, y."),
        heading("query_object_theta", "Observed angle of the block."),
        id(
            "demo",
            "Retrieved demonstration: its episode in the index; null where nothing was retrieved.",
        )
        .nullable(),
        id("demo_frame", "Retrieved frame of that demonstration.").nullable(),
        number(
            "d_q",
            "Distance of the object-augmented states in normalised coordinates.",
        )
        .nullable(),
        number("d_o", "Distance of the object poses alone in normalised coordinates.").nullable(),
        world(
            "delta_x",
            "Translation of the motion that carries the demonstration's object onto the observed one, x.",
        )
        .nullable(),
        world("delta_y", "Translation of that motion, y.").nullable(),
        heading(
            "delta_theta",
            "Rotation of that motion, about the world's origin, before the translation.",
        )
        .nullable(),
        world("set_point_x", "Position that the plan leads the pusher to, x.").nullable(),
        world("set_point_y", "Position that the plan leads the pusher to, y.").nullable(),
        category("plan", "How it was planned to get there: direct, rrt, failed or none."),
        id("plan_steps", "Control steps of the plan that were executed."),
        id("rrt_nodes", "Nodes of the search tree; 0 where none was grown."),
        id("replay_steps", "Actions of the demonstration that were executed."),
        world(
            "predicted_object_x",
            "Predicted origin of the block's frame after the replay, x.",
        )
        .nullable(),
        world(
            "predicted_object_y",
            "Predicted origin of the block's frame after the replay, y.",
        )
        .nullable(),
        heading(
            "predicted_object_theta",
            "Predicted angle of the block after the replay.",
        )
        .nullable(),
        number("predicted_coverage", "Predicted coverage after the replay.").nullable(),
        ColumnSpec::new("reason", Text, "The decision in words."),
    ],
};

/// The tables of a stage's artifact. An artifact may lack some of them (pictures, when none were asked for).
pub const fn of(stage: Stage) -> &'static [&'static TableSpec] {
    match stage {
        Stage::Ingest => &[&EPISODES, &FRAMES, &IMAGES],
        Stage::Segment => &[&MODES, &SEGMENTS],
        Stage::Index => &[&INDEX, &SCALES],
        Stage::Rollout => &[&RESULTS, &STEPS, &DECISIONS],
        Stage::TrainPose | Stage::Report => &[],
    }
}

/// Every table there is, with the stage that makes it.
pub fn all() -> impl Iterator<Item = (Stage, &'static TableSpec)> {
    Stage::ALL
        .into_iter()
        .flat_map(|stage| of(stage).iter().map(move |&spec| (stage, spec)))
}

/// The table of this name.
pub fn find(name: &str) -> Option<&'static TableSpec> {
    all().map(|(_, spec)| spec).find(|spec| spec.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn declarations_hold_together() {
        let mut names = BTreeSet::new();
        for (_, table) in all() {
            assert!(names.insert(table.name), "{} twice", table.name);
            let columns: BTreeSet<_> = table.columns.iter().map(|c| c.name).collect();
            assert_eq!(columns.len(), table.columns.len(), "{} repeats a column", table.name);
            assert!(table.description.ends_with('.'), "{}", table.name);
            for column in table.columns {
                assert!(column.description.ends_with('.'), "{}.{}", table.name, column.name);
                assert!(
                    (1..=table.version).contains(&column.since),
                    "{}.{}",
                    table.name,
                    column.name
                );
                assert!(
                    column.since == 1 || column.nullable,
                    "{}.{} was added later, and has to be nullable to be read from older tables",
                    table.name,
                    column.name
                );
            }
        }
        assert_eq!(names.len(), 10);
    }
}

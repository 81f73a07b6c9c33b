//! The tables of every artifact, described once, so that no stage needs to know another stage's code.
//!
//! Push-T: the world frame is the simulator's 512 x 512 plane, x to the right and y downwards in pictures, in pixels; a
//! growing angle turns clockwise on the screen. Angles are radians. Frames are control steps of 0.1 s.

mod spatial;
mod spatial_rollouts;

use crate::spec::ColumnKind::{Bool, Category, F64, F64List, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

pub use spatial::{POSE_ERRORS, SPATIAL_POSES, TRAINING};
pub use spatial_rollouts::{
    SPATIAL_DECISIONS, SPATIAL_DIVERGENCE, SPATIAL_INDEX, SPATIAL_REPLAYS, SPATIAL_RESULTS, SPATIAL_STEPS,
};

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
const MODE: ColumnSpec = category("mode", "Manipulation mode: transit or transfer.");

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

/// States that Retrieve searches.
pub const INDEX: TableSpec = TableSpec {
    name: "index",
    version: 2,
    domain: "",
    formerly: "",
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
        flag(
            "retrievable",
            "Whether the frame may be retrieved. Where its pose was not clear it may not, and has a pose between those of the clear frames round it. Null in older artifacts, whose frames all may.",
        )
        .nullable()
        .since(2),
    ],
};

/// Ranges that the index is normalised by.
pub const SCALES: TableSpec = TableSpec {
    name: "scales",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a dimension of the object-augmented state: the range that it is normalised by.",
    columns: &[
        ColumnSpec::new("dimension", Text, "Name of the dimension, a column of the index table."),
        number("minimum", "Least value, in the dimension's own unit."),
        number("maximum", "Greatest value, in the dimension's own unit."),
    ],
};

/// Parts of demonstrations that can be retrieved by what they do to the object.
pub const CHUNKS: TableSpec = TableSpec {
    name: "chunks",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a chunk: a part of a demonstration that starts with the pusher clear of the block and ends anywhere after the block began to move. The motion is o_j^-1 o_e, the pose of the block at the last frame in its own frame at the first. Sorted by episode, first and last frame.",
    columns: &[
        EPISODE,
        id("first_frame", "First frame of the chunk."),
        id("last_frame", "Last frame of the chunk, included."),
        in_object("motion_x", "Translation of the block's motion, x."),
        in_object("motion_y", "Translation of the block's motion, y."),
        turn("motion_theta", "Rotation of the block's motion.").frame("object"),
        length("travel", "Length of the pusher's path."),
        length(
            "pushed",
            "Length of the block's path: root mean square displacement of its points, summed over the frames.",
        ),
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

const SEED: ColumnSpec = id(
    "seed",
    "Seed of the scene; its number in table scenes, where the rollouts start from a scenes artifact.",
);

/// Outcomes of rollouts.
pub const RESULTS: TableSpec = TableSpec {
    name: "results",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a rollout: its scene and its outcome. Coverage is the part of the goal area that the block covers, IoU is intersection over union of the two, the score is coverage over 0.95, at most 1.",
    columns: &[
        id("episode", "Number of the rollout in this artifact, from 0."),
        SEED,
        world("agent_x", "Position of the pusher in the first state, x."),
        world("agent_y", "Position of the pusher in the first state, y."),
        world("block_x", "Origin of the block's frame in the first state, x."),
        world("block_y", "Origin of the block's frame in the first state, y."),
        heading("block_theta", "Angle of the block in the first state."),
        number("contacts", "Contact points counted while the scene was set up."),
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
    version: 2,
    domain: "",
    formerly: "",
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
        category("phase", "What the action is part of: plan or replay."),
        world(
            "observed_object_x",
            "Origin of the block's frame that the policy was told before the action, x; null where it is told the true state.",
        )
        .nullable()
        .since(2),
        world("observed_object_y", "The same, y.").nullable().since(2),
        heading("observed_object_theta", "Angle of the block that the policy was told.")
            .nullable()
            .since(2),
        number(
            "pose_confidence",
            "Confidence of the estimate from the picture before the action, 0 to 1; null where there is no picture.",
        )
        .nullable()
        .since(2),
        category(
            "pose_flag",
            "What to think of that estimate, as in table poses; where it is not clear, the policy was told the last clear one.",
        )
        .nullable()
        .since(2),
    ],
};

/// Decisions of rollouts: the reason for every action.
pub const DECISIONS: TableSpec = TableSpec {
    name: "decisions",
    version: 2,
    domain: "",
    formerly: "",
    description: "One row a decision of the policy: what it saw, what it retrieved, how it moved it, what it planned and what it executed. Sorted by seed and decision.",
    columns: &[
        SEED,
        id("decision", "Number of the decision in its rollout, from 0."),
        id("step", "Control step at which it was taken."),
        MODE,
        category("selector", "Rule that chose: two_stage or outcome."),
        world("query_eef_x", "Observed position of the pusher, x."),
        world("query_eef_y", "Observed position of the pusher, y."),
        world("query_object_x", "Observed origin of the block's frame, x."),
        world("query_object_y", "Observed origin of the block's frame, y."),
        heading("query_object_theta", "Observed angle of the block."),
        id(
            "demo",
            "Retrieved demonstration: its episode in the index, which is its place there; demo_name says what it is in the source.",
        ),
        id(
            "demo_frame",
            "Retrieved frame of that demonstration, where the chunk starts.",
        ),
        id("demo_end", "Last frame of the chunk, included."),
        id(
            "compared",
            "How many demonstrations (two_stage) or chunks (outcome) were compared.",
        ),
        number(
            "d_q",
            "Distance of the object-augmented states in normalised coordinates; null for the outcome rule.",
        )
        .nullable(),
        number(
            "d_o",
            "Distance of the object poses alone in normalised coordinates; null for the outcome rule.",
        )
        .nullable(),
        world(
            "delta_x",
            "Translation of the motion that carries the demonstration's object onto the observed one, x; 0 with Reframe off.",
        ),
        world("delta_y", "Translation of that motion, y."),
        heading(
            "delta_theta",
            "Rotation of that motion, about the world's origin, before the translation.",
        ),
        world("set_point_x", "Position that the plan leads the pusher to, x."),
        world("set_point_y", "Position that the plan leads the pusher to, y."),
        category(
            "plan",
            "How it was planned to get there: direct, planned, failed or off.",
        ),
        id("plan_steps", "Control steps of the plan."),
        id(
            "plan_nodes",
            "Nodes of the tree or graph that was searched; 0 where none was.",
        ),
        ColumnSpec::new(
            "plan_path",
            F64List,
            "Polyline of the plan, from the pusher to the set-point: x and y by turns, world frame, px.",
        ),
        id(
            "replay_steps",
            "Control steps of the chunk; fewer are executed when the next decision comes earlier.",
        ),
        world(
            "predicted_object_x",
            "Where the demonstration says the block's origin will be after the chunk, x.",
        ),
        world(
            "predicted_object_y",
            "Where the demonstration says the block's origin will be after the chunk, y.",
        ),
        heading(
            "predicted_object_theta",
            "Angle that the demonstration says the block will have after the chunk.",
        ),
        number("predicted_coverage", "Coverage of the goal at that predicted pose."),
        ColumnSpec::new("reason", Text, "The decision in words."),
        NAME_IN_SOURCE,
    ],
};

/// Outcomes of rollouts under smaller budgets of steps.
pub const BUDGETS: TableSpec = TableSpec {
    name: "budgets",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a budget of control steps, every 50 up to the greatest and the greatest itself: what the rollouts of this artifact had reached by then. A rollout that ended by success keeps its maxima. Intervals are those of 95 %: percentile bootstrap of the mean, Wilson for the success rate. Sorted by budget.",
    columns: &[
        id("budget", "Control steps that count."),
        id("rollouts", "Rollouts behind every figure of the row."),
        number(
            "score_mean",
            "Mean over the rollouts of the greatest score within the budget.",
        ),
        number("score_low", "Lower end of its interval."),
        number("score_high", "Upper end of its interval."),
        number(
            "coverage_mean",
            "Mean over the rollouts of the greatest coverage within the budget.",
        ),
        number("coverage_low", "Lower end of its interval."),
        number("coverage_high", "Upper end of its interval."),
        number(
            "iou_mean",
            "Mean over the rollouts of the greatest IoU within the budget.",
        ),
        number("iou_low", "Lower end of its interval."),
        number("iou_high", "Upper end of its interval."),
        number(
            "success_rate",
            "Share of the rollouts whose coverage passed 0.95 within the budget.",
        ),
        number("success_low", "Lower end of its interval."),
        number("success_high", "Upper end of its interval."),
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

//! The tables of every artifact, described once, so that no stage needs to know another stage's code.
//!
//! Push-T: the world frame is the simulator's 512 x 512 plane, x to the right and y downwards in pictures, in pixels; a
//! growing angle turns clockwise on the screen. Angles are radians. Frames are control steps of 0.1 s.

mod left_out;
mod spatial;
mod spatial_rollouts;

use crate::spec::ColumnKind::{Binary, Bool, Category, F64, F64List, Text, U32};
use crate::spec::{ColumnSpec, TableSpec};

pub use left_out::LEFT_OUT;
pub use spatial::{CAMERA_IMAGES, CONVENTIONS, DEMOS, MODELS, SPATIAL_FRAMES, STATES};
pub use spatial_rollouts::{SPATIAL_DECISIONS, SPATIAL_RESULTS, SPATIAL_STEPS};

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
const MODE: ColumnSpec = category("mode", "Manipulation mode: transit or transfer.");

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

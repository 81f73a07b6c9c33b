//! Tables of robosuite demonstrations: an arm with a two-finger gripper, and one manipulated object.
//!
//! The world frame is robosuite's: metres, z upwards. Frames are control steps of 0.05 s. Quaternions are unit quaternions in
//! the order x, y, z, w. The end effector's position is that of the grip site; what its orientation is that of (the hand
//! body, as robosuite's `robot0_eef_quat`, or the grip site) says row `eef_orientation` of table `conventions`.

use super::{EPISODE, category, flag, id, number};
use crate::spec::ColumnKind::F32List;
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

/// Poses of robosuite's objects, estimated from pictures.
pub const SPATIAL_POSES: TableSpec = TableSpec {
    name: "spatial_poses",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame of every demonstration: the object's pose as the encoder estimates it from the frame's picture alone, and the embedding behind it. No recorded object pose enters. The estimated frame is that of the gripper as it holds the object, a constant rigid offset away from the recorded frame at best. Sorted by episode and frame.",
    columns: &[
        EPISODE,
        FRAME,
        flag(
            "trained_on",
            "Whether pictures of this demonstration were trained on; the others were held out.",
        ),
        world("object_x", "Estimated position, x."),
        world("object_y", "Estimated position, y."),
        world("object_z", "Estimated position, z."),
        attitude("object_qx", "Estimated orientation, quaternion part x."),
        attitude("object_qy", "Estimated orientation, quaternion part y."),
        attitude("object_qz", "Estimated orientation, quaternion part z."),
        attitude("object_qw", "Estimated orientation, quaternion part w."),
        ColumnSpec::new(
            "embedding",
            F32List,
            "The encoder's embedding of the picture, 256 numbers.",
        ),
    ],
};

/// Course of a training.
pub const TRAINING: TableSpec = TableSpec {
    name: "training",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row an epoch of the encoder's training: the losses as trained (means over the epoch's steps), and the same on demonstrations that were held out, which nothing is chosen by.",
    columns: &[
        id("epoch", "Number of the epoch, from 1."),
        id("steps", "Steps of the optimiser until its end."),
        number("learning_rate", "Learning rate in its last step."),
        number("loss", "Weighted sum of the losses."),
        number(
            "absolute",
            "L_abs, before its weight: weighted sum of 10 per metre and 1 per rad.",
        ),
        number("relative", "L_rel, likewise."),
        number("cross", "L_cross, likewise."),
        number(
            "held_out_absolute",
            "L_abs over frames of the demonstrations that were held out, without random crops; null where none was.",
        )
        .nullable(),
    ],
};

/// Errors of an estimator.
pub const POSE_ERRORS: TableSpec = TableSpec {
    name: "pose_errors",
    version: 1,
    domain: "",
    formerly: "",
    description: "One row a frame of every demonstration, made after training from the recorded object poses, which nothing before it has read: error of the estimated pose after one constant rigid offset is removed, which is fitted on frames before the grasp of the demonstrations trained on. Turns of the object that do not show are no error; of an object without such turns neither is half a turn of the two-finger gripper about its axis of approach. Sorted by episode and frame.",
    columns: &[
        EPISODE,
        FRAME,
        flag("trained_on", "Whether pictures of this demonstration were trained on."),
        category(
            "phase",
            "before_grasp: transit that transfer follows, or no transfer at all; held: transfer; after_release: transit after the last transfer.",
        ),
        length(
            "translation",
            "Distance between estimated and recorded position, at the origin of the recorded frame.",
        ),
        length(
            "translation_at_grasp",
            "The same at the origin of the estimated frame, which is where the gripper grasps.",
        ),
        turn(
            "rotation",
            "Angle between estimated and recorded orientation, up to those turns.",
        ),
        flag(
            "half_turn",
            "Whether the estimated frame was taken to be turned by half a turn about the axis of approach.",
        ),
    ],
};

//! The tables of `poses` and `encoder` artifacts.

use nalgebra::Isometry3;
use re4_artifact::{Word, columns, table};

use crate::estimator::Flag;
use crate::spatial::{FrameError, GraspPhase};

table! {
    /// One row per frame of every demonstration: the object's pose as estimated from the frame's image only, and its reliability.
    /// Recorded object poses are not used. Sorted by episode and frame.
    #[table("poses", version = 3, formerly = "spatial_poses")]
    pub struct PoseRow<E> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// The estimate.
        #[prefix = ""]
        pub estimate: E,
    }
}

columns! {
    /// An encoder's estimate for an image. The estimated frame is that of the gripper when it holds the object: it differs from
    /// the recorded frame by a constant rigid offset at best.
    pub struct SpatialEstimate {
        /// Whether images of this demonstration were in the training set; if not, they were held out.
        pub trained_on: bool,
        /// Estimated pose of the object.
        #[frame = "world"]
        pub object: Isometry3<f64>,
        /// The fraction of held-out frames with a similar disagreement of the image's crops whose estimates agree with their
        /// demonstration's anchor, 0 to 1; null if the encoder uses one crop or there are no held-out demonstrations.
        pub confidence: Option<f64>,
        /// Whether the confidence is below 0.5; null if it is.
        pub unsure: Option<bool>,
        /// The encoder's embedding of the image: 256 numbers of a ResNet-18, or the x and y of every keypoint in units of half an
        /// image side from the image's centre.
        pub embedding: Vec<f32>,
    }
}

table! {
    /// One row per pixel of the 96 x 96 images: the fraction of it that the goal covers, over all images. The pose of this mask is
    /// the goal pose, and angles are measured relative to it. Sorted by row and column.
    #[table("anchor", version = 2)]
    pub struct AnchorRow {
        /// Row of the image, from 0 at the top.
        pub row: usize,
        /// Column of the image, from 0 at the left.
        pub column: usize,
        /// Fraction of the pixel that has the goal's colour, 0 to 1.
        #[formerly = "goal_share"]
        pub goal_fraction: f64,
    }
}

table! {
    /// One row per demonstration with a grasp: the pose that the encoder's training takes as the object's before the grasp, for all
    /// of the demonstration's frames. Sorted by episode.
    #[table("labels", version = 1)]
    pub struct LabelRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Whether images of this demonstration were in the training set.
        pub trained_on: bool,
        /// The frame whose end-effector pose is the anchor.
        pub frame: u32,
        /// The anchor: the end effector's pose at the grasp.
        #[frame = "world"]
        pub anchor: Isometry3<f64>,
    }
}

table! {
    /// One row per epoch of the encoder's training: the training losses (means over the epoch's steps), and the loss on held-out
    /// demonstrations, which does not influence the training.
    #[table("training", version = 1)]
    pub struct TrainingRow {
        /// Number of the epoch, from 1.
        pub epoch: u32,
        /// Number of optimiser steps up to the end of the epoch.
        pub steps: u32,
        /// Learning rate of the epoch's last step.
        pub learning_rate: f64,
        /// Weighted sum of the losses.
        pub loss: f64,
        /// L_abs, before its weight: the distance of two poses as `losses.distance` and its weights define it.
        pub absolute: f64,
        /// L_rel, in the same unit.
        pub relative: f64,
        /// L_cross, in the same unit.
        pub cross: f64,
        /// L_abs over frames of the held-out demonstrations, without random crops; null if there are none.
        pub held_out_absolute: Option<f64>,
    }
}

table! {
    /// One row per frame of every demonstration: the error of the estimated pose with respect to the recorded object pose, which
    /// is used only here, after training. One constant rigid offset is removed, which is fitted on frames before the grasp of the
    /// demonstrations trained on. Rotations within the object's symmetry are no error. For an object without a symmetry by pi, a
    /// rotation by pi of the two-finger gripper about its axis of approach is no error either. Sorted by episode and frame.
    #[table("pose_errors", version = 2)]
    pub struct PoseErrorRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// Whether images of this demonstration were in the training set.
        pub trained_on: bool,
        /// before_grasp: transit before transfer, or all frames if there is no transfer; held: transfer; after_release: transit
        /// after the last transfer.
        pub phase: GraspPhase,
        /// The error.
        #[prefix = ""]
        pub error: FrameError,
    }
}

impl Word for Flag {
    const ALL: &'static [Self] = &Self::ALL;

    fn word(self) -> &'static str {
        self.as_str()
    }
}

impl Word for GraspPhase {
    const ALL: &'static [Self] = &Self::ALL;

    fn word(self) -> &'static str {
        self.as_str()
    }
}

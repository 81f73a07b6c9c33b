//! The tables of a `poses` artifact.

use nalgebra::Isometry3;
use re4_artifact::{Word, columns, table};

use crate::estimator::Flag;
use crate::spatial::{FrameError, GraspPhase};

table! {
    /// One row a frame of every demonstration: the object's pose as estimated from the frame's image alone, and what to think of it.
    /// No recorded object pose enters. Sorted by episode and frame.
    #[table("poses", version = 2, formerly = "spatial_poses")]
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
    /// What an encoder says of an image. The estimated frame is that of the gripper as it holds the object, a constant rigid offset
    /// away from the recorded frame at best.
    pub struct SpatialEstimate {
        /// Whether images of this demonstration were trained on; the others were held out.
        pub trained_on: bool,
        /// Estimated pose.
        #[frame = "world"]
        pub object: Isometry3<f64>,
        /// The encoder's embedding of the image, 256 numbers.
        pub embedding: Vec<f32>,
    }
}

table! {
    /// One row a pixel of the 96 x 96 images: how much of it the goal covers, as seen over the images. The goal pose is the pose of
    /// this mask; angles are measured from it. Sorted by row and column.
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
    /// One row an epoch of the encoder's training: the losses as trained (means over the epoch's steps), and the same on
    /// demonstrations that were held out, which nothing is chosen by.
    #[table("training", version = 1)]
    pub struct TrainingRow {
        /// Number of the epoch, from 1.
        pub epoch: u32,
        /// Steps of the optimiser until its end.
        pub steps: u32,
        /// Learning rate in its last step.
        pub learning_rate: f64,
        /// Weighted sum of the losses.
        pub loss: f64,
        /// L_abs, before its weight: weighted sum of 10 per metre and 1 per rad.
        pub absolute: f64,
        /// L_rel, likewise.
        pub relative: f64,
        /// L_cross, likewise.
        pub cross: f64,
        /// L_abs over frames of the demonstrations that were held out, without random crops; null where none was.
        pub held_out_absolute: Option<f64>,
    }
}

table! {
    /// One row a frame of every demonstration, made after training from the recorded object poses, which nothing before it has read:
    /// error of the estimated pose after one constant rigid offset is removed, which is fitted on frames before the grasp of the
    /// demonstrations trained on. Rotations of the object that do not show are no error; of an object without such rotations neither
    /// is half a rotation of the two-finger gripper about its axis of approach. Sorted by episode and frame.
    #[table("pose_errors", version = 2)]
    pub struct PoseErrorRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// Whether images of this demonstration were trained on.
        pub trained_on: bool,
        /// before_grasp: transit that transfer follows, or no transfer at all; held: transfer; after_release: transit after the last
        /// transfer.
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

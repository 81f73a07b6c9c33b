//! The tables of an `episodes` artifact, which all stages after ingest read.
//!
//! In the plane, the world frame is the 512 x 512 window of Push-T: pixels, x to the right and y downwards in images, so that a
//! growing angle turns clockwise on the screen; a frame is a control step of 0.1 s. In space it is robosuite's: metres, z
//! upwards; a frame is a control step of 0.05 s. The end effector is the grip site there, and a gripper command above 0
//! closes, whatever the dataset has. What it has in another frame or with another sign is kept in columns `raw_*`, which are
//! null where it does not differ: every artifact has the same columns, and one of nulls takes no room.

#![allow(
    clippy::doc_markdown,
    reason = "documentation of rows and fields is the plain text of descriptions in files"
)]

use nalgebra::{Isometry3, UnitQuaternion};
use re4_episode::SpatialFrame;
use re4_geometry::{Point2, Pose2};
use serde::{Deserialize, Serialize};

use crate::{Label, SixAxis, columns, table};

/// Number of keypoints of Push-T's block.
pub const KEYPOINTS: usize = 9;

table! {
    /// One row a demonstration, in the order of the artifact.
    #[table("episodes", version = 2)]
    pub struct EpisodeRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the demonstration in its source: of Push-T its place there, from 0; of an HDF5 file, whose demonstrations have
        /// names (table demos), the number that the name ends in, null where there is none, it exceeds 32 bits, or several have
        /// it. In artifacts of version 1 a place stands in for those numbers.
        pub source_episode: Option<u32>,
        /// Frames of the demonstration.
        pub frames: usize,
    }
}

table! {
    /// One row a demonstration: what it is called in its source and what was measured on it. Sorted by episode.
    #[table("demos", version = 1)]
    pub struct DemoRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Its name: that of its group below /data of an HDF5 file, such as demo_12; of Push-T the word episode and its number.
        pub demo: String,
        /// Filter keys of /mask that list it, comma-separated; empty where none does.
        pub filter_keys: String,
        /// Row of table models that holds its MJCF; null where it has none.
        pub model: Option<u32>,
        /// Largest distance between the goal positions of the recorded absolute actions and those converted from delta actions,
        /// beyond the first step; null where only one kind is known.
        #[unit = "m"]
        pub goal_error_position: Option<f64>,
        /// Largest angle between the goal orientations, likewise.
        #[unit = "rad"]
        pub goal_error_rotation: Option<f64>,
    }
}

table! {
    /// One row a frame of every demonstration: the object-augmented state, the action and what was recorded beside it. Sorted by
    /// episode and frame.
    #[table("frames", version = 2, formerly = "spatial_frames")]
    pub struct FrameRow<F> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0; one control step each.
        pub frame: u32,
        /// What was recorded.
        #[prefix = ""]
        pub recorded: F,
    }
}

columns! {
    /// A frame in the plane.
    pub struct PlanarColumns {
        /// Position of the pusher's centre.
        #[frame = "world"]
        pub eef: Point2,
        /// Pose of the block; null where the dataset has none.
        #[frame = "world"]
        pub object: Option<Pose2>,
        /// Target position commanded to the pusher.
        #[frame = "world"]
        pub action: Point2,
        /// Contact points between pusher and block counted during the control step that led to this frame; null where they were not
        /// recorded.
        pub contacts: Option<f64>,
        /// Recorded keypoint of the block; null where none were.
        #[frame = "world"]
        #[prefix = "keypoint"]
        pub keypoints: Option<[Point2; KEYPOINTS]>,
    }
}

columns! {
    /// A frame in space. Numbers that the dataset has are copied bit for bit unless a column `raw_*` beside them says otherwise;
    /// which of the two kinds of actions it has says row action_kind of table conventions, the other one is converted.
    pub struct SpatialColumns {
        /// Pose of the grip site. In artifacts of version 1 its orientation is the recorded one.
        #[frame = "world"]
        pub eef: Isometry3<f64>,
        /// Pose of the manipulated object; null where the dataset has none.
        #[frame = "world"]
        pub object: Option<Isometry3<f64>>,
        /// Joint position of a finger, from 0 closed to 0.04 open, of the second with the opposite sign.
        #[unit = "m"]
        #[prefix = "finger"]
        pub fingers: [f64; 2],
        /// Delta action: motion of the goal, each number in [-1, 1]; 1 is the controller's output_max.
        #[unit = "1"]
        #[frame = "world"]
        pub delta: SixAxis,
        /// Absolute action: goal of the grip site.
        #[frame = "world"]
        pub goal: SixAxis,
        /// Gripper command: below 0 opens, above 0 closes. In artifacts of version 1 its sign is the recorded one.
        pub gripper: f64,
        /// Reward of the step; null where it was not recorded.
        pub reward: Option<f64>,
        /// Whether the step was recorded as the last or as a success; null where it was not recorded.
        pub done: Option<bool>,
        /// Recorded orientation of the end effector, where it is that of another frame (row eef_orientation of table conventions).
        #[frame = "world"]
        #[since = 2]
        pub raw_eef: Option<UnitQuaternion<f64>>,
        /// Recorded gripper command, where its sign or range is another (rows gripper_sign and gripper_range of table conventions).
        #[since = 2]
        pub raw_gripper: Option<f64>,
    }
}

table! {
    /// One row an image, sorted by camera, episode and frame: the recorded one, or the one rendered from the recorded state where the
    /// summary of the artifact says so, lossless. Row groups are small, so that an image can be read alone.
    #[table("images", version = 2, formerly = "camera_images")]
    pub struct ImageRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// Name of the camera: agentview, robot0_eye_in_hand, ..., or img, the one of Push-T; null in old artifacts of Push-T.
        #[since = 2]
        pub camera: Option<Label>,
        /// The bytes of a PNG file, 8 bits a channel, RGB, first row at the top.
        pub image: Vec<u8>,
    }
}

table! {
    /// One row a convention of the dataset that its values depend on, with the evidence that it holds.
    #[table("conventions", version = 1)]
    pub struct Convention {
        /// What it is about: object_layout, eef_orientation, eef_quaternion, action_kind, gripper_sign, ....
        pub convention: Label,
        /// How it is in this dataset.
        pub value: Label,
        /// Why that is believed: proven, by the evidence of this row; setting, by an explicit setting of the pipeline; declared, by the
        /// file's own words where nothing depends on it.
        pub basis: Label,
        /// The test that was made, in words.
        pub evidence: String,
        /// What the test measured for this value; null where nothing was measured.
        pub residual: Option<f64>,
        /// What it measured for the next best value; null where there is none.
        pub runner_up: Option<f64>,
        /// What the residual has to be below; null where nothing was measured.
        pub threshold: Option<f64>,
        /// Unit of the three; empty for none.
        pub unit: Label,
        /// Frames that the test was made on.
        pub frames: usize,
    }
}

table! {
    /// One row a demonstration of the source that was asked for and cannot be used, and so is not in this artifact. There is no such
    /// table where all can. In the order of the source.
    #[table("left_out", version = 1)]
    #[derive(Eq, Serialize, Deserialize)]
    pub struct LeftOut {
        /// Its name in the source: a group such as demo_12, or episode 12 of Push-T.
        pub demo: String,
        /// What is wrong with it, one sentence with the remedy, without the path of the dataset.
        pub why: String,
    }
}

table! {
    /// One row a frame, in the order of table frames: the recorded state of the simulator before the action.
    #[table("states", version = 1)]
    pub struct StateRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0; one control step each.
        pub frame: u32,
        /// Flattened MuJoCo state: time, qpos, qvel.
        pub state: Vec<f64>,
    }
}

table! {
    /// One row a distinct MuJoCo model of the dataset, in the order of first use. Asset paths are those of the machine that
    /// recorded.
    #[table("models", version = 1)]
    pub struct ModelRow {
        /// Number of the model, from 0.
        pub model: u32,
        /// The model as MJCF.
        pub mjcf: String,
    }
}

impl SpatialColumns {
    /// The frame in the vocabulary of the pipeline; none without the pose of the object.
    pub fn frame(&self) -> Option<SpatialFrame> {
        Some(SpatialFrame {
            eef: self.eef,
            object: self.object?,
            fingers: self.fingers,
            delta: self.delta.0,
            goal: self.goal.0,
            gripper: self.gripper,
            reward: self.reward,
        })
    }
}

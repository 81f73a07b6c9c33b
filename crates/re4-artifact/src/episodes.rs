//! The tables of an `episodes` artifact, which all stages after ingest read.
//!
//! Planar tables (Push-T): the world frame is the 512 x 512 window in pixels, x to the right and y downwards in images, so that a
//! growing angle is a clockwise rotation on the screen; a frame is a control step of 0.1 s.
//!
//! Tables of SE(3) (robosuite): the world frame is robosuite's, in metres, z upwards; a frame is a control step of 0.05 s. The
//! end effector is the grip site, and a gripper command above 0 closes. Ingest converts datasets with other conventions. It keeps
//! recorded values of another frame or with another sign in columns `raw_*`, which are null if the conventions agree: all
//! artifacts have the same columns, and a column of nulls needs no space.
//!
//! Tables of an arm without an object (task `arm`): vectors are recorded numbers in recorded units, named element by element in table
//! `signals`. Poses of the end effector are in the frame in which they were recorded, usually that of the robot's base.

#![allow(
    clippy::doc_markdown,
    reason = "documentation of rows and fields is the plain text of descriptions in files"
)]

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use re4_episode::SpatialFrame;
use re4_geometry::{Point2, Pose2};
use serde::{Deserialize, Serialize};

use crate::{Label, SixAxis, Word, columns, table};

/// Number of keypoints of Push-T's block.
pub const KEYPOINTS: usize = 9;

table! {
    /// One row per demonstration, in the order of the artifact.
    #[table("episodes", version = 2)]
    pub struct EpisodeRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the demonstration in its source. Push-T: its index, from 0. HDF5 files, whose demonstrations have names
        /// (table demos): the number at the end of the name; null if the name has none, the number exceeds 32 bits, or several
        /// demonstrations have the same number. In tables of version 1 it is the index of the demonstration also for
        /// HDF5 files.
        pub source_episode: Option<u32>,
        /// Number of frames of the demonstration.
        pub frames: usize,
    }
}

table! {
    /// One row per demonstration: its name in the source and measurements on it. Sorted by episode.
    #[table("demos", version = 1)]
    pub struct DemoRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Name of the demonstration. HDF5 files: the name of its group in /data, such as demo_12. Push-T: the word episode and
        /// its number.
        pub demo: String,
        /// Filter keys in /mask that contain the demonstration, comma-separated; empty if there are none.
        pub filter_keys: String,
        /// Row of its MJCF in table models; null if it has none.
        pub model: Option<u32>,
        /// Largest distance between the goal positions of the recorded absolute actions and of the absolute actions converted
        /// from delta actions, without the first step; null if only one kind of action is known.
        #[unit = "m"]
        pub goal_error_position: Option<f64>,
        /// Largest angle between the goal orientations of the recorded and of the converted absolute actions, without the first
        /// step; null if only one kind of action is known.
        #[unit = "rad"]
        pub goal_error_rotation: Option<f64>,
    }
}

table! {
    /// One row per frame of every demonstration: the object-augmented state, the action and other recorded values. Sorted by
    /// episode and frame.
    #[table("frames", version = 2, formerly = "spatial_frames")]
    pub struct FrameRow<F> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0. A frame is one control step.
        pub frame: u32,
        /// The recorded values.
        #[prefix = ""]
        pub recorded: F,
    }
}

columns! {
    /// A frame of a planar demonstration.
    pub struct PlanarColumns {
        /// Position of the pusher's centre.
        #[frame = "world"]
        pub eef: Point2,
        /// Pose of the block; null if the dataset has none.
        #[frame = "world"]
        pub object: Option<Pose2>,
        /// Target position commanded to the pusher.
        #[frame = "world"]
        pub action: Point2,
        /// Number of contact points between pusher and block during the control step before this frame; null if it was not
        /// recorded.
        pub contacts: Option<f64>,
        /// Recorded keypoint of the block; null if keypoints were not recorded.
        #[frame = "world"]
        #[prefix = "keypoint"]
        pub keypoints: Option<[Point2; KEYPOINTS]>,
    }
}

columns! {
    /// A frame of a demonstration in SE(3). Columns are bit-exact copies of recorded numbers unless a column `raw_*` contains them. Row
    /// action_kind of table conventions states which kind of action was recorded; the other kind is converted from it.
    pub struct SpatialColumns {
        /// Pose of the grip site. In tables of version 1, the orientation is the recorded one, even if it is that of another
        /// frame.
        #[frame = "world"]
        pub eef: Isometry3<f64>,
        /// Pose of the manipulated object; null if the dataset has none.
        #[frame = "world"]
        pub object: Option<Isometry3<f64>>,
        /// Joint position of a finger, from 0 (closed) to 0.04 (open); that of the second finger has the opposite sign.
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
        /// Gripper command: below 0 opens, above 0 closes. In tables of version 1, its sign is the recorded one.
        pub gripper: f64,
        /// Reward of the step; null if it was not recorded.
        pub reward: Option<f64>,
        /// Whether the step was recorded as the last one or as a success; null if it was not recorded.
        pub done: Option<bool>,
        /// Recorded orientation of the end effector if it is that of another frame than the grip site (row eef_orientation of
        /// table conventions), else null.
        #[frame = "world"]
        #[since = 2]
        pub raw_eef: Option<UnitQuaternion<f64>>,
        /// Recorded gripper command if it has another sign or range (rows gripper_sign and gripper_range of table conventions),
        /// else null.
        #[since = 2]
        pub raw_gripper: Option<f64>,
    }
}

columns! {
    /// A frame of a demonstration of one arm, without an object. The vectors are those of the recording; table signals names their
    /// elements. The other columns are derived from elements of the vectors or from further recorded arrays, so that no reader has to
    /// know the robot.
    #[domain = "arm"]
    pub struct ArmColumns {
        /// Time of the frame since the start of the demonstration, as it was recorded; null if times were not recorded.
        #[unit = "s"]
        pub time: Option<f64>,
        /// Recorded state, with as many elements in every frame as table signals has rows of vector state.
        pub state: Vec<f64>,
        /// Recorded action, with as many elements in every frame as table signals has rows of vector action.
        pub action: Vec<f64>,
        /// Position of the end effector; null if the dataset has none.
        #[frame = "recorded"]
        pub eef: Option<Vector3<f64>>,
        /// Orientation of the end effector, converted to a quaternion; null if the dataset has none.
        #[frame = "recorded"]
        pub eef_orientation: Option<UnitQuaternion<f64>>,
        /// Measured opening of the gripper, in the recorded unit and with the recorded sign: the distance between two fingers if both were
        /// recorded, else the recorded number. Null if the dataset has none.
        pub opening: Option<f64>,
        /// Gripper command, as it was recorded; null if the actions have none.
        pub gripper: Option<f64>,
        /// Reward of the step; null if it was not recorded.
        pub reward: Option<f64>,
        /// Whether the step was recorded as the last one or as a success; null if it was not recorded.
        pub done: Option<bool>,
    }
}

/// A vector of a frame of [`ArmColumns`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SignalVector {
    /// The recorded state.
    State,
    /// The recorded action.
    Action,
}

impl Word for SignalVector {
    const ALL: &'static [Self] = &[Self::State, Self::Action];

    fn word(self) -> &'static str {
        match self {
            Self::State => "state",
            Self::Action => "action",
        }
    }
}

/// What an element of a recorded vector measures or commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SignalRole {
    /// A joint of the arm.
    Joint,
    /// A coordinate of the end effector's position, or of its displacement.
    EefPosition,
    /// A number of the end effector's orientation, or of its rotation.
    EefOrientation,
    /// The gripper: its opening, a finger, or its command.
    Gripper,
    /// Anything else.
    Other,
}

impl Word for SignalRole {
    const ALL: &'static [Self] = &[
        Self::Joint,
        Self::EefPosition,
        Self::EefOrientation,
        Self::Gripper,
        Self::Other,
    ];

    fn word(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::EefPosition => "eef_position",
            Self::EefOrientation => "eef_orientation",
            Self::Gripper => "gripper",
            Self::Other => "other",
        }
    }
}

table! {
    /// One row per element of the vectors state and action of table frames. Sorted by vector (state before action) and index.
    #[table("signals", version = 1)]
    #[domain = "arm"]
    pub struct SignalRow {
        /// Vector of table frames: state or action.
        pub vector: SignalVector,
        /// Index of the element in its vector, from 0.
        pub index: u32,
        /// Name of the element in the source. Elements of an array without names have the name of the array and their index, such as
        /// robot0_eef_pos_2.
        pub name: String,
        /// What the element measures or commands: joint, eef_position, eef_orientation, gripper or other.
        pub role: SignalRole,
        /// Unit of the element; null if it is not known.
        pub unit: Option<Label>,
        /// Where the role comes from: name (of the element or of its array), setting (of the pipeline file) or proof (of the
        /// numbers).
        pub basis: Label,
    }
}

table! {
    /// One row per image, sorted by camera, episode and frame. Images are stored without loss. They are recorded or, according to the
    /// summary of the artifact, rendered from the recorded states. Row groups are small, so that single images can be read.
    #[table("images", version = 2, formerly = "camera_images")]
    pub struct ImageRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// Name of the camera: agentview, robot0_eye_in_hand and others; img for Push-T, but null in its tables of version 1.
        #[since = 2]
        pub camera: Option<Label>,
        /// The bytes of a PNG file, 8 bits per channel, RGB, first row at the top.
        pub image: Vec<u8>,
    }
}

table! {
    /// One row per convention that the meaning of the dataset's values depends on, with the evidence for it.
    #[table("conventions", version = 1)]
    pub struct Convention {
        /// Name of the convention: object_layout, eef_orientation, eef_quaternion, action_kind, gripper_sign and others.
        pub convention: Label,
        /// The convention of this dataset.
        pub value: Label,
        /// How the value was determined: proven (by the evidence in this row), setting (by an explicit setting of the pipeline),
        /// or declared (by metadata of the file, for conventions on which nothing depends).
        pub basis: Label,
        /// Description of the test.
        pub evidence: String,
        /// Residual of the test for this value; null if nothing was measured.
        pub residual: Option<f64>,
        /// Residual of the test for the second best value; null if there is none.
        pub runner_up: Option<f64>,
        /// Upper limit of the residual; null if nothing was measured.
        pub threshold: Option<f64>,
        /// Unit of residual, runner_up and threshold; empty for none.
        pub unit: Label,
        /// Number of frames that were tested.
        pub frames: usize,
    }
}

table! {
    /// One row per requested demonstration of the source that cannot be used and is therefore not in this artifact, in the order
    /// of the source. The table does not exist if all demonstrations can be used.
    #[table("left_out", version = 1)]
    #[derive(Eq, Serialize, Deserialize)]
    pub struct LeftOut {
        /// Name of the demonstration in the source: a group such as demo_12, or episode 12 for Push-T.
        pub demo: String,
        /// Why it cannot be used: one sentence with the remedy, without the path of the dataset.
        pub why: String,
    }
}

table! {
    /// One row per frame of every demonstration that was left out although it can be read: it contradicts what most of the other
    /// demonstrations prove, for example with the opposite sign of the gripper command. The values follow the conventions of the
    /// other demonstrations. Only the audit reads them. Sorted by demonstration and frame.
    #[table("left_out_frames", version = 2)]
    pub struct LeftOutFrameRow<F> {
        /// Number of the demonstration's row in table left_out, from 0.
        pub left_out: u32,
        /// Number of the frame in its episode, from 0. A frame is one control step.
        pub frame: u32,
        /// The recorded values.
        #[prefix = ""]
        pub recorded: F,
    }
}

table! {
    /// One row per frame, in the order of table frames: the recorded state of the simulator before the action.
    #[table("states", version = 1)]
    pub struct StateRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0. A frame is one control step.
        pub frame: u32,
        /// Flattened MuJoCo state: time, qpos, qvel.
        pub state: Vec<f64>,
    }
}

table! {
    /// One row per distinct MuJoCo model of the dataset, in the order of first use. Asset paths are those of the machine on which
    /// the dataset was recorded.
    #[table("models", version = 1)]
    pub struct ModelRow {
        /// Number of the model, from 0.
        pub model: u32,
        /// The model in MJCF.
        pub mjcf: String,
    }
}

impl SpatialColumns {
    /// Converts the row to the frame type of the pipeline; `None` if the pose of the object is null.
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

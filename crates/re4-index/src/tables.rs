//! Tables of an `index` artifact.

use nalgebra::Isometry3;
use re4_artifact::{SixAxis, columns, table};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};

table! {
    /// One row per frame of every indexed demonstration: its object-augmented state and the action taken at the frame. Sorted by
    /// episode and frame.
    #[table("index", version = 3, formerly = "spatial_index")]
    pub struct IndexRow<S> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in the episode, from 0.
        pub frame: u32,
        /// Manipulation mode: transit or transfer.
        pub mode: Mode,
        /// State and action.
        #[prefix = ""]
        pub state: S,
        /// Whether Retrieve may select the frame. A frame that it may not select can still be replayed. False for frames whose
        /// pose estimate is not flagged clear, which have a pose interpolated between the surrounding clear frames, and for
        /// frames that the pipeline excludes because of an audit finding. Null in older artifacts, in which Retrieve may select
        /// every frame.
        #[since = 2]
        pub retrievable: Option<bool>,
    }
}

columns! {
    /// A planar object-augmented state and the action taken in it.
    #[derive(Copy)]
    pub struct PlanarState {
        /// Position of the pusher's centre.
        #[frame = "world"]
        pub eef: Point2,
        /// Pose of the block.
        #[frame = "world"]
        pub object: Pose2,
        /// Commanded target position of the pusher.
        #[frame = "world"]
        pub action: Point2,
        /// Normalised coordinates: eef_x, eef_y, object_x, object_y, object_theta.
        pub q: [f64; 5],
    }
}

columns! {
    /// An object-augmented state in SE(3) and the action taken in it. The scales and weights of the distances are settings of the
    /// policy; the object's symmetry belongs to the task.
    #[derive(Copy)]
    pub struct SpatialState {
        /// Pose of the grip site.
        #[frame = "world"]
        pub eef: Isometry3<f64>,
        /// Pose of the manipulated object.
        #[frame = "world"]
        pub object: Isometry3<f64>,
        /// Absolute action: goal pose of the grip site.
        #[frame = "world"]
        pub goal: SixAxis,
        /// Gripper command: below 0 opens, above 0 closes.
        pub gripper: f64,
    }
}

table! {
    /// One row per dimension of the planar object-augmented state, with the range that normalises it.
    #[table("scales", version = 1)]
    pub struct ScaleRow {
        /// Name of the dimension, a column of the index table.
        pub dimension: String,
        /// Minimum value, in the dimension's own unit.
        pub minimum: f64,
        /// Maximum value, in the dimension's own unit.
        pub maximum: f64,
    }
}

//! The tables of an `index` artifact.

use nalgebra::Isometry3;
use re4_artifact::{SixAxis, columns, table};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};

table! {
    /// One row a frame of every indexed demonstration: its object-augmented state and the action taken there. Sorted by episode and
    /// frame.
    #[table("index", version = 3, formerly = "spatial_index")]
    pub struct IndexRow<S> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// Manipulation mode: transit or transfer.
        pub mode: Mode,
        /// State and action.
        #[prefix = ""]
        pub state: S,
        /// Whether Retrieve may choose the frame; others may still be replayed. Not those whose pose was not clear in the image, which
        /// have a pose between those of the clear frames round it, nor those that the pipeline leaves out for what the audit found.
        /// Null in older artifacts, whose frames all may.
        #[since = 2]
        pub retrievable: Option<bool>,
    }
}

columns! {
    /// An object-augmented state in the plane, and the action taken there.
    #[derive(Copy)]
    pub struct PlanarState {
        /// Position of the pusher's centre.
        #[frame = "world"]
        pub eef: Point2,
        /// Pose of the block.
        #[frame = "world"]
        pub object: Pose2,
        /// Target position commanded to the pusher.
        #[frame = "world"]
        pub action: Point2,
        /// Normalised coordinates: eef_x, eef_y, object_x, object_y, object_theta.
        pub q: [f64; 5],
    }
}

columns! {
    /// An object-augmented state in space, and the action taken there. Scales and weights of the distances, and the object's
    /// symmetry, are settings of the policy.
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
    /// One row a dimension of the object-augmented state in the plane: the range that it is normalised by.
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

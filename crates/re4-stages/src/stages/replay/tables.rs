//! The tables of a `replays` artifact.

use re4_artifact::{Label, columns, table};
use re4_policy::Divergence;

table! {
    /// Divergence between open-loop replays and recordings. One row per replay, which executes the demonstration's actions from
    /// its first state. Sorted by episode.
    #[table("replays", version = 4, formerly = "spatial_replays")]
    pub struct ReplayRow<R> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the demonstration in its source, as in table episodes.
        pub source_episode: Option<u32>,
        /// Number of frames compared.
        pub frames: usize,
        /// Results of the replay.
        #[prefix = ""]
        pub replay: R,
        /// Name of the demonstration in its source: the group below /data of an HDF5 file, such as demo_12; for Push-T the word
        /// episode and its number. Null in older artifacts.
        #[since = 2]
        pub demo_name: Option<String>,
    }
}

columns! {
    /// Results of a planar replay. The distance between two poses of the block is the root mean square displacement of its
    /// points.
    #[domain = "plane"]
    pub struct PlanarReplay {
        /// Maximum distance between the replayed and the recorded pusher.
        #[unit = "px"]
        pub pusher_max: f64,
        /// Median distance between the replayed and the recorded block.
        #[unit = "px"]
        pub block_median: f64,
        /// Maximum distance between the replayed and the recorded block.
        #[unit = "px"]
        pub block_max: f64,
        /// Distance between the replayed and the recorded block at the last frame.
        #[unit = "px"]
        pub block_final: f64,
        /// Coverage of the goal at the last recorded frame.
        pub coverage_recorded: f64,
        /// Coverage of the goal at the same frame of the replay.
        pub coverage_replayed: f64,
        /// Coverage of the goal after the last action; the recording has no frame after it.
        pub coverage_after: f64,
    }
}

columns! {
    /// Results of a replay of a robosuite task. Distances are between the simulated and the recorded state before the same
    /// action.
    #[domain = "space"]
    pub struct SpatialReplay {
        /// Kind of the executed actions: delta or absolute.
        pub actions: Label,
        /// Origin of the actions: recorded, or converted from the other kind.
        pub origin: Label,
        /// Whether the task's success rule was satisfied after any action.
        pub success: bool,
        /// First action after which the success rule was satisfied; null if there is none.
        pub first_success: Option<usize>,
        /// Whether the success rule was satisfied after the last action.
        pub success_at_end: bool,
        /// Maximum distance between the simulated and the recorded object's origin.
        #[unit = "m"]
        pub object_max: f64,
        /// Distance between the simulated and the recorded object's origin before the last action.
        #[unit = "m"]
        pub object_final: f64,
        /// Maximum angle between the simulated and the recorded object's orientation.
        #[unit = "rad"]
        #[formerly = "object_turn_max"]
        pub object_rotation_max: f64,
        /// Maximum distance between the simulated and the recorded grip site.
        #[unit = "m"]
        pub eef_max: f64,
        /// Maximum difference between a simulated and a recorded joint position of the arm.
        #[unit = "rad"]
        pub arm_max: f64,
    }
}

table! {
    /// Distance between each replay and its recording, one row per frame. Sorted by episode and frame; for robosuite tasks by
    /// episode, actions and frame.
    #[table("divergence", version = 3, formerly = "spatial_divergence")]
    pub struct DivergenceRow<D> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// Distance between the replay and the recording.
        #[prefix = ""]
        pub distance: D,
    }
}

columns! {
    /// Distance between a replay of a robosuite task and its recording before an action.
    #[domain = "space"]
    pub struct SpatialDivergence {
        /// Kind of the executed actions: delta or absolute.
        pub actions: Label,
        /// Distance between the simulated and the recorded object's origin.
        #[unit = "m"]
        pub object: f64,
        /// Angle between the simulated and the recorded object's orientation.
        #[unit = "rad"]
        #[formerly = "object_turn"]
        pub object_rotation: f64,
        /// Distance between the simulated and the recorded grip site.
        #[unit = "m"]
        pub eef: f64,
    }
}

/// A row of table `divergence` for a planar replay.
pub type PlanarDivergenceRow = DivergenceRow<Divergence>;

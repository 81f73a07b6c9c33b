//! The tables of a `replays` artifact.

use re4_artifact::{Label, columns, table};
use re4_policy::Divergence;

table! {
    /// One row a demonstration whose actions were replayed open-loop from its own first state: how far the simulator strays from the
    /// recording. Sorted by episode.
    #[table("replays", version = 4, formerly = "spatial_replays")]
    pub struct ReplayRow<R> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the demonstration in its source, as in table episodes.
        pub source_episode: Option<u32>,
        /// Frames compared.
        pub frames: usize,
        /// What came of it.
        #[prefix = ""]
        pub replay: R,
        /// Name of the demonstration in its source: the group below /data of an HDF5 file, such as demo_12; of Push-T the word episode
        /// and its number. Null in older artifacts.
        #[since = 2]
        pub demo_name: Option<String>,
    }
}

columns! {
    /// A replay in the plane. The distance between two poses of the block is the root mean square displacement of its points.
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
        /// Coverage of the goal after the last action, which no recorded frame shows.
        pub coverage_after: f64,
    }
}

columns! {
    /// A replay in space. Distances are between the simulator's state and the recorded one before the same action.
    #[domain = "space"]
    pub struct SpatialReplay {
        /// Which actions were played: delta or absolute.
        pub actions: Label,
        /// Where they come from: recorded, or converted from the other kind.
        pub origin: Label,
        /// Whether the task's success rule held after some action.
        pub success: bool,
        /// First action after which it held; null where it never did.
        pub first_success: Option<usize>,
        /// Whether it held after the last one.
        pub success_at_end: bool,
        /// Largest distance of the object's origin from the recorded one.
        #[unit = "m"]
        pub object_max: f64,
        /// The same before the last action.
        #[unit = "m"]
        pub object_final: f64,
        /// Largest angle between the object's orientation and the recorded one.
        #[unit = "rad"]
        #[formerly = "object_turn_max"]
        pub object_rotation_max: f64,
        /// Largest distance of the grip site from the recorded one.
        #[unit = "m"]
        pub eef_max: f64,
        /// Largest difference of a joint position of the arm.
        #[unit = "rad"]
        pub arm_max: f64,
    }
}

table! {
    /// One row a frame of every replayed demonstration: the distance between the replay and the recording. Sorted by episode and
    /// frame, in space by episode, actions and frame.
    #[table("divergence", version = 3, formerly = "spatial_divergence")]
    pub struct DivergenceRow<D> {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the frame in its episode, from 0.
        pub frame: u32,
        /// The distance.
        #[prefix = ""]
        pub distance: D,
    }
}

columns! {
    /// How far a replay in space is from the recording, before an action.
    #[domain = "space"]
    pub struct SpatialDivergence {
        /// Which actions were played: delta or absolute.
        pub actions: Label,
        /// Distance of the object's origin from the recorded one.
        #[unit = "m"]
        pub object: f64,
        /// Angle between the object's orientation and the recorded one.
        #[unit = "rad"]
        #[formerly = "object_turn"]
        pub object_rotation: f64,
        /// Distance of the grip site from the recorded one.
        #[unit = "m"]
        pub eef: f64,
    }
}

/// Distances of a replay in the plane.
pub type PlanarDivergenceRow = DivergenceRow<Divergence>;

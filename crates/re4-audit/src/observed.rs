//! The tables of an `observations` artifact: what the audit of many demonstrations measures of each one, and what it derives from all
//! of them. Only demonstrations with a gripper have one.

use re4_artifact::{Label, table};

use crate::actions::ActionFit;
use crate::checks::find;
use crate::copies::Path;
use crate::thresholds::Observation;

table! {
    /// One row per demonstration: what thresholds and the search for copies need. Sorted by episode.
    #[table("observations", version = 1)]
    pub struct ObservationRow {
        /// Number of the demonstration in the audit, from 0. Demonstrations that were left out follow the others.
        pub episode: u32,
        /// Name of the demonstration in its source.
        pub demo: String,
        /// Whether ingest used the demonstration. Others have no part in thresholds.
        pub kept: bool,
        /// Number of frames.
        pub frames: u32,
        /// Position of the object at the last frame, world frame.
        #[unit = "m"]
        pub last_object: [f64; 3],
        /// Whether a reward above 0 was recorded; null if no rewards were recorded.
        pub rewarded: Option<bool>,
        /// BLAKE3 hash of all poses, finger positions and actions.
        pub recording: Vec<u8>,
        /// BLAKE3 hash of all actions.
        pub actions: Vec<u8>,
        /// Lag of the end effector behind its actions in frames; null if it is not clear.
        pub lag: Option<f64>,
        /// Motion of the end effector per step for an action of 1; null if it hardly moves.
        #[unit = "m"]
        pub gain: Option<f64>,
        /// Correlation of steps and actions at the best lag; null if the end effector hardly moves.
        pub correlation: Option<f64>,
        /// Positions of end effector and object in m, world frame, at 24 equal fractions of the duration: x, y, z of the end effector, then of the
        /// object, point after point.
        pub path: Vec<f32>,
    }
}

table! {
    /// One row per measured value from which a threshold is derived. Sorted by episode.
    #[table("measured", version = 1)]
    pub struct MeasuredRow {
        /// Number of the demonstration in the audit.
        pub episode: u32,
        /// Code of the check whose threshold is derived from the value.
        pub code: Label,
        /// The value, in the unit of the check.
        pub value: f64,
    }
}

table! {
    /// One row per check that applies to the dataset: its threshold. Sorted by code.
    #[table("thresholds", version = 1)]
    pub struct ThresholdRow {
        /// Code of the check.
        pub code: Label,
        /// Threshold that measured values are compared with, in the unit of the check; null if it has none, or does not run.
        pub threshold: Option<f64>,
        /// Origin of the threshold: data, derived from this dataset; setting, from the pipeline file; default, built in.
        pub origin: Label,
        /// Description of how the threshold was determined.
        pub derivation: String,
        /// Whether the check is made.
        pub made: bool,
    }
}

table! {
    /// One row: what checks compare with besides their thresholds.
    #[table("usual", version = 1)]
    pub struct UsualRow {
        /// Median of the last object positions, coordinate by coordinate, world frame; null without demonstrations.
        #[unit = "m"]
        pub last_object: Option<[f64; 3]>,
        /// Median number of frames.
        pub frames: f64,
        /// Standard deviation of the number of frames, from the median absolute deviation.
        pub frames_deviation: f64,
        /// Whether any demonstration has a reward above 0.
        pub rewards: bool,
        /// Median lag of end effectors behind their actions in frames; null if it is not clear.
        pub lag: Option<f64>,
        /// Median motion per step for an action of 1; null if it is not clear.
        #[unit = "m"]
        pub gain: Option<f64>,
        /// Median of the demonstrations' largest steps of the end effector.
        #[unit = "m"]
        pub largest_step: f64,
        /// Median of the demonstrations' largest rotations of the end effector in one step.
        #[unit = "rad"]
        pub largest_rotation: f64,
        /// Whether absolute actions were recorded.
        pub recorded_goals: bool,
    }
}

table! {
    /// One row per demonstration that is a copy of an earlier one. Sorted by episode.
    #[table("copies", version = 1)]
    pub struct CopyRow {
        /// Number of the demonstration in the audit.
        pub episode: u32,
        /// Code of the check that found it: duplicate, near_duplicate or same_actions.
        pub code: Label,
        /// Root mean square distance of the paths; null unless the code is near_duplicate.
        #[unit = "m"]
        pub distance: Option<f64>,
        /// Number of the earlier demonstration.
        pub other: u32,
        /// Name of the earlier demonstration in its source.
        pub other_demo: String,
        /// Number of frames of the earlier demonstration.
        pub other_frames: u32,
    }
}

impl ObservationRow {
    /// The row of an observation; `kept` is whether ingest used the demonstration.
    pub fn new(observation: &Observation, kept: bool) -> Self {
        let response = observation.response.as_ref();
        Self {
            episode: observation.episode,
            demo: observation.demo.clone(),
            kept,
            frames: observation.frames,
            last_object: observation.last_object.into(),
            rewarded: observation.rewarded,
            recording: observation.recording.to_vec(),
            actions: observation.actions.to_vec(),
            lag: response.and_then(|fit| fit.lag),
            gain: response.map(|fit| fit.gain),
            correlation: response.map(|fit| fit.correlation),
            path: observation.path.coordinates().to_vec(),
        }
    }

    /// The observation with these values. `None` if a hash has not 32 bytes, or a value is of a check that this build does not know.
    pub fn into_observation(self, measured: &[MeasuredRow]) -> Option<Observation> {
        let value = |row: &MeasuredRow| Some((find(&row.code)?.code, row.value));
        Some(Observation {
            episode: self.episode,
            demo: self.demo,
            frames: self.frames,
            values: measured.iter().map(value).collect::<Option<_>>()?,
            last_object: self.last_object.into(),
            rewarded: self.rewarded,
            recording: self.recording.try_into().ok()?,
            actions: self.actions.try_into().ok()?,
            response: self
                .gain
                .zip(self.correlation)
                .map(|(gain, correlation)| ActionFit::known(self.lag, gain, correlation)),
            path: Path::of_coordinates(self.path),
        })
    }
}

impl MeasuredRow {
    /// The rows of an observation.
    pub fn of(observation: &Observation) -> impl Iterator<Item = Self> + '_ {
        observation.values.iter().map(|&(code, value)| Self {
            episode: observation.episode,
            code: code.into(),
            value,
        })
    }
}

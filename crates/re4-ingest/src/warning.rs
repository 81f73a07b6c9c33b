//! Warnings of readers, as data.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Kind of a [`Warning`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarningCode {
    /// The block angle jumps between 0 and 2π inside an episode. The data is valid, but plain differences of angles are wrong
    /// there.
    AngleSeam,
    /// A commanded target outside the 512 px window.
    ActionOutsideWindow,
    /// An episode of fewer than [`crate::pusht::SHORT_EPISODE`] frames.
    ShortEpisode,
    /// A state equal to the one before it in the same episode.
    RepeatedState,
    /// The dataset has no `data/n_contacts`.
    NoContacts,
    /// The dataset has no `data/keypoint`.
    NoKeypoints,
    /// The dataset has no `data/img`.
    NoImages,
    /// Numbers in single precision where double precision is usual; they are widened.
    SinglePrecision,
    /// Members of `/data` that are not demonstrations.
    SkippedMembers,
    /// Filter keys that cannot be read and were not requested.
    SkippedFilterKeys,
    /// The attribute `total` of `/data` is not the number of frames.
    StaleTotal,
    /// Observations that are not used because some demonstrations lack them and all demonstrations have states.
    UnusedObservations,
    /// Optional arrays that contain invalid values.
    SkippedValues,
    /// Demonstrations that cannot be used and were left out.
    LeftOut,
    /// Datasets of the file that are not ingested.
    SkippedDatasets,
    /// A remark on a convention that is established.
    Convention,
    /// Demonstrations that are missing from the file used for comparison.
    NotCompared,
    /// Block angles outside 0 to 2π.
    AngleWrapped,
    /// Chunks of a zarr array that are not stored and are read as the fill value.
    AbsentChunks,
    /// Columns of an array that are not ingested.
    SkippedColumns,
    /// Statements of metadata that the files contradict, and that are not used.
    Metadata,
    /// The poses of the object are unknown.
    NoObjectPoses,
}

/// The code as it is written in tables and messages.
impl fmt::Display for WarningCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// An unusual finding that does not stop a reader. One warning covers all occurrences of its kind in a dataset: it has their
/// count and the place of the first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Kind.
    pub code: WarningCode,
    /// One sentence for the user.
    pub message: String,
    /// Episode of the first occurrence, by its number in the source dataset.
    pub episode: Option<u32>,
    /// Frame of the first occurrence, counted from the start of its episode.
    pub frame: Option<u64>,
    /// Number of occurrences.
    pub count: u64,
}

impl Warning {
    /// A warning about the dataset as a whole.
    pub fn new(code: WarningCode, message: String, count: usize) -> Self {
        Self {
            code,
            message,
            episode: None,
            frame: None,
            count: count as u64,
        }
    }
}

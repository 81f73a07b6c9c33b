//! What a reader finds odd, as data.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Kind of a [`Warning`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WarningCode {
    /// The block angle jumps between 0 and 2π inside an episode: no fault, but a raw difference of angles is wrong there.
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
    /// Members of `/data` that are no demonstrations.
    SkippedMembers,
    /// Filter keys that cannot be read, and were not asked for.
    SkippedFilterKeys,
    /// The attribute `total` of `/data` is not the number of frames.
    StaleTotal,
    /// Observations that are not used, since some demonstrations lack them and all have states.
    UnusedObservations,
    /// Arrays that nothing needs, with values that they cannot have.
    SkippedValues,
    /// Demonstrations that cannot be used and were left out.
    LeftOut,
    /// Datasets of the file that are not ingested.
    SkippedDatasets,
    /// What should be known of a convention although it is settled.
    Convention,
    /// Demonstrations that the file to compare with lacks.
    NotCompared,
    /// Block angles outside of 0 to 2π.
    AngleWrapped,
    /// Chunks of a zarr array that are not stored and stand for the fill value.
    AbsentChunks,
    /// Columns of an array that are not ingested.
    SkippedColumns,
}

/// The word used in tables and messages.
impl fmt::Display for WarningCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Something odd that does not stop a reader. One warning stands for all places of its kind: it counts them and names
/// the first.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Kind.
    pub code: WarningCode,
    /// One sentence for people.
    pub message: String,
    /// Episode of the first place, by its number in the source dataset.
    pub episode: Option<u32>,
    /// Frame of the first place, counted from the start of its episode.
    pub frame: Option<u64>,
    /// How many places there are.
    pub count: u64,
}

impl Warning {
    /// Of the dataset as a whole.
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

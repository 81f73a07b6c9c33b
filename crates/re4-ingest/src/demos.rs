//! The interface of demonstration sources, independent of their format.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::error::IngestError;
use crate::left_out::refusal;
use crate::tables::{ArmColumns, LeftOut, PlanarColumns, SignalRow, SpatialColumns};
use crate::warning::{Warning, WarningCode};

/// An opened dataset of one format. The requested demonstrations have been resolved and found readable.
///
/// A new format implements this trait in a module of its own; what is written to the tables is the same for all formats.
pub trait DemoSource: Sync {
    /// Whether the file or folder at a path looks like this format, judged by the kind of path, the extension or the first bytes.
    fn probe(path: &Path) -> bool
    where
        Self: Sized;

    /// Describes the contents of the dataset.
    fn info(&self) -> &Info;

    /// The elements of the recorded vectors, for sources that yield [`Frames::Arm`]: first those of the state, then those of the
    /// action, each in the order of the vector.
    fn signals(&self) -> &[SignalRow] {
        &[]
    }

    /// Number of the requested demonstrations.
    fn count(&self) -> usize;

    /// Whether a range of the demonstrations can be read without the others. If not, the artifact is made in one part.
    fn can_be_read_in_parts(&self) -> bool {
        true
    }

    /// Reads a range of the requested demonstrations in order and passes each to `take` with its index among all of them, or the reason
    /// why it cannot be used.
    /// Only a bounded number of demonstrations is in memory at once, unless the format stores all numbers in arrays over the
    /// whole dataset.
    ///
    /// # Errors
    /// A fault of the dataset as a whole, or an error that `take` returns.
    fn episodes<E: From<IngestError> + Send>(
        &self,
        range: Range<usize>,
        take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E>;

    /// Reads the recorded images of a camera and passes them to `take` in order, block by block. `of` lists the demonstrations
    /// with their numbers of frames; demonstration indices in the blocks refer to it. A demonstration with images that cannot be
    /// decoded is passed on as left out.
    ///
    /// # Errors
    /// Same as [`Self::episodes`].
    fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E>;

    /// Returns the warnings about the dataset, including those about single demonstrations in `tally`, in a fixed order.
    ///
    /// # Errors
    /// A file cannot be read.
    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError>;

    /// Checks that no file has changed since it was opened.
    ///
    /// # Errors
    /// Names the first file that changed.
    fn unchanged(&self) -> Result<(), IngestError>;
}

/// Description of a dataset.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Info {
    /// The format and its version.
    pub format: String,
    /// Control rate in Hz; `None` if the dataset does not state it.
    pub rate: Option<f64>,
    /// Cameras with recorded images that are requested, in alphabetical order.
    pub cameras: Vec<String>,
    /// What is recorded in every frame, by the names of the source.
    pub features: Vec<String>,
    /// Whether the pose of the manipulated object is known.
    pub object_poses: bool,
    /// Number of demonstrations in the whole dataset.
    pub demonstrations: usize,
    /// Names of the lists of demonstrations that can be used as a filter.
    pub filter_keys: Vec<String>,
    /// Further properties that are specific to the format, such as `environment`.
    #[serde(flatten)]
    pub details: Map<String, Value>,
}

/// A demonstration to read. Its name in the source is its name in all tables and messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DemoName {
    /// Its name: that of an HDF5 group, such as `demo_12`, or `episode N` for Push-T.
    pub name: String,
    /// Its number in the source; `None` if the name has none, it exceeds 32 bits, or another demonstration has the same number.
    pub number: Option<u32>,
    /// Filter keys that list it, in alphabetical order.
    pub filter_keys: Vec<String>,
}

/// A row-major matrix.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Matrix {
    /// Number of columns.
    pub columns: usize,
    /// All values, row by row.
    pub values: Vec<f64>,
}

impl Matrix {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }
}

/// A demonstration, in the frames, units and signs of the pipeline.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Its name.
    pub name: DemoName,
    /// Its frames.
    pub frames: Frames,
    /// Flattened simulator state before each action, if recorded.
    pub states: Option<Matrix>,
    /// The simulator model as MJCF, if there is one.
    pub model: Option<Arc<str>>,
    /// Differences (metres, radians) between the recorded absolute actions and those computed from the recorded delta actions,
    /// from the second step on; `None` if only one kind is available.
    pub goal_errors: Option<Vec<(f64, f64)>>,
    /// Names of its datasets in single precision.
    pub single_precision: Vec<&'static str>,
    /// Descriptions of optional data that was skipped because of invalid values.
    pub skipped: Vec<String>,
    /// Why it contradicts the conventions that the other demonstrations prove, if it does. It is left out, but its frames can be
    /// audited.
    pub contradiction: Option<String>,
}

/// The frames of a demonstration.
#[derive(Debug, Clone, PartialEq)]
pub enum Frames {
    /// Of a planar task, in SE(2).
    Planar(Vec<PlanarColumns>),
    /// Of a spatial task, in SE(3).
    Spatial(Vec<SpatialColumns>),
    /// Of an arm without an object, with the vectors as they were recorded. All frames of a dataset have vectors of the same
    /// lengths.
    Arm(Vec<ArmColumns>),
}

impl Frames {
    /// Number of frames.
    pub fn count(&self) -> usize {
        match self {
            Self::Planar(frames) => frames.len(),
            Self::Spatial(frames) => frames.len(),
            Self::Arm(frames) => frames.len(),
        }
    }
}

/// Consecutive images of a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageBlock {
    /// For each image, the index of its demonstration among those requested, and its frame in that demonstration.
    pub places: Vec<(u32, u32)>,
    /// Rows of pixels.
    pub height: usize,
    /// Pixels of a row.
    pub width: usize,
    /// RGB bytes, pixel by pixel, top row first, image by image.
    pub bytes: Vec<u8>,
}

/// The first of many, and their number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FirstOf<T> {
    /// The first one; `None` if there is none.
    pub first: Option<T>,
    /// Number of all.
    pub count: usize,
}

impl<T> Default for FirstOf<T> {
    fn default() -> Self {
        Self { first: None, count: 0 }
    }
}

impl<T> FirstOf<T> {
    fn add(&mut self, next: T) {
        self.first.get_or_insert(next);
        self.count += 1;
    }

    fn append(&mut self, next: Self) {
        self.first = self.first.take().or(next.first);
        self.count += next.count;
    }
}

/// Statistics about the demonstrations that were read, for warnings.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Number of demonstrations that were used.
    pub episodes: usize,
    /// Frames of these demonstrations.
    pub frames: usize,
    /// The demonstrations that cannot be used.
    pub left_out: Vec<LeftOut>,
    /// Differences (metres, radians) between recorded and computed absolute actions, of all demonstrations that have both kinds.
    pub goal_errors: Vec<(f64, f64)>,
    /// Demonstrations with only one kind of action.
    pub not_compared: FirstOf<String>,
    /// Datasets in single precision, by demonstration.
    single_precision: FirstOf<(String, String)>,
    /// Descriptions of data that was skipped because of invalid values.
    skipped: FirstOf<String>,
}

impl Tally {
    /// Adds a demonstration that was used.
    pub fn add(&mut self, episode: &mut Episode) {
        let name = &episode.name.name;
        match &episode.goal_errors {
            Some(errors) => self.goal_errors.extend(errors),
            None => self.not_compared.add(name.clone()),
        }
        for &dataset in &episode.single_precision {
            self.single_precision.add((name.clone(), dataset.to_owned()));
        }
        episode.skipped.drain(..).for_each(|skipped| self.skipped.add(skipped));
        self.episodes += 1;
        self.frames += episode.frames.count();
    }

    /// Adds the statistics of later demonstrations.
    pub fn append(&mut self, later: Self) {
        self.episodes += later.episodes;
        self.frames += later.frames;
        self.left_out.extend(later.left_out);
        self.goal_errors.extend(later.goal_errors);
        self.not_compared.append(later.not_compared);
        self.single_precision.append(later.single_precision);
        self.skipped.append(later.skipped);
    }

    /// The warning about demonstrations that were left out of `of` in total, if any.
    pub(crate) fn left_out_warning(&self, of: usize) -> Option<Warning> {
        let left = &self.left_out;
        let message = || format!("left out: {}", refusal(left, of));
        (!left.is_empty()).then(|| Warning::new(WarningCode::LeftOut, message(), left.len()))
    }

    /// Warnings about single demonstrations.
    pub(crate) fn warnings(&self) -> Vec<Warning> {
        let mut warnings = Vec::new();
        if let Some(first) = &self.skipped.first {
            let message = format!("{first}; these values are not ingested and stay null in the table");
            warnings.push(Warning::new(WarningCode::SkippedValues, message, self.skipped.count));
        }
        if let Some((demo, dataset)) = &self.single_precision.first {
            let message = format!("{demo}/{dataset} has single precision and was converted to double precision");
            let count = self.single_precision.count;
            warnings.push(Warning::new(WarningCode::SinglePrecision, message, count));
        }
        warnings
    }
}

//! Sources of demonstrations, whatever their format: what a dataset holds, and its demonstrations one after the other.

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;
use serde_json::{Map, Value};

use crate::error::IngestError;
use crate::left_out::refusal;
use crate::tables::{LeftOut, PlanarColumns, SpatialColumns};
use crate::warning::{Warning, WarningCode};

/// A dataset of one format, opened: which of its demonstrations are asked for is known, and that they can be read.
///
/// A new format is a module with one more of these; what is written of a demonstration is the same for all.
pub trait DemoSource: Sync {
    /// Whether something at a path looks like this format: by its first bytes, or by the names in a folder. Nothing else is read.
    fn probe(path: &Path) -> bool
    where
        Self: Sized;

    /// What the dataset holds.
    fn info(&self) -> &Info;

    /// The demonstrations that are asked for, in order.
    fn demos(&self) -> &[DemoName];

    /// Hands on these demonstrations in order, each with its place among them, or why it cannot be used. Only a bounded number of
    /// them is in memory, unless the format keeps all its numbers in arrays of the whole dataset.
    ///
    /// # Errors
    /// What is wrong with the dataset as a whole, or whatever `take` refuses.
    fn episodes<E: From<IngestError> + Send>(
        &self,
        take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E>;

    /// Hands on the recorded images of a camera, block by block, of these demonstrations and numbers of frames, in order; numbers
    /// in the blocks are places among these. A demonstration whose images cannot be decoded is handed on as left out.
    ///
    /// # Errors
    /// As [`Self::episodes`].
    fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E>;

    /// What is odd, beside what single demonstrations told, in a fixed order.
    ///
    /// # Errors
    /// A file that cannot be read.
    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError>;

    /// Whether all files are still what they were when they were opened.
    ///
    /// # Errors
    /// The first that is not.
    fn unchanged(&self) -> Result<(), IngestError>;
}

/// What a dataset holds.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Info {
    /// The format, and its version.
    pub format: String,
    /// Control steps a second, in Hz; none where nothing says it.
    pub rate: Option<f64>,
    /// Cameras whose images are recorded and asked for, in the order of their names.
    pub cameras: Vec<String>,
    /// What is recorded of every frame, as the source calls it.
    pub features: Vec<String>,
    /// Whether the pose of the manipulated object is known.
    pub object_poses: bool,
    /// Demonstrations of the whole dataset.
    pub demonstrations: usize,
    /// Names of the lists of demonstrations that can be filtered by.
    pub filter_keys: Vec<String>,
    /// What is to be said of it in the words of its format, such as `environment`.
    #[serde(flatten)]
    pub details: Map<String, Value>,
}

/// A demonstration that is to be read. What it is called in the source is what it is called everywhere.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DemoName {
    /// Its name: that of a group such as `demo_12`, or of Push-T the word episode and its number.
    pub name: String,
    /// Its number in the source; none where the name has none, it exceeds 32 bits, or another demonstration has the same.
    pub number: Option<u32>,
    /// Filter keys that list it, in alphabetical order.
    pub filter_keys: Vec<String>,
}

/// Rows of numbers, one after the other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Matrix {
    /// Numbers of a row.
    pub columns: usize,
    /// All numbers.
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
    /// What it is called.
    pub name: DemoName,
    /// Its frames.
    pub frames: Frames,
    /// Flattened state of the simulator before each action, where it is recorded.
    pub states: Option<Matrix>,
    /// The simulator's model, as MJCF, where there is one.
    pub model: Option<Arc<str>>,
    /// Distances (metres, radians) of recorded absolute actions from those that follow from recorded delta actions, beyond
    /// the first step; none where only one kind is known.
    pub goal_errors: Option<Vec<(f64, f64)>>,
    /// Datasets that hold single precision.
    pub single_precision: Vec<&'static str>,
    /// What nothing needs and was left out for the values in it, in words.
    pub skipped: Vec<String>,
}

/// The frames of a demonstration, by where the task is.
#[derive(Debug, Clone, PartialEq)]
pub enum Frames {
    /// In a plane.
    Planar(Vec<PlanarColumns>),
    /// In space.
    Spatial(Vec<SpatialColumns>),
}

impl Frames {
    /// Their number.
    pub fn count(&self) -> usize {
        match self {
            Self::Planar(frames) => frames.len(),
            Self::Spatial(frames) => frames.len(),
        }
    }
}

/// Consecutive images of a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageBlock {
    /// Of each image, the place of its demonstration among those asked for, and its frame there.
    pub places: Vec<(u32, u32)>,
    /// Rows of pixels.
    pub height: usize,
    /// Pixels of a row.
    pub width: usize,
    /// Red, green and blue, pixel by pixel, first row at the top, image by image.
    pub bytes: Vec<u8>,
}

/// What was learned of the demonstrations that were used.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tally {
    /// The demonstrations in order, with their frames.
    pub demos: Vec<(DemoName, usize)>,
    /// Those that cannot be used.
    pub left_out: Vec<LeftOut>,
    /// Errors of converted actions, of all that are known in both kinds.
    pub goal_errors: Vec<(f64, f64)>,
    /// Demonstrations of which one kind alone is known.
    pub not_compared: Vec<String>,
    /// Datasets that hold single precision, by demonstration.
    single_precision: Vec<(String, &'static str)>,
    /// What is not used for the values in it.
    skipped: Vec<String>,
}

impl Tally {
    /// Notes a demonstration.
    pub fn add(&mut self, episode: &mut Episode) {
        let name = &episode.name.name;
        match &episode.goal_errors {
            Some(errors) => self.goal_errors.extend(errors),
            None => self.not_compared.push(name.clone()),
        }
        let single = episode.single_precision.iter();
        self.single_precision
            .extend(single.map(|&dataset| (name.clone(), dataset)));
        self.skipped.append(&mut episode.skipped);
        self.demos.push((episode.name.clone(), episode.frames.count()));
    }

    /// Frames of all demonstrations.
    pub fn frames(&self) -> usize {
        self.demos.iter().map(|(_, frames)| frames).sum()
    }

    /// That demonstrations were left out, where any were, `of` so many.
    pub(crate) fn left_out_warning(&self, of: usize) -> Option<Warning> {
        let left = &self.left_out;
        let message = || format!("left out: {}", refusal(left, of));
        (!left.is_empty()).then(|| Warning::new(WarningCode::LeftOut, message(), left.len()))
    }

    /// What single demonstrations had that is odd.
    pub(crate) fn warnings(&self) -> Vec<Warning> {
        let mut warnings = Vec::new();
        if let Some(first) = self.skipped.first() {
            let message = format!("{first}; these values are not used, and stay empty in the table");
            warnings.push(Warning::new(WarningCode::SkippedValues, message, self.skipped.len()));
        }
        if let Some((demo, dataset)) = self.single_precision.first() {
            let message = format!("single precision in {demo}/{dataset}, widened to double precision");
            let count = self.single_precision.len();
            warnings.push(Warning::new(WarningCode::SinglePrecision, message, count));
        }
        warnings
    }
}

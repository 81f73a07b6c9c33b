//! Opening a dataset and reading its arrays.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::conventions::PushtConventions;
use super::episodes::{PushtEpisodes, Recorded};
use super::images::{ImageBlocks, ImageSource};
use super::judge;
use super::settle::covers;
use super::validate::{self, Notes};
use crate::demos::Info;
use crate::error::{Fault, IngestError};
use crate::left_out::OnBad;
use crate::selection::Selection;
use crate::source::Stop;
use crate::store::Store;
use crate::tables::KEYPOINTS;
use crate::tables::LeftOut;
use crate::warning::Warning;
use crate::zarr::{Absent, Element, Lost, ZarrArray};

const FLOATS: &str = "float32 or float64";

/// Types of actions and keypoints, which may be integer pixels.
const NUMBERS: &str = "a float type or an integer type of 16 bits or more";

/// Maximum number of frames of a dataset: more than eleven days of recording at 10 Hz. All its numbers are read into memory, and
/// a few bytes of compressed zeros could otherwise declare any number of frames.
pub(crate) const FRAME_LIMIT: u64 = 10_000_000;

/// Control rate of the original dataset in Hz, which the checks assume.
pub(crate) const RATE: f64 = 10.0;

/// Number of columns of a state, without and with the agent's velocity.
const STATE: u64 = 5;
const STATE_WITH_VELOCITY: u64 = 7;

/// An opened Push-T dataset. Types and shapes of all arrays and the episode ends have been checked; the data has not been read.
pub struct PushtReader {
    dataset: PathBuf,
    store: Arc<Store>,
    ranges: Vec<Range<usize>>,
    state: ZarrArray,
    action: ZarrArray,
    contacts: Option<ZarrArray>,
    keypoint: Option<ZarrArray>,
    images: Option<Arc<ImageSource>>,
    has_images: bool,
}

/// Options for reading a dataset.
#[derive(Clone, Copy)]
pub struct PushtOptions<'a> {
    /// Units and the kind of actions.
    pub conventions: PushtConventions,
    /// What to do with episodes that cannot be used.
    pub on_bad: OnBad,
    /// Whether images will be read, too. Missing image chunks are then reported with the other faults, and [`OnBad::LeaveOut`]
    /// decodes all images once, so that episodes with invalid images are left out.
    pub images: bool,
    /// Called while reading; returns true if reading should stop.
    pub stop: Stop<'a>,
}

impl Default for PushtOptions<'_> {
    fn default() -> Self {
        Self {
            conventions: PushtConventions::default(),
            on_bad: OnBad::default(),
            images: false,
            stop: &|| false,
        }
    }
}

/// The result of reading a dataset.
#[derive(Debug, Clone, PartialEq)]
pub struct PushtReading {
    /// The selected episodes without those left out, in pixels and radians, with absolute targets as actions.
    pub episodes: PushtEpisodes,
    /// Warnings, in a fixed order.
    pub warnings: Vec<Warning>,
    /// Selected episodes that cannot be used, in the order of the dataset; empty with [`OnBad::Refuse`].
    pub left_out: Vec<LeftOut>,
    /// Fraction (0 to 1) of the change in the agent's steps that its targets explain; `None` if there is too little motion. The
    /// original dataset has 0.996.
    pub explained: Option<f64>,
}

/// Collects faults, so that they are reported together.
#[derive(Default)]
struct Faults(Vec<Fault>);

impl Faults {
    fn take<T>(&mut self, outcome: Result<T, Fault>) -> Option<T> {
        outcome.map_err(|fault| self.0.push(fault)).ok()
    }

    fn check(&mut self) -> Result<(), Fault> {
        Fault::of_all(std::mem::take(&mut self.0)).map_or(Ok(()), Err)
    }
}

impl PushtReader {
    /// Opens a folder store, or a zip file with a store at its root or up to two folders deep. A zip file is unpacked to a
    /// temporary folder that is removed when the reader and its iterators are dropped.
    ///
    /// # Errors
    /// The dataset is not a complete Push-T dataset; see [`Fault`].
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        Self::open_for(path, true, &|| false)
    }

    /// Like [`Self::open`], but without `images` the array `data/img` is not checked. `stop` is called while a zip file is
    /// unpacked.
    ///
    /// # Errors
    /// Same as [`Self::open`], and [`Fault::Stopped`] once `stop` returned true.
    pub fn open_for(path: &Path, images: bool, stop: Stop<'_>) -> Result<Self, IngestError> {
        let store = Store::open(path, stop).map_err(|fault| fault.of(path))?;
        let store = Arc::new(store);
        Self::open_checked(path, &store, images, stop).map_err(|fault| store.explain(fault).of(path))
    }

    fn open_checked(path: &Path, store: &Arc<Store>, images: bool, stop: Stop<'_>) -> Result<Self, Fault> {
        let mut faults = Faults::default();
        let mut open = |name: &str, required: bool, check: fn(&ZarrArray) -> Result<(), Fault>| {
            let array = match ZarrArray::open(store, name, stop) {
                Ok(None) if required => Err(missing_array(store, name)),
                other => other,
            };
            let array = faults.take(array).flatten()?;
            faults.take(check(&array)).map(|()| array)
        };
        let state = open("data/state", true, check_state);
        let action = open("data/action", true, check_action);
        let contacts = open("data/n_contacts", false, check_contacts);
        let keypoint = open("data/keypoint", false, check_keypoint);
        let ends = open("meta/episode_ends", true, check_ends);
        let images = if images {
            open("data/img", false, |_| Ok(()))
        } else {
            None
        };
        let images = images.and_then(|array| {
            let source = ImageSource::new(path.to_owned(), array);
            faults.take(source).map(Arc::new)
        });
        let mut ranges = None;
        if let Some(state) = &state {
            let images = images.as_ref().map(|images| &images.array);
            let others = [action.as_ref(), contacts.as_ref(), keypoint.as_ref(), images];
            let others: Vec<&ZarrArray> = others.into_iter().flatten().collect();
            faults.0.extend(lengths(state, &others));
            // Report missing chunks together with the faults found so far. Without faults, reading reports them.
            if !faults.0.is_empty() {
                faults
                    .0
                    .extend(others.into_iter().chain([state]).filter_map(lost_chunks));
            }
            if let Some(ends) = &ends
                && state.len() <= FRAME_LIMIT
            {
                ranges = faults.take(read_ranges(ends, state.len(), stop));
            }
        }
        faults.check()?;
        match (state, action, ranges) {
            (Some(state), Some(action), Some(ranges)) => Ok(Self {
                dataset: path.to_owned(),
                store: Arc::clone(store),
                ranges,
                has_images: ["data/img/.zarray", "data/img/zarr.json"]
                    .iter()
                    .any(|file| store.length(file).is_some()),
                state,
                action,
                contacts,
                keypoint,
                images,
            }),
            // Unreachable, since a missing array was reported above.
            _ => Err(missing_array(store, "data/state")),
        }
    }

    /// BLAKE3 hash over the files of the dataset's arrays and their metadata in the byte order of their paths. For each file it
    /// covers the length of its path, the path (with `/`), the length of the file and the BLAKE3 hash of its bytes, with lengths
    /// as little-endian u64. Files of other arrays and unrelated files are excluded. For a zip file it covers the unpacked store,
    /// so that a folder and a zip file of it have the same hash.
    ///
    /// # Errors
    /// A file cannot be read or changed since the dataset was opened, or `stop` returned true.
    pub fn source_hash(&self, stop: Stop<'_>) -> Result<[u8; 32], IngestError> {
        self.store.hash(stop).map_err(|fault| self.error(fault))
    }

    /// Checks that no file of the dataset was changed, replaced, added or removed since it was opened.
    ///
    /// # Errors
    /// [`Fault::Changed`] if one was.
    pub fn unchanged(&self) -> Result<(), IngestError> {
        self.store.unchanged().map_err(|fault| fault.of(&self.dataset))
    }

    /// The format of the store: 2 or 3.
    pub fn zarr_format(&self) -> u32 {
        if self.store.is_format_3() { 3 } else { 2 }
    }

    /// Frames of each episode of the dataset, as rows of its arrays, end exclusive.
    pub fn episode_ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }

    /// Number of frames of the dataset.
    pub fn frame_count(&self) -> usize {
        self.ranges.last().map_or(0, |range| range.end)
    }

    /// Height, width and channels (always 3) of the images; `None` if there are none or the dataset was opened without images.
    pub fn image_shape(&self) -> Option<[usize; 3]> {
        self.images.as_ref().map(|images| images.shape())
    }

    /// Whether the dataset has images, even if it was opened without them.
    pub fn has_images(&self) -> bool {
        self.has_images
    }

    /// Describes the contents of the dataset.
    pub fn info(&self) -> Info {
        let recorded = [
            (true, "data/state"),
            (true, "data/action"),
            (self.contacts.is_some(), "data/n_contacts"),
            (self.keypoint.is_some(), "data/keypoint"),
            (self.has_images, "data/img"),
        ];
        Info {
            format: format!("zarr v{}, Push-T replay buffer", self.zarr_format()),
            rate: Some(RATE),
            features: recorded
                .into_iter()
                .filter(|(there, _)| *there)
                .map(|(_, name)| name.to_owned())
                .collect(),
            object_poses: true,
            demonstrations: self.ranges.len(),
            ..Info::default()
        }
    }

    /// Reads and validates the numeric arrays of the selected episodes with the conventions of the original dataset, and refuses
    /// the dataset if any of them cannot be used. See [`Self::read`].
    ///
    /// # Errors
    /// Same as [`Self::read`].
    pub fn read_episodes(&self, selection: &Selection) -> Result<(PushtEpisodes, Vec<Warning>), IngestError> {
        let reading = self.read(selection, &PushtOptions::default())?;
        Ok((reading.episodes, reading.warnings))
    }

    /// Reads and validates the numeric arrays of the selected episodes. Other episodes are not checked.
    ///
    /// # Errors
    /// The selection does not match; units or kind of actions contradict the conventions; a file changed; `stop` returned true.
    /// Missing or broken chunks and values that no Push-T recording has are reported in one error, unless the affected episodes
    /// are left out and others remain.
    pub fn read(&self, selection: &Selection, options: &PushtOptions<'_>) -> Result<PushtReading, IngestError> {
        self.read_checked(selection, options).map_err(|fault| self.error(fault))
    }

    fn read_checked(&self, selection: &Selection, options: &PushtOptions<'_>) -> Result<PushtReading, Fault> {
        let sources = selection.resolve_episodes(self.ranges.len())?;
        let (episodes, notes, lost) = self.columns(sources, options)?;
        judge::judged(episodes, notes, lost, Vec::new(), options)
    }

    /// Reads the columns of the selected episodes as they are in the dataset, and the rows that cannot be read.
    fn columns(
        &self,
        sources: Vec<u32>,
        options: &PushtOptions<'_>,
    ) -> Result<(PushtEpisodes, Notes, Vec<Lost>), Fault> {
        let stop = options.stop;
        let rows: Vec<Range<usize>> = sources
            .iter()
            .map(|&source| self.ranges[source as usize].clone())
            .collect();
        let runs: Vec<Range<u64>> = rows.iter().map(|rows| rows.start as u64..rows.end as u64).collect();
        let images = self.images.as_ref().filter(|_| options.images);
        let of_actions = if options.conventions.zero_action_is_usual() {
            Absent::IsFill
        } else {
            Absent::IsLost
        };
        // If every selected episode lacks data of some array, the read would be useless.
        let missing: Vec<Lost> = [
            self.state.missing(&runs, Absent::IsLost),
            self.action.missing(&runs, of_actions),
            self.contacts
                .as_ref()
                .and_then(|array| array.missing(&runs, Absent::IsFill)),
            self.keypoint
                .as_ref()
                .and_then(|array| array.missing(&runs, Absent::IsLost)),
            images.and_then(|images| images.array.missing(&runs, Absent::IsLost)),
        ]
        .into_iter()
        .flatten()
        .collect();
        if missing.iter().any(|lost| covers(lost, &runs)) {
            let missing = missing.into_iter().map(|lost| lost.fault).collect();
            return Err(Fault::of_all(missing).unwrap_or(Fault::NoEpisodes));
        }
        let mut lost = Vec::new();
        let mut notes = Notes {
            has_images: self.has_images,
            ..Notes::default()
        };
        let mut floats = |array: &ZarrArray, absent| -> Result<Vec<f64>, Fault> {
            let element = array.element(|_| true, NUMBERS)?;
            let read = array.read_floats(element, &runs, absent, stop)?;
            notes.absent_chunks += read.absent;
            lost.extend(read.lost);
            Ok(read.values)
        };
        let state = floats(&self.state, Absent::IsLost)?;
        let action = floats(&self.action, of_actions)?;
        let contacts = self
            .contacts
            .as_ref()
            .map(|array| floats(array, Absent::IsFill))
            .transpose()?;
        let keypoint = self
            .keypoint
            .as_ref()
            .map(|array| floats(array, Absent::IsLost))
            .transpose()?;
        if let Some(images) = images {
            match options.on_bad {
                OnBad::LeaveOut => lost.extend(images.judge(&runs, stop)?),
                OnBad::Refuse => lost.extend(images.array.missing(&runs, Absent::IsLost)),
            }
        }
        let frames = rows
            .iter()
            .scan(0, |start, rows| {
                let frames = *start..*start + rows.len();
                *start = frames.end;
                Some(frames)
            })
            .collect();
        let mut episodes = PushtEpisodes {
            frames,
            state: Vec::new(),
            action: table(&action),
            contacts,
            keypoint: keypoint.map(|keypoint| {
                table::<{ 2 * KEYPOINTS }>(&keypoint)
                    .into_iter()
                    .map(|row| std::array::from_fn(|point| [row[2 * point], row[2 * point + 1]]))
                    .collect()
            }),
            sources,
            rows,
            recorded: Recorded::default(),
        };
        if self.state.shape().get(1) == Some(&STATE_WITH_VELOCITY) {
            let wide: Vec<[f64; 7]> = table(&state);
            validate::velocity(&wide, &episodes.frames)?;
            notes.velocity = true;
            episodes.state = wide
                .iter()
                .map(|[x, y, block_x, block_y, theta, ..]| [*x, *y, *block_x, *block_y, *theta])
                .collect();
        } else {
            episodes.state = table(&state);
        }
        Ok((episodes, notes, lost))
    }

    /// The images of the selected episodes as blocks of consecutive frames, in order, decoded ahead on the current
    /// rayon pool. Blocks end where a chunk of the dataset or a gap in the selection ends, and may span episodes.
    /// Blocks that are being decoded use at most [`super::IMAGE_BUDGET`] in total, or three times 128 MiB if chunks have the
    /// maximum size. Blocks that the caller keeps are not included.
    ///
    /// The iterator ends after its first error. A chunk that is read is validated as a whole.
    ///
    /// # Errors
    /// The dataset has no images, the selection does not match the dataset, or a chunk file is missing. The iterator
    /// reports chunks that cannot be decoded and values that are not integers from 0 to 255, for all selected episodes in one
    /// error.
    pub fn image_blocks(&self, selection: &Selection) -> Result<ImageBlocks, IngestError> {
        let numbers = selection
            .resolve_episodes(self.ranges.len())
            .map_err(|error| Fault::from(error).of(&self.dataset))?;
        let runs: Vec<Range<usize>> = numbers
            .iter()
            .map(|&number| self.ranges[number as usize].clone())
            .collect();
        self.blocks(&runs)
    }

    /// The images of episodes that were read; see [`Self::image_blocks`].
    ///
    /// # Errors
    /// Same as [`Self::image_blocks`].
    pub fn image_blocks_of(&self, episodes: &PushtEpisodes) -> Result<ImageBlocks, IngestError> {
        self.blocks(&episodes.rows)
    }

    fn blocks(&self, runs: &[Range<usize>]) -> Result<ImageBlocks, IngestError> {
        let source = self.images.as_ref().ok_or_else(|| Fault::NoImages.of(&self.dataset))?;
        ImageBlocks::new(Arc::clone(source), runs)
    }

    fn error(&self, fault: Fault) -> IngestError {
        self.store.explain(fault).of(&self.dataset)
    }
}

fn missing_array(store: &Store, name: &str) -> Fault {
    Fault::MissingArray {
        array: name.to_owned(),
        file: if store.is_format_3() { "zarr.json" } else { ".zarray" },
        arrays: store.arrays(),
    }
}

fn check_shape(array: &ZarrArray, fits: impl Fn(&[u64]) -> bool, expected: &'static str) -> Result<(), Fault> {
    if fits(array.shape()) {
        Ok(())
    } else {
        Err(Fault::WrongShape {
            array: array.name().to_owned(),
            found: array.shape().to_vec(),
            expected,
        })
    }
}

fn check_state(array: &ZarrArray) -> Result<(), Fault> {
    check_shape(
        array,
        |shape| matches!(shape, [_, STATE | STATE_WITH_VELOCITY]),
        "(N, 5), or (N, 7) with the agent's velocity in the last two columns,",
    )?;
    // Integer types are not accepted, because one of the columns is an angle in radians.
    array.element(Element::is_float, FLOATS).map(drop)
}

fn check_action(array: &ZarrArray) -> Result<(), Fault> {
    check_shape(array, |shape| matches!(shape, [_, 2]), "(N, 2)")?;
    array.element(holds_pixels, NUMBERS).map(drop)
}

fn check_contacts(array: &ZarrArray) -> Result<(), Fault> {
    check_shape(array, |shape| matches!(shape, [_] | [_, 1]), "(N, 1) or (N,)")?;
    array.element(|_| true, "a number type").map(drop)
}

fn check_keypoint(array: &ZarrArray) -> Result<(), Fault> {
    let flat = 2 * KEYPOINTS as u64;
    check_shape(
        array,
        |shape| match shape {
            [_, points, 2] => *points == KEYPOINTS as u64,
            [_, numbers] => *numbers == flat,
            _ => false,
        },
        "(N, 9, 2) or (N, 18)",
    )?;
    array.element(holds_pixels, NUMBERS).map(drop)
}

fn check_ends(array: &ZarrArray) -> Result<(), Fault> {
    check_shape(array, |shape| matches!(shape, [_] | [_, 1]), "(number of episodes,)")?;
    array.element(|_| true, "a number type").map(drop)
}

/// Whether a type can represent every pixel coordinate of the window.
fn holds_pixels(element: Element) -> bool {
    element.is_float() || element.size() > 1
}

/// Checks that all arrays have the same, acceptable length.
fn lengths(state: &ZarrArray, others: &[&ZarrArray]) -> Vec<Fault> {
    let mut faults: Vec<Fault> = others
        .iter()
        .filter(|array| array.len() != state.len())
        .map(|array| Fault::LengthMismatch {
            array: array.name().to_owned(),
            found: array.len(),
            expected: state.len(),
        })
        .collect();
    if state.len() > FRAME_LIMIT {
        faults.push(Fault::TooManyFrames {
            frames: state.len(),
            limit: FRAME_LIMIT,
        });
    }
    faults
}

/// Missing chunks of an array, over the whole dataset.
fn lost_chunks(array: &ZarrArray) -> Option<Fault> {
    let absent = if array.name() == "data/n_contacts" {
        Absent::IsFill
    } else {
        Absent::IsLost
    };
    let all = 0..array.len().min(FRAME_LIMIT);
    array.missing(std::slice::from_ref(&all), absent).map(|lost| lost.fault)
}

fn read_ranges(ends: &ZarrArray, frames: u64, stop: Stop<'_>) -> Result<Vec<Range<usize>>, Fault> {
    if ends.len() > frames {
        return Err(Fault::TooManyEnds {
            episodes: ends.len(),
            frames,
        });
    }
    let element = ends.element(|_| true, "a number type")?;
    let read = ends.read_integers(element, stop)?;
    match Fault::of_all(read.lost.into_iter().map(|lost| lost.fault).collect()) {
        Some(fault) => Err(fault),
        None => validate::episode_ranges(&read.values, frames),
    }
}

/// Splits a flat array into rows of `WIDTH` columns.
fn table<const WIDTH: usize>(values: &[f64]) -> Vec<[f64; WIDTH]> {
    values.as_chunks::<WIDTH>().0.to_vec()
}

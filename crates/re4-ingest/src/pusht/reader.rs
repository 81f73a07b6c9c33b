//! Opening a dataset and reading its arrays.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::episodes::{KEYPOINTS, PushtEpisodes};
use super::images::{ImageBlocks, ImageSource};
use super::validate;
use crate::error::{Fault, IngestError};
use crate::selection::Selection;
use crate::store::Store;
use crate::warning::Warning;
use crate::zarr::{Element, ZarrArray};

const FLOATS: &str = "float32 or float64";

/// Most frames of a dataset, more than eleven days of recording at 10 Hz. Its numbers are read into memory as a whole, and a few bytes of
/// compressed zeros can claim any number of them.
const FRAME_LIMIT: u64 = 10_000_000;

/// An opened Push-T dataset: every array's type and shape and the episode ends are checked, the data is not yet read.
pub struct PushtReader {
    dataset: PathBuf,
    store: Arc<Store>,
    ranges: Vec<Range<usize>>,
    state: ZarrArray,
    action: ZarrArray,
    contacts: Option<ZarrArray>,
    keypoint: Option<ZarrArray>,
    images: Option<Arc<ImageSource>>,
}

impl PushtReader {
    /// Opens a folder store, or a zip file with a store at its root or up to two folders down. A zip file is unpacked
    /// to a temporary folder that is removed when the reader and its iterators are dropped.
    ///
    /// # Errors
    /// Anything that is not a complete Push-T dataset, by [`Fault`].
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        Self::open_checked(path).map_err(|fault| fault.of(path))
    }

    fn open_checked(path: &Path) -> Result<Self, Fault> {
        let store = Arc::new(Store::open(path)?);
        let folder = store.folder();
        let state = ZarrArray::open_required(folder, "data/state")?;
        check_shape(&state, |shape| matches!(shape, [_, 5]), "(N, 5)")?;
        state.element(Element::is_float, FLOATS)?;
        let action = ZarrArray::open_required(folder, "data/action")?;
        check_shape(&action, |shape| matches!(shape, [_, 2]), "(N, 2)")?;
        action.element(Element::is_float, FLOATS)?;
        let contacts = ZarrArray::open(folder, "data/n_contacts")?;
        if let Some(contacts) = &contacts {
            check_shape(contacts, |shape| matches!(shape, [_] | [_, 1]), "(N, 1) or (N,)")?;
            contacts.element(|_| true, "a number type")?;
        }
        let keypoint = ZarrArray::open(folder, "data/keypoint")?;
        if let Some(keypoint) = &keypoint {
            check_shape(
                keypoint,
                |shape| matches!(shape, [_, points, 2] if *points == KEYPOINTS as u64),
                "(N, 9, 2)",
            )?;
            keypoint.element(Element::is_float, FLOATS)?;
        }
        let images = ZarrArray::open(folder, "data/img")?
            .map(|array| ImageSource::new(path.to_owned(), array, Arc::clone(&store)).map(Arc::new))
            .transpose()?;
        let others = [
            Some(&action),
            contacts.as_ref(),
            keypoint.as_ref(),
            images.as_ref().map(|images| &images.array),
        ];
        for array in others.into_iter().flatten() {
            if array.len() != state.len() {
                return Err(Fault::LengthMismatch {
                    array: array.name().to_owned(),
                    found: array.len(),
                    expected: state.len(),
                });
            }
        }
        if state.len() > FRAME_LIMIT {
            return Err(Fault::TooManyFrames {
                frames: state.len(),
                limit: FRAME_LIMIT,
            });
        }
        let ends = ZarrArray::open_required(folder, "meta/episode_ends")?;
        check_shape(&ends, |shape| matches!(shape, [_]), "(number of episodes,)")?;
        let element = ends.element(|e| !e.is_float(), "an integer type")?;
        if ends.len() > state.len() {
            return Err(Fault::TooManyEnds {
                episodes: ends.len(),
                frames: state.len(),
            });
        }
        let ranges = validate::episode_ranges(&ends.read_integers(element)?, state.len())?;
        Ok(Self {
            dataset: path.to_owned(),
            store,
            ranges,
            state,
            action,
            contacts,
            keypoint,
            images,
        })
    }

    /// BLAKE3 over the store's files in the byte order of their paths: for each, the length of its path, the path (with
    /// `/`), the length of the file and the BLAKE3 of its bytes, lengths as little-endian u64. For a zip file it covers
    /// the unpacked store, so that a folder and a zip of it agree.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn source_hash(&self) -> Result<[u8; 32], IngestError> {
        self.store.hash().map_err(|fault| fault.of(&self.dataset))
    }

    /// Frames of each episode of the dataset: rows of its arrays, end exclusive.
    pub fn episode_ranges(&self) -> &[Range<usize>] {
        &self.ranges
    }

    /// Number of frames of the dataset.
    pub fn frame_count(&self) -> usize {
        self.ranges.last().map_or(0, |range| range.end)
    }

    /// Height, width and channels (always 3) of the pictures, if the dataset has any.
    pub fn image_shape(&self) -> Option<[usize; 3]> {
        self.images.as_ref().map(|images| images.shape())
    }

    /// Reads and validates the numeric arrays of the selected episodes; what lies outside of them is not judged, except
    /// that every chunk must be there and decode. Warnings come in a fixed order.
    ///
    /// # Errors
    /// A selection that does not fit, a missing or broken chunk, or a value no Push-T recording can have.
    pub fn read_episodes(&self, selection: &Selection) -> Result<(PushtEpisodes, Vec<Warning>), IngestError> {
        self.read_checked(selection).map_err(|fault| fault.of(&self.dataset))
    }

    fn read_checked(&self, selection: &Selection) -> Result<(PushtEpisodes, Vec<Warning>), Fault> {
        let sources = selection.resolve(self.ranges.len())?;
        let rows: Vec<Range<usize>> = sources
            .iter()
            .map(|&source| self.ranges[source as usize].clone())
            .collect();
        let floats = |array: &ZarrArray| array.read_floats(array.element(|_| true, FLOATS)?);
        let frames = rows
            .iter()
            .scan(0, |start, rows| {
                let frames = *start..*start + rows.len();
                *start = frames.end;
                Some(frames)
            })
            .collect();
        let episodes = PushtEpisodes {
            frames,
            state: select(&floats(&self.state)?, &rows),
            action: select(&floats(&self.action)?, &rows),
            contacts: match &self.contacts {
                Some(contacts) => Some(select::<1>(&floats(contacts)?, &rows).into_iter().flatten().collect()),
                None => None,
            },
            keypoint: match &self.keypoint {
                Some(keypoint) => Some(
                    select::<{ 2 * KEYPOINTS }>(&floats(keypoint)?, &rows)
                        .into_iter()
                        .map(|row| std::array::from_fn(|point| [row[2 * point], row[2 * point + 1]]))
                        .collect(),
                ),
                None => None,
            },
            sources,
            rows,
        };
        validate::values(&episodes)?;
        let warnings = validate::warnings(&episodes, self.images.is_some());
        Ok((episodes, warnings))
    }

    /// The pictures of the selected episodes as blocks of consecutive frames, in order, decoded ahead on the current
    /// rayon pool. Blocks end where a chunk of the dataset or a gap in the selection ends, never merely where an episode
    /// does. Blocks in the making hold at most [`super::IMAGE_BUDGET`] together (three times 128 MiB if chunks are as
    /// large as they may be); beyond that, memory is what the caller keeps.
    ///
    /// The iterator ends after its first error. A chunk that is touched is validated as a whole.
    ///
    /// # Errors
    /// A dataset without pictures, a selection that does not fit, a missing chunk file; from the iterator, a chunk that
    /// cannot be decoded and values that are not whole numbers from 0 to 255.
    pub fn image_blocks(&self, selection: &Selection) -> Result<ImageBlocks, IngestError> {
        let source = self.images.as_ref().ok_or_else(|| Fault::NoImages.of(&self.dataset))?;
        let numbers = selection
            .resolve(self.ranges.len())
            .map_err(|error| Fault::from(error).of(&self.dataset))?;
        let runs: Vec<Range<usize>> = numbers
            .iter()
            .map(|&number| self.ranges[number as usize].clone())
            .collect();
        ImageBlocks::new(Arc::clone(source), &runs)
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

/// The rows of the selected episodes, of a flat array of `WIDTH` columns.
fn select<const WIDTH: usize>(values: &[f64], rows: &[Range<usize>]) -> Vec<[f64; WIDTH]> {
    let (table, _) = values.as_chunks::<WIDTH>();
    rows.iter()
        .flat_map(|rows| table[rows.clone()].iter().copied())
        .collect()
}

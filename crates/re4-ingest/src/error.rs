//! Why an ingest stops: one sentence that says what, where and how to fix it.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::left_out::parts;
use crate::robomimic::Hdf5Fault;
use crate::selection::SelectionError;
use crate::source::io_fix;

/// A raw dataset that cannot be ingested.
#[derive(Debug, Error)]
#[error("cannot ingest {}: {fault}", dataset.display())]
pub struct IngestError {
    /// The path that was given for the dataset.
    pub dataset: PathBuf,
    /// What is wrong with it.
    #[source]
    pub fault: Box<Fault>,
}

/// What is wrong with a dataset. Frames are rows of the arrays, counted from 0 over the whole dataset.
#[derive(Debug, Error)]
pub enum Fault {
    /// Nothing at the path.
    #[error("there is no such file or folder; correct the path, or fetch the dataset first")]
    MissingPath,
    /// Neither a regular file nor a folder, or a folder where a file is needed.
    #[error("it is {what}, not a regular file; give the path of the file itself")]
    NotAFile {
        /// What it is.
        what: &'static str,
    },
    /// A file that is no longer what it was when it was opened.
    #[error(
        "{} changed while it was read, so nothing was published; wait until whatever writes it is done and run again",
        path.display()
    )]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// The caller asked to stop.
    #[error("reading was stopped; run again to go on")]
    Stopped,
    /// A folder without content.
    #[error("the folder is empty; give the folder of a zarr store (it holds .zgroup, data/ and meta/)")]
    EmptyFolder,
    /// A folder that is no store.
    #[error("it is not a zarr store (no .zgroup in it); {hint}")]
    NotAStore {
        /// What to give instead.
        hint: String,
    },
    /// An array where a group should be.
    #[error("it is a single zarr array, not a dataset; give the folder above data/ and meta/")]
    SingleArray,
    /// A file of another kind where a store should be.
    #[error("{what}; {fix}")]
    NotAStoreFile {
        /// What it is.
        what: &'static str,
        /// How to get a store of it.
        fix: &'static str,
    },
    /// Something of a store that is neither a regular file nor a folder.
    #[error("{file} of the store is {what}, not a regular file; remove it, or restore the file")]
    NotAFileInside {
        /// Path within the store.
        file: String,
        /// What it is.
        what: &'static str,
    },
    /// A file that is no zip.
    #[error("the zip file is unreadable ({why}); download or pack it again")]
    UnreadableZip {
        /// The unpacker's words.
        why: String,
    },
    /// An entry of a zip that cannot be unpacked.
    #[error("entry {entry} of the zip file is unreadable ({why}); download or pack it again")]
    UnreadableZipEntry {
        /// Name of the entry.
        entry: String,
        /// The unpacker's words.
        why: String,
    },
    /// An entry that would be unpacked outside the store.
    #[error(
        "entry {entry} of the zip file is a link or leads outside of it; pack the store again without such entries"
    )]
    UnsafeZipEntry {
        /// Name of the entry.
        entry: String,
    },
    /// A link in a folder store that leads back to a folder that holds it.
    #[error("{link} is a link to a folder that it lies in; remove the link")]
    CircularLink {
        /// Path of the link within the store.
        link: String,
    },
    /// A zip without a store.
    #[error(
        "the zip file holds no zarr store (no .zgroup or zarr.json at its root or up to two folders down); pack the folder of the store"
    )]
    ZipWithoutStore,
    /// A zip with more than one store.
    #[error("the zip file holds {count} zarr stores ({first} and {second} among them); pack one store only")]
    SeveralStoresInZip {
        /// How many.
        count: usize,
        /// The first in alphabetical order.
        first: String,
        /// The second in alphabetical order.
        second: String,
    },
    /// The operating system refused something.
    #[error("cannot {action} {}: {source}; {}", path.display(), io_fix(source))]
    Io {
        /// What was tried, such as "read".
        action: &'static str,
        /// On which path.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// A required array is not there.
    #[error(
        "array {array} is missing (no {array}/{file}{}); restore it, or give a complete dataset",
        there(arrays)
    )]
    MissingArray {
        /// Array within the store.
        array: String,
        /// Name of its metadata.
        file: &'static str,
        /// Arrays that the store has.
        arrays: Vec<String>,
    },
    /// Metadata of an array that cannot be understood.
    #[error("the metadata of array {array} ({file}) cannot be read: {why}; restore that file")]
    ArrayMetadata {
        /// Array within the store.
        array: String,
        /// Path of the metadata within the store.
        file: String,
        /// What is wrong with it.
        why: String,
    },
    /// A valid encoding that this reader does not know.
    #[error(
        "array {array} is stored in a way that is not supported: {why}; rewrite it with zarr's default compressor and no filters"
    )]
    Encoding {
        /// Array within the store.
        array: String,
        /// What is not supported.
        why: String,
    },
    /// Chunks too large for the memory budget.
    #[error(
        "array {array} has chunks of {} MiB and the limit is {} MiB; rewrite it with smaller chunks along its first axis",
        bytes.div_ceil(1 << 20), limit >> 20
    )]
    ChunkTooLarge {
        /// Array within the store.
        array: String,
        /// Size of a chunk, decoded.
        bytes: u64,
        /// The limit.
        limit: u64,
    },
    /// An array of the wrong element type.
    #[error(
        "array {array} has dtype {found}, but {expected} is expected; convert it{}",
        or_without(array)
    )]
    WrongDtype {
        /// Array within the store.
        array: String,
        /// As written in `.zarray`.
        found: String,
        /// Types that are accepted.
        expected: &'static str,
    },
    /// An array of the wrong shape.
    #[error(
        "array {array} has shape {found:?}, but {expected} is expected (N: number of frames); reshape it, or give a Push-T dataset{}",
        or_without(array)
    )]
    WrongShape {
        /// Array within the store.
        array: String,
        /// Its shape.
        found: Vec<u64>,
        /// The shape in words.
        expected: &'static str,
    },
    /// Arrays of different lengths.
    #[error(
        "array {array} has {found} frames and data/state has {expected}; every array of data/ must have one row per frame, so restore or cut the odd one"
    )]
    LengthMismatch {
        /// Array within the store.
        array: String,
        /// Its length.
        found: u64,
        /// Length of `data/state`.
        expected: u64,
    },
    /// More frames than are read.
    #[error("data/state has {frames} frames, and at most {limit} are read; split the dataset")]
    TooManyFrames {
        /// Frames of the dataset.
        frames: u64,
        /// The limit.
        limit: u64,
    },
    /// More episodes than frames.
    #[error(
        "meta/episode_ends has {episodes} entries and data/state has {frames} frames; every episode has a frame or more, so repair or restore meta/episode_ends"
    )]
    TooManyEnds {
        /// Entries of `meta/episode_ends`.
        episodes: u64,
        /// Frames in the arrays.
        frames: u64,
    },
    /// No episodes.
    #[error("meta/episode_ends is empty, so the dataset has no episodes; give a dataset with at least one")]
    NoEpisodes,
    /// A negative end.
    #[error("meta/episode_ends is negative at index {index} ({value}); ends are frame counts, so repair that entry")]
    NegativeEnd {
        /// Episode.
        index: usize,
        /// Its end.
        value: i128,
    },
    /// Ends that do not grow.
    #[error(
        "meta/episode_ends is not strictly increasing at index {index} ({value} after {previous}); repair that entry"
    )]
    EndsNotIncreasing {
        /// Episode.
        index: usize,
        /// Its end.
        value: i128,
        /// End of the episode before it; 0 for the first.
        previous: i128,
    },
    /// Ends that do not cover the arrays.
    #[error(
        "meta/episode_ends ends at frame {last} (index {index}) but the arrays have {frames} frames; the last end must be the number of frames, so repair it or restore the missing frames"
    )]
    EndsDoNotMatch {
        /// The last episode.
        index: usize,
        /// Its end.
        last: i128,
        /// Frames in the arrays.
        frames: u64,
    },
    /// A chunk that is not stored, where it cannot stand for the fill value.
    #[error("{}", missing_chunk(array, chunk, *more, *inside, fill.as_deref(), *fills_are_stored))]
    MissingChunk {
        /// Array within the store.
        array: String,
        /// Name of the chunk's file within the array.
        chunk: String,
        /// How many others of the array are missing, too.
        more: u64,
        /// Number of the chunk in its file, where files hold several.
        inside: Option<usize>,
        /// The fill value as it is written in the metadata, if there is one.
        fill: Option<String>,
        /// Whether other chunks hold nothing else and are stored.
        fills_are_stored: bool,
    },
    /// A chunk file that cannot be decoded.
    #[error("chunk {chunk} of array {array} cannot be decoded (file {array}/{chunk}): {why}; restore that file")]
    UndecodableChunk {
        /// Array within the store.
        array: String,
        /// Name of the chunk's file within the array.
        chunk: String,
        /// What is wrong with it.
        why: String,
    },
    /// A NaN or an infinity.
    #[error(
        "array {array} has {value} at frame {frame} (episode {episode}), column {column} ({name}); remove or repair that frame, or leave that episode out"
    )]
    NotFinite {
        /// Array within the store.
        array: String,
        /// Frame.
        frame: u64,
        /// Episode of the frame.
        episode: u32,
        /// Column.
        column: usize,
        /// Name of the column.
        name: String,
        /// The value.
        value: f64,
    },
    /// A value no Push-T recording can have.
    #[error(
        "array {array} has {value} at frame {frame} (episode {episode}), column {column} ({name}), outside {low} to {high} {unit}; repair that frame, convert its units, or leave that episode out"
    )]
    OutOfRange {
        /// Array within the store.
        array: String,
        /// Frame.
        frame: u64,
        /// Episode of the frame.
        episode: u32,
        /// Column.
        column: usize,
        /// Name of the column.
        name: String,
        /// The value.
        value: f64,
        /// Smallest accepted value.
        low: f64,
        /// Largest accepted value.
        high: f64,
        /// Unit of the range.
        unit: &'static str,
    },
    /// A number of contacts that is no count.
    #[error(
        "array data/n_contacts has {value} at frame {frame} (episode {episode}), which is no count; repair that frame, or leave that episode out"
    )]
    NotACount {
        /// Frame.
        frame: u64,
        /// Episode of the frame.
        episode: u32,
        /// The value.
        value: f64,
    },
    /// An image value that is no byte.
    #[error(
        "array data/img has {value} at frame {frame}, row {row}, column {column}, channel {channel}; images hold whole numbers from 0 to 255, so repair or convert that frame"
    )]
    NotAByte {
        /// Frame.
        frame: u64,
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        column: usize,
        /// Channel of the pixel.
        channel: usize,
        /// The value.
        value: f64,
    },
    /// Images scaled to 0..1.
    #[error(
        "array data/img looks scaled to 0..1 (it has {value} at frame {frame}); images hold whole numbers from 0 to 255, so multiply it by 255 and round"
    )]
    ScaledImages {
        /// Frame.
        frame: u64,
        /// The first fractional value.
        value: f64,
    },
    /// An end that is no whole number.
    #[error("meta/episode_ends is no whole number at index {index}; ends are frame counts, so repair that entry")]
    FractionalEnd {
        /// Episode.
        index: usize,
    },
    /// More columns than a state has, which are not the agent's velocity.
    #[error(
        "array data/state has seven columns, and the last two are not the agent's velocity ({why}); keep agent_x, agent_y, block_x, block_y, block_theta"
    )]
    StateColumns {
        /// What was found.
        why: String,
    },
    /// An episode that is not as the others are.
    #[error("{what} (episode {episode}), unlike the other episodes; repair it, or leave that episode out")]
    Contradicts {
        /// Episode.
        episode: u32,
        /// What is odd about it.
        what: String,
    },
    /// Numbers that are not what the settings say that they are.
    #[error("{what}; {fix}")]
    Convention {
        /// What was found, with the figures.
        what: String,
        /// What to set, or to convert.
        fix: String,
    },
    /// Episodes that cannot be used.
    #[error("{}", unusable(*bad, *episodes, list, *more, *all))]
    Episodes {
        /// How many.
        bad: usize,
        /// Of how many that were selected.
        episodes: usize,
        /// What is wrong with them, one entry a fault, without remedies.
        list: Vec<String>,
        /// Faults beyond these.
        more: usize,
        /// Whether leaving them out is no remedy, as nothing would be left or it was asked for already.
        all: bool,
    },
    /// Several faults of the dataset as a whole.
    #[error("{} things are wrong with it:{}", list.len() + more, several(list, *more))]
    Several {
        /// A sentence for each.
        list: Vec<String>,
        /// Faults beyond these.
        more: usize,
    },
    /// Images asked for, but none there.
    #[error("the dataset has no images (no array data/img); ingest it without images")]
    NoImages,
    /// A selection that does not fit.
    #[error(transparent)]
    Selection(#[from] SelectionError),
    /// An HDF5 file that is not as it has to be.
    #[error(transparent)]
    Hdf5(#[from] Hdf5Fault),
}

impl IngestError {
    /// Whether a file was opened without the HDF5 library and cannot be read so.
    pub fn needs_library(&self) -> bool {
        matches!(*self.fault, Fault::Hdf5(Hdf5Fault::NeedsLibrary))
    }
}

/// Entries of a list that are spelled out.
const SPELLED_OUT: usize = 20;

/// What a store has, in brackets of a sentence that says what it lacks.
fn there(arrays: &[String]) -> String {
    match arrays {
        [] => String::new(),
        arrays if arrays.len() > SPELLED_OUT => format!(", but {} other arrays", arrays.len()),
        arrays => format!(", but the store has {}", arrays.join(", ")),
    }
}

fn missing_chunk(
    array: &str,
    chunk: &str,
    more: u64,
    inside: Option<usize>,
    fill: Option<&str>,
    fills_are_stored: bool,
) -> String {
    let which = match (inside, more) {
        (Some(number), _) => format!("chunk number {number} of file {array}/{chunk} of array {array} is missing"),
        (None, 0) => format!("chunk {chunk} of array {array} is missing (no file {array}/{chunk})"),
        (None, more) => {
            format!("chunk {chunk} and {more} more of array {array} are missing (no file {array}/{chunk})")
        }
    };
    let why = match fill {
        Some(fill) if fills_are_stored => {
            format!(
                "others that hold nothing but the fill value {fill} are stored, so that it was not left out for that"
            )
        }
        Some(fill) => {
            format!("the fill value {fill}, which zarr's rule puts in its place, is not what a recording holds")
        }
        None => "the array has no fill value that could stand for it".to_owned(),
    };
    let files = if more == 0 { "that file" } else { "those files" };
    format!("{which}, and {why}; restore {files}, since the data is lost")
}

/// What else to do about an array that need not be there.
fn or_without(array: &str) -> &'static str {
    match array {
        "data/keypoint" | "data/n_contacts" => ", or remove the array, which is optional",
        "data/img" => ", or ingest without images",
        _ => "",
    }
}

fn unusable(bad: usize, of: usize, list: &[String], more: usize, all: bool) -> String {
    let more = match more {
        0 => String::new(),
        more => format!("; and {more} more"),
    };
    let fix = if all {
        "repair them"
    } else {
        "repair them, or set ingest.on_bad = \"leave_out\" to go on with the others"
    };
    format!(
        "{bad} of {of} episodes cannot be used: {}{more}; {fix}",
        list.join("; ")
    )
}

fn several(list: &[String], more: usize) -> String {
    let sentences: Vec<String> = (1..)
        .zip(list)
        .map(|(number, sentence)| format!(" ({number}) {sentence}"))
        .collect();
    let more = match more {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    sentences.join(";") + &more
}

impl Fault {
    /// What is wrong, without the remedy.
    pub(crate) fn what(&self) -> String {
        parts(&self.to_string()).0.to_owned()
    }

    /// Whether reading has to end at once: nothing more can be said of the dataset.
    pub(crate) fn ends_reading(&self) -> bool {
        matches!(self, Self::Stopped | Self::Changed { .. } | Self::Io { .. })
    }

    /// One fault of several of the dataset as a whole; `None` if there are none.
    pub(crate) fn of_all(mut faults: Vec<Self>) -> Option<Self> {
        if let Some(place) = faults.iter().position(Self::ends_reading) {
            return Some(faults.swap_remove(place));
        }
        if faults.len() < 2 {
            return faults.pop();
        }
        Some(Self::Several {
            more: faults.len().saturating_sub(SPELLED_OUT),
            list: faults.iter().take(SPELLED_OUT).map(Self::to_string).collect(),
        })
    }

    /// One fault of several of single episodes. `bad` of `episodes` are affected.
    pub(crate) fn of_episodes(faults: &[Self], bad: usize, episodes: usize, all: bool) -> Self {
        Self::Episodes {
            bad,
            episodes,
            list: faults.iter().take(SPELLED_OUT).map(Self::what).collect(),
            more: faults.len().saturating_sub(SPELLED_OUT),
            all,
        }
    }

    /// Attaches the dataset's path.
    pub(crate) fn of(self, dataset: &Path) -> IngestError {
        IngestError {
            dataset: dataset.to_owned(),
            fault: Box::new(self),
        }
    }

    /// An error of the operating system.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>, source: io::Error) -> Self {
        Self::Io {
            action,
            path: path.into(),
            source,
        }
    }
}

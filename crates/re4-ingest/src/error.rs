//! Errors of ingesting a dataset. Each message states what is wrong and where, and after the first `"; "` how to fix it.

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

/// A fault of a dataset. Frames are rows of the arrays, counted from 0 over the whole dataset.
#[derive(Debug, Error)]
pub enum Fault {
    /// There is nothing at the path.
    #[error("there is no such file or folder; correct the path, or fetch the dataset first")]
    MissingPath,
    /// Neither a regular file nor a folder, or a folder where a file is needed.
    #[error("it is {what}, not a regular file; give the path of the file itself")]
    NotAFile {
        /// Description of what is at the path.
        what: &'static str,
    },
    /// A file changed after it was opened.
    #[error(
        "{} changed while it was read, so nothing was published; wait until the program that writes it has finished, then run again",
        path.display()
    )]
    Changed {
        /// The file.
        path: PathBuf,
    },
    /// The caller requested a stop.
    #[error("reading was stopped; run again to continue")]
    Stopped,
    /// The folder is empty.
    #[error("the folder is empty; give the folder of a zarr store (it contains .zgroup, data/ and meta/)")]
    EmptyFolder,
    /// The folder is not a store.
    #[error("it is not a zarr store (no .zgroup in it); {hint}")]
    NotAStore {
        /// The remedy.
        hint: String,
    },
    /// The path is an array, but a group is needed.
    #[error("it is a single zarr array, not a dataset; give the folder that contains data/ and meta/")]
    SingleArray,
    /// The path is a file that is not a zip file.
    #[error("{what}; {fix}")]
    NotAStoreFile {
        /// Description of the file.
        what: &'static str,
        /// The remedy.
        fix: &'static str,
    },
    /// An entry of the store is neither a regular file nor a folder.
    #[error("{file} of the store is {what}, not a regular file; remove it, or restore the file")]
    NotAFileInside {
        /// Path within the store.
        file: String,
        /// Description of what is at the path.
        what: &'static str,
    },
    /// The zip file cannot be opened.
    #[error("the zip file is unreadable ({why}); download or pack it again")]
    UnreadableZip {
        /// Message of the zip library.
        why: String,
    },
    /// An entry of a zip file cannot be unpacked.
    #[error("entry {entry} of the zip file is unreadable ({why}); download or pack it again")]
    UnreadableZipEntry {
        /// Name of the entry.
        entry: String,
        /// Message of the zip library.
        why: String,
    },
    /// An entry of a zip file that would be unpacked outside the store.
    #[error(
        "entry {entry} of the zip file is a symbolic link or its path leads outside the archive; pack the store again without such entries"
    )]
    UnsafeZipEntry {
        /// Name of the entry.
        entry: String,
    },
    /// A link in a folder store points to one of its own parent folders.
    #[error("{link} is a symbolic link to one of its own parent folders; remove the link")]
    CircularLink {
        /// Path of the link within the store.
        link: String,
    },
    /// The zip file contains no store.
    #[error(
        "the zip file contains no zarr store (no .zgroup or zarr.json at its root or up to two folders deep); zip the folder of the store"
    )]
    ZipWithoutStore,
    /// The zip file contains more than one store.
    #[error("the zip file contains {count} zarr stores, including {first} and {second}; zip only one store")]
    SeveralStoresInZip {
        /// Number of stores.
        count: usize,
        /// The first in alphabetical order.
        first: String,
        /// The second in alphabetical order.
        second: String,
    },
    /// An operation of the operating system failed.
    #[error("cannot {action} {}: {source}; {}", path.display(), io_fix(source))]
    Io {
        /// The operation, such as "read".
        action: &'static str,
        /// Path of the file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A required array is missing.
    #[error(
        "array {array} is missing (no {array}/{file}{}); restore it, or give a complete dataset",
        there(arrays)
    )]
    MissingArray {
        /// Array within the store.
        array: String,
        /// Name of its metadata file.
        file: &'static str,
        /// Arrays that the store contains.
        arrays: Vec<String>,
    },
    /// The metadata of an array is invalid.
    #[error("the metadata of array {array} ({file}) cannot be read: {why}; restore that file")]
    ArrayMetadata {
        /// Array within the store.
        array: String,
        /// Path of the metadata within the store.
        file: String,
        /// What is wrong with it.
        why: String,
    },
    /// The encoding of an array is valid but not supported.
    #[error(
        "array {array} uses an unsupported encoding: {why}; rewrite it with zarr's default compressor and no filters"
    )]
    Encoding {
        /// Array within the store.
        array: String,
        /// What is not supported.
        why: String,
    },
    /// The chunks of an array exceed the memory budget.
    #[error(
        "array {array} has chunks of {} MiB, but the limit is {} MiB; rewrite it with smaller chunks along its first axis",
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
    /// The element type of an array is not accepted.
    #[error(
        "array {array} has dtype {found}, but {expected} is expected; convert it{}",
        or_without(array)
    )]
    WrongDtype {
        /// Array within the store.
        array: String,
        /// Type as written in the metadata.
        found: String,
        /// Accepted types, in words.
        expected: &'static str,
    },
    /// The shape of an array is not accepted.
    #[error(
        "array {array} has shape {found:?}, but {expected} is expected (N: number of frames); reshape it, or give a Push-T dataset{}",
        or_without(array)
    )]
    WrongShape {
        /// Array within the store.
        array: String,
        /// Its shape.
        found: Vec<u64>,
        /// Accepted shape, in words.
        expected: &'static str,
    },
    /// The length of an array differs from that of `data/state`.
    #[error(
        "array {array} has {found} frames, but data/state has {expected}; every array in data/ must have one row per frame, so restore or truncate the array that differs"
    )]
    LengthMismatch {
        /// Array within the store.
        array: String,
        /// Its length.
        found: u64,
        /// Length of `data/state`.
        expected: u64,
    },
    /// There are too many frames.
    #[error("data/state has {frames} frames, more than the limit of {limit}; split the dataset")]
    TooManyFrames {
        /// Frames of the dataset.
        frames: u64,
        /// The limit.
        limit: u64,
    },
    /// There are more episodes than frames.
    #[error(
        "meta/episode_ends has {episodes} entries, but data/state has {frames} frames; every episode needs at least one frame, so repair or restore meta/episode_ends"
    )]
    TooManyEnds {
        /// Entries of `meta/episode_ends`.
        episodes: u64,
        /// Frames in the arrays.
        frames: u64,
    },
    /// There are no episodes.
    #[error("meta/episode_ends is empty, so the dataset has no episodes; give a dataset with at least one")]
    NoEpisodes,
    /// An entry of `meta/episode_ends` is negative.
    #[error(
        "meta/episode_ends is negative at index {index} ({value}); ends are cumulative frame counts, so repair that entry"
    )]
    NegativeEnd {
        /// Index of the entry.
        index: usize,
        /// The entry.
        value: i128,
    },
    /// Entries of `meta/episode_ends` do not increase.
    #[error(
        "meta/episode_ends is not strictly increasing at index {index} ({value} after {previous}); repair that entry"
    )]
    EndsNotIncreasing {
        /// Index of the entry.
        index: usize,
        /// The entry.
        value: i128,
        /// The entry before it; 0 for the first.
        previous: i128,
    },
    /// The last entry of `meta/episode_ends` does not equal the number of frames.
    #[error(
        "meta/episode_ends ends at frame {last} (index {index}) but the arrays have {frames} frames; the last end must equal the number of frames, so repair it or restore the missing frames"
    )]
    EndsDoNotMatch {
        /// Index of the last entry.
        index: usize,
        /// The last entry.
        last: i128,
        /// Frames in the arrays.
        frames: u64,
    },
    /// A chunk is not stored, and may not be replaced by the fill value.
    #[error("{}", missing_chunk(array, chunk, *more, *inside, fill.as_deref(), *fills_are_stored))]
    MissingChunk {
        /// Array within the store.
        array: String,
        /// Name of the chunk's file within the array.
        chunk: String,
        /// Number of further missing chunks of the array.
        more: u64,
        /// Number of the chunk in its file, if a file contains several (a shard).
        inside: Option<usize>,
        /// The fill value as written in the metadata, if there is one.
        fill: Option<String>,
        /// Whether other chunks that contain only the fill value are stored.
        fills_are_stored: bool,
    },
    /// A chunk file cannot be decoded.
    #[error("chunk {chunk} of array {array} cannot be decoded (file {array}/{chunk}): {why}; restore that file")]
    UndecodableChunk {
        /// Array within the store.
        array: String,
        /// Name of the chunk's file within the array.
        chunk: String,
        /// What is wrong with it.
        why: String,
    },
    /// A value is NaN or infinite.
    #[error(
        "{array} has {value} at frame {frame} (episode {episode}), column {column} ({name}); remove or repair that frame, or leave that episode out"
    )]
    NotFinite {
        /// Where it is, such as "array data/state".
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
    /// A value is outside the range of Push-T recordings.
    #[error(
        "{array} has {value} at frame {frame} (episode {episode}), column {column} ({name}), outside {low} to {high} {unit}; repair that frame, convert its units, or leave that episode out"
    )]
    OutOfRange {
        /// Where it is, such as "array data/state".
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
    /// A number of contacts is not a non-negative integer.
    #[error(
        "array data/n_contacts has {value} at frame {frame} (episode {episode}), which is not a valid contact count; repair that frame, or leave that episode out"
    )]
    NotACount {
        /// Frame.
        frame: u64,
        /// Episode of the frame.
        episode: u32,
        /// The value.
        value: f64,
    },
    /// An image value is not an integer from 0 to 255.
    #[error(
        "array data/img has {value} at frame {frame}, row {row}, column {column}, channel {channel}; images contain integers from 0 to 255, so repair or convert that frame"
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
    /// Image values are scaled to 0..1.
    #[error(
        "array data/img looks scaled to 0..1 (it has {value} at frame {frame}); images contain integers from 0 to 255, so multiply it by 255 and round"
    )]
    ScaledImages {
        /// Frame.
        frame: u64,
        /// The first fractional value.
        value: f64,
    },
    /// An entry of `meta/episode_ends` is not an integer.
    #[error(
        "meta/episode_ends is not an integer at index {index}; ends are cumulative frame counts, so repair that entry"
    )]
    FractionalEnd {
        /// Index of the entry.
        index: usize,
    },
    /// States have seven columns, but the last two are not the agent's velocity.
    #[error(
        "array data/state has seven columns, and the last two are not the agent's velocity ({why}); keep agent_x, agent_y, block_x, block_y, block_theta"
    )]
    StateColumns {
        /// What was found.
        why: String,
    },
    /// An episode contradicts the others.
    #[error("{what} (episode {episode}), unlike the other episodes; repair it, or leave that episode out")]
    Contradicts {
        /// Episode.
        episode: u32,
        /// What is unusual about it.
        what: String,
    },
    /// Values contradict the settings, or the conventions of the original dataset.
    #[error("{what}; {fix}")]
    Convention {
        /// What was found, with the values.
        what: String,
        /// What to set or to convert.
        fix: String,
    },
    /// Episodes cannot be used.
    #[error("{}", unusable(*bad, *episodes, list, *more, *all))]
    Episodes {
        /// Number of these episodes.
        bad: usize,
        /// Number of selected episodes.
        episodes: usize,
        /// Their faults, one entry each, without remedies.
        list: Vec<String>,
        /// Number of faults that are not listed.
        more: usize,
        /// Whether `ingest.on_bad = "leave_out"` is no remedy, because no episode would remain or because it is set already.
        all: bool,
    },
    /// Several faults of the dataset as a whole.
    #[error("{} problems were found:{}", list.len() + more, several(list, *more))]
    Several {
        /// One message for each fault.
        list: Vec<String>,
        /// Number of faults that are not listed.
        more: usize,
    },
    /// Images are requested, but there are none.
    #[error("the dataset has no images (no array data/img); ingest it without images")]
    NoImages,
    /// The selection does not match the dataset.
    #[error(transparent)]
    Selection(#[from] SelectionError),
    /// An HDF5 file cannot be used.
    #[error(transparent)]
    Hdf5(#[from] Hdf5Fault),
    /// A LeRobot dataset, or an episode of it, cannot be used: one sentence with the remedy.
    #[error("{0}")]
    Lerobot(String),
}

impl IngestError {
    /// Whether a file was opened without the HDF5 library but needs it.
    pub fn needs_library(&self) -> bool {
        matches!(*self.fault, Fault::Hdf5(Hdf5Fault::NeedsLibrary))
    }
}

/// Maximum number of list entries in a message.
const SPELLED_OUT: usize = 20;

/// The arrays of a store, as a clause for the parentheses after a missing array's name.
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
                "other chunks that contain only the fill value {fill} are stored, so this one was not omitted for that reason"
            )
        }
        Some(fill) => {
            format!("the fill value {fill}, which zarr would substitute, is not valid recorded data")
        }
        None => "the array has no fill value to substitute".to_owned(),
    };
    let files = if more == 0 { "that file" } else { "those files" };
    format!("{which}, and {why}; restore {files}, because the data is lost")
}

/// An alternative remedy for an optional array.
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
        "repair them, or set ingest.on_bad = \"leave_out\" to ingest the others"
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
    /// The fault without the remedy.
    pub(crate) fn what(&self) -> String {
        parts(&self.to_string()).0.to_owned()
    }

    /// Whether reading must end at once, because nothing reliable can be said about the rest of the dataset.
    pub(crate) fn ends_reading(&self) -> bool {
        matches!(self, Self::Stopped | Self::Changed { .. } | Self::Io { .. })
    }

    /// Combines faults of the dataset as a whole into one; `None` if there are none.
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

    /// Combines faults of single episodes into one. `bad` of `episodes` are affected.
    pub(crate) fn of_episodes(faults: &[Self], bad: usize, episodes: usize, all: bool) -> Self {
        Self::Episodes {
            bad,
            episodes,
            list: faults.iter().take(SPELLED_OUT).map(Self::what).collect(),
            more: faults.len().saturating_sub(SPELLED_OUT),
            all,
        }
    }

    /// Adds the dataset's path.
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

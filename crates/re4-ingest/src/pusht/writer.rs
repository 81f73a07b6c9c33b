//! Writes episodes in the format of the Push-T dataset.

use std::f64::consts::TAU;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use re4_episode::{PlanarEpisode, PlanarFrame};
use re4_geometry::{Point2, wrap_to_two_pi};
use serde::Serialize;
use serde_json::json;
use thiserror::Error;
use zarrs::array::{Array, ArrayBytes, ArrayMetadata, ArrayMetadataV2, ArrayToBytesCodecTraits, CodecOptions};
use zarrs::storage::store::MemoryStore;

use super::episodes::PushtEpisodes;
use super::validate;
use crate::error::Fault;
use crate::source::io_fix;
use crate::tables::KEYPOINTS;

/// Rows of a chunk, as in the original dataset.
const CHUNK: usize = 161;

/// The nine keypoints of the block in the block frame (pixels): `world = position + R(theta) keypoint`.
///
/// Derived from `pusht_cchi_v7_replay.zarr` by `tests/fixtures/derive_keypoints.py`: the median over its 25,650 frames of
/// `R(theta)^T (keypoint - position)`. The recorded points are rigid (distances between them vary by less than 4.1e-5 px).
/// They are within 1.5e-5 px of these in half of the frames and within 0.04 px in 99 %. While the block moves fast, the recorded
/// pose and the recorded keypoints are from slightly different times and differ by up to 2.2 px.
pub const KEYPOINTS_IN_BLOCK: [[f64; 2]; KEYPOINTS] = [
    [9.269_787, 90.040_974],
    [-60.983_472, -1.186_730],
    [60.912_755, -1.393_363],
    [-0.270_504, 25.543_625],
    [-14.064_927, 122.815_854],
    [39.002_738, 32.857_404],
    [-39.966_414, 32.729_655],
    [-16.824_344, 62.863_179],
    [23.541_461, -1.700_288],
];

/// Writer of Push-T datasets: Zarr v2 folders with `data/{action,state,keypoint,n_contacts}` and `meta/episode_ends`, float32
/// (int64 for the ends), Blosc zstd level 5 with bit shuffle, 161 rows per chunk, as in the original. No images are written.
pub struct PushtWriter;

/// An episode to write.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedEpisode {
    /// Frames in order of time. Block angles may be any finite number; they are stored in 0 to 2π.
    pub frames: Vec<PlanarFrame>,
}

impl From<&PlanarEpisode> for RecordedEpisode {
    fn from(episode: &PlanarEpisode) -> Self {
        Self {
            frames: episode.frames.clone(),
        }
    }
}

/// An error of writing episodes.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The path exists already.
    #[error("cannot record episodes to {}: it exists already; remove it or choose another path", path.display())]
    Exists {
        /// The path of the dataset.
        path: PathBuf,
    },
    /// There are no episodes, or an episode has no frames.
    #[error("cannot record episodes to {}: {}; record at least one frame in every episode", path.display(),
        episode.map_or("there is no episode".to_owned(), |episode| format!("episode {episode} has no frames")))]
    Empty {
        /// The path of the dataset.
        path: PathBuf,
        /// The episode without frames; `None` if there are no episodes.
        episode: Option<usize>,
    },
    /// A value that the reader of the dataset would refuse. Frames are counted over all episodes.
    #[error("cannot record episodes to {}: {fault}", path.display())]
    Value {
        /// The path of the dataset.
        path: PathBuf,
        /// The fault of the value.
        #[source]
        fault: Box<Fault>,
    },
    /// The encoder failed.
    #[error("cannot record episodes to {}: array {array} cannot be encoded: {why}; this is a bug in re4-pipe, please report it", path.display())]
    Encode {
        /// The path of the dataset.
        path: PathBuf,
        /// Array within the store.
        array: &'static str,
        /// Message of the encoder.
        why: String,
    },
    /// An operation of the operating system failed.
    #[error("cannot record episodes to {}: cannot {action} {}: {source}; {}", path.display(), file.display(), io_fix(source))]
    Io {
        /// The path of the dataset.
        path: PathBuf,
        /// The operation, such as "write".
        action: &'static str,
        /// Path of the file or folder.
        file: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl PushtWriter {
    /// Writes the episodes to a new folder, completely or not at all: the dataset is built in a temporary sibling and renamed.
    /// Equal episodes give equal bytes. If contacts are unknown (NaN) in every frame, `n_contacts` is not written.
    ///
    /// # Errors
    /// The path exists, there are no episodes or an episode has no frames, a value is outside the range that
    /// [`super::PushtReader`] accepts, or a file cannot be written.
    pub fn write(path: &Path, episodes: &[RecordedEpisode]) -> Result<(), RecordError> {
        let io_error = |action, file: &Path, source| RecordError::Io {
            path: path.to_owned(),
            action,
            file: file.to_owned(),
            source,
        };
        match fs::symlink_metadata(path) {
            Ok(_) => return Err(RecordError::Exists { path: path.to_owned() }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(io_error("inspect", path, error)),
        }
        if episodes.is_empty() {
            return Err(RecordError::Empty {
                path: path.to_owned(),
                episode: None,
            });
        }
        if let Some(episode) = episodes.iter().position(|episode| episode.frames.is_empty()) {
            return Err(RecordError::Empty {
                path: path.to_owned(),
                episode: Some(episode),
            });
        }
        let columns = columns(episodes);
        validate::values(&columns).map_err(|fault| RecordError::Value {
            path: path.to_owned(),
            fault: Box::new(fault),
        })?;
        let files = files(&columns).map_err(|(array, why)| RecordError::Encode {
            path: path.to_owned(),
            array,
            why,
        })?;

        let parent = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let temporary = tempfile::Builder::new()
            .prefix(".re4-record-")
            .tempdir_in(parent)
            // Only the kind of the error: tempfile's own message repeats the path and adds a random name.
            .map_err(|error| io_error("create a folder in", parent, error.kind().into()))?;
        // The temporary folder is private to its owner, so the store is built in a subfolder with the usual permissions.
        let building = temporary.path().join("store");
        for (name, bytes) in files {
            let file = building.join(name);
            let folder = file.parent().unwrap_or(&building);
            fs::create_dir_all(folder).map_err(|error| io_error("create", folder, error))?;
            fs::write(&file, bytes).map_err(|error| io_error("write", &file, error))?;
        }
        fs::rename(&building, path).map_err(|error| io_error("rename the finished dataset to", path, error))
    }
}

/// The columns as they will be stored, with every number rounded to f32.
fn columns(episodes: &[RecordedEpisode]) -> PushtEpisodes {
    let round = |value: f64| f64::from(value as f32);
    let pair = |point: Point2| [round(point.x), round(point.y)];
    let mut columns = PushtEpisodes::default();
    let (mut contacts, mut keypoints) = (Vec::new(), Vec::new());
    for (source, episode) in episodes.iter().enumerate() {
        let start = columns.state.len();
        for frame in &episode.frames {
            let ([agent_x, agent_y], [block_x, block_y]) = (pair(frame.eef), pair(frame.object.translation()));
            columns
                .state
                .push([agent_x, agent_y, block_x, block_y, stored_angle(frame.object.theta)]);
            columns.action.push(pair(frame.action));
            contacts.push(round(frame.contacts));
            keypoints.push(KEYPOINTS_IN_BLOCK.map(|[x, y]| pair(frame.object.transform_point(Point2::new(x, y)))));
        }
        let range = start..columns.state.len();
        columns.sources.push(source as u32);
        columns.rows.push(range.clone());
        columns.frames.push(range);
    }
    columns.contacts = Some(contacts).filter(|contacts| !contacts.iter().all(|value| value.is_nan()));
    columns.keypoint = Some(keypoints);
    columns
}

/// The angle in `[0, 2π)` after rounding to f32.
fn stored_angle(theta: f64) -> f64 {
    let rounded = f64::from(wrap_to_two_pi(theta) as f32);
    // For angles just below 2π the nearest f32 exceeds 2π; 0 is the same angle within the rounding error.
    if rounded >= TAU { 0.0 } else { rounded }
}

/// Files of a store: path within the store, and content.
type Files = Vec<(String, Vec<u8>)>;

/// The store's files and their content. The error has the array that could not be encoded, and why.
fn files(columns: &PushtEpisodes) -> Result<Files, (&'static str, String)> {
    let group = || text(&json!({ "zarr_format": 2 }));
    let attributes = || text(&json!({}));
    let mut files = Vec::new();
    for folder in ["", "data/", "meta/"] {
        files.push((format!("{folder}.zgroup"), group()));
        files.push((format!("{folder}.zattrs"), attributes()));
    }
    let floats = |values: &mut dyn Iterator<Item = f64>| -> Vec<u8> {
        values.flat_map(|value| (value as f32).to_ne_bytes()).collect()
    };
    let length = columns.state.len();
    let mut add = |name, inner: &[usize], bytes: &[u8]| -> Result<(), (&'static str, String)> {
        let shape = [&[length], inner].concat();
        files.extend(array_files(name, "<f4", &shape, CHUNK, bytes).map_err(|why| (name, why))?);
        Ok(())
    };
    add(
        "data/action",
        &[2],
        &floats(&mut columns.action.iter().flatten().copied()),
    )?;
    add(
        "data/state",
        &[5],
        &floats(&mut columns.state.iter().flatten().copied()),
    )?;
    if let Some(keypoint) = &columns.keypoint {
        add(
            "data/keypoint",
            &[KEYPOINTS, 2],
            &floats(&mut keypoint.iter().flatten().flatten().copied()),
        )?;
    }
    if let Some(contacts) = &columns.contacts {
        add("data/n_contacts", &[1], &floats(&mut contacts.iter().copied()))?;
    }
    let ends: Vec<u8> = columns
        .frames
        .iter()
        .flat_map(|frames| (frames.end as i64).to_ne_bytes())
        .collect();
    let name = "meta/episode_ends";
    let episodes = columns.frames.len();
    files.extend(array_files(name, "<i8", &[episodes], episodes, &ends).map_err(|why| (name, why))?);
    Ok(files)
}

/// `.zarray` and the chunks of an array with `chunk` whole rows per chunk. `bytes` are in native byte order.
fn array_files(name: &'static str, dtype: &str, shape: &[usize], chunk: usize, bytes: &[u8]) -> Result<Files, String> {
    let (rows, inner) = shape.split_first().ok_or("no dimensions")?;
    let chunks = [&[chunk], inner].concat();
    let metadata = json!({
        "chunks": chunks,
        "compressor": { "blocksize": 0, "clevel": 5, "cname": "zstd", "id": "blosc", "shuffle": 2 },
        "dtype": dtype,
        "fill_value": if dtype == "<f4" { json!(0.0) } else { json!(0) },
        "filters": null,
        "order": "C",
        "shape": shape,
        "zarr_format": 2,
    });
    let mut files = vec![(format!("{name}/.zarray"), text(&metadata))];
    let metadata: ArrayMetadataV2 = serde_json::from_value(metadata).map_err(|error| error.to_string())?;
    let array = Array::new_with_metadata(Arc::new(MemoryStore::new()), "/array", ArrayMetadata::V2(metadata))
        .map_err(|error| error.to_string())?;
    let chunk_bytes = bytes.len() / rows * chunk;
    for (number, part) in bytes.chunks(chunk_bytes).enumerate() {
        // Chunks at the edge are stored at full size, padded with the fill value, which is zero.
        let mut padded = part.to_vec();
        padded.resize(chunk_bytes, 0);
        let index: Vec<u64> = std::iter::once(number as u64).chain(inner.iter().map(|_| 0)).collect();
        let shape = array.chunk_shape(&index).map_err(|error| error.to_string())?;
        let encoded = array
            .codecs()
            .encode(
                ArrayBytes::new_flen(padded),
                &shape,
                array.data_type(),
                array.fill_value(),
                &CodecOptions::default(),
            )
            .map_err(|error| error.to_string())?;
        let key = array.chunk_key(&index);
        let key = key.as_str().strip_prefix("array/").unwrap_or(key.as_str());
        files.push((format!("{name}/{key}"), encoded.into_owned()));
    }
    Ok(files)
}

/// JSON in the layout of zarr-python.
fn text(value: &serde_json::Value) -> Vec<u8> {
    let mut text = Vec::new();
    let formatter = serde_json::ser::PrettyFormatter::with_indent(b"    ");
    // Writing a JSON value to memory cannot fail; if it did, every reader would refuse the empty file.
    let _ = value.serialize(&mut serde_json::Serializer::with_formatter(&mut text, formatter));
    text
}

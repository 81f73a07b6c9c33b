//! Shared by the tests: the fixtures, the formulas of their values, and copies of them that tests can corrupt.
#![allow(dead_code, reason = "each test uses a part of this")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests may fail like tests"
)]

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use re4_ingest::Selection;
use re4_ingest::pusht::{PushtEpisodes, PushtOptions, PushtReader, Recorded};
use tempfile::TempDir;

pub(crate) mod made;

pub(crate) const FRAMES: usize = 30;
pub(crate) const RANGES: [Range<usize>; 3] = [0..12, 12..17, 17..30];
pub(crate) const SIDE: usize = 8;

pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

/// A file or folder of the datasets that are not part of the repository, if it is available.
pub(crate) fn available(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let data = std::env::var_os("RE4_DATA").map_or_else(beside, PathBuf::from);
    let path = data.join(name);
    let there = path.exists();
    if !there {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            path.display()
        );
    }
    there.then_some(path)
}

/// The original dataset, if it is available.
pub(crate) fn real_dataset() -> Option<PathBuf> {
    available("pusht/pusht_cchi_v7_replay.zarr")
}

/// The files of a folder and of the folders in it that have this extension, sorted.
pub(crate) fn files_below(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files_below(&path, extension));
        } else if path.extension().is_some_and(|end| end == extension) {
            found.push(path);
        }
    }
    found.sort();
    found
}

pub(crate) fn state(t: usize) -> [f64; 5] {
    let t = t as f64;
    [
        100.0 + 1.5 * t,
        50.0 + 2.25 * t,
        200.0 + 0.5 * t,
        300.0 - 0.25 * t,
        (t % 25.0) * 0.25,
    ]
}

pub(crate) fn action(t: usize) -> [f64; 2] {
    [((37 * t) % 512) as f64, ((91 * t + 5) % 512) as f64]
}

pub(crate) fn contacts(t: usize) -> f64 {
    (t % 3) as f64
}

pub(crate) fn keypoint(t: usize) -> [[f64; 2]; 9] {
    std::array::from_fn(|point| std::array::from_fn(|axis| 10.0 * point as f64 + 100.0 * axis as f64 + 0.5 * t as f64))
}

pub(crate) fn image(t: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for y in 0..SIDE {
        for x in 0..SIDE {
            for c in 0..3 {
                bytes.push(((7 * t + 31 * y + 5 * x + 11 * c) % 256) as u8);
            }
        }
    }
    bytes
}

/// The content of a fixture for the given episodes.
pub(crate) fn expected(sources: &[u32], complete: bool) -> PushtEpisodes {
    let rows: Vec<Range<usize>> = sources.iter().map(|&source| RANGES[source as usize].clone()).collect();
    let all = || rows.iter().cloned().flatten();
    let mut start = 0;
    PushtEpisodes {
        sources: sources.to_vec(),
        frames: rows
            .iter()
            .map(|rows| {
                start += rows.len();
                start - rows.len()..start
            })
            .collect(),
        state: all().map(state).collect(),
        action: all().map(action).collect(),
        contacts: complete.then(|| all().map(contacts).collect()),
        keypoint: complete.then(|| all().map(keypoint).collect()),
        rows,
        recorded: Recorded::default(),
    }
}

/// A copy of a fixture that a test may corrupt.
pub(crate) struct Copy {
    folder: TempDir,
}

impl Copy {
    pub(crate) fn of(name: &str) -> Self {
        let folder = TempDir::new().unwrap();
        copy_folder(&fixture(name), &folder.path().join("store.zarr"));
        Self { folder }
    }

    pub(crate) fn path(&self) -> PathBuf {
        self.folder.path().join("store.zarr")
    }

    pub(crate) fn remove(self, name: &str) -> Self {
        let path = self.path().join(name);
        if path.is_dir() {
            fs::remove_dir_all(path)
        } else {
            fs::remove_file(path)
        }
        .unwrap();
        self
    }

    pub(crate) fn write(self, name: &str, bytes: impl AsRef<[u8]>) -> Self {
        fs::write(self.path().join(name), bytes).unwrap();
        self
    }

    /// Changes a file's bytes.
    pub(crate) fn edit(self, name: &str, edit: impl FnOnce(&mut Vec<u8>)) -> Self {
        let path = self.path().join(name);
        let mut bytes = fs::read(&path).unwrap();
        edit(&mut bytes);
        fs::write(path, bytes).unwrap();
        self
    }

    /// Changes entries of an array's `.zarray`.
    pub(crate) fn metadata(self, array: &str, entries: &[(&str, serde_json::Value)]) -> Self {
        self.edit(&format!("{array}/.zarray"), |bytes| {
            let mut json: serde_json::Value = serde_json::from_slice(bytes).unwrap();
            for (key, value) in entries {
                json[*key] = value.clone();
            }
            *bytes = serde_json::to_vec(&json).unwrap();
        })
    }

    /// Replaces an array by an uncompressed one of a single chunk.
    pub(crate) fn replace(self, array: &str, dtype: &str, shape: &[usize], bytes: Vec<u8>) -> Self {
        let folder = self.path().join(array);
        fs::remove_dir_all(&folder).unwrap();
        fs::create_dir(&folder).unwrap();
        let metadata = serde_json::json!({
            "zarr_format": 2, "shape": shape, "chunks": shape.iter().map(|&length| length.max(1)).collect::<Vec<_>>(),
            "dtype": dtype, "compressor": null, "fill_value": 0, "filters": null, "order": "C"
        });
        fs::write(folder.join(".zarray"), serde_json::to_vec(&metadata).unwrap()).unwrap();
        if shape.iter().product::<usize>() > 0 {
            fs::write(folder.join(vec!["0"; shape.len()].join(".")), bytes).unwrap();
        }
        self
    }

    /// Replaces an array of the fixture by float32 values.
    pub(crate) fn floats(self, array: &str, shape: &[usize], values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|&value| (value as f32).to_le_bytes()).collect();
        self.replace(array, "<f4", shape, bytes)
    }

    /// Replaces `meta/episode_ends`.
    pub(crate) fn ends(self, ends: &[i64]) -> Self {
        let bytes = ends.iter().flat_map(|end| end.to_le_bytes()).collect();
        self.replace("meta/episode_ends", "<i8", &[ends.len()], bytes)
    }

    /// The message with which the copy is refused, without the paths of this run.
    pub(crate) fn refusal(&self) -> String {
        refusal(&self.path(), self.folder.path())
    }
}

/// The message with which a dataset is refused, with `folder` replaced by `[folder]`.
pub(crate) fn refusal(dataset: &Path, folder: &Path) -> String {
    let sentence = read_all(dataset).expect_err("the dataset should be refused");
    sentence.replace(folder.to_str().unwrap(), "[folder]")
}

/// Opens a dataset and reads columns and images. Returns the message of the first error.
pub(crate) fn read_all(dataset: &Path) -> Result<PushtEpisodes, String> {
    let reader = PushtReader::open(dataset).map_err(|error| error.to_string())?;
    let options = PushtOptions {
        images: true,
        ..PushtOptions::default()
    };
    let episodes = reader
        .read(&Selection::All, &options)
        .map_err(|error| error.to_string())?
        .episodes;
    if reader.image_shape().is_some() {
        for block in reader
            .image_blocks(&Selection::All)
            .map_err(|error| error.to_string())?
        {
            block.map_err(|error| error.to_string())?;
        }
    }
    Ok(episodes)
}

pub(crate) fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Packs files into a zip.
pub(crate) fn zip_files(path: &Path, files: &[(String, Vec<u8>)], stored: bool) {
    use std::io::Write;
    let method = if stored {
        zip::CompressionMethod::Stored
    } else {
        zip::CompressionMethod::Deflated
    };
    let options = zip::write::SimpleFileOptions::default().compression_method(method);
    let mut writer = zip::ZipWriter::new(fs::File::create(path).unwrap());
    for (name, bytes) in files {
        writer.start_file(name.as_str(), options).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap();
}

/// The files of a folder, with `prefix` before their relative paths.
pub(crate) fn files_of(folder: &Path, prefix: &str) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = format!("{prefix}{}", entry.file_name().to_str().unwrap());
        if entry.file_type().unwrap().is_dir() {
            files.extend(files_of(&entry.path(), &format!("{name}/")));
        } else {
            files.push((name, fs::read(entry.path()).unwrap()));
        }
    }
    files.sort();
    files
}

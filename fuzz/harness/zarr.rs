//! Edits some files of a Push-T store, then reads all of it.
//!
//! An input consists of the number of the store (one byte), the selection of episodes (one byte), and edits, each with the number
//! of a file (one byte) and the bytes that `edits.rs` describes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use re4_ingest::pusht::{PushtOptions, PushtReader};
use re4_ingest::{OnBad, Selection};
use tempfile::TempDir;

use super::edits::{Input, edit};

const MOST_EDITS: usize = 8;

/// The stores that are edited. Most numbers select one of the first stores, so that older inputs keep their meaning.
const STORES: [&str; 7] = [
    "minimal", "modern", "original", "mixed", "format3", "sharded", "fortran",
];

/// Numbers below this one select one of the first stores.
const OLDER: (usize, u8) = (4, 240);

/// An unedited store in a temporary folder.
struct Store {
    folder: PathBuf,
    files: BTreeMap<PathBuf, Vec<u8>>,
}

/// The stores that are edited.
pub(crate) struct Zarr {
    stores: Vec<Store>,
    _folder: TempDir,
}

impl Zarr {
    /// Copies the stores that the tests of the reader use.
    pub(crate) fn new(repository: &Path) -> Self {
        let folder = tempfile::Builder::new().prefix("re4-fuzz-").tempdir().unwrap();
        let fixtures = repository.join("crates/re4-ingest/tests/fixtures");
        let stores = STORES.map(|name| {
            let store = Store {
                folder: folder.path().join(name),
                files: files_below(&fixtures.join(name)),
            };
            for (name, bytes) in &store.files {
                write(&store.folder.join(name), bytes);
            }
            store
        });
        Self {
            stores: stores.into(),
            _folder: folder,
        }
    }

    /// Reads the store that the input describes. Returns the first error.
    pub(crate) fn run(&self, input: &[u8]) -> Result<(), String> {
        let mut input = Input(input);
        let (older, newer) = self.stores.split_at(OLDER.0);
        let store = match input.byte() {
            number if number < OLDER.1 => &older[usize::from(number) % older.len()],
            number => &newer[usize::from(number - OLDER.1) % newer.len()],
        };
        let selection = selection(input.byte());
        let names: Vec<&PathBuf> = store.files.keys().collect();
        let mut edited: BTreeMap<&PathBuf, Option<Vec<u8>>> = BTreeMap::new();
        while !input.is_empty() && edited.len() < MOST_EDITS {
            let number = usize::from(input.byte());
            let name = names[number % names.len()];
            let donor = &store.files[names[(number + 1) % names.len()]];
            let content = edited.remove(name).flatten();
            let content = edit(&mut input, content.as_ref().unwrap_or(&store.files[name]), donor);
            edited.insert(name, content);
        }
        for (name, content) in &edited {
            match content {
                Some(bytes) => write(&store.folder.join(name), bytes),
                None => fs::remove_file(store.folder.join(name)).unwrap(),
            }
        }
        let outcome = read(&store.folder, &selection);
        for name in edited.into_keys() {
            write(&store.folder.join(name), &store.files[name]);
        }
        outcome
    }
}

/// Reads everything in a dataset.
pub(crate) fn read(path: &Path, selection: &Selection) -> Result<(), String> {
    let reader = PushtReader::open(path).map_err(|error| error.to_string())?;
    reader.source_hash(&|| false).map_err(|error| error.to_string())?;
    // With `leave_out`, the same checks apply, and the remaining demonstrations are read as without the bad ones.
    let options = PushtOptions {
        on_bad: OnBad::LeaveOut,
        images: true,
        ..PushtOptions::default()
    };
    if let Ok(reading) = reader.read(selection, &options) {
        let good = reading.episodes;
        assert_eq!(good.action.len(), good.frame_count());
        assert!(good.state.as_flattened().iter().all(|value| value.is_finite()));
    }
    let (episodes, _) = reader.read_episodes(selection).map_err(|error| error.to_string())?;
    let frames = episodes.frame_count();
    assert_eq!(episodes.action.len(), frames);
    let planar = episodes.planar_episodes();
    assert_eq!(planar.iter().map(|episode| episode.frames.len()).sum::<usize>(), frames);
    let Some([height, width, channels]) = reader.image_shape() else {
        return Ok(());
    };
    let mut images = 0;
    for block in reader.image_blocks(selection).map_err(|error| error.to_string())? {
        let block = block.map_err(|error| error.to_string())?;
        assert_eq!(block.bytes.len(), block.frames.len() * height * width * channels);
        images += block.frames.len();
    }
    assert_eq!(images, frames);
    Ok(())
}

pub(crate) fn selection(byte: u8) -> Selection {
    let count = u32::from(byte >> 2);
    match byte % 4 {
        0 => Selection::All,
        1 => Selection::First(count),
        2 => Selection::Last(count),
        _ => Selection::List([count / 8, count % 8].map(|number| u64::from(number).into()).to_vec()),
    }
}

/// The files below a folder, by relative path.
pub(crate) fn files_below(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_owned();
                files.insert(name, fs::read(path).unwrap());
            }
        }
    }
    files
}

fn write(path: &Path, bytes: &[u8]) {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).unwrap();
    }
    fs::write(path, bytes).unwrap();
}

//! Edits some bytes of a small HDF5 file, then reads all of it without the HDF5 library.
//!
//! An input consists of the number of the file (one byte), the selection of demonstrations (one byte), and edits as described in
//! `edits.rs`. A file that only the library can read is refused, because the program reads it in another process.

use std::fs;
use std::path::{Path, PathBuf};

use re4_ingest::robomimic::{Access, DemoChoice, Interpreter, Reading, RobomimicReader, RobomimicSource, Sources};
use re4_ingest::{DemoSource as _, Frames, IngestError, Tally};
use re4_robosuite::conventions::{RobosuiteTask, Settings};
use tempfile::TempDir;

use super::edits::{Input, edit};
use super::zarr::selection;

const MOST_EDITS: usize = 8;

/// The files that are edited.
pub(crate) struct Hdf5 {
    files: Vec<Vec<u8>>,
    path: PathBuf,
    _folder: TempDir,
}

impl Hdf5 {
    /// Reads the files that `make_hdf5.py` wrote.
    pub(crate) fn new(repository: &Path) -> Self {
        let folder = tempfile::Builder::new().prefix("re4-fuzz-").tempdir().unwrap();
        let fixtures = repository.join("crates/re4-ingest/tests/fixtures/hdf5");
        let file = |name: &str| fs::read(fixtures.join(name)).unwrap();
        Self {
            files: vec![file("plain.hdf5"), file("single.hdf5")],
            path: folder.path().join("edited.hdf5"),
            _folder: folder,
        }
    }

    /// Reads the file that the input describes. Returns the first error.
    pub(crate) fn run(&self, input: &[u8]) -> Result<(), String> {
        let mut input = Input(input);
        let number = usize::from(input.byte());
        let choice = input.byte();
        let mut bytes = self.files[number % self.files.len()].clone();
        let donor = &self.files[(number + 1) % self.files.len()];
        for _ in 0..MOST_EDITS {
            if input.is_empty() {
                break;
            }
            bytes = edit(&mut input, &bytes, donor).unwrap_or_default();
        }
        fs::write(&self.path, &bytes).unwrap();
        read(&self.path, choice).map_err(|error| error.to_string())
    }
}

/// Reads everything in a file. An unusable demonstration is not an error of the file.
fn read(path: &Path, choice: u8) -> Result<(), IngestError> {
    let choice = DemoChoice {
        filter: (choice & 0x80 != 0).then(|| "train".to_owned()),
        select: selection(choice & 0x7f),
        cautious: false,
    };
    let reader = RobomimicReader::open(&Sources::open(path)?, &choice, Access::Direct, None)?;
    reader.sources().hash(&|| false)?;
    let reading = Reading {
        task: RobosuiteTask::named("can"),
        object: None,
        env_args: None,
        conventions: Settings::default(),
    };
    let learned = Interpreter::learn(&reader, &reading)?;
    let cameras = reader.cameras(None)?;
    let source = RobomimicSource::new(reader, learned, None, cameras)?;
    let mut tally = Tally::default();
    let mut kept = Vec::new();
    source.episodes(0..source.demos().len(), |_, episode| {
        match episode {
            Ok(mut episode) => {
                assert!(matches!(episode.frames, Frames::Spatial(_)) && episode.frames.count() > 0);
                kept.push((episode.name.clone(), episode.frames.count()));
                tally.add(&mut episode);
            }
            Err(left) => {
                assert!(!left.why.is_empty());
                tally.left_out.push(left);
            }
        }
        Ok::<(), IngestError>(())
    })?;
    for camera in &source.info().cameras {
        source.images(camera, &kept, |block| {
            if let Ok(block) = block {
                assert_eq!(block.bytes.len(), block.places.len() * block.height * block.width * 3);
            }
            Ok::<(), IngestError>(())
        })?;
    }
    source.warnings(&tally)?;
    source.unchanged()
}

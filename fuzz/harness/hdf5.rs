//! A small HDF5 file with some of its bytes edited, read whole without the HDF5 library.
//!
//! An input is the number of the file that is edited (one byte), the choice of demonstrations (one byte), and edits, each what
//! `edits.rs` says. A file that only the library could read is refused, as the program leaves it to another process.

use std::fs;
use std::path::{Path, PathBuf};

use re4_ingest::IngestError;
use re4_ingest::robomimic::{Access, DemoChoice, Interpreter, Reading, RobomimicReader, Sources};
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

    /// Reads the file that the input describes; the sentence of the first error.
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

/// Reads all that there is of a file; a demonstration that cannot be used is no error of the file.
fn read(path: &Path, choice: u8) -> Result<(), IngestError> {
    let choice = DemoChoice {
        filter: (choice & 0x80 != 0).then(|| "train".to_owned()),
        select: selection(choice & 0x7f),
        cautious: false,
    };
    let reader = RobomimicReader::open(&Sources::open(path)?, &choice, Access::Direct)?;
    reader.sources().hash(&|| false)?;
    let reading = Reading {
        task: RobosuiteTask::named("can"),
        object: None,
        env_args: None,
        conventions: Settings::default(),
    };
    let (interpreter, _) = Interpreter::learn(&reader, &reading)?;
    let cameras = reader.cameras(None)?;
    let mut sound = Vec::new();
    let mut faults = Vec::new();
    reader.for_each(
        |_, demo| {
            let demo = match demo {
                Ok(demo) => demo,
                Err(left) => return Ok(Err(left.why)),
            };
            assert_eq!(demo.actions.len(), demo.frames);
            if let Err(left) = reader.check_cameras(&demo, &cameras)? {
                return Ok(Err(left.why));
            }
            match interpreter.interpret(&reader, &demo, None) {
                Ok(columns) => {
                    assert_eq!(columns.goal.len(), demo.frames);
                    Ok(Ok((demo.name, demo.frames)))
                }
                Err(error) if error.needs_library() => Err(error),
                Err(error) => Ok(Err(error.fault.to_string())),
            }
        },
        |_, read| {
            match read {
                Ok(demo) => sound.push(demo),
                Err(why) => faults.push(why),
            }
            Ok::<(), IngestError>(())
        },
    )?;
    assert!(faults.iter().all(|why| !why.is_empty()));
    for camera in &cameras {
        reader.for_each_block(camera, &sound, |block| {
            if let Ok(block) = block {
                assert_eq!(block.bytes.len(), block.frames.len() * block.height * block.width * 3);
            }
            Ok::<(), IngestError>(())
        })?;
    }
    reader.total_warning(sound.iter().map(|(_, frames)| *frames as u64).sum())?;
    reader.skipped_warning(&cameras)?;
    reader.sources().unchanged()
}

//! Unpacks a zip file with a Push-T store and reads all of it. An input is the zip file.

use std::fs;

use re4_ingest::Selection;
use tempfile::TempDir;

/// The temporary folder of the zip file.
pub(crate) struct Zip {
    folder: TempDir,
}

impl Zip {
    pub(crate) fn new() -> Self {
        Self {
            folder: tempfile::Builder::new().prefix("re4-fuzz-").tempdir().unwrap(),
        }
    }

    /// Reads the zip file. Returns the first error.
    pub(crate) fn run(&self, input: &[u8]) -> Result<(), String> {
        let path = self.folder.path().join("store.zip");
        fs::write(&path, input).unwrap();
        super::zarr::read(&path, &Selection::All)
    }
}

//! The files of a dataset: their hash, and detecting changes since they were hashed.

use std::path::Path;

use re4_lerobot::Dataset;
use serde::{Deserialize, Serialize};

use super::opened::{error_of, fault_of};
use crate::error::{Fault, IngestError};
use crate::source::{Identity, SourceFile, Stop, check_unchanged};

/// Identities of the files that are read, in alphabetical order of their names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LerobotFiles(Vec<(String, Identity)>);

impl LerobotFiles {
    /// BLAKE3 hash of the files in the byte order of their names. For each file it covers the length of its name, the name (with
    /// `/`), the length of the file and the BLAKE3 hash of its bytes, with lengths as little-endian u64. Files that are not read, such
    /// as statistics and videos of other cameras, are excluded.
    pub(super) fn hash(path: &Path, dataset: &Dataset, stop: Stop<'_>) -> Result<(Self, [u8; 32]), IngestError> {
        let hashed = || -> Result<(Self, [u8; 32]), Fault> {
            let mut hasher = blake3::Hasher::new();
            let mut identities = Vec::new();
            for name in dataset.files().map_err(|fault| fault_of(&fault.into()))? {
                let file = SourceFile::open_checked(&path.join(&name)).map_err(|fault| inside(&name, fault))?;
                hasher.update(&(name.len() as u64).to_le_bytes());
                hasher.update(name.as_bytes());
                hasher.update(&file.length().to_le_bytes());
                hasher.update(&file.hash_checked(stop)?);
                file.unchanged_checked()?;
                identities.push((name, file.identity()));
            }
            Ok((Self(identities), *hasher.finalize().as_bytes()))
        };
        let (files, hash) = hashed().map_err(|fault| fault.of(path))?;
        // What was opened before is what was hashed.
        dataset.unchanged().map_err(error_of)?;
        Ok((files, hash))
    }

    /// Checks that a dataset that was opened again consists of the files that were hashed.
    pub(super) fn are_of(&self, path: &Path, dataset: &Dataset) -> Result<(), IngestError> {
        let names = dataset.files().map_err(|fault| fault_of(&fault.into()).of(path))?;
        if !names.iter().eq(self.0.iter().map(|(name, _)| name)) {
            return Err(Fault::Changed { path: path.to_owned() }.of(path));
        }
        self.unchanged(path)
    }

    /// Checks that no file has changed.
    pub(super) fn unchanged(&self, path: &Path) -> Result<(), IngestError> {
        let check = |(name, identity): &(String, Identity)| check_unchanged(&path.join(name), identity);
        self.0.iter().try_for_each(check).map_err(|fault| fault.of(path))
    }
}

/// The fault of a file inside the dataset.
fn inside(name: &str, fault: Fault) -> Fault {
    match fault {
        Fault::MissingPath => Fault::Lerobot(format!(
            "{name}: it is missing; restore it, or download the dataset again"
        )),
        Fault::NotAFile { what } => {
            Fault::Lerobot(format!("{name}: it is {what}, not a regular file; restore the file"))
        }
        other => other,
    }
}

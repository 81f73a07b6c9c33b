//! Hashes of files that this process, or the one that wrote its plan, has computed, and what is known of their demonstrations.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::Result;
use re4_artifact::Key;
use re4_ingest::robomimic::Surveyed;
use serde::{Deserialize, Serialize};

/// The hash of a file, and what the file system says of the file that was hashed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HashedFile {
    /// The file.
    pub path: PathBuf,
    /// Length in bytes.
    pub bytes: u64,
    /// Time of the last change in nanoseconds since 1970.
    pub modified_ns: i64,
    /// BLAKE3 hash of its content.
    pub blake3: Key,
    /// What is known of its demonstrations, if it is an HDF5 file that was opened.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surveyed: Option<Surveyed>,
}

/// Files that need not be hashed again unless their length or time has changed.
#[derive(Debug, Default)]
pub(crate) struct Hashes(Mutex<BTreeMap<PathBuf, HashedFile>>);

impl Hashes {
    /// Trusts these hashes.
    pub(crate) fn of(files: &[HashedFile]) -> Self {
        let files = files.iter().map(|file| (file.path.clone(), file.clone()));
        Self(Mutex::new(files.collect()))
    }

    /// All files, sorted by path.
    pub(crate) fn all(&self) -> Vec<HashedFile> {
        let files = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        files.values().cloned().collect()
    }

    /// What is known of a file that has not changed.
    fn unchanged(&self, path: &Path) -> Option<HashedFile> {
        let path = absolute(path);
        let found = self.files().get(&path).cloned();
        found.filter(|file| Some((file.bytes, file.modified_ns)) == state(&path))
    }

    /// What is known of the demonstrations in a file that has not changed.
    pub(crate) fn surveyed(&self, path: &Path) -> Option<Surveyed> {
        self.unchanged(path)?.surveyed
    }

    /// Remembers what is known of the demonstrations in a file whose hash is known.
    pub(crate) fn set_surveyed(&self, path: &Path, surveyed: &Surveyed) {
        if let Some(file) = self.files().get_mut(&absolute(path)) {
            file.surveyed = Some(surveyed.clone());
        }
    }

    /// The known hash of a file that has not changed.
    pub(crate) fn known(&self, path: &Path) -> Option<Key> {
        let file = self.unchanged(path)?;
        tracing::info!(path = %path.display(), "hash of the source is known");
        Some(file.blake3)
    }

    /// The known hash of a file, or that which `hash` computes.
    pub(crate) fn get(&self, path: &Path, hash: impl FnOnce() -> Result<Key>) -> Result<Key> {
        if let Some(known) = self.known(path) {
            return Ok(known);
        }
        let path = absolute(path);
        let before = state(&path);
        let blake3 = hash()?;
        if let Some((bytes, modified_ns)) = before.filter(|_| before == state(&path)) {
            let file = HashedFile {
                path: path.clone(),
                bytes,
                modified_ns,
                blake3,
                surveyed: None,
            };
            self.files().insert(path, file);
        }
        Ok(blake3)
    }

    fn files(&self) -> MutexGuard<'_, BTreeMap<PathBuf, HashedFile>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The path by which a file is known. It may be named by another one from another folder.
fn absolute(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

/// Length and time of the last change of a file in nanoseconds.
fn state(path: &Path) -> Option<(u64, i64)> {
    let of = fs::metadata(path).ok()?;
    Some((of.len(), of.mtime() * 1_000_000_000 + of.mtime_nsec()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn a_file_is_hashed_again_only_if_it_changed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data");
        fs::write(&path, "one").unwrap();
        let (hashes, count) = (Hashes::default(), Cell::new(0_u8));
        let get = |hashes: &Hashes| {
            let hash = || {
                count.set(count.get() + 1);
                Ok(Key::from_bytes([count.get(); 32]))
            };
            hashes.get(&path, hash).unwrap()
        };
        assert_eq!(
            (get(&hashes), get(&hashes)),
            (Key::from_bytes([1; 32]), Key::from_bytes([1; 32]))
        );
        // As another process with the plan of the first one.
        let other = Hashes::of(&hashes.all());
        assert_eq!(get(&other), Key::from_bytes([1; 32]));
        fs::write(&path, "two!").unwrap();
        assert_eq!(get(&other), Key::from_bytes([2; 32]));
    }
}

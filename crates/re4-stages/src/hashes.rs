//! Hashes of files that this process, or the one that wrote its plan, has computed.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::Result;
use re4_artifact::Key;
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

    /// The known hash of a file, or that which `hash` computes.
    pub(crate) fn get(&self, path: &Path, hash: impl FnOnce() -> Result<Key>) -> Result<Key> {
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // The file may be named by another path on another machine or from another folder.
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let state = |path: &Path| {
            fs::metadata(path)
                .ok()
                .map(|of| (of.len(), of.mtime() * 1_000_000_000 + of.mtime_nsec()))
        };
        let before = state(&path);
        let found = known().get(&path).cloned();
        if let Some(file) = found.filter(|file| Some((file.bytes, file.modified_ns)) == before) {
            tracing::info!(path = %path.display(), "hash of the source is known");
            return Ok(file.blake3);
        }
        let blake3 = hash()?;
        if let Some((bytes, modified_ns)) = before.filter(|_| before == state(&path)) {
            let file = HashedFile {
                path: path.clone(),
                bytes,
                modified_ns,
                blake3,
            };
            known().insert(path, file);
        }
        Ok(blake3)
    }
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

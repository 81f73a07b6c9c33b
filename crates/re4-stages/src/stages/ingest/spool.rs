//! Stores the finished images of an unfinished artifact, so that an interrupted run can continue.
//!
//! Rendering takes minutes, and a run may be ended at any moment. The images of each demonstration and camera are therefore
//! written atomically to a file of their own, in a folder in the artifacts folder that is named by the artifact's key. The next
//! run with the same key uses these files, and the folder is removed once the artifact is published. A damaged file is ignored.

use std::fs;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use re4_artifact::Key;
use re4_fault::fault;
use serde::{Deserialize, Serialize};

/// Folder of all spools, below the artifacts folder.
const FOLDER: &str = "spool";

/// Length of a hash, in bytes.
const HASH: usize = 32;

/// A folder of finished images.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Spool {
    folder: PathBuf,
    key: Key,
}

impl Spool {
    /// Opens the spool of the artifact with this key. Creates its folder if necessary.
    pub(super) fn open(artifacts: &Path, key: Key) -> Result<Self> {
        let folder = artifacts.join(FOLDER).join(key.short());
        fs::create_dir_all(&folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
        Ok(Self { folder, key })
    }

    fn path(&self, camera: &str, episode: u32) -> PathBuf {
        self.folder.join(format!("{camera}-{episode:06}"))
    }

    /// Hash of a file's contents together with its artifact, camera and episode, so that a renamed file is not taken for another
    /// one.
    fn hash(&self, camera: &str, episode: u32, contents: &[u8]) -> [u8; HASH] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.key.as_bytes());
        hasher.update(camera.as_bytes());
        hasher.update(&episode.to_le_bytes());
        hasher.update(contents);
        *hasher.finalize().as_bytes()
    }

    /// Stores the images (PNG files) of a demonstration.
    pub(super) fn put(&self, camera: &str, episode: u32, images: &[Vec<u8>]) -> Result<()> {
        let mut contents = Vec::new();
        for image in images {
            contents.extend((image.len() as u64).to_le_bytes());
            contents.extend(image);
        }
        let path = self.path(camera, episode);
        let failed = || fault!("cannot write {}", path.display(); "free disk space and run again");
        let mut file = tempfile::NamedTempFile::new_in(&self.folder).with_context(failed)?;
        file.write_all(&self.hash(camera, episode, &contents))
            .with_context(failed)?;
        file.write_all(&contents).with_context(failed)?;
        file.persist(&path).with_context(failed)?;
        Ok(())
    }

    /// The images of a demonstration with this number of frames; `None` if they are missing, incomplete or damaged.
    pub(super) fn get(&self, camera: &str, episode: u32, frames: usize) -> Result<Option<Vec<Vec<u8>>>> {
        let path = self.path(camera, episode);
        let bytes = match fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            read => read.with_context(|| format!("cannot read {}", path.display()))?,
        };
        let Some((hash, mut contents)) = bytes.split_at_checked(HASH) else {
            return Ok(None);
        };
        if self.hash(camera, episode, contents) != *hash {
            return Ok(None);
        }
        let mut images = Vec::with_capacity(frames);
        while let Some((length, rest)) = contents.split_first_chunk::<8>() {
            let Some((image, rest)) = rest.split_at_checked(u64::from_le_bytes(*length) as usize) else {
                return Ok(None);
            };
            images.push(image.to_vec());
            contents = rest;
        }
        Ok((images.len() == frames).then_some(images))
    }

    /// Removes the spool, after the artifact has been published.
    pub(super) fn remove(self) -> Result<()> {
        match fs::remove_dir_all(&self.folder) {
            // Another run of the same artifact has removed it already.
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            removed => removed.with_context(|| format!("cannot remove {}", self.folder.display()))?,
        }
        // Fails if other spools remain in the common folder, which is intended.
        if let Some(all) = self.folder.parent() {
            let _ = fs::remove_dir(all);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may stop where it fails")]

    use super::*;

    #[test]
    fn only_intact_files_are_read() {
        let place = tempfile::tempdir().unwrap();
        let spool = Spool::open(place.path(), Key::from_bytes([7; 32])).unwrap();
        let images = vec![vec![1, 2, 3], vec![], vec![4; 300]];
        assert_eq!(spool.get("a", 5, 3).unwrap(), None);
        spool.put("a", 5, &images).unwrap();
        assert_eq!(spool.get("a", 5, 3).unwrap(), Some(images));
        // Another length, camera or episode.
        assert_eq!(spool.get("a", 5, 2).unwrap(), None);
        let path = spool.path("a", 5);
        fs::copy(&path, spool.path("b", 5)).unwrap();
        fs::copy(&path, spool.path("a", 6)).unwrap();
        assert_eq!(spool.get("b", 5, 3).unwrap(), None);
        assert_eq!(spool.get("a", 6, 3).unwrap(), None);
        // Any changed byte and any truncation.
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x10;
            fs::write(&path, &bytes).unwrap();
            assert_eq!(spool.get("a", 5, 3).unwrap(), None, "byte {at}");
            fs::write(&path, &whole[..at]).unwrap();
            assert_eq!(spool.get("a", 5, 3).unwrap(), None, "cut at {at}");
        }
        spool.remove().unwrap();
        assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);
    }
}

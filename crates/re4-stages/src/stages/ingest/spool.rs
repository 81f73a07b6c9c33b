//! Finished images of an artifact that is not finished.
//!
//! Drawing takes minutes, and a run may be ended at any moment. So the images of each demonstration and camera are written to
//! a file of their own, whole or not at all, in a folder beside the artifacts that is named by the artifact's key; the next run
//! with the same key takes what is there, and the folder is removed once the artifact is published. A file that is not as it was
//! written counts as not there.

use std::fs;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use re4_artifact::Key;
use re4_fault::fault;

/// Folder of the spools, below that of the artifacts.
const FOLDER: &str = "spool";

/// Bytes of a hash.
const HASH: usize = 32;

/// A folder of finished images.
pub(super) struct Spool {
    folder: PathBuf,
    key: Key,
}

impl Spool {
    /// The spool of the artifact of this key, made if need be.
    pub(super) fn open(artifacts: &Path, key: Key) -> Result<Self> {
        let folder = artifacts.join(FOLDER).join(key.short());
        fs::create_dir_all(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        Ok(Self { folder, key })
    }

    fn path(&self, camera: &str, episode: u32) -> PathBuf {
        self.folder.join(format!("{camera}-{episode:06}"))
    }

    /// Hash of a file's contents: which artifact, camera and episode they are for is part of it.
    fn hash(&self, camera: &str, episode: u32, contents: &[u8]) -> [u8; HASH] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.key.as_bytes());
        hasher.update(camera.as_bytes());
        hasher.update(&episode.to_le_bytes());
        hasher.update(contents);
        *hasher.finalize().as_bytes()
    }

    /// Keeps the images of a demonstration.
    pub(super) fn put(&self, camera: &str, episode: u32, images: &[Vec<u8>]) -> Result<()> {
        let mut contents = Vec::new();
        for image in images {
            contents.extend((image.len() as u64).to_le_bytes());
            contents.extend(image);
        }
        let path = self.path(camera, episode);
        let failed = || fault!("cannot write {}", path.display(); "free some space and run again");
        let mut file = tempfile::NamedTempFile::new_in(&self.folder).with_context(failed)?;
        file.write_all(&self.hash(camera, episode, &contents))
            .with_context(failed)?;
        file.write_all(&contents).with_context(failed)?;
        file.persist(&path).with_context(failed)?;
        Ok(())
    }

    /// The images of a demonstration of so many frames; none where they are not there, or not whole.
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

    /// Removes it; the artifact is published.
    pub(super) fn remove(self) -> Result<()> {
        match fs::remove_dir_all(&self.folder) {
            // Another run of the same artifact was first.
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            removed => removed.with_context(|| format!("cannot remove {}", self.folder.display()))?,
        }
        // Others may still need the folder of all spools.
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
    fn only_what_was_put_is_there() {
        let place = tempfile::tempdir().unwrap();
        let spool = Spool::open(place.path(), Key::from_bytes([7; 32])).unwrap();
        let images = vec![vec![1, 2, 3], vec![], vec![4; 300]];
        assert_eq!(spool.get("a", 5, 3).unwrap(), None);
        spool.put("a", 5, &images).unwrap();
        assert_eq!(spool.get("a", 5, 3).unwrap(), Some(images));
        // Another length, camera, episode or artifact.
        assert_eq!(spool.get("a", 5, 2).unwrap(), None);
        let path = spool.path("a", 5);
        fs::copy(&path, spool.path("b", 5)).unwrap();
        fs::copy(&path, spool.path("a", 6)).unwrap();
        assert_eq!(spool.get("b", 5, 3).unwrap(), None);
        assert_eq!(spool.get("a", 6, 3).unwrap(), None);
        // Any byte that is not as it was, and any cut.
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

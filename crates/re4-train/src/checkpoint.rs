//! Checkpoints, from which an interrupted training resumes.
//!
//! A checkpoint is one file that is written atomically. It contains what a [`Learner`](crate::Learner) saves (the weights and the
//! optimiser's state) and the results of the epochs so far. It begins with the key of the artifact that is being built and a hash over key and contents, so that neither a
//! checkpoint of other data nor an incomplete one is used.

use std::fs;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use crate::{Epoch, TrainError};

/// First bytes of a checkpoint file.
const MAGIC: &[u8; 16] = b"re4 checkpoint 2";

/// The checkpoint folder of an artifact.
#[derive(Debug)]
pub struct Checkpoints {
    folder: PathBuf,
    key: [u8; 32],
}

/// The contents of a checkpoint file.
#[derive(Debug)]
pub struct Checkpoint {
    /// Path of the file.
    pub path: PathBuf,
    /// What the learner saved.
    pub parts: Vec<Vec<u8>>,
    /// The results of the epochs so far.
    pub epochs: Vec<Epoch>,
}

fn name(epochs: usize) -> String {
    format!("epoch-{epochs:05}")
}

impl Checkpoints {
    /// Opens the checkpoint folder of the artifact with this key, and creates it if necessary.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn open(folder: &Path, key: [u8; 32]) -> Result<Self, TrainError> {
        fs::create_dir_all(folder).map_err(|source| TrainError::Checkpoint {
            path: folder.to_path_buf(),
            source,
        })?;
        Ok(Self {
            folder: folder.to_path_buf(),
            key,
        })
    }

    /// A sentence about the checkpoint that is kept after this number of epochs, for error messages.
    pub(crate) fn describe(&self, epochs: u32) -> String {
        match epochs {
            0 => "no epoch was finished, so there is no checkpoint".to_owned(),
            n => format!(
                "the checkpoint of epoch {n} is kept as {}",
                self.folder.join(name(n as usize)).display()
            ),
        }
    }

    fn hash(&self, contents: &[u8]) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.key);
        hasher.update(contents);
        *hasher.finalize().as_bytes()
    }

    /// An error about the checkpoint after this number of epochs.
    pub(crate) fn cannot_write(&self, epochs: usize, why: String) -> TrainError {
        TrainError::Checkpoint {
            path: self.folder.join(name(epochs)),
            source: std::io::Error::other(why),
        }
    }

    /// Writes the checkpoint of the last of these epochs, and removes older ones.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn keep(&self, parts: &[Vec<u8>], epochs: &[Epoch]) -> Result<(), TrainError> {
        let path = self.folder.join(name(epochs.len()));
        let failed = |source| TrainError::Checkpoint {
            path: path.clone(),
            source,
        };
        let results = serde_json::to_vec(epochs).map_err(|error| failed(std::io::Error::other(error)))?;
        let all = || std::iter::once(&results).chain(parts);
        let mut contents = Vec::with_capacity(all().map(|part| part.len() + 8).sum());
        for part in all() {
            contents.extend((part.len() as u64).to_le_bytes());
            contents.extend_from_slice(part);
        }
        let mut file = tempfile::NamedTempFile::new_in(&self.folder).map_err(failed)?;
        file.write_all(MAGIC)
            .and_then(|()| file.write_all(&self.key))
            .and_then(|()| file.write_all(&self.hash(&contents)))
            .and_then(|()| file.write_all(&contents))
            .and_then(|()| file.as_file().sync_all())
            .map_err(failed)?;
        file.persist(&path).map_err(|error| failed(error.error))?;
        for (number, older) in self.found()? {
            if number < epochs.len() {
                // A failure does not matter: the newest valid checkpoint is used.
                let _ = fs::remove_file(older);
            }
        }
        Ok(())
    }

    /// Paths of the files with the name of a checkpoint, sorted by epoch.
    fn found(&self) -> Result<Vec<(usize, PathBuf)>, TrainError> {
        let failed = |source| TrainError::Checkpoint {
            path: self.folder.clone(),
            source,
        };
        let mut found = Vec::new();
        for entry in fs::read_dir(&self.folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let name = entry.file_name();
            let number = name.to_str().and_then(|name| name.strip_prefix("epoch-"));
            if let Some(number) = number.and_then(|number| number.parse().ok()) {
                found.push((number, entry.path()));
            }
        }
        found.sort();
        Ok(found)
    }

    /// The last valid checkpoint.
    ///
    /// # Errors
    /// If a file cannot be read, or belongs to another artifact.
    pub fn last(&self) -> Result<Option<Checkpoint>, TrainError> {
        for (_, path) in self.found()?.into_iter().rev() {
            let bytes = match fs::read(&path) {
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                read => read.map_err(|source| TrainError::Checkpoint {
                    path: path.clone(),
                    source,
                })?,
            };
            let Some(rest) = bytes.strip_prefix(MAGIC) else {
                continue;
            };
            let Some((key, rest)) = rest.split_first_chunk::<32>() else {
                continue;
            };
            if *key != self.key {
                return Err(TrainError::ForeignCheckpoint { path });
            }
            let Some((hash, contents)) = rest.split_first_chunk::<32>() else {
                continue;
            };
            if *hash != self.hash(contents) {
                continue;
            }
            if let Some((results, parts)) = parts(contents)
                && let Ok(epochs) = serde_json::from_slice(results)
            {
                return Ok(Some(Checkpoint { path, parts, epochs }));
            }
        }
        Ok(None)
    }

    /// Removes the folder after the artifact is published.
    ///
    /// # Errors
    /// If the folder cannot be removed.
    pub fn remove(self) -> Result<(), TrainError> {
        match fs::remove_dir_all(&self.folder) {
            // Another run of the same artifact has already removed it.
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            removed => removed.map_err(|source| TrainError::Checkpoint {
                path: self.folder.clone(),
                source,
            })?,
        }
        // Removes the parent folder if it is empty; other artifacts may still have checkpoints there.
        if let Some(all) = self.folder.parent() {
            let _ = fs::remove_dir(all);
        }
        Ok(())
    }
}

/// Splits the contents of a file into the results of the epochs and what the learner saved.
fn parts(mut contents: &[u8]) -> Option<(&[u8], Vec<Vec<u8>>)> {
    let mut all = Vec::new();
    while !contents.is_empty() {
        let (length, rest) = contents.split_first_chunk::<8>()?;
        let (part, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
        contents = rest;
        all.push(part);
    }
    let (first, rest) = all.split_first()?;
    Some((first, rest.iter().map(|part| part.to_vec()).collect()))
}

//! Checkpoints, from which an interrupted training resumes.
//!
//! A checkpoint is one file that is written atomically. It contains the weights, the optimiser's state and the results of the
//! epochs so far. It begins with the key of the artifact that is being built and a hash over key and contents, so that neither a
//! checkpoint of other data nor an incomplete one is used.

use std::fs;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use burn::module::Module as _;
use burn::optim::ModuleOptimizer;
use burn::store::ModuleRecord;

use crate::EncoderError;
use crate::network::Encoder;
use crate::train::Epoch;

/// First bytes of a checkpoint file.
const MAGIC: &[u8; 16] = b"re4 checkpoint 1";

/// The checkpoint folder of an artifact.
#[derive(Debug)]
pub struct Checkpoints {
    folder: PathBuf,
    key: [u8; 32],
}

/// The contents of a checkpoint file.
pub(crate) struct Checkpoint {
    path: PathBuf,
    encoder: Vec<u8>,
    optimizer: Vec<u8>,
    epochs: Vec<Epoch>,
}

fn name(epochs: usize) -> String {
    format!("epoch-{epochs:05}")
}

impl Checkpoints {
    /// Opens the checkpoint folder of the artifact with this key, and creates it if necessary.
    ///
    /// # Errors
    /// If the folder cannot be created.
    pub fn open(folder: &Path, key: [u8; 32]) -> Result<Self, EncoderError> {
        fs::create_dir_all(folder).map_err(|source| EncoderError::Checkpoint {
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

    /// Writes the checkpoint of the last of these epochs, and removes older ones.
    pub(crate) fn keep(
        &self,
        encoder: &Encoder,
        optimizer: &ModuleOptimizer,
        epochs: &[Epoch],
    ) -> Result<(), EncoderError> {
        let path = self.folder.join(name(epochs.len()));
        let failed = |source| EncoderError::Checkpoint {
            path: path.clone(),
            source,
        };
        let other = |error: &dyn std::fmt::Display| failed(std::io::Error::other(error.to_string()));
        let epoch_results = serde_json::to_vec(epochs).map_err(|error| other(&error))?;
        // The inference copy of the module has the statistics of batch normalisation after the last step.
        let encoder = encoder
            .valid()
            .into_record()
            .into_bytes()
            .map_err(|error| other(&error))?;
        let optimizer = optimizer.into_bytes().map_err(|error| other(&error))?;
        let mut contents = Vec::with_capacity(encoder.len() + optimizer.len() + epoch_results.len() + 24);
        for part in [epoch_results.as_slice(), &encoder, &optimizer] {
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
    fn found(&self) -> Result<Vec<(usize, PathBuf)>, EncoderError> {
        let failed = |source| EncoderError::Checkpoint {
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
    pub(crate) fn last(&self) -> Result<Option<Checkpoint>, EncoderError> {
        for (_, path) in self.found()?.into_iter().rev() {
            let bytes = match fs::read(&path) {
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                read => read.map_err(|source| EncoderError::Checkpoint {
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
                return Err(EncoderError::ForeignCheckpoint { path });
            }
            let Some((hash, contents)) = rest.split_first_chunk::<32>() else {
                continue;
            };
            if *hash != self.hash(contents) {
                continue;
            }
            if let Some([epoch_results, encoder, optimizer]) = parts(contents)
                && let Ok(epochs) = serde_json::from_slice(epoch_results)
            {
                return Ok(Some(Checkpoint {
                    path,
                    encoder: encoder.to_vec(),
                    optimizer: optimizer.to_vec(),
                    epochs,
                }));
            }
        }
        Ok(None)
    }

    /// Removes the folder after the artifact is published.
    ///
    /// # Errors
    /// If the folder cannot be removed.
    pub fn remove(self) -> Result<(), EncoderError> {
        match fs::remove_dir_all(&self.folder) {
            // Another run of the same artifact has already removed it.
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            removed => removed.map_err(|source| EncoderError::Checkpoint {
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

fn parts(mut contents: &[u8]) -> Option<[&[u8]; 3]> {
    let mut next = || {
        let (length, rest) = contents.split_first_chunk::<8>()?;
        let (part, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
        contents = rest;
        Some(part)
    };
    Some([next()?, next()?, next()?])
}

impl Checkpoint {
    /// Loads the checkpoint into a new encoder and optimiser.
    pub(crate) fn restore(
        self,
        encoder: Encoder,
        optimizer: ModuleOptimizer,
    ) -> Result<(Encoder, ModuleOptimizer, Vec<Epoch>), EncoderError> {
        let path = self.path;
        let failed = |error: &dyn std::fmt::Display| EncoderError::Checkpoint {
            path: path.clone(),
            source: std::io::Error::other(error.to_string()),
        };
        let record = ModuleRecord::from_bytes(burn::tensor::Bytes::from_bytes_vec(self.encoder))
            .map_err(|error| failed(&error))?;
        let encoder = encoder.try_load_record(record).map_err(|error| failed(&error))?;
        let optimizer = optimizer
            .from_bytes(burn::tensor::Bytes::from_bytes_vec(self.optimizer))
            .map_err(|error| failed(&error))?;
        Ok((encoder, optimizer, self.epochs))
    }
}

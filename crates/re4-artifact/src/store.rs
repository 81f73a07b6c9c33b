//! The store: a folder that contains artifacts by stage and key.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::canonical::{canonical_json, canonical_text};
use crate::disk::{LOCK_NAME, TEMPORARY_PREFIX, is_alive, lock};
use crate::error::ArtifactError;
use crate::key::{Key, Recipe, Stage};
use crate::reader::Artifact;
use crate::writer::{Writer, remove_own};

const RUNS: &str = "runs";

/// A folder of artifacts.
///
/// Artifacts are in `<root>/<artifact>/<first 16 digits of the key>/`. Records of runs, such as their wall time, are in
/// `<root>/runs/<stage>-<first 16 digits of the key>.json` and are not part of any hash.
#[derive(Debug, Clone)]
pub struct Store {
    root: PathBuf,
}

impl Store {
    /// Opens the store at `root`, creates the folder if necessary, and removes the temporary files of writers that no longer run.
    ///
    /// Temporary folders of running writers are kept. If the store cannot be written to, it is opened for reading.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] if the root cannot be created or a leftover cannot be removed.
    pub fn open(root: &Path) -> Result<Self, ArtifactError> {
        fs::create_dir_all(root).map_err(ArtifactError::io("create the artifacts folder", root))?;
        let store = Self {
            root: root.to_path_buf(),
        };
        match store.lock() {
            Ok(guard) => {
                store.remove_leftovers()?;
                drop(guard);
            }
            // Existing artifacts can still be read and verified. The first write returns this error again.
            Err(ArtifactError::Io { source, .. })
                if matches!(
                    source.kind(),
                    io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::StorageFull
                ) => {}
            Err(error) => return Err(error),
        }
        Ok(store)
    }

    /// Removes all unpublished files of this process and of processes that no longer run.
    ///
    /// To be called right before the process exits, while its other threads may still be writing. The returned value holds the
    /// lock of the store; keep it until the exit, so that no thread publishes an artifact. `None` if the lock is unavailable.
    pub fn abandon(&self) -> Option<impl Sized> {
        let guard = self.lock().ok()?;
        remove_own();
        // Leftovers that cannot be removed now are removed when the store is opened the next time.
        let _ = self.remove_leftovers();
        Some(guard)
    }

    /// The root folder of the store.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of the artifact with this stage and key, whether it exists or not.
    pub fn folder(&self, stage: Stage, key: &Key) -> PathBuf {
        self.root.join(stage.artifact()).join(key.short())
    }

    /// Returns the artifact with this stage and key if it has been published, after verifying every byte of it.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] if a file differs from what was published; a damaged artifact is never rebuilt silently.
    /// [`ArtifactError::NewerManifest`] if a newer build wrote the artifact, [`ArtifactError::OtherKey`] if the folder belongs to
    /// another key.
    pub fn lookup(&self, stage: Stage, key: &Key) -> Result<Option<Artifact>, ArtifactError> {
        let folder = self.folder(stage, key);
        match fs::symlink_metadata(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(ArtifactError::io("access", &folder)(error)),
            Ok(_) => {
                let artifact = Artifact::open(&folder)?;
                if artifact.key() != key {
                    return Err(ArtifactError::OtherKey {
                        folder,
                        expected: key.to_string(),
                        found: artifact.key().to_string(),
                    });
                }
                artifact.verify_bytes()?;
                Ok(Some(artifact))
            }
        }
    }

    /// Starts writing the artifact of this recipe, in a temporary folder next to the final one.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] if the folder cannot be created.
    pub fn begin(&self, recipe: &Recipe) -> Result<Writer, ArtifactError> {
        Writer::new(self, recipe)
    }

    /// Writes a summary of a run that is not part of the artifact: wall time, host, date. An existing file is replaced
    /// atomically.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] if the file cannot be written.
    pub fn record_run(&self, stage: Stage, key: &Key, summary: &impl Serialize) -> Result<PathBuf, ArtifactError> {
        let text = canonical_text(&canonical_json(summary)?);
        let folder = self.root.join(RUNS);
        let path = folder.join(format!("{stage}-{}.json", key.short()));
        // `remove_leftovers` deletes temporary files in this folder under the same lock, so it cannot delete this one.
        let guard = self.lock()?;
        fs::create_dir_all(&folder).map_err(ArtifactError::io("create the folder", &folder))?;
        let mut file = tempfile::Builder::new()
            .prefix(TEMPORARY_PREFIX)
            .tempfile_in(&folder)
            .map_err(ArtifactError::io("write", &path))?;
        file.write_all(text.as_bytes())
            .map_err(ArtifactError::io("write", &path))?;
        file.persist(&path)
            .map_err(|error| ArtifactError::io("write", &path)(error.error))?;
        drop(guard);
        Ok(path)
    }

    /// Acquires the lock of the whole store. It is held only while a temporary folder is created, published or removed.
    pub(crate) fn lock(&self) -> Result<fs::File, ArtifactError> {
        lock(&self.root.join(LOCK_NAME))
    }

    fn remove_leftovers(&self) -> Result<(), ArtifactError> {
        let runs = entries(&self.root.join(RUNS))?;
        for path in runs.into_iter().filter(|path| is_temporary(path)) {
            fs::remove_file(&path).map_err(ArtifactError::io("remove the leftover", &path))?;
        }
        for stage in Stage::ALL {
            for path in entries(&self.root.join(stage.artifact()))? {
                if is_temporary(&path) && !is_alive(&path) {
                    fs::remove_dir_all(&path).map_err(ArtifactError::io("remove the leftover", &path))?;
                }
            }
        }
        Ok(())
    }
}

fn is_temporary(path: &Path) -> bool {
    path.file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with(TEMPORARY_PREFIX))
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, ArtifactError> {
    let listing = match fs::read_dir(folder) {
        Ok(listing) => listing,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(ArtifactError::io("list", folder)(error)),
    };
    listing
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()
        .map_err(ArtifactError::io("list", folder))
}

//! The store: a folder of artifacts by stage and key.

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

/// A folder of artifacts: `<root>/<artifact>/<first 16 digits of the key>/`, and beside them, outside of every hash,
/// `<root>/runs/<stage>-<first 16 digits of the key>.json` with summary of the run such as its wall time.
#[derive(Debug, Clone)]
pub struct Store {
    root: PathBuf,
}

impl Store {
    /// Opens the store at `root`, made if need be, and removes what dead writers left behind. Temporaries of writers that
    /// still live are left alone. A store that may not be written is opened for reading.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] when the root cannot be made, or a left-over cannot be removed.
    pub fn open(root: &Path) -> Result<Self, ArtifactError> {
        fs::create_dir_all(root).map_err(ArtifactError::io("make the artifacts folder", root))?;
        let store = Self {
            root: root.to_path_buf(),
        };
        match store.lock() {
            Ok(guard) => {
                store.remove_leftovers()?;
                drop(guard);
            }
            // What is there can still be read and verified; the first write says what is wrong.
            Err(ArtifactError::Io { source, .. })
                if matches!(
                    source.kind(),
                    io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::StorageFull
                ) => {}
            Err(error) => return Err(error),
        }
        Ok(store)
    }

    /// Removes what this process and dead ones have begun to write. For a process that ends in the next moment, whatever its
    /// threads are doing: until it has ended, nothing can be published, as the lock that is returned is held.
    pub fn abandon(&self) -> Option<impl Sized> {
        let guard = self.lock().ok()?;
        remove_own();
        // What cannot be removed now is removed when the store is opened next.
        let _ = self.remove_leftovers();
        Some(guard)
    }

    /// The root of the store.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where the artifact of this stage and key is, or would be.
    pub fn folder(&self, stage: Stage, key: &Key) -> PathBuf {
        self.root.join(stage.artifact()).join(key.short())
    }

    /// The artifact of this stage and key, if it has been published; every byte of it is verified.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] when a byte of it is not as published: nothing is rebuilt behind the user's back.
    /// [`ArtifactError::NewerManifest`] when a newer build wrote it,
    /// [`ArtifactError::OtherKey`] when the folder is another key's.
    pub fn lookup(&self, stage: Stage, key: &Key) -> Result<Option<Artifact>, ArtifactError> {
        let folder = self.folder(stage, key);
        match fs::symlink_metadata(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(ArtifactError::io("look for", &folder)(error)),
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

    /// Begins to write the artifact of this recipe, in a temporary folder beside its place.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] when the folder cannot be made.
    pub fn begin(&self, recipe: &Recipe) -> Result<Writer, ArtifactError> {
        Writer::new(self, recipe)
    }

    /// Writes summary of a run that do not belong into the artifact: wall time, host, date. The file is replaced whole.
    ///
    /// # Errors
    /// [`ArtifactError::Io`] when it cannot be written.
    pub fn record_run(&self, stage: Stage, key: &Key, summary: &impl Serialize) -> Result<PathBuf, ArtifactError> {
        let text = canonical_text(&canonical_json(summary)?);
        let folder = self.root.join(RUNS);
        let path = folder.join(format!("{stage}-{}.json", key.short()));
        // Left-overs in this folder are removed under the same lock, so that nobody takes ours for one.
        let guard = self.lock()?;
        fs::create_dir_all(&folder).map_err(ArtifactError::io("make the folder", &folder))?;
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

    /// The lock of the whole store, held for moments: while a temporary is made, published or removed.
    pub(crate) fn lock(&self) -> Result<fs::File, ArtifactError> {
        lock(&self.root.join(LOCK_NAME))
    }

    fn remove_leftovers(&self) -> Result<(), ArtifactError> {
        let runs = entries(&self.root.join(RUNS))?;
        for path in runs.into_iter().filter(|path| is_temporary(path)) {
            fs::remove_file(&path).map_err(ArtifactError::io("remove the left-over", &path))?;
        }
        for stage in Stage::ALL {
            for path in entries(&self.root.join(stage.artifact()))? {
                if is_temporary(&path) && !is_alive(&path) {
                    fs::remove_dir_all(&path).map_err(ArtifactError::io("remove the left-over", &path))?;
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

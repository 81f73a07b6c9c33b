//! The store: a folder that contains artifacts by stage and key.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use serde::Serialize;
use serde_json::Value;
use tempfile::TempDir;

use crate::canonical::{canonical_json, canonical_text};
use crate::disk::is_gone;
use crate::error::ArtifactError;
use crate::key::{Key, Recipe, Stage};
use crate::manifest::{MANIFEST_NAME, PARTS};
use crate::owner::{is_leftover, prefix};
use crate::reader::Artifact;
use crate::remote::{Connection, connection};
use crate::writer::{Publication, Writer, remove_own};

const RUNS: &str = "runs";

/// A folder of artifacts.
///
/// Artifacts are in `<root>/<artifact>/<first 16 digits of the key>/`. Records of runs, such as their wall time, are in
/// `<root>/runs/<stage>-<first 16 digits of the key>.json` and are not part of any hash.
#[derive(Debug, Clone)]
pub struct Store {
    root: PathBuf,
    /// The files of artifacts that were verified, if they are verified only once.
    verified: Option<Arc<Mutex<Verified>>>,
    /// The object store of which this store is the cache.
    pub(crate) connection: Option<Arc<Connection>>,
    /// Whether artifacts in parts are verified part by part, when these are read.
    by_part: bool,
}

/// The files of artifacts by the artifact's folder.
type Verified = BTreeMap<PathBuf, Vec<FileState>>;

/// Path in the folder, device, inode, length, and times of the last write and of the last change of a file. Every write changes the last one.
type FileState = (OsString, u64, u64, u64, [i64; 2], [i64; 2]);

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
            verified: None,
            connection: connection(root),
            by_part: false,
        };
        match store.remove_leftovers() {
            // Existing artifacts can still be read and verified. The first write returns an error.
            Err(ArtifactError::Io { source, .. })
                if matches!(
                    source.kind(),
                    io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::StorageFull
                ) => {}
            removed => removed?,
        }
        Ok(store)
    }

    /// Removes all unpublished files of this process.
    ///
    /// To be called right before the process exits, while its other threads may still be writing. Keep the returned value until the
    /// exit, so that no thread publishes an artifact.
    #[must_use]
    pub fn abandon(&self) -> impl Sized + use<> {
        let publication = Publication::wait();
        remove_own();
        publication
    }

    /// The same store, for a process that looks up the same artifacts many times: [`Store::lookup`] reads the bytes of an artifact
    /// again only if one of its files was written to since the last time.
    #[must_use]
    pub fn verifying_once(self) -> Self {
        Self {
            verified: Some(Arc::default()),
            ..self
        }
    }

    /// The root folder of the store.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of the artifact with this stage and key, whether it exists or not.
    pub fn folder(&self, stage: Stage, key: &Key) -> PathBuf {
        self.root.join(stage.artifact()).join(key.short())
    }

    /// Returns the artifact with this stage and key if it has been published, after verifying every byte of it. If the store is the
    /// cache of an object store, it is downloaded or uploaded if one of them lacks it. In a store that is [verified by
    /// part](Self::verifying_by_part), parts are downloaded when they are verified.
    ///
    /// # Errors
    /// [`ArtifactError::Damaged`] if a file differs from what was published; a damaged artifact is never rebuilt silently.
    /// [`ArtifactError::NewerManifest`] if a newer build wrote the artifact, [`ArtifactError::OtherKey`] if the folder belongs to
    /// another key.
    pub fn lookup(&self, stage: Stage, key: &Key) -> Result<Option<Artifact>, ArtifactError> {
        let folder = self.folder(stage, key);
        if self.by_part
            && let Some(artifact) = self.remote_parts(&folder)?
        {
            return expected(artifact, key).map(Some);
        }
        self.pull(&folder, MANIFEST_NAME)?;
        let found = self.lookup_here(stage, key)?;
        if let Some(artifact) = &found {
            self.push(artifact.path(), MANIFEST_NAME)?;
        }
        Ok(found)
    }

    /// [`Store::lookup`] in the folder of the store alone.
    pub(crate) fn lookup_here(&self, stage: Stage, key: &Key) -> Result<Option<Artifact>, ArtifactError> {
        let folder = self.folder(stage, key);
        match fs::symlink_metadata(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(ArtifactError::io("access", &folder)(error)),
            Ok(_) if is_begun(&folder) => Ok(None),
            Ok(_) => {
                let artifact = expected(Artifact::open(&folder)?, key)?;
                // A process that makes some parts verifies those that it reads.
                if !(self.by_part && artifact.in_parts()) {
                    self.verify(&artifact)?;
                }
                Ok(Some(artifact))
            }
        }
    }

    /// The same store, for a process that makes some parts of an artifact: [`Store::lookup`] does not read the files of artifacts in
    /// parts, because [`Artifact::part`] verifies those of a part.
    #[must_use]
    pub fn verifying_by_part(self) -> Self {
        Self { by_part: true, ..self }
    }

    fn verify(&self, artifact: &Artifact) -> Result<(), ArtifactError> {
        let Some(verified) = &self.verified else {
            return artifact.verify_bytes();
        };
        // The state is taken before the bytes are read, so that a write during the reading is noticed the next time.
        let states = file_states(artifact.path()).map_err(ArtifactError::io("list", artifact.path()))?;
        let known = || verified.lock().unwrap_or_else(PoisonError::into_inner);
        if known().get(artifact.path()) != Some(&states) {
            artifact.verify_bytes()?;
            known().insert(artifact.path().to_path_buf(), states);
        }
        Ok(())
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
        let path = record(&self.root, stage.as_str(), key);
        self.write_record(&path, text.as_bytes())?;
        self.push_record(&path)?;
        Ok(path)
    }

    pub(crate) fn write_record(&self, path: &Path, text: &[u8]) -> Result<(), ArtifactError> {
        let folder = self.root.join(RUNS);
        fs::create_dir_all(&folder).map_err(ArtifactError::io("create the folder", &folder))?;
        let write = || -> io::Result<()> {
            let temporary = self.temporary("run")?;
            let file = temporary.path().join("run.json");
            fs::write(&file, text)?;
            fs::rename(&file, path)
        };
        write().map_err(ArtifactError::io("write", path))?;
        Ok(())
    }

    /// Reads the record of the run that made an artifact; `None` if there is none, or if it is not JSON.
    pub fn run_record(root: &Path, stage: Stage, key: &Key) -> Option<Value> {
        serde_json::from_slice(&fs::read(record(root, stage.as_str(), key)).ok()?).ok()
    }

    /// Creates a temporary folder in the root, so that leftovers are found without listing the artifacts.
    ///
    /// Network file systems keep what they know about a path for some time. So the folder is not in one that is removed when it is empty, as
    /// other machines would fail in a new one of the same name. And temporary files are in such folders, where other machines do not look
    /// at them, as they would take the length of that moment for that of the published file.
    pub(crate) fn temporary(&self, what: &str) -> io::Result<TempDir> {
        fs::create_dir_all(&self.root)?;
        tempfile::Builder::new().prefix(&prefix(what)).tempdir_in(&self.root)
    }

    fn remove_leftovers(&self) -> Result<(), ArtifactError> {
        for path in entries(&self.root)? {
            if !is_leftover(&path) {
                continue;
            }
            let removed = if path.is_dir() {
                fs::remove_dir_all(&path)
            } else {
                fs::remove_file(&path)
            };
            match removed {
                // Another process has removed it.
                Err(error) if is_gone(&error) => {}
                removed => removed.map_err(ArtifactError::io("remove the leftover", &path))?,
            }
        }
        Ok(())
    }
}

/// An artifact if it has this key.
fn expected(artifact: Artifact, key: &Key) -> Result<Artifact, ArtifactError> {
    if artifact.key() == key {
        return Ok(artifact);
    }
    Err(ArtifactError::OtherKey {
        folder: artifact.path().to_path_buf(),
        expected: key.to_string(),
        found: artifact.key().to_string(),
    })
}

/// The record of the run that made an artifact.
pub(crate) fn record(root: &Path, stage: &str, key: &Key) -> PathBuf {
    root.join(RUNS).join(format!("{stage}-{}.json", key.short()))
}

/// The states of all files and folders in a folder, by their paths relative to it.
fn file_states(folder: &Path) -> io::Result<Vec<FileState>> {
    let mut states = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(&inner)? {
            let entry = entry?;
            let of = entry.metadata()?;
            let path = entry.path();
            states.push((
                path.strip_prefix(folder).unwrap_or(&path).as_os_str().to_owned(),
                of.dev(),
                of.ino(),
                of.len(),
                [of.mtime(), of.mtime_nsec()],
                [of.ctime(), of.ctime_nsec()],
            ));
            if of.is_dir() {
                folders.push(path);
            }
        }
    }
    states.sort();
    Ok(states)
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

/// Whether the folder of an artifact has nothing but the folder of its parts, or nothing at all because that is created next.
fn is_begun(folder: &Path) -> bool {
    fs::read_dir(folder)
        .is_ok_and(|mut entries| entries.all(|entry| entry.is_ok_and(|entry| entry.file_name() == PARTS)))
}

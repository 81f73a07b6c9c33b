//! Stores whose artifacts are kept in an object store, with a folder on this machine as their cache.
//!
//! An object store has neither renames nor locks, and its listings may be late. A folder is therefore uploaded file by file, each as an
//! object that must not exist yet, and the file that makes the folder complete (the manifest) comes last. Without the manifest, the
//! artifact does not exist. An object that exists already is compared: equal bytes are fine, since equal keys give equal bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::disk::sync_folder;
use crate::error::{ArtifactError, Damage};
use crate::key::{Key, Stage};
use crate::manifest::{MANIFEST_NAME, Manifest, PART_MANIFEST_NAME, PARTS};
use crate::reader::Artifact;
use crate::store::{Store, record};
use crate::transfer::{each, failed, is_complete, pull_folder, push_folder, write};
use crate::writer::{Publication, Temporary};

/// Objects by their names, whose parts are separated by `/`.
pub trait Remote: fmt::Debug + Send + Sync {
    /// Address of the objects for messages, such as `s3://bucket/prefix`, without a slash at the end.
    fn address(&self) -> &str;

    /// The bytes of an object; `None` if there is none.
    ///
    /// # Errors
    /// If the object store does not answer or refuses.
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, RemoteError>;

    /// A range of the bytes of an object: fewer if the object ends before the range; `None` if there is no object.
    ///
    /// # Errors
    /// As [`Remote::get`].
    fn get_range(&self, name: &str, range: Range<u64>) -> Result<Option<Vec<u8>>, RemoteError>;

    /// Creates an object, unless there is one with this name. Of several writers, exactly one creates it.
    ///
    /// # Errors
    /// As [`Remote::get`].
    fn put_new(&self, name: &str, content: Arc<Vec<u8>>) -> Result<Put, RemoteError>;

    /// Names and lengths in bytes of the objects in a folder and its folders, in the order of their names; those of all objects if the
    /// folder is empty. Objects that were created a moment ago may be missing.
    ///
    /// # Errors
    /// As [`Remote::get`].
    fn list(&self, folder: &str) -> Result<Vec<(String, u64)>, RemoteError>;
}

/// What [`Remote::put_new`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Put {
    /// The object was created.
    Created,
    /// There is an object with this name, or another writer is creating it.
    Taken,
}

/// An object store did not answer, or refused.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{reason}")]
pub struct RemoteError {
    /// The reason, in one line.
    pub reason: String,
    /// What the user can do about it.
    pub remedy: Option<&'static str>,
}

/// An object that a manifest lists.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listed {
    /// Name relative to the folder of the manifest.
    pub file: String,
    /// Length in bytes.
    pub bytes: u64,
    /// Hash.
    pub blake3: Key,
}

/// An object store and what is known about it.
#[derive(Debug)]
pub(crate) struct Connection {
    remote: Arc<dyn Remote>,
    /// Folders that are known to be complete in the object store, so that they are compared only once per process.
    complete: Mutex<BTreeSet<String>>,
}

/// The object stores of this process, by the folder of their cache.
static CONNECTIONS: Mutex<BTreeMap<PathBuf, Arc<Connection>>> = Mutex::new(BTreeMap::new());

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Makes a folder the cache of an object store: stores that this process opens there from now on download what is missing, and upload
/// what they publish. The folder is created if necessary.
///
/// # Errors
/// [`ArtifactError::Io`] if the folder cannot be created.
pub fn attach(cache: &Path, remote: Arc<dyn Remote>) -> Result<(), ArtifactError> {
    fs::create_dir_all(cache).map_err(ArtifactError::io("create the cache of artifacts", cache))?;
    let cache = fs::canonicalize(cache).map_err(ArtifactError::io("access", cache))?;
    let connection = Connection {
        remote,
        complete: Mutex::default(),
    };
    locked(&CONNECTIONS).insert(cache, Arc::new(connection));
    Ok(())
}

/// The object store of which a folder is the cache in this process; `None` if it is an ordinary folder.
pub fn attached(cache: &Path) -> Option<Arc<dyn Remote>> {
    connection(cache).map(|connection| Arc::clone(&connection.remote))
}

/// The connection of a store with this root.
pub(crate) fn connection(root: &Path) -> Option<Arc<Connection>> {
    let connections = locked(&CONNECTIONS);
    if connections.is_empty() {
        return None;
    }
    connections.get(&fs::canonicalize(root).ok()?).map(Arc::clone)
}

/// Downloads an artifact to the store at `root` if that is the cache of an object store and lacks the artifact; for readers that open
/// the folders of artifacts by path.
///
/// # Errors
/// As [`Store::lookup`].
pub fn fetch(root: &Path, stage: Stage, key: &Key) -> Result<(), ArtifactError> {
    if connection(root).is_some() {
        let store = Store::open(root)?;
        store.pull(&store.folder(stage, key), MANIFEST_NAME)?;
    }
    Ok(())
}

/// Downloads an artifact, given by its folder in the store at `root`, which may be missing. Returns whether it is there now. If `root`
/// is not the cache of an object store, nothing is downloaded.
///
/// # Errors
/// As [`Store::lookup`].
pub fn fetch_folder(root: &Path, folder: &Path) -> Result<bool, ArtifactError> {
    Store::open(root)?.pull(folder, MANIFEST_NAME)
}

/// Downloads all artifacts of the object store to its cache `root`, and returns their number.
///
/// # Errors
/// As [`Store::lookup`].
pub fn fetch_all(root: &Path) -> Result<usize, ArtifactError> {
    let Some(connection) = connection(root) else {
        return Ok(0);
    };
    let store = Store::open(root)?;
    let remote = &*connection.remote;
    let objects = remote.list("").map_err(failed("list", remote, ""))?;
    let folders: Vec<&str> = objects
        .iter()
        .filter_map(|(name, _)| name.strip_suffix(MANIFEST_NAME)?.strip_suffix('/'))
        .collect();
    for folder in &folders {
        store.pull(&store.root().join(folder), MANIFEST_NAME)?;
    }
    Ok(folders.len())
}

/// Downloads the part that a file of an artifact in parts belongs to, if the store of the artifact is the cache of an object store and lacks
/// the part. `file` is relative to the folder of the artifact.
pub(crate) fn fetch_part_of(artifact: &Path, file: &str) -> Result<(), ArtifactError> {
    let part = Path::new(file).parent().filter(|part| part.starts_with(PARTS));
    let root = artifact.parent().and_then(Path::parent);
    if let (Some(part), Some(root)) = (part, root)
        && connection(root).is_some()
    {
        // Without the part, the missing file is reported by the caller.
        Store::open(root)?.pull(&artifact.join(part), PART_MANIFEST_NAME)?;
    }
    Ok(())
}

impl Store {
    /// The manifest of a folder in the object store.
    fn remote_text(&self, folder: &Path, last: &'static str) -> Result<Option<Vec<u8>>, ArtifactError> {
        let Some(connection) = &self.connection else {
            return Ok(None);
        };
        let object = format!("{}/{last}", self.name_of(folder)?);
        let remote = &*connection.remote;
        remote.get(&object).map_err(failed("read", remote, &object))
    }

    /// Those of some numbers whose folders are not in the object store, or all if there is none. The manifest of a folder is `last`.
    pub(crate) fn not_remote(
        &self,
        mut numbers: Vec<u32>,
        folder: impl Fn(u32) -> PathBuf + Sync,
        last: &'static str,
    ) -> Result<Vec<u32>, ArtifactError> {
        if self.connection.is_some() {
            let found = Mutex::new(BTreeSet::new());
            each(&numbers, |&number| {
                if self.remote_text(&folder(number), last)?.is_some() {
                    locked(&found).insert(number);
                }
                Ok(())
            })?;
            let found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
            numbers.retain(|number| !found.contains(number));
        }
        Ok(numbers)
    }

    /// The artifact in parts in this folder, if it is in the object store and not in this folder. None of its parts is downloaded.
    pub(crate) fn remote_parts(&self, folder: &Path) -> Result<Option<Artifact>, ArtifactError> {
        if folder.join(MANIFEST_NAME).exists() {
            return Ok(None);
        }
        let Some(text) = self.remote_text(folder, MANIFEST_NAME)? else {
            return Ok(None);
        };
        let (temporary, _lock) = Temporary::held(self, "download")?;
        write(&temporary.path().join(MANIFEST_NAME), &text)?;
        let manifest = Manifest::read(temporary.path(), MANIFEST_NAME);
        let manifest = manifest.map_err(|error| error.at(&self.shown(folder)))?;
        if manifest.parts.is_none() {
            return Ok(None);
        }
        self.pull_record(&record(self.root(), &manifest.stage, &manifest.key))?;
        Ok(Some(Artifact::with_manifest(folder.to_path_buf(), manifest)))
    }

    /// The address of a folder in the object store, for messages.
    fn shown(&self, folder: &Path) -> PathBuf {
        match (&self.connection, self.name_of(folder)) {
            (Some(connection), Ok(name)) => format!("{}/{name}", connection.remote.address()).into(),
            _ => folder.to_path_buf(),
        }
    }

    /// Uploads a published folder, and the parts that its manifest `last` lists, unless it is in the object store already. Without an object
    /// store, nothing happens.
    pub(crate) fn push(&self, folder: &Path, last: &'static str) -> Result<(), ArtifactError> {
        let Some(connection) = &self.connection else {
            return Ok(());
        };
        let name = self.name_of(folder)?;
        if locked(&connection.complete).contains(&name) {
            return Ok(());
        }
        let remote = &*connection.remote;
        if !is_complete(remote, folder, &name, last)? {
            let parts = parts_of(&Manifest::read(folder, last)?);
            each(&parts, |part| {
                self.push(&folder.join(PARTS).join(part), PART_MANIFEST_NAME)
            })?;
            push_folder(remote, folder, &name, last)?;
        }
        locked(&connection.complete).insert(name);
        Ok(())
    }

    /// Downloads a folder whose manifest `last` is in the object store, and the parts that it lists, unless they exist. Returns whether the
    /// folder exists.
    pub(crate) fn pull(&self, folder: &Path, last: &'static str) -> Result<bool, ArtifactError> {
        let exists = folder.join(last).exists();
        let Some(connection) = self.connection.as_ref().filter(|_| !exists) else {
            return Ok(exists);
        };
        let remote = &*connection.remote;
        let name = self.name_of(folder)?;
        let Some(text) = self.remote_text(folder, last)? else {
            return Ok(false);
        };
        let (temporary, lock) = Temporary::held(self, "download")?;
        write(&temporary.path().join(last), &text)?;
        let shown = self.shown(folder);
        let manifest = Manifest::read(temporary.path(), last).map_err(|error| error.at(&shown))?;
        if last == MANIFEST_NAME {
            self.pull_record(&record(self.root(), &manifest.stage, &manifest.key))?;
        }
        if manifest.parts.is_some() {
            each(&parts_of(&manifest), |part| {
                let file = format!("{PARTS}/{part}/{PART_MANIFEST_NAME}");
                if self.pull(&folder.join(PARTS).join(part), PART_MANIFEST_NAME)? {
                    Ok(())
                } else {
                    Err(ArtifactError::damaged(&shown, Damage::Missing { file }))
                }
            })?;
            // After the parts, so that the manifest is not there without them.
            fs::create_dir_all(folder).map_err(ArtifactError::io("create the folder", folder))?;
            self.publish_manifest(folder, &manifest)?;
        } else {
            pull_folder(remote, &name, temporary.path(), &listed(&manifest))?;
            move_into_place(temporary, folder, last)?;
        }
        drop(lock);
        locked(&connection.complete).insert(name);
        Ok(true)
    }

    /// Uploads the record of a run, unless there is one: that of the run that made the artifact.
    pub(crate) fn push_record(&self, record: &Path) -> Result<(), ArtifactError> {
        let Some(connection) = &self.connection else {
            return Ok(());
        };
        let name = self.name_of(record)?;
        let content = fs::read(record).map_err(ArtifactError::io("read", record))?;
        let put = connection.remote.put_new(&name, Arc::new(content));
        put.map(drop).map_err(failed("create", &*connection.remote, &name))
    }

    /// Downloads the record of a run if there is one and this machine has none.
    fn pull_record(&self, record: &Path) -> Result<(), ArtifactError> {
        let Some(connection) = self.connection.as_ref().filter(|_| !record.exists()) else {
            return Ok(());
        };
        let name = self.name_of(record)?;
        let found = connection.remote.get(&name);
        match found.map_err(failed("read", &*connection.remote, &name))? {
            Some(text) => self.write_record(record, &text),
            None => Ok(()),
        }
    }

    /// The name of a folder or file of this store in the object store.
    fn name_of(&self, path: &Path) -> Result<String, ArtifactError> {
        let inside = path.strip_prefix(self.root());
        let inside = inside.ok().and_then(Path::to_str).filter(|inside| !inside.is_empty());
        inside.map(str::to_owned).ok_or_else(|| {
            let outside = io::Error::other(format!("it is not in {}", self.root().display()));
            ArtifactError::io("keep in an object store", path)(outside)
        })
    }
}

/// Renames a downloaded folder, unless another process has downloaded or made it.
fn move_into_place(temporary: Temporary, folder: &Path, last: &str) -> Result<(), ArtifactError> {
    sync_folder(temporary.path())?;
    if let Some(parent) = folder.parent() {
        fs::create_dir_all(parent).map_err(ArtifactError::io("create the folder", parent))?;
    }
    let _publication = Publication::wait();
    match fs::rename(temporary.path(), folder) {
        Ok(()) => temporary.published(),
        Err(_) if folder.join(last).exists() => {}
        Err(error) => return Err(ArtifactError::io("publish", folder)(error)),
    }
    Ok(())
}

/// Names of the parts that a manifest lists; none if the artifact is not in parts.
fn parts_of(manifest: &Manifest) -> Vec<String> {
    let parts = manifest.tables.values().flat_map(|table| &table.parts);
    let names: BTreeSet<String> = parts.map(|part| part.part.clone()).collect();
    names.into_iter().collect()
}

/// The files that the manifest of an artifact of one part, or of a part, lists.
fn listed(manifest: &Manifest) -> Vec<Listed> {
    let tables = manifest.tables.values().map(|table| Listed {
        file: table.file.clone(),
        bytes: table.bytes,
        blake3: table.blake3,
    });
    let files = manifest.files.iter().map(|(name, summary)| Listed {
        file: name.clone(),
        bytes: summary.bytes,
        blake3: summary.blake3,
    });
    tables.chain(files).collect()
}

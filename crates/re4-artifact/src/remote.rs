//! Stores whose artifacts are kept in an object store, with a folder on this machine as their cache.
//!
//! An object store has neither renames nor locks, and its listings may be late. A folder is therefore uploaded file by file, each as an
//! object that must not exist yet, and the file that makes the folder complete (the manifest) comes last. Without the manifest, the
//! artifact does not exist. An object that exists already is compared: equal bytes are fine, since equal keys give equal bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::ops::Range;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use crate::disk::sync_folder;
use crate::error::{ArtifactError, Damage};
use crate::key::{Key, Stage};
use crate::manifest::{MANIFEST_NAME, Manifest, PART_MANIFEST_NAME, PARTS};
use crate::store::{Store, record};
use crate::writer::{Publication, Temporary};

/// Number of objects that are transferred at the same time.
const AT_ONCE: usize = 8;

/// Length up to which an object is read by one request, and several are transferred at the same time. Larger ones are read in blocks of
/// this length, so that memory is bounded.
const BLOCK: u64 = 16 << 20;

/// How often an upload is tried again if the name is taken but there is no object: its writer may have failed in the meantime.
const ATTEMPTS: usize = 5;

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

impl Store {
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
        let object = format!("{name}/{last}");
        let Some(text) = remote.get(&object).map_err(failed("read", remote, &object))? else {
            return Ok(false);
        };
        let (temporary, lock) = Temporary::held(self, "download")?;
        write(&temporary.path().join(last), &text)?;
        let shown = PathBuf::from(format!("{}/{name}", remote.address()));
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

/// Uploads the files of a folder (not of folders in it), `last` as the last one, to the folder `name` of the object store. If it has `last` already, the
/// folder is complete, and only that file is compared.
///
/// # Errors
/// [`ArtifactError::NotReproducible`] if an object has other bytes than the file, [`ArtifactError::Remote`], [`ArtifactError::Io`].
pub fn push_folder(remote: &dyn Remote, folder: &Path, name: &str, last: &str) -> Result<(), ArtifactError> {
    if is_complete(remote, folder, name, last)? {
        return Ok(());
    }
    let (mut small, mut large) = (Vec::new(), Vec::new());
    for (file, bytes) in files_in(folder).map_err(ArtifactError::io("list", folder))? {
        if file != last {
            let of_its_size = if bytes <= BLOCK { &mut small } else { &mut large };
            of_its_size.push(Upload::new(folder, name, file));
        }
    }
    let send = |upload: &Upload| upload.send(remote, &Arc::new(upload.read()?));
    // An object is in memory while it is sent, so large ones are sent one after another.
    each(&small, send)?;
    large.iter().try_for_each(send)?;
    send(&Upload::new(folder, name, last.to_owned()))
}

/// Whether the object store has the file `last` of a folder, which was uploaded after the others.
fn is_complete(remote: &dyn Remote, folder: &Path, name: &str, last: &str) -> Result<bool, ArtifactError> {
    let marker = Upload::new(folder, name, last.to_owned());
    match marker.compare(remote, &marker.read()?)? {
        Some(false) => Err(marker.differs(remote)),
        found => Ok(found.is_some()),
    }
}

/// Downloads files of the folder `name` of the object store to the folder `to`, and checks their lengths and hashes.
///
/// # Errors
/// [`ArtifactError::Damaged`] naming the object if it is missing or has other bytes, [`ArtifactError::Remote`], [`ArtifactError::Io`].
pub fn pull_folder(remote: &dyn Remote, name: &str, to: &Path, files: &[Listed]) -> Result<(), ArtifactError> {
    each(files, |file| {
        let object = format!("{name}/{}", file.file);
        let path = to.join(&file.file);
        let damage = match download(remote, &object, &path, file.bytes)? {
            None => Damage::Missing {
                file: file.file.clone(),
            },
            Some((found, _)) if found != file.bytes => Damage::Length {
                file: file.file.clone(),
                expected: file.bytes,
                found,
            },
            Some((_, hash)) if hash != file.blake3 => Damage::Content {
                file: file.file.clone(),
            },
            Some(_) => return Ok(()),
        };
        let folder = format!("{}/{name}", remote.address());
        Err(ArtifactError::damaged(Path::new(&folder), damage))
    })
}

/// Downloads an object to a new file and returns its length and hash; `None` if there is no object. Of an object that is longer than
/// `expected` bytes, at least one byte more is read.
fn download(
    remote: &dyn Remote,
    object: &str,
    path: &Path,
    expected: u64,
) -> Result<Option<(u64, Key)>, ArtifactError> {
    let refuse = |error| ArtifactError::io("write", path)(error);
    let mut file = File::create_new(path).map_err(refuse)?;
    let mut hasher = blake3::Hasher::new();
    let mut at = 0;
    loop {
        // The last range has one byte more than is expected.
        let end = if expected - at <= BLOCK {
            expected + 1
        } else {
            at + BLOCK
        };
        let found = if expected <= BLOCK {
            remote.get(object)
        } else {
            remote.get_range(object, at..end)
        };
        let Some(block) = found.map_err(failed("read", remote, object))? else {
            return Ok(None);
        };
        hasher.update(&block);
        file.write_all(&block).map_err(refuse)?;
        at += block.len() as u64;
        if at != end || at > expected {
            break;
        }
    }
    file.sync_all().map_err(refuse)?;
    Ok(Some((at, hasher.finalize().into())))
}

/// A file that is uploaded.
struct Upload {
    path: PathBuf,
    /// Name relative to the folder.
    file: String,
    /// Name of the folder in the object store.
    folder: String,
    object: String,
}

impl Upload {
    fn new(folder: &Path, name: &str, file: String) -> Self {
        Self {
            path: folder.join(&file),
            folder: name.to_owned(),
            object: format!("{name}/{file}"),
            file,
        }
    }

    fn read(&self) -> Result<Vec<u8>, ArtifactError> {
        fs::read(&self.path).map_err(ArtifactError::io("read", &self.path))
    }

    /// Creates the object. If there is one already, it must be equal.
    fn send(&self, remote: &dyn Remote, content: &Arc<Vec<u8>>) -> Result<(), ArtifactError> {
        for _ in 0..ATTEMPTS {
            let put = remote.put_new(&self.object, Arc::clone(content));
            if put.map_err(failed("create", remote, &self.object))? == Put::Created {
                return Ok(());
            }
            match self.compare(remote, content)? {
                Some(true) => return Ok(()),
                Some(false) => return Err(self.differs(remote)),
                // The writer that was creating it has failed.
                None => {}
            }
        }
        let error = RemoteError {
            reason: "other writers are creating it, but do not finish".to_owned(),
            remedy: Some("run again"),
        };
        Err(failed("create", remote, &self.object)(error))
    }

    /// Whether the object has these bytes; `None` if there is no object.
    fn compare(&self, remote: &dyn Remote, content: &[u8]) -> Result<Option<bool>, ArtifactError> {
        if content.len() as u64 <= BLOCK {
            let found = remote.get(&self.object);
            let found = found.map_err(failed("read", remote, &self.object))?;
            return Ok(found.map(|found| found == content));
        }
        let mut at = 0;
        loop {
            let rest = &content[at..];
            // The last range has one byte more than the file.
            let length = if rest.len() as u64 <= BLOCK {
                rest.len() + 1
            } else {
                BLOCK as usize
            };
            let found = remote.get_range(&self.object, at as u64..(at + length) as u64);
            let Some(found) = found.map_err(failed("read", remote, &self.object))? else {
                return Ok(None);
            };
            if found != rest[..length.min(rest.len())] {
                return Ok(Some(false));
            }
            at += found.len();
            if at == content.len() {
                return Ok(Some(true));
            }
        }
    }

    fn differs(&self, remote: &dyn Remote) -> ArtifactError {
        ArtifactError::NotReproducible {
            folder: PathBuf::from(format!("{}/{}", remote.address(), self.folder)),
            what: format!("{}, compared with {}", self.file, self.path.display()),
        }
    }
}

/// Names and lengths of the files in a folder, in order.
fn files_in(folder: &Path) -> io::Result<Vec<(String, u64)>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let metadata = entry.metadata()?;
        if metadata.is_file() {
            let name = entry.file_name().into_string();
            let name = name.map_err(|name| io::Error::other(format!("the name {} is not Unicode", name.display())))?;
            files.push((name, metadata.len()));
        }
    }
    files.sort();
    Ok(files)
}

/// Calls `act` for each item, for several at the same time, until one fails.
fn each<T: Sync>(items: &[T], act: impl Fn(&T) -> Result<(), ArtifactError> + Sync) -> Result<(), ArtifactError> {
    let next = AtomicUsize::new(0);
    let work = || {
        while let Some(item) = items.get(next.fetch_add(1, Ordering::Relaxed)) {
            // The others end after their present items.
            act(item).inspect_err(|_| next.store(items.len(), Ordering::Relaxed))?;
        }
        Ok(())
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..AT_ONCE.min(items.len())).map(|_| scope.spawn(work)).collect();
        let ended: Vec<_> = workers.into_iter().map(thread::ScopedJoinHandle::join).collect();
        ended
            .into_iter()
            .try_for_each(|ended| ended.unwrap_or_else(|panic| resume_unwind(panic)))
    })
}

fn write(path: &Path, content: &[u8]) -> Result<(), ArtifactError> {
    File::create_new(path)
        .and_then(|mut file| {
            file.write_all(content)?;
            file.sync_all()
        })
        .map_err(ArtifactError::io("write", path))
}

fn failed(operation: &'static str, remote: &dyn Remote, object: &str) -> impl FnOnce(RemoteError) -> ArtifactError {
    let object = format!("{}/{object}", remote.address());
    move |source| ArtifactError::Remote {
        operation,
        object,
        source,
    }
}

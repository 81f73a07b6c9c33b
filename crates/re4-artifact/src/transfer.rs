//! Uploads and downloads of the files of a folder.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use crate::error::{ArtifactError, Damage};
use crate::key::Key;
use crate::remote::{Listed, Put, Remote, RemoteError};

/// Number of objects that are transferred at the same time.
const AT_ONCE: usize = 8;

/// Length up to which an object is read by one request, and several are transferred at the same time. Larger ones are read in blocks of
/// this length, so that memory is bounded.
const BLOCK: u64 = 16 << 20;

/// How often an upload is tried again if the name is taken but there is no object: its writer may have failed in the meantime.
const ATTEMPTS: usize = 5;

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
pub(crate) fn is_complete(remote: &dyn Remote, folder: &Path, name: &str, last: &str) -> Result<bool, ArtifactError> {
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
pub(crate) fn each<T: Sync>(
    items: &[T],
    act: impl Fn(&T) -> Result<(), ArtifactError> + Sync,
) -> Result<(), ArtifactError> {
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

pub(crate) fn write(path: &Path, content: &[u8]) -> Result<(), ArtifactError> {
    File::create_new(path)
        .and_then(|mut file| {
            file.write_all(content)?;
            file.sync_all()
        })
        .map_err(ArtifactError::io("write", path))
}

pub(crate) fn failed(
    operation: &'static str,
    remote: &dyn Remote,
    object: &str,
) -> impl FnOnce(RemoteError) -> ArtifactError {
    let object = format!("{}/{object}", remote.address());
    move |source| ArtifactError::Remote {
        operation,
        object,
        source,
    }
}

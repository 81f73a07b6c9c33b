//! Files on disk: hashing, syncing, and the lock that tells a live temporary from a dead writer's.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _};
use std::path::Path;

use crate::error::ArtifactError;
use crate::key::Key;

/// Name of the lock file in a temporary folder, and in the root of a store.
pub(crate) const LOCK_NAME: &str = ".lock";

/// Prefix of the name of temporary files and folders.
pub(crate) const TEMPORARY_PREFIX: &str = ".tmp-";

/// Opens a lock file, made if need be, and waits until the lock is ours. It is released when the file is dropped, or when
/// the process ends in whatever way.
pub(crate) fn lock(path: &Path) -> Result<File, ArtifactError> {
    let file = OpenOptions::new()
        .create(true)
        .truncate(false)
        .write(true)
        .open(path)
        .map_err(ArtifactError::io("write", path))?;
    file.lock().map_err(ArtifactError::io("lock", path))?;
    Ok(file)
}

/// Whether a living process holds the lock file in this temporary folder.
pub(crate) fn is_alive(temporary: &Path) -> bool {
    // A folder without lock file is one whose writer died between making the one and the other, or while publishing:
    // both happen under the store's lock, which the caller holds.
    let Ok(file) = File::open(temporary.join(LOCK_NAME)) else {
        return false;
    };
    // A file system that knows no locks cannot tell; what may be alive stays.
    file.try_lock().is_err()
}

/// Makes the entries of a folder durable.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), ArtifactError> {
    File::open(folder)
        .and_then(|file| file.sync_all())
        .map_err(ArtifactError::io("sync", folder))
}

/// Bytes that are hashed at once: enough for all cores.
const BLOCK: usize = 4 << 20;

/// BLAKE3 of a file, read block by block and hashed on all cores. It is not memory-mapped: a file that is cut off while it is
/// mapped ends the process.
pub(crate) fn hash_file(path: &Path) -> io::Result<Key> {
    let mut file = File::open(path)?;
    let length = usize::try_from(file.metadata()?.len()).unwrap_or(BLOCK);
    let mut block = vec![0; BLOCK.min(length).max(1)];
    let mut hasher = blake3::Hasher::new();
    loop {
        match file.read(&mut block) {
            Ok(0) => return Ok(hasher.finalize().into()),
            Ok(read) => {
                hasher.update_rayon(&block[..read]);
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

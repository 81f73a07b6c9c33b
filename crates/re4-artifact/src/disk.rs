//! Files on disk: hashing, syncing, and the lock that tells a live temporary from a dead writer's.

use std::fs::{File, OpenOptions};
use std::io;
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

/// BLAKE3 of a file, memory-mapped and hashed on all cores.
pub(crate) fn hash_file(path: &Path) -> io::Result<Key> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_mmap_rayon(path)?;
    Ok(hasher.finalize().into())
}

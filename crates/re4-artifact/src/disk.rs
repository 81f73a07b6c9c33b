//! Files on disk: hashing, syncing, and the lock that distinguishes the folder of a running writer from a leftover.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _};
use std::path::Path;

use crate::error::ArtifactError;
use crate::key::Key;

/// Name of the lock file in a temporary folder, and in the root of a store.
pub(crate) const LOCK_NAME: &str = ".lock";

/// Prefix of the name of temporary files and folders.
pub(crate) const TEMPORARY_PREFIX: &str = ".tmp-";

/// Opens a lock file, creates it if necessary, and waits until the lock is acquired. The lock is released when the file is
/// dropped and when the process ends, even if it is killed.
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

/// Returns whether a running process has locked this temporary folder. The caller must hold the lock of the store.
pub(crate) fn is_alive(temporary: &Path) -> bool {
    // A writer creates its lock file right after its folder and removes it right before publication, both under the lock of the
    // store. The caller holds that lock, so a folder without a lock file belongs to a writer that died in between.
    let Ok(file) = File::open(temporary.join(LOCK_NAME)) else {
        return false;
    };
    // On file systems without locks this fails as well; a folder whose writer may be running is kept.
    file.try_lock().is_err()
}

/// Syncs the entries of a folder to disk.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), ArtifactError> {
    File::open(folder)
        .and_then(|file| file.sync_all())
        .map_err(ArtifactError::io("sync", folder))
}

/// Number of bytes that are hashed at once: large enough to use all cores.
const BLOCK: usize = 4 << 20;

/// Computes the BLAKE3 hash of a file, block by block, on all cores. The file is not memory-mapped, because the process would be
/// killed if another process truncated the file meanwhile.
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

//! Files on disk: hashing and syncing.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

use crate::error::ArtifactError;
use crate::key::Key;

/// Syncs the entries of a folder to disk.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), ArtifactError> {
    File::open(folder)
        .and_then(|file| file.sync_all())
        .map_err(ArtifactError::io("sync", folder))
}

/// Whether something is not there, in an error about a path that another process may have removed meanwhile. A network file system can
/// report a stale handle instead, if this machine has seen what was removed.
pub(crate) fn is_gone(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::NotFound | io::ErrorKind::StaleNetworkFileHandle
    )
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

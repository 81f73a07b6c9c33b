//! Installation of a complete, checked download: a zip file is unpacked, any other file is moved. Both are atomic.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use zip::ZipArchive;
use zip::result::ZipError;

use crate::error::Fault;

/// Unpacks `archive` to a temporary folder in `destination` and moves the dataset to `destination/provides`. In the archive the
/// dataset has the path `provides` or the last component of it.
pub(crate) fn unpack(archive: &Path, destination: &Path, provides: &Path) -> Result<(), Fault> {
    let temporary = tempfile::Builder::new()
        .prefix(".re4-fetch-")
        .tempdir_in(destination)
        // Only the kind of the error, because tempfile's message repeats the path and contains a random name.
        .map_err(|error| Fault::io("create a folder in", destination, error.kind().into()))?;
    unpack_all(archive, temporary.path())?;
    let last = provides.file_name().map_or(provides, Path::new);
    let unpacked = [provides, last]
        .map(|inside| temporary.path().join(inside))
        .into_iter()
        .find(|path| path.exists())
        .ok_or_else(|| Fault::Incomplete {
            expected: provides.display().to_string(),
        })?;
    move_to(&unpacked, &destination.join(provides), "move the unpacked dataset to")
}

/// Moves a downloaded file to its final path.
pub(crate) fn put(file: &Path, target: &Path) -> Result<(), Fault> {
    move_to(file, target, "move the downloaded file to")
}

fn move_to(from: &Path, target: &Path, action: &'static str) -> Result<(), Fault> {
    if let Some(parent) = target.parent() {
        fs::create_dir_all(parent).map_err(|error| Fault::io("create", parent, error))?;
    }
    fs::rename(from, target).map_err(|error| Fault::io(action, target, error))
}

fn unpack_all(archive: &Path, target: &Path) -> Result<(), Fault> {
    let unreadable = |why: String| Fault::UnreadableZip { why };
    let file = File::open(archive).map_err(|error| Fault::io("read", archive, error))?;
    let mut zip = ZipArchive::new(io::BufReader::new(file)).map_err(|error| unreadable(error.to_string()))?;
    for index in 0..zip.len() {
        let mut entry = zip.by_index(index).map_err(|error| match error {
            ZipError::Io(error) => Fault::io("read", archive, error),
            error => unreadable(format!("entry {index}: {error}")),
        })?;
        let name = entry
            .name()
            .map_or_else(|_| format!("number {index}"), std::borrow::Cow::into_owned);
        // Entries with links or with paths outside of the target could overwrite other files of the user.
        let path = match entry.enclosed_name() {
            Some(inside) if !entry.is_symlink() => target.join(inside),
            _ => return Err(Fault::UnsafeZipEntry { entry: name }),
        };
        if entry.is_dir() {
            fs::create_dir_all(&path).map_err(|error| Fault::io("create", &path, error))?;
            continue;
        }
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|error| Fault::io("create", parent, error))?;
        }
        let mut output = File::create(&path).map_err(|error| Fault::io("write", &path, error))?;
        let expected = entry.size();
        let written = io::copy(&mut entry, &mut output).map_err(|error| match error.kind() {
            // These errors are caused by the disk, all others by the archive.
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::ReadOnlyFilesystem => {
                Fault::io("write", &path, error)
            }
            _ => unreadable(format!("entry {name}: {error}")),
        })?;
        if written != expected {
            return Err(unreadable(format!(
                "entry {name}: {written} bytes instead of {expected}"
            )));
        }
    }
    Ok(())
}

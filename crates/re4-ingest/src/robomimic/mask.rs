//! Writes filter keys to a copy of an HDF5 file.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use hdf5::types::VarLenUnicode;
use re4_fault::Remedy;
use thiserror::Error;

/// Why a filter key cannot be written.
#[derive(Debug, Error, Remedy)]
pub enum MaskError {
    /// The copy exists, or cannot be written.
    #[error("cannot copy {} to {}: {reason}", source_file.display(), copy.display())]
    #[remedy("give --mask the path of a new file in a folder with enough space")]
    Copy {
        /// The source.
        source_file: PathBuf,
        /// The copy.
        copy: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The HDF5 library refuses.
    #[error("cannot write the filter key /mask/{key} to {}: {reason}", copy.display())]
    #[remedy("check that the source is an intact HDF5 file, or use --keep-list instead")]
    Write {
        /// The copy.
        copy: PathBuf,
        /// The filter key.
        key: String,
        /// The reason.
        reason: String,
    },
}

/// Copies an HDF5 file and writes the filter key `/mask/KEY` with the names of demonstrations to the copy, as robomimic does. A filter
/// key of that name is replaced. The source is not changed; if the key cannot be written, no copy remains.
///
/// # Errors
/// If the copy exists or cannot be written.
pub fn copy_with_filter(source: &Path, copy: &Path, key: &str, names: &[String]) -> Result<(), MaskError> {
    let refused = |reason: String| MaskError::Copy {
        source_file: source.to_owned(),
        copy: copy.to_owned(),
        reason,
    };
    if copy.exists() {
        return Err(refused("it exists already".to_owned()));
    }
    let folder = copy.parent().filter(|folder| !folder.as_os_str().is_empty());
    let copied = || -> std::io::Result<tempfile::NamedTempFile> {
        let mut from = std::fs::File::open(source)?;
        let mut to = tempfile::Builder::new()
            .permissions(std::fs::Permissions::from_mode(0o666)) // less the bits of the umask
            .tempfile_in(folder.unwrap_or(Path::new(".")))?;
        // Not `fs::copy`, which would also copy that a source may only be read.
        std::io::copy(&mut from, &mut to)?;
        Ok(to)
    };
    // The copy gets its name when it is complete. Until then it is removed on every way out.
    let temporary = copied().map_err(|error| refused(error.to_string()))?;
    write(temporary.path(), key, names).map_err(|reason| MaskError::Write {
        copy: copy.to_owned(),
        key: key.to_owned(),
        reason,
    })?;
    temporary
        .as_file()
        .sync_all()
        .map_err(|error| refused(error.to_string()))?;
    temporary
        .persist_noclobber(copy)
        .map(drop)
        .map_err(|error| refused(error.error.to_string()))
}

fn write(copy: &Path, key: &str, names: &[String]) -> Result<(), String> {
    let text = |error: hdf5::Error| error.to_string();
    let names: Vec<VarLenUnicode> = names
        .iter()
        .map(|name| name.parse().map_err(|error| format!("{name:?}: {error}")))
        .collect::<Result<_, String>>()?;
    let file = hdf5::File::append(copy).map_err(text)?;
    let mask = if file.link_exists("mask") {
        file.group("mask").map_err(text)?
    } else {
        file.create_group("mask").map_err(text)?
    };
    if mask.link_exists(key) {
        mask.unlink(key).map_err(text)?;
    }
    mask.new_dataset_builder().with_data(&names).create(key).map_err(text)?;
    file.close().map_err(text)
}

//! The formats.

pub(crate) mod hdf5;
pub(crate) mod lerobot;
pub(crate) mod robomimic;
pub(crate) mod zarr;

use std::path::Path;

use anyhow::Result;

/// Size of a file, or of all files in a folder.
fn size(path: &Path) -> Result<u64> {
    let about = std::fs::metadata(path)?;
    if !about.is_dir() {
        return Ok(about.len());
    }
    let mut bytes = 0;
    for entry in std::fs::read_dir(path)? {
        bytes += size(&entry?.path())?;
    }
    Ok(bytes)
}

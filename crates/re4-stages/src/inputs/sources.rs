//! Locates raw datasets and weights, and lists the demonstrations that an `episodes` artifact lacks.

use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::Artifact;
use re4_fault::{bail, fault};
use re4_ingest::LeftOut;
use tracing::debug;

/// The path of a weights file, looked up as for [`find_source`].
pub(crate) fn find_weights(weights: &Path) -> Result<PathBuf> {
    find_source(weights).map_err(|_| {
        fault!(
            "cannot start from the weights {}: the file does not exist", weights.display();
            "download ResNet-18's with re4-pipe fetch resnet18, or remove pose.encoder.weights to start from random ones"
        )
        .into()
    })
}

/// The path of a source. A relative path is looked up in `RE4_DATA`, then in `data`, then in the current folder.
pub(crate) fn find_source(source: &Path) -> Result<PathBuf> {
    if source.is_absolute() {
        return Ok(source.to_owned());
    }
    let mut folders = data_folders();
    folders.push(PathBuf::new());
    if let Some(found) = folders
        .iter()
        .map(|folder| folder.join(source))
        .find(|path| path.exists())
    {
        debug!(path = %found.display(), "source found");
        return Ok(found);
    }
    let searched: Vec<String> = data_folders()
        .iter()
        .map(|folder| folder.display().to_string())
        .collect();
    let fetch = if source.starts_with("pusht") {
        ", or download it with re4-pipe fetch pusht"
    } else {
        ""
    };
    bail!(
        "cannot ingest {}: it was not found in {} or the current folder",
        source.display(),
        searched.join(", ");
        "set RE4_DATA to the folder that contains it, or give its absolute path{fetch}"
    )
}

/// The folders with raw datasets, in the order in which they are searched: `RE4_DATA` if it is set, then `data`.
pub fn data_folders() -> Vec<PathBuf> {
    let named = std::env::var_os("RE4_DATA")
        .filter(|value| !value.is_empty())
        .map(PathBuf::from);
    named.into_iter().chain([PathBuf::from("data")]).collect()
}

/// The demonstrations of the source that were left out of an `episodes` artifact.
pub(crate) fn left_out(artifact: &Artifact) -> Result<Vec<LeftOut>> {
    if !artifact.has::<LeftOut>() {
        return Ok(Vec::new());
    }
    Ok(artifact.read()?)
}

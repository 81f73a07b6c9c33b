//! Raw datasets and weights: where they are, and what of them is in no artifact.

use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::Artifact;
use re4_fault::{bail, fault};
use re4_ingest::LeftOut;
use tracing::debug;

/// A file of weights, looked for as sources are.
pub(crate) fn find_weights(weights: &Path) -> Result<PathBuf> {
    find_source(weights).map_err(|_| {
        fault!(
            "cannot start from the weights {}: there is no such file", weights.display();
            "get ResNet-18's with re4-pipe fetch resnet18, or leave pose.encoder.weights out to start from random ones"
        )
        .into()
    })
}

/// A relative source is looked for below `RE4_DATA`, below `data`, and last in the current folder.
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
    let looked_below: Vec<String> = data_folders()
        .iter()
        .map(|folder| folder.display().to_string())
        .collect();
    let fetch = if source.starts_with("pusht") {
        ", or get it with re4-pipe fetch pusht"
    } else {
        ""
    };
    bail!(
        "cannot ingest {}: it is not below {} (seen from the current folder), nor in the current folder itself",
        source.display(),
        looked_below.join(" or ");
        "set RE4_DATA to the folder that it is below, or give its absolute path{fetch}"
    )
}

/// The folders with raw datasets, in the order in which they are searched: `RE4_DATA` where it is set, then `data`.
pub fn data_folders() -> Vec<PathBuf> {
    let named = std::env::var_os("RE4_DATA")
        .filter(|value| !value.is_empty())
        .map(PathBuf::from);
    named.into_iter().chain([PathBuf::from("data")]).collect()
}

/// Demonstrations of the source that are not in an `episodes` artifact.
pub(crate) fn left_out(artifact: &Artifact) -> Result<Vec<LeftOut>> {
    if !artifact.has::<LeftOut>() {
        return Ok(Vec::new());
    }
    Ok(artifact.read()?)
}

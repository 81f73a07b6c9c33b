//! The pages of the influence of demonstrations and of a curation.

use std::path::Path;

use anyhow::Result;
use re4_artifact::Artifact;

/// Makes the page of an `influence` artifact.
///
/// # Errors
/// If a table cannot be read.
pub fn influence_page(_artifact: &Artifact, _store: &Path) -> Result<String> {
    Ok(String::new())
}

/// Makes the page of a `curation` artifact.
///
/// # Errors
/// If a table cannot be read.
pub fn curation_page(_artifact: &Artifact) -> Result<String> {
    Ok(String::new())
}

//! The pages of the influence of demonstrations and of a curation.

use anyhow::{Result, ensure};
use re4_artifact::{Artifact, Stage};

use crate::html::influence::{self, Curation, Influence};

/// Makes the page of an `influence` artifact.
///
/// # Errors
/// If the artifact is another one, or a table cannot be read.
pub fn influence_page(artifact: &Artifact) -> Result<String> {
    check(artifact, Stage::Influence)?;
    Ok(influence::influence_page(&Influence {
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        key: artifact.key().to_string(),
        rows: artifact.read()?,
        episodes: artifact.read()?,
        pairs: artifact.read()?,
    }))
}

/// Makes the page of a `curation` artifact.
///
/// # Errors
/// If the artifact is another one, or a table cannot be read.
pub fn curation_page(artifact: &Artifact) -> Result<String> {
    check(artifact, Stage::Curate)?;
    Ok(influence::curation_page(&Curation {
        tool_version: env!("CARGO_PKG_VERSION").to_owned(),
        key: artifact.key().to_string(),
        rows: artifact.read()?,
        rounds: artifact.read()?,
        judged: artifact.read()?,
    }))
}

fn check(artifact: &Artifact, stage: Stage) -> Result<()> {
    ensure!(
        artifact.manifest().artifact == stage.artifact(),
        "cannot report on {}: it has {}; name an artifact of re4-pipe {}",
        artifact.path().display(),
        artifact.manifest().artifact,
        stage.as_str()
    );
    Ok(artifact.verify_bytes()?)
}

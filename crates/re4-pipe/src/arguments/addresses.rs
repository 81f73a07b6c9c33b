//! Addresses of object stores among the arguments.

use std::path::PathBuf;

use anyhow::Result;
use re4_stages::{Notes, is_address, local_artifact, local_artifacts, local_store};

use super::{Command, ExportArguments, InspectArguments, ReportArguments, VerifyArguments, VideoArguments};

impl Command {
    /// Replaces addresses of object stores by the folders in which this machine keeps their artifacts, and downloads the artifacts that
    /// are named.
    ///
    /// # Errors
    /// If this build has no object stores, an object store is not reached, or there is no such artifact.
    pub(crate) fn use_local_folders(&mut self) -> Result<()> {
        for path in self.artifacts() {
            *path = local_artifact(path)?;
        }
        let reads_all = self.reads_all();
        let Some(common) = self.common() else {
            return Ok(());
        };
        if is_address(&common.artifacts) {
            let address = common.artifacts.display().to_string();
            common.artifacts = if reads_all {
                local_artifacts(&common.artifacts)?
            } else {
                local_store(&common.artifacts)?
            };
            let copies = common.artifacts.display();
            Notes::new(common.quiet).note(&format!("{:>10}  {address}  copies in {copies}", "store"));
        }
        Ok(())
    }

    /// The arguments that name artifacts.
    fn artifacts(&mut self) -> Vec<&mut PathBuf> {
        match self {
            Self::Video(VideoArguments { path, .. }) | Self::Inspect(InspectArguments { path, .. }) => vec![path],
            Self::Export(ExportArguments {
                artifact,
                keep,
                modes,
                poses,
                ..
            }) => [artifact].into_iter().chain(keep).chain(modes).chain(poses).collect(),
            Self::Verify(VerifyArguments { paths, .. }) | Self::Report(ReportArguments { paths, .. }) => {
                paths.iter_mut().collect()
            }
            #[cfg(feature = "query")]
            Self::Query(super::QueryArguments { paths, .. }) => paths.iter_mut().collect(),
            _ => Vec::new(),
        }
    }

    /// Whether the command reads all artifacts of the store.
    fn reads_all(&self) -> bool {
        match self {
            Self::Verify(VerifyArguments { paths, .. }) => paths.is_empty(),
            #[cfg(feature = "query")]
            Self::Query(super::QueryArguments { paths, .. }) => paths.is_empty(),
            _ => false,
        }
    }
}

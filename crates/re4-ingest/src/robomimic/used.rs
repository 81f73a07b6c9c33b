//! One of several files of a dataset, with its requested demonstrations.

use std::ops::Range;
use std::path::Path;
use std::sync::OnceLock;

use super::fault::Hdf5Fault;
use super::file::Access;
use super::members::Member;
use super::reader::{DemoChoice, RobomimicReader};
use super::sources::Sources;
use super::survey::Surveyed;
use crate::demos::Episode;
use crate::error::{Fault, IngestError};
use crate::tables::LeftOut;

/// A file of which demonstrations are requested.
#[derive(Debug, Clone)]
pub(super) struct Used {
    pub(super) file: Member,
    /// Index of its first demonstration in the dataset.
    pub(super) start: usize,
    /// Number of its requested demonstrations.
    pub(super) count: usize,
    /// Indices of these among the demonstrations that the filter lists; `None` for all.
    pub(super) places: Option<Vec<usize>>,
    /// What is known of the requested demonstrations, so that they are looked at once, however often the file is opened.
    pub(super) surveyed: OnceLock<Surveyed>,
}

impl Used {
    pub(super) fn range(&self) -> Range<usize> {
        self.start..self.start + self.count
    }

    pub(super) fn name(&self, name: &str) -> String {
        [self.file.prefix.as_str(), name].concat()
    }

    pub(super) fn left_out(&self, left: &LeftOut) -> LeftOut {
        LeftOut {
            demo: self.name(&left.demo),
            why: format!("in {}, {}", self.file.path.display(), left.why),
        }
    }

    pub(super) fn episode(&self, episode: Result<Episode, LeftOut>) -> Result<Episode, LeftOut> {
        let mut episode = episode.map_err(|left| self.left_out(&left))?;
        episode.name.name = self.name(&episode.name.name);
        // Other files have demonstrations of the same number.
        episode.name.number = None;
        let within = |text: &mut String| *text = format!("in {}, {text}", self.file.path.display());
        episode.contradiction.iter_mut().for_each(within);
        episode.skipped.iter_mut().for_each(within);
        Ok(episode)
    }

    pub(super) fn open(&self, choice: &DemoChoice, access: Access) -> Result<RobomimicReader, IngestError> {
        let sources = Sources::open_again(&self.file.path, &self.file.identity)?;
        let mut reader =
            RobomimicReader::open_places(&sources, choice, access, self.places.as_deref(), self.surveyed.get())?;
        self.surveyed.get_or_init(|| reader.surveyed().clone());
        if let Some(model) = reader.sources().model_names().next() {
            return Err(other(
                &self.file.path,
                format!(
                    "its demonstrations refer to models beside the file, such as {model}, which is only supported for a dataset of one file; ingest the files one by one"
                ),
            ));
        }
        if reader.demos().len() != self.count {
            return Err(sources.changed());
        }
        reader.prefix.clone_from(&self.file.prefix);
        Ok(reader)
    }
}

/// The error about something else that is wrong with a dataset or a file.
pub(super) fn other(dataset: &Path, text: String) -> IngestError {
    Fault::from(Hdf5Fault::Other(text)).of(dataset)
}

//! A LeRobot dataset as a source of demonstrations.

use std::path::{Path, PathBuf};

use re4_lerobot::{Cameras, Info as LerobotInfo};
use serde_json::json;

use super::files::LerobotFiles;
use super::keys::{LerobotKeys, cameras, only_camera};
use super::opened::LerobotDataset;
use crate::demos::{DemoName, DemoSource, Episode, ImageBlock, Info, Tally};
use crate::error::IngestError;
use crate::pusht::{PushtConventions, PushtOptions, PushtReading, from_lerobot};
use crate::selection::Selection;
use crate::source::Stop;
use crate::tables::{Convention, LeftOut};
use crate::warning::{Warning, WarningCode};

/// Camera of `lerobot/pusht`.
const PUSHT_IMAGE: &str = "observation.image";

/// Name of Push-T's camera in the table of images, which all sources share.
const PUSHT_CAMERA: &str = "img";

/// Which demonstrations and features of a Push-T dataset are read.
#[derive(Debug, Clone, Copy)]
pub struct PushtChoice<'a> {
    /// The features.
    pub keys: &'a LerobotKeys,
    /// Name of a split, to whose episodes the selection is restricted.
    pub split: Option<&'a str>,
    /// The demonstrations.
    pub select: &'a Selection,
    /// Whether images will be read.
    pub images: bool,
}

impl PushtChoice<'_> {
    /// The camera to open.
    fn camera(&self, info: &LerobotInfo) -> Result<Option<String>, crate::error::Fault> {
        if !self.images {
            return Ok(None);
        }
        only_camera(info, self.keys.image.as_deref(), PUSHT_IMAGE)
    }

    /// Opens the dataset with the camera of this choice.
    ///
    /// # Errors
    /// All faults of the dataset, in one error.
    pub fn open(&self, path: &Path, stop: Stop<'_>) -> Result<LerobotDataset, IngestError> {
        let info = LerobotDataset::described(path)?;
        let camera = self.camera(&info).map_err(|fault| fault.of(path))?;
        LerobotDataset::open(path, &Cameras::Named(camera.into_iter().collect()), stop)
    }
}

/// An opened dataset with its numbers read and judged; images are streamed.
pub struct LerobotSource {
    path: PathBuf,
    opened: LerobotDataset,
    files: LerobotFiles,
    info: Info,
    demos: Vec<DemoName>,
    reading: PushtReading,
    conventions: Vec<Convention>,
}

impl LerobotSource {
    /// Reads the numbers of a Push-T dataset. `files` are those that were hashed.
    ///
    /// # Errors
    /// A file changed, the selection does not fit, the numbers are not those of Push-T, or, with [`crate::OnBad::Refuse`], an episode
    /// cannot be used.
    pub fn pusht(
        path: &Path,
        files: LerobotFiles,
        choice: &PushtChoice<'_>,
        options: &PushtOptions<'_>,
    ) -> Result<Self, IngestError> {
        let opened = choice.open(path, options.stop)?;
        files.are_of(path, &opened.dataset)?;
        let chosen = opened
            .select(choice.select, choice.split)
            .map_err(|fault| fault.of(path))?;
        let (reading, conventions) = from_lerobot::read(&opened.dataset, &chosen, choice.keys, options)?;
        let first = chosen.first().copied().unwrap_or_default();
        let mut info = opened.info(first, |_| PUSHT_CAMERA.to_owned())?;
        info.object_poses = reading.episodes.recorded.block;
        if options.conventions != PushtConventions::default() {
            info.details
                .insert("conventions".to_owned(), json!({ "settings": options.conventions }));
        }
        Ok(Self {
            path: path.to_owned(),
            demos: opened.names(&chosen),
            opened,
            files,
            info,
            reading,
            conventions,
        })
    }

    /// The conventions that the data proves.
    pub fn conventions(&self) -> &[Convention] {
        &self.conventions
    }

    /// The warning about images that are not read, if any.
    fn no_images(&self) -> Option<Warning> {
        if !self.info.cameras.is_empty() {
            return None;
        }
        let names = cameras(self.opened.dataset.info());
        let message = match names.as_slice() {
            [] => "the dataset has no images".to_owned(),
            names => format!(
                "no images were ingested: ingest.lerobot.image may name a camera ({})",
                names.join(", ")
            ),
        };
        Some(Warning::new(WarningCode::NoImages, message, 1))
    }
}

impl DemoSource for LerobotSource {
    /// Accepts a folder with `meta/info.json`.
    fn probe(path: &Path) -> bool {
        LerobotDataset::probe(path)
    }

    fn info(&self) -> &Info {
        &self.info
    }

    fn demos(&self) -> &[DemoName] {
        &self.demos
    }

    fn episodes<E: From<IngestError> + Send>(
        &self,
        take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        self.reading.each(&self.demos, take)
    }

    fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let features = self.opened.dataset.cameras();
        let feature = features.first().map_or(camera, String::as_str);
        self.opened.images(feature, of, take)
    }

    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError> {
        let left_out = tally.left_out_warning(self.demos.len());
        let warnings = self.reading.warnings.iter().cloned();
        Ok(warnings
            .chain(self.no_images())
            .chain(self.opened.notes())
            .chain(left_out)
            .collect())
    }

    fn unchanged(&self) -> Result<(), IngestError> {
        self.files.unchanged(&self.path)
    }
}

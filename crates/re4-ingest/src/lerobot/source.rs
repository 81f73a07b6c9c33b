//! A LeRobot dataset as a source of demonstrations.

use std::ops::Range;
use std::path::{Path, PathBuf};

use re4_lerobot::{Cameras, Info as LerobotInfo};
use serde_json::json;

use super::arm::ArmLayout;
use super::files::LerobotFiles;
use super::keys::{LerobotKeys, cameras, only_camera};
use super::opened::LerobotDataset;
use crate::demos::{DemoName, DemoSource, Episode, Frames, ImageBlock, Info, Tally};
use crate::error::{Fault, IngestError};
use crate::pusht::{PushtConventions, PushtOptions, PushtReading, from_lerobot};
use crate::selection::Selection;
use crate::source::Stop;
use crate::tables::{Convention, LeftOut, SignalRow};
use crate::warning::{Warning, WarningCode};

/// Camera of `lerobot/pusht`.
const PUSHT_IMAGE: &str = "observation.image";

/// Name of Push-T's camera in the table of images, which all sources share.
const PUSHT_CAMERA: &str = "img";

/// Which demonstrations and features of a dataset are read.
#[derive(Debug, Clone, Copy)]
pub struct LerobotChoice<'a> {
    /// Whether it is a dataset of Push-T; otherwise it is one of an arm.
    pub planar: bool,
    /// The features.
    pub keys: &'a LerobotKeys,
    /// Name of a split, to whose episodes the selection is restricted.
    pub split: Option<&'a str>,
    /// The demonstrations.
    pub select: &'a Selection,
    /// Whether images will be read.
    pub images: bool,
    /// Cameras of an arm whose images will be read; `None` for all.
    pub cameras: Option<&'a [String]>,
}

impl LerobotChoice<'_> {
    /// The cameras to open.
    fn cameras(&self, info: &LerobotInfo) -> Result<Vec<String>, Fault> {
        if !self.images {
            return Ok(Vec::new());
        }
        if self.planar {
            let camera = only_camera(info, self.keys.image.as_deref(), PUSHT_IMAGE)?;
            return Ok(camera.into_iter().collect());
        }
        let all = cameras(info);
        let Some(wanted) = self.cameras else {
            return Ok(all.into_iter().map(str::to_owned).collect());
        };
        let find = |name: &String| {
            let found = all
                .iter()
                .find(|camera| *camera == name || short(camera, &all) == *name);
            found.map(|camera| (*camera).to_owned()).ok_or_else(|| {
                Fault::Lerobot(format!(
                    "meta/info.json: there is no camera {name}; set ingest.cameras to some of the cameras ({})",
                    if all.is_empty() {
                        "none".to_owned()
                    } else {
                        all.join(", ")
                    }
                ))
            })
        };
        wanted.iter().map(find).collect()
    }

    /// Opens the dataset with the cameras of this choice.
    ///
    /// # Errors
    /// All faults of the dataset, in one error.
    pub fn open(&self, path: &Path, stop: Stop<'_>) -> Result<LerobotDataset, IngestError> {
        let info = LerobotDataset::described(path)?;
        let cameras = self.cameras(&info).map_err(|fault| fault.of(path))?;
        LerobotDataset::open(path, &Cameras::Named(cameras), stop)
    }
}

/// Name of a camera in the table of images: without `observation.images.` or `observation.`, unless another camera has that name.
fn short(camera: &str, all: &[&str]) -> String {
    let stem = |name: &str| {
        let rest = name
            .strip_prefix("observation.images.")
            .or_else(|| name.strip_prefix("observation."));
        rest.unwrap_or(name).to_owned()
    };
    let own = stem(camera);
    match all.iter().filter(|other| stem(other) == own).count() {
        0 | 1 => own,
        _ => camera.to_owned(),
    }
}

/// What the demonstrations consist of.
enum Content {
    /// Push-T, with all numbers read and judged.
    Pusht(PushtReading),
    /// An arm, whose episodes are read one after the other.
    Arm(ArmLayout, Vec<SignalRow>),
}

/// An opened dataset; images are streamed.
pub struct LerobotSource {
    path: PathBuf,
    opened: LerobotDataset,
    files: LerobotFiles,
    info: Info,
    demos: Vec<DemoName>,
    /// Indices of the episodes.
    chosen: Vec<usize>,
    content: Content,
    conventions: Vec<Convention>,
}

impl LerobotSource {
    /// The requested demonstrations, in order.
    pub fn demos(&self) -> &[DemoName] {
        &self.demos
    }

    /// Opens a dataset again, reads the numbers of one of Push-T, and proves the conventions. `files` are those that were hashed.
    ///
    /// # Errors
    /// A file changed, the selection or a setting does not fit, the numbers are not those of Push-T, or, with
    /// [`crate::OnBad::Refuse`], an episode of Push-T cannot be used.
    pub fn read(
        path: &Path,
        files: LerobotFiles,
        choice: &LerobotChoice<'_>,
        options: &PushtOptions<'_>,
    ) -> Result<Self, IngestError> {
        let opened = choice.open(path, options.stop)?;
        files.are_of(path, &opened.dataset)?;
        let at = |fault: Fault| fault.of(path);
        let chosen = opened.select(choice.select, choice.split).map_err(at)?;
        let first = chosen.first().copied().unwrap_or_default();
        let dataset = &opened.dataset;
        let (content, conventions, info) = if choice.planar {
            choice.keys.check(true).map_err(at)?;
            let (reading, conventions) = from_lerobot::read(dataset, &chosen, choice.keys, options)?;
            let mut info = opened.info(first, |_| PUSHT_CAMERA.to_owned())?;
            info.object_poses = reading.episodes.recorded.block;
            if options.conventions != PushtConventions::default() {
                let settings = json!({ "settings": options.conventions });
                info.details.insert("conventions".to_owned(), settings);
            }
            (Content::Pusht(reading), conventions, info)
        } else {
            let mut layout = ArmLayout::of(dataset.info(), choice.keys).map_err(at)?;
            let conventions = layout.learn(dataset, &chosen, options.stop)?.into_iter().collect();
            let all = cameras(dataset.info());
            let info = opened.info(first, |camera| short(camera, &all))?;
            let signals = layout.signals();
            (Content::Arm(layout, signals), conventions, info)
        };
        Ok(Self {
            path: path.to_owned(),
            demos: opened.names(&chosen),
            opened,
            files,
            info,
            chosen,
            content,
            conventions,
        })
    }

    /// The cameras that would be ingested if images were read.
    ///
    /// # Errors
    /// A setting names a camera that is not there.
    pub fn recorded(&self, choice: &LerobotChoice<'_>) -> Result<Vec<String>, IngestError> {
        let all = LerobotChoice {
            images: true,
            ..*choice
        };
        all.cameras(self.opened.dataset.info())
            .map_err(|fault| fault.of(&self.path))
    }

    /// The conventions that the data proves.
    pub fn conventions(&self) -> &[Convention] {
        &self.conventions
    }

    /// Reads the episodes of an arm.
    fn arms<E: From<IngestError> + Send>(
        &self,
        layout: &ArmLayout,
        range: Range<usize>,
        mut take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut place = range.start;
        self.opened.read(&self.chosen[range], |frames| {
            let name = &self.demos[place];
            let columns = frames.and_then(|frames| layout.columns(&frames));
            let episode = columns
                .map_err(|why| LeftOut {
                    demo: name.name.clone(),
                    why,
                })
                .map(|columns| Episode {
                    name: name.clone(),
                    frames: Frames::Arm(columns),
                    states: None,
                    model: None,
                    goal_errors: None,
                    single_precision: Vec::new(),
                    skipped: Vec::new(),
                    contradiction: None,
                });
            place += 1;
            take(place - 1, episode)
        })
    }

    /// The warning about images that are not read, if any.
    fn no_images(&self) -> Option<Warning> {
        if !self.info.cameras.is_empty() {
            return None;
        }
        let names = cameras(self.opened.dataset.info());
        let message = match names.as_slice() {
            [] => "the dataset has no images".to_owned(),
            names => format!("images of these cameras are not ingested: {}", names.join(", ")),
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

    fn signals(&self) -> &[SignalRow] {
        match &self.content {
            Content::Pusht(_) => &[],
            Content::Arm(_, signals) => signals,
        }
    }

    fn count(&self) -> usize {
        self.demos().len()
    }

    fn can_be_read_in_parts(&self) -> bool {
        matches!(self.content, Content::Arm(..))
    }

    fn episodes<E: From<IngestError> + Send>(
        &self,
        range: Range<usize>,
        take: impl FnMut(usize, Result<Episode, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        match &self.content {
            Content::Pusht(reading) => reading.each(&self.demos, range, take),
            Content::Arm(layout, _) => self.arms(layout, range, take),
        }
    }

    fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        // The cameras of the description are those of the dataset, in the same order.
        let names = self.info.cameras.iter().zip(self.opened.dataset.cameras());
        let feature = names.into_iter().find(|(name, _)| *name == camera);
        self.opened
            .images(feature.map_or(camera, |(_, feature)| feature), of, take)
    }

    fn warnings(&self, tally: &Tally) -> Result<Vec<Warning>, IngestError> {
        let left_out = tally.left_out_warning(self.demos.len());
        let warnings: &[Warning] = match &self.content {
            Content::Pusht(reading) => &reading.warnings,
            Content::Arm(..) => &[],
        };
        Ok(warnings
            .iter()
            .cloned()
            .chain(self.no_images())
            .chain(self.opened.notes())
            .chain(left_out)
            .collect())
    }

    fn unchanged(&self) -> Result<(), IngestError> {
        self.files.unchanged(&self.path)
    }
}

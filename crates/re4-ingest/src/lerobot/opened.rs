//! An opened dataset: its demonstrations by name, its errors as those of this crate.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::mpsc::sync_channel;

use re4_episode::episode_name;
use re4_fault::Remedy as _;
use re4_lerobot::{Cameras, Coding, Dataset, Faults, Info as LerobotInfo, LerobotError};
use serde_json::{Value, json};

use super::files::LerobotFiles;
use crate::demos::{DemoName, ImageBlock, Info};
use crate::error::{Fault, IngestError};
use crate::name::SourceName;
use crate::selection::Selection;
use crate::source::Stop;
use crate::tables::LeftOut;
use crate::warning::{Warning, WarningCode};

/// Blocks of images that are decoded before they are taken; each has at most 8 MiB.
const AHEAD: usize = 2;

/// A dataset with the cameras whose images will be read.
pub struct LerobotDataset {
    pub(super) dataset: Dataset,
    /// All demonstrations.
    names: Vec<DemoName>,
}

impl LerobotDataset {
    /// Whether a folder looks like a LeRobot dataset.
    pub fn probe(path: &Path) -> bool {
        Dataset::probe(path)
    }

    /// The description of a dataset, from `meta/info.json` alone.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(crate) fn described(path: &Path) -> Result<LerobotInfo, IngestError> {
        Dataset::info_of(path).map_err(error_of)
    }

    /// Opens a dataset and compares all its counts.
    ///
    /// # Errors
    /// All faults that were found, in one error.
    pub fn open(path: &Path, cameras: &Cameras, stop: Stop<'_>) -> Result<Self, IngestError> {
        let dataset = Dataset::open(path, cameras, stop).map_err(error_of)?;
        let splits = &dataset.info().splits;
        let name = |episode: &re4_lerobot::Episode| {
            let number = u32::try_from(episode.index).ok();
            let lists = |split: &&(String, std::ops::Range<u64>)| split.1.contains(&(episode.index as u64));
            let mut filter_keys: Vec<String> = splits.iter().filter(lists).map(|split| split.0.clone()).collect();
            filter_keys.sort();
            DemoName {
                name: number.map_or_else(|| format!("episode {}", episode.index), episode_name),
                number,
                filter_keys,
            }
        };
        let names = dataset.episodes().iter().map(name).collect();
        Ok(Self { dataset, names })
    }

    /// BLAKE3 hash of the files that are read, and their identities.
    ///
    /// # Errors
    /// A file cannot be read or changed, or `stop` returned true.
    pub fn hash(&self, path: &Path, stop: Stop<'_>) -> Result<(LerobotFiles, [u8; 32]), IngestError> {
        LerobotFiles::hash(path, &self.dataset, stop)
    }

    /// Indices of the selected episodes among those that a split lists.
    pub(super) fn select(&self, select: &Selection, split: Option<&str>) -> Result<Vec<usize>, Fault> {
        let splits = &self.dataset.info().splits;
        if let Some(split) = split
            && !splits.iter().any(|(name, _)| name == split)
        {
            let names: Vec<&str> = splits.iter().map(|(name, _)| name.as_str()).collect();
            return Err(Fault::Lerobot(format!(
                "meta/info.json, key splits: there is no split {split}; set ingest.filter to one of the splits ({}), or remove it",
                if names.is_empty() {
                    "none".to_owned()
                } else {
                    names.join(", ")
                }
            )));
        }
        let sources: Vec<SourceName> = self.names.iter().map(|name| SourceName::new(&name.name)).collect();
        let listed = |place: usize| {
            split.is_none_or(|split| {
                self.names
                    .get(place)
                    .is_some_and(|name| name.filter_keys.iter().any(|key| key == split))
            })
        };
        Ok(select.resolve_among(&sources, &listed)?)
    }

    /// The demonstrations of episodes.
    pub(super) fn names(&self, episodes: &[usize]) -> Vec<DemoName> {
        episodes
            .iter()
            .filter_map(|&number| self.names.get(number).cloned())
            .collect()
    }

    /// Describes the contents. `camera` gives the name of a camera in the table of images.
    pub(super) fn info(&self, first: usize, camera: impl Fn(&str) -> String) -> Result<Info, IngestError> {
        let info = self.dataset.info();
        let mut details = serde_json::Map::new();
        if let Some(robot) = &info.robot_type {
            details.insert("robot".to_owned(), json!(robot));
        }
        details.insert(
            "tasks".to_owned(),
            json!(self.dataset.tasks().values().collect::<Vec<_>>()),
        );
        let codings = self
            .dataset
            .cameras()
            .iter()
            .map(|name| {
                Ok((
                    camera(name),
                    described(name, self.dataset.coding(name, first).map_err(error_of)?),
                ))
            })
            .collect::<Result<serde_json::Map<_, _>, IngestError>>()?;
        if !codings.is_empty() {
            details.insert("image_coding".to_owned(), Value::Object(codings));
        }
        let version = match info.version {
            re4_lerobot::Version::V2 => "v2",
            re4_lerobot::Version::V3 => "v3",
        };
        let stated = info.stated_version.as_str();
        Ok(Info {
            format: format!("LeRobot {}", if stated.starts_with(version) { stated } else { version }),
            rate: Some(info.fps),
            cameras: self.dataset.cameras().iter().map(|name| camera(name)).collect(),
            features: info.features.iter().map(|feature| feature.name.clone()).collect(),
            object_poses: false,
            demonstrations: self.names.len(),
            filter_keys: info.splits.iter().map(|(name, _)| name.clone()).collect(),
            details,
        })
    }

    /// Reads the numbers of episodes, in order, and passes them or the reason why they cannot be read to `take`.
    pub(super) fn read<E: From<IngestError>>(
        &self,
        episodes: &[usize],
        mut take: impl FnMut(Result<re4_lerobot::Frames, String>) -> Result<(), E>,
    ) -> Result<(), E> {
        let read = self.dataset.read(episodes.iter().copied(), &|| false, |_, frames| {
            take(frames.map_err(|faults| sentence(&faults))).map_err(Halt::Taken)
        });
        read.map_err(Halt::into_error)
    }

    /// Reads the images of a camera; see [`crate::DemoSource::images`].
    pub(super) fn images<E: From<IngestError>>(
        &self,
        camera: &str,
        of: &[(DemoName, usize)],
        mut take: impl FnMut(Result<ImageBlock, LeftOut>) -> Result<(), E>,
    ) -> Result<(), E> {
        let places: BTreeMap<&str, usize> = (0..)
            .zip(of)
            .map(|(place, (name, _))| (name.name.as_str(), place))
            .collect();
        let place = |number: usize| {
            self.names
                .get(number)
                .and_then(|name| places.get(name.name.as_str()))
                .copied()
        };
        let episodes: Vec<usize> = (0..self.names.len())
            .filter(|&number| place(number).is_some())
            .collect();
        let wanted = |number: usize| place(number).unwrap_or_default();
        let convert = |block: Result<re4_lerobot::ImageBlock, (usize, Faults)>| match block {
            Err((episode, faults)) => Err(LeftOut {
                demo: of
                    .get(wanted(episode))
                    .map(|(name, _)| name.name.clone())
                    .unwrap_or_default(),
                why: sentence(&faults),
            }),
            Ok(block) => {
                let demo = wanted(block.episode) as u32;
                let frames = block.first..block.first + block.count;
                Ok(ImageBlock {
                    places: frames.map(|frame| (demo, frame as u32)).collect(),
                    height: block.height,
                    width: block.width,
                    bytes: block.bytes,
                })
            }
        };
        // The next block is decoded while the caller encodes this one.
        std::thread::scope(|scope| {
            let (sender, blocks) = sync_channel(AHEAD);
            let numbers = episodes.iter().copied();
            let decoding = scope.spawn(move || {
                self.dataset.images(camera, numbers, &|| false, |block| {
                    sender.send(block).map_err(|_| Halt::Taken(()))
                })
            });
            for block in blocks {
                take(convert(block))?;
            }
            match decoding.join() {
                Ok(Err(Halt::Dataset(error))) => Err(error_of(error).into()),
                Ok(_) => Ok(()),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        })
    }

    /// Warnings about statements that are wrong but not used.
    pub(super) fn notes(&self) -> impl Iterator<Item = Warning> {
        let notes = self.dataset.notes().iter();
        notes.map(|note| Warning::new(WarningCode::Metadata, note.clone(), 1))
    }
}

/// How images are stored, for the description of the source.
fn described(name: &str, coding: Coding) -> Value {
    let mut value = json!({ "feature": name, "codec": coding.name(), "lossy": coding.is_lossy() });
    if let (Coding::Video { color, .. }, Some(value)) = (coding, value.as_object_mut()) {
        value.insert("rgb".to_owned(), json!(color.to_string()));
    }
    value
}

/// An error of the dataset, or one of the caller.
enum Halt<E> {
    Dataset(LerobotError),
    Taken(E),
}

impl<E: From<IngestError>> Halt<E> {
    fn into_error(self) -> E {
        match self {
            Self::Dataset(error) => error_of(error).into(),
            Self::Taken(error) => error,
        }
    }
}

impl<E> From<LerobotError> for Halt<E> {
    fn from(error: LerobotError) -> Self {
        Self::Dataset(error)
    }
}

/// The faults of an episode as one sentence.
pub(crate) fn sentence(faults: &Faults) -> String {
    let more = match faults.count() {
        0 | 1 => String::new(),
        more => format!(" (and {} more)", more - 1),
    };
    faults.iter().next().map_or_else(String::new, |first| {
        let fix = first.remedy().unwrap_or_default();
        format!("{first}{more}; {fix}")
    })
}

/// All faults of a dataset.
pub(crate) fn fault_of(faults: &Faults) -> Fault {
    if faults.stopped() {
        return Fault::Stopped;
    }
    if faults.count() < 2 {
        return Fault::Lerobot(sentence(faults));
    }
    let list: Vec<String> = faults.iter().map(re4_fault::Remedy::sentence).collect();
    Fault::Several {
        more: faults.count() - list.len(),
        list,
    }
}

/// The error of this crate.
#[expect(clippy::needless_pass_by_value, reason = "a conversion for map_err")]
pub(crate) fn error_of(error: LerobotError) -> IngestError {
    fault_of(&error.faults).of(&error.dataset)
}

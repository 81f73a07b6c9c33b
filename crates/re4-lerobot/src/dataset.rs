//! An opened dataset.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use crate::fault::{Fault, Faults, Kind, LerobotError};
use crate::info::{self, Content, INFO, Info, Version};
use crate::layout::{self, Files, Layout};
use crate::meta::{self, EPISODES_V2, EPISODES_V3, Stated, TASKS_V2, TASKS_V3};
use crate::video::{Stop, Video};

/// The cameras whose images will be read. Files of other cameras need not exist.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cameras {
    /// All, except depth cameras.
    All,
    /// These features.
    Named(Vec<String>),
}

impl Cameras {
    /// No camera.
    pub fn none() -> Self {
        Self::Named(Vec::new())
    }
}

/// An episode and its place in the files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Episode {
    /// Its number, from 0.
    pub index: usize,
    /// Number of frames.
    pub length: usize,
    /// Its first row, counted over the whole dataset.
    pub start: usize,
    /// Its tasks in words.
    pub tasks: Vec<String>,
    /// File of its rows, and the first of them in that file.
    pub(crate) data: (u32, usize),
    /// For each camera with videos: the file, and the first frame in that file.
    pub(crate) videos: BTreeMap<String, (u32, usize)>,
}

/// Size, time of modification and inode of a file.
type Identity = (u64, i64, i64, u64);

/// A dataset whose metadata, tables and videos agree. Rows and frames are read on request.
pub struct Dataset {
    pub(crate) root: PathBuf,
    pub(crate) info: Info,
    pub(crate) tasks: BTreeMap<u64, String>,
    pub(crate) episodes: Vec<Episode>,
    pub(crate) data: Files,
    pub(crate) videos: BTreeMap<String, Files>,
    cameras: Vec<String>,
    notes: Vec<String>,
    identities: Vec<(String, Identity)>,
}

impl Dataset {
    /// Whether a folder looks like a LeRobot dataset.
    pub fn probe(path: &Path) -> bool {
        path.join(INFO).is_file()
    }

    /// Reads only `meta/info.json`.
    ///
    /// # Errors
    /// It is not a LeRobot dataset, or the file has faults.
    pub fn info_of(path: &Path) -> Result<Info, LerobotError> {
        let read = || {
            let map = meta::object(path, INFO)?;
            let version = version(path, info::stated_major(&map)?)?;
            info::parse(&map, version)
        };
        read().map_err(|faults: Faults| LerobotError {
            dataset: path.to_owned(),
            faults,
        })
    }

    /// Opens a dataset and checks its metadata, the columns and row counts of its tables, and the frame counts and times of the videos
    /// of the cameras.
    ///
    /// # Errors
    /// All faults that were found.
    pub fn open(path: &Path, cameras: &Cameras, stop: Stop<'_>) -> Result<Self, LerobotError> {
        Self::open_checked(path, cameras, stop).map_err(|faults| LerobotError {
            dataset: path.to_owned(),
            faults,
        })
    }

    fn open_checked(root: &Path, cameras: &Cameras, stop: Stop<'_>) -> Result<Self, Faults> {
        if !Self::probe(root) {
            let what = match root.is_dir() {
                true => "it is not a LeRobot dataset (there is no meta/info.json in it)",
                false if root.exists() => "it is not a folder",
                false => "there is no such folder",
            };
            let fix = "give the folder that contains meta/ and data/";
            return Err(Fault::of_file(Kind::Format, "", what, fix).into());
        }
        let map = meta::object(root, INFO)?;
        let stated_major = info::stated_major(&map)?;
        let version = version(root, stated_major)?;
        let mut faults = Faults::default();
        let tasks = meta::tasks(root, version);
        let tasks = tasks.map_err(|found| faults.extend(found)).unwrap_or_default();
        let info = match info::parse(&map, version) {
            Ok(info) => info,
            Err(found) => {
                faults.extend(found);
                return Err(faults);
            }
        };
        let stated = meta::episodes(root, &info);
        let stated = stated.map_err(|found| faults.extend(found)).unwrap_or_default();
        if !faults.is_empty() {
            return Err(faults);
        }
        let (cameras, mut notes) = chosen(&info, cameras, &mut faults);
        totals(&info, &stated, &tasks, &mut faults);
        let Layout { episodes, data, videos } = match layout::place(root, &info, &stated, &cameras, stop) {
            Ok(layout) => layout,
            Err(found) => {
                faults.extend(found);
                return Err(faults);
            }
        };
        if !faults.is_empty() {
            return Err(faults);
        }
        note(&info, stated_major, episodes.len(), &mut notes);
        let mut dataset = Self {
            root: root.to_owned(),
            info,
            tasks,
            episodes,
            data,
            videos,
            cameras,
            notes,
            identities: Vec::new(),
        };
        for name in dataset.files()? {
            let identity = identity(root, &name)?;
            dataset.identities.push((name, identity));
        }
        Ok(dataset)
    }

    /// Its folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The contents of `meta/info.json`.
    pub fn info(&self) -> &Info {
        &self.info
    }

    /// The episodes, in order.
    pub fn episodes(&self) -> &[Episode] {
        &self.episodes
    }

    /// The tasks in words, by their index.
    pub fn tasks(&self) -> &BTreeMap<u64, String> {
        &self.tasks
    }

    /// Number of frames of all episodes.
    pub fn frames(&self) -> usize {
        self.episodes.iter().map(|episode| episode.length).sum()
    }

    /// The cameras whose images can be read, in alphabetical order.
    pub fn cameras(&self) -> &[String] {
        &self.cameras
    }

    /// What deviates from the format without making the data ambiguous, one sentence each.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Names of all files that are read, relative to the dataset, in alphabetical order.
    ///
    /// # Errors
    /// A folder cannot be listed.
    pub fn files(&self) -> Result<Vec<String>, Fault> {
        let mut names = vec![INFO.to_owned()];
        match self.info.version {
            Version::V2 => names.extend([TASKS_V2.to_owned(), EPISODES_V2.to_owned()]),
            Version::V3 => {
                names.push(TASKS_V3.to_owned());
                names.extend(crate::files::below(&self.root, EPISODES_V3, "parquet")?);
            }
        }
        names.extend(self.data.names.iter().cloned());
        names.extend(self.videos.values().flat_map(|files| files.names.iter().cloned()));
        names.sort();
        Ok(names)
    }

    /// Checks that no file has changed since the dataset was opened.
    ///
    /// # Errors
    /// Names the first file that changed.
    pub fn unchanged(&self) -> Result<(), LerobotError> {
        for (name, before) in &self.identities {
            let now = identity(&self.root, name).map_err(|fault| self.error(fault))?;
            if now != *before {
                let fix = "wait until the program that writes it has finished, then run again";
                return Err(self.error(Fault::of_file(Kind::Io, name, "it changed while it was read", fix)));
            }
        }
        Ok(())
    }

    /// Opens the video of an episode. Also returns the frame of the file that is the first of the episode.
    ///
    /// # Errors
    /// There is no such video, or its file cannot be read.
    pub fn video(&self, camera: &str, episode: usize) -> Result<(Video, usize), LerobotError> {
        let place = self
            .episodes
            .get(episode)
            .and_then(|episode| episode.videos.get(camera));
        let file = place.and_then(|(file, _)| self.videos.get(camera)?.names.get(*file as usize));
        let (Some(name), Some(&(_, first))) = (file, place) else {
            let what = format!("there is no video of {camera} for episode {episode}");
            return Err(self.error(Fault::of_file(Kind::Missing, "", what, "name a camera that has videos")));
        };
        let video = Video::open(&self.root.join(name), name).map_err(|fault| self.error(fault))?;
        Ok((video, first))
    }

    pub(crate) fn error(&self, faults: impl Into<Faults>) -> LerobotError {
        LerobotError {
            dataset: self.root.clone(),
            faults: faults.into(),
        }
    }
}

fn identity(root: &Path, name: &str) -> Result<Identity, Fault> {
    let about = std::fs::metadata(root.join(name)).map_err(|error| Fault::io(name, "opened", &error))?;
    Ok((about.len(), about.mtime(), about.mtime_nsec(), about.ino()))
}

/// The version by the files; by the statement only if both or none are there.
fn version(root: &Path, stated: Option<u32>) -> Result<Version, Fault> {
    match (
        root.join(EPISODES_V2).is_file(),
        root.join(EPISODES_V3).is_dir(),
        stated,
    ) {
        (true, false, _) | (true, true, Some(2)) => Ok(Version::V2),
        (false, true, _) | (true, true, Some(3)) => Ok(Version::V3),
        (true, true, _) => {
            let what = "both meta/episodes.jsonl (v2) and meta/episodes/ (v3) exist, and the version is not stated";
            Err(Fault::key(
                Kind::Format,
                INFO,
                "codebase_version",
                what,
                "write v2.1 or v3.0",
            ))
        }
        (false, false, _) => {
            let v2 = stated == Some(2);
            let name = if v2 {
                EPISODES_V2
            } else {
                "meta/episodes/chunk-000/file-000.parquet"
            };
            Err(Fault::of_file(
                Kind::MissingFile,
                name,
                "it is missing",
                "restore it, or download the dataset again",
            ))
        }
    }
}

/// The cameras to read, and notes about those that are skipped.
fn chosen(info: &Info, cameras: &Cameras, faults: &mut Faults) -> (Vec<String>, Vec<String>) {
    let has_images = |content| matches!(content, Content::Images | Content::Video);
    let all = || info.features.iter().filter(|feature| has_images(feature.content));
    let mut notes = Vec::new();
    let mut names: Vec<String> = match cameras {
        Cameras::All => {
            let skipped = all().filter(|feature| feature.depth);
            notes.extend(skipped.map(|feature| format!("{} is a depth camera and is not read", feature.name)));
            all()
                .filter(|feature| !feature.depth)
                .map(|feature| feature.name.clone())
                .collect()
        }
        Cameras::Named(names) => names.clone(),
    };
    names.sort();
    names.dedup();
    for name in &names {
        let key = format!("features.{name}");
        match info.feature(name) {
            Some(feature) if has_images(feature.content) && !feature.depth => {}
            Some(feature) if feature.depth => {
                let fix = "choose another camera";
                faults.push(Fault::key(
                    Kind::Unsupported,
                    INFO,
                    &key,
                    "depth images cannot be read",
                    fix,
                ));
            }
            _ => {
                let there: Vec<&str> = all().map(|feature| feature.name.as_str()).collect();
                let there = if there.is_empty() {
                    "none".to_owned()
                } else {
                    there.join(", ")
                };
                let fix = format!("choose one of the cameras ({there})");
                faults.push(Fault::key(
                    Kind::Missing,
                    INFO,
                    &key,
                    "there is no camera of this name",
                    fix,
                ));
            }
        }
    }
    (names, notes)
}

/// Compares the totals with what there is.
fn totals(info: &Info, stated: &[Stated], tasks: &BTreeMap<u64, String>, faults: &mut Faults) {
    let frames = stated
        .iter()
        .fold(0_u64, |sum, episode| sum.saturating_add(episode.length));
    let (episodes_file, tasks_file) = match info.version {
        Version::V2 => (EPISODES_V2, TASKS_V2),
        Version::V3 => (EPISODES_V3, TASKS_V3),
    };
    let counts = [
        (
            "total_episodes",
            info.total_episodes,
            stated.len() as u64,
            "episodes",
            episodes_file,
        ),
        ("total_frames", info.total_frames, frames, "frames", episodes_file),
        ("total_tasks", info.total_tasks, tasks.len() as u64, "tasks", tasks_file),
    ];
    for (key, total, count, of, file) in counts {
        if let Some(total) = total
            && total != count
        {
            let what = format!("it is {total}, but {file} lists {count} {of}");
            faults.push(Fault::key(
                Kind::Count,
                INFO,
                key,
                what,
                "correct it, or restore the missing files",
            ));
        }
    }
    for episode in stated.iter().filter(|episode| episode.length == 0) {
        let what = format!("row {}: episode {} has no frames", episode.row, episode.index);
        faults.push(Fault::column(
            Kind::Count,
            &episode.file,
            "length",
            what,
            "remove the episode",
        ));
    }
}

/// Notes about statements that are wrong but not used.
fn note(info: &Info, stated: Option<u32>, episodes: usize, notes: &mut Vec<String>) {
    let (major, format) = match info.version {
        Version::V2 => (2, "v2"),
        Version::V3 => (3, "v3"),
    };
    if stated != Some(major) {
        let stated = if stated.is_none() {
            "no version"
        } else {
            &info.stated_version
        };
        notes.push(format!("{INFO} states {stated}, but the files are those of {format}"));
    }
    for (name, range) in info.splits.iter().filter(|(_, range)| range.end > episodes as u64) {
        notes.push(format!(
            "split {name} ends at episode {}, but there are {episodes} episodes",
            range.end
        ));
    }
}

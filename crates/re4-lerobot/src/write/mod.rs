//! Writer of LeRobot datasets, v3.0 and v2.1.
//!
//! [`Writer::create`] takes the declaration of the features, [`Writer::add`] one episode after the other, and [`Writer::finish`] opens
//! the written dataset with the reader of this crate, which checks all counts, adds the statistics over all episodes, and only then
//! gives the dataset its name. Equal input gives equal bytes. One episode is in memory at a time.
//!
//! Images are written as the given PNG bytes in the tables of data, or encoded as H.264 videos.

mod error;
mod folder;
mod meta;
mod stats;
mod tables;
mod video;

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Map, Value};

pub use self::error::WriteError;
use self::folder::Staging;
use self::meta::{Episodes, Row};
use self::stats::{Levels, Moments, Stats, Total};
use self::tables::DataFiles;
use self::video::Videos;
use crate::dataset::{Cameras, Dataset};
use crate::info::{BOOKKEEPING, Version};
use crate::video::Stop;

/// What the episodes of a dataset have in common.
#[derive(Debug, Clone)]
pub struct Declaration {
    /// The version of the format.
    pub version: Version,
    /// Frames per second.
    pub fps: usize,
    /// Name of the robot.
    pub robot: String,
    /// The features, in the order of the columns.
    pub features: Vec<Declared>,
    /// Columns of the table of episodes besides those of the format, such as `re4/seed`.
    pub columns: Vec<String>,
    /// Contents of the key `re4` of `meta/info.json`.
    pub about: Map<String, Value>,
    /// When the next file begins.
    pub limits: Limits,
}

/// Sizes at which the next file of a dataset begins. They are also stated in `meta/info.json`.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Size of a table of data, in bytes. A file contains whole episodes and is therefore somewhat larger.
    pub data_bytes: u64,
    /// Size of a video, in bytes. A video is also shorter than 1024 s.
    pub video_bytes: u64,
    /// Files (v3.0) or episodes (v2.1) of a folder.
    pub chunk: usize,
}

impl Default for Limits {
    /// The sizes of the official writer.
    fn default() -> Self {
        Self {
            data_bytes: 100 << 20,
            video_bytes: 200 << 20,
            chunk: 1000,
        }
    }
}

/// A feature to write.
#[derive(Debug, Clone, PartialEq)]
pub struct Declared {
    /// Its name, such as `observation.state`.
    pub name: String,
    /// What it contains.
    pub kind: FeatureKind,
}

/// What a feature contains.
#[derive(Debug, Clone, PartialEq)]
pub enum FeatureKind {
    /// One number per frame.
    Scalar(Number),
    /// Several numbers per frame, with their names.
    Vector(Number, Vec<String>),
    /// PNG images with this width and height, pixels.
    Image(usize, usize),
    /// PNG images with this width and height, which are encoded as a video. Both are even.
    Video(usize, usize),
}

impl FeatureKind {
    /// Number of values of a frame; 1 for images and videos.
    fn width(&self) -> usize {
        match self {
            Self::Vector(_, names) => names.len(),
            Self::Scalar(_) | Self::Image(..) | Self::Video(..) => 1,
        }
    }
}

/// Types of numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Number {
    /// 32-bit floats.
    Single,
    /// 64-bit floats.
    Double,
    /// 64-bit integers.
    Integer,
    /// True or false.
    Truth,
}

/// The values of a feature in one episode, frame by frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Data {
    /// 32-bit floats.
    Single(Vec<f32>),
    /// 64-bit floats.
    Double(Vec<f64>),
    /// 64-bit integers.
    Integer(Vec<i64>),
    /// True or false.
    Truth(Vec<bool>),
    /// PNG files, 8 bits per channel, RGB.
    Images(Vec<Vec<u8>>),
}

impl Data {
    fn len(&self) -> usize {
        match self {
            Self::Single(values) => values.len(),
            Self::Double(values) => values.len(),
            Self::Integer(values) => values.len(),
            Self::Truth(values) => values.len(),
            Self::Images(values) => values.len(),
        }
    }

    fn number(&self) -> Option<Number> {
        match self {
            Self::Single(_) => Some(Number::Single),
            Self::Double(_) => Some(Number::Double),
            Self::Integer(_) => Some(Number::Integer),
            Self::Truth(_) => Some(Number::Truth),
            Self::Images(_) => None,
        }
    }

    /// The first value that is not finite.
    fn not_finite(&self) -> Option<usize> {
        match self {
            Self::Single(values) => values.iter().position(|value| !value.is_finite()),
            Self::Double(values) => values.iter().position(|value| !value.is_finite()),
            _ => None,
        }
    }
}

/// A value of a column of the table of episodes. A column has one type.
#[derive(Debug, Clone, PartialEq)]
pub enum EpisodeValue {
    /// Text.
    Text(String),
    /// A whole number.
    Integer(i64),
    /// A number.
    Double(f64),
    /// True or false.
    Truth(bool),
}

/// An episode to write.
#[derive(Debug, Clone, PartialEq)]
pub struct NewEpisode {
    /// The task in words.
    pub task: String,
    /// The features in the order of the declaration.
    pub data: Vec<Data>,
    /// The values of the declaration's columns, in their order.
    pub values: Vec<EpisodeValue>,
}

/// A dataset that has been written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// Number of episodes.
    pub episodes: usize,
    /// Number of frames.
    pub frames: usize,
    /// Size of all files, in bytes.
    pub bytes: u64,
}

/// Writes a dataset. If it is dropped before [`Writer::finish`], nothing remains.
pub struct Writer {
    declared: Declaration,
    staging: Staging,
    data: DataFiles,
    videos: Videos,
    episodes: Episodes,
    tasks: Vec<String>,
    totals: Vec<Option<Total>>,
    frames: usize,
}

impl Writer {
    /// Starts a dataset. Its files are written to a temporary folder beside `path`.
    ///
    /// # Errors
    /// The path exists and is not an empty folder, its parent folder does not exist or cannot be written to, or the name of a feature
    /// cannot be used.
    pub fn create(path: &Path, declared: Declaration) -> Result<Self, WriteError> {
        let mut names: BTreeSet<&str> = BOOKKEEPING.into();
        for feature in &declared.features {
            let odd = matches!(feature.kind, FeatureKind::Video(width, height) if width % 2 + height % 2 > 0);
            let what = if feature.name.is_empty() || feature.name.contains('/') {
                "its name is empty or contains a slash"
            } else if odd {
                "a video needs an even width and height"
            } else if names.insert(&feature.name) {
                continue;
            } else {
                "there is another feature of this name"
            };
            return Err(WriteError::Feature {
                path: path.to_owned(),
                feature: feature.name.clone(),
                what,
            });
        }
        let staging = Staging::create(path)?;
        Ok(Self {
            data: DataFiles::new(&declared),
            videos: Videos::new(&declared),
            episodes: Episodes::new(&declared),
            totals: vec![None; declared.features.len() + BOOKKEEPING.len()],
            declared,
            staging,
            tasks: Vec::new(),
            frames: 0,
        })
    }

    /// Appends an episode.
    ///
    /// # Errors
    /// A feature has another type or number of values than declared, or a value that is not finite; an image is damaged or has another
    /// size; a file cannot be written.
    pub fn add(&mut self, episode: &NewEpisode) -> Result<(), WriteError> {
        let length = self.check(episode)?;
        let index = self.episodes.count();
        let known = self.tasks.iter().position(|task| *task == episode.task);
        let task = known.unwrap_or(self.tasks.len());
        if known.is_none() {
            self.tasks.push(episode.task.clone());
        }
        let bookkeeping = self.bookkeeping(index, length, task);
        let stats = self.stats(index, episode, &bookkeeping)?;
        let place = self.data.add(&self.staging, index, episode, &bookkeeping)?;
        let videos = self.videos.add(&self.staging, index, episode)?;
        let row = Row {
            index,
            task: episode.task.clone(),
            length,
            data: place,
            videos,
            from: self.frames,
            values: episode.values.clone(),
            stats,
        };
        self.episodes.add(&self.staging, row)?;
        self.frames += length;
        Ok(())
    }

    /// Completes the dataset and gives it its name.
    ///
    /// # Errors
    /// There is no episode, a file cannot be written, or the reader refuses the dataset.
    pub fn finish(mut self, stop: Stop<'_>) -> Result<Written, WriteError> {
        let count = self.episodes.count();
        if count == 0 {
            return Err(WriteError::Empty {
                path: self.staging.path().to_owned(),
            });
        }
        self.data.close(&self.staging)?;
        self.videos.close(&self.staging)?;
        self.episodes.close(&self.staging)?;
        meta::tasks(&self.staging, self.declared.version, &self.tasks)?;
        let info = meta::info(
            &self.declared,
            [count, self.frames, self.tasks.len(), self.videos.files()],
        );
        self.staging.write_json("meta/info.json", &info)?;
        self.verify(stop)?;
        let bytes = self.staging.publish()?;
        Ok(Written {
            episodes: count,
            frames: self.frames,
            bytes,
        })
    }

    /// The columns that every dataset has, in the order of [`BOOKKEEPING`].
    fn bookkeeping(&self, index: usize, length: usize, task: usize) -> [Data; 5] {
        // As the official writer: the quotient in double precision, then rounded.
        let time = |frame: usize| (frame as f64 / self.declared.fps as f64) as f32;
        [
            Data::Single((0..length).map(time).collect()),
            Data::Integer((0..length as i64).collect()),
            Data::Integer(vec![index as i64; length]),
            Data::Integer((self.frames as i64..(self.frames + length) as i64).collect()),
            Data::Integer(vec![task as i64; length]),
        ]
    }

    /// Checks an episode against the declaration; returns its number of frames.
    fn check(&self, episode: &NewEpisode) -> Result<usize, WriteError> {
        let refuse = |feature: &str, what: String, fix| WriteError::Value {
            path: self.staging.path().to_owned(),
            episode: self.episodes.count(),
            feature: feature.to_owned(),
            what,
            fix,
        };
        let mut length = None;
        let declared = &self.declared.features;
        if episode.data.len() != declared.len() || episode.values.len() != self.declared.columns.len() {
            let what = format!(
                "{} features are given, but {} are declared",
                episode.data.len(),
                declared.len()
            );
            return Err(refuse("all features", what, BUG));
        }
        for (Declared { name, kind }, data) in declared.iter().zip(&episode.data) {
            let number = match kind {
                FeatureKind::Scalar(number) | FeatureKind::Vector(number, _) => Some(*number),
                FeatureKind::Image(..) | FeatureKind::Video(..) => None,
            };
            if data.number() != number {
                return Err(refuse(
                    name,
                    "its values have another type than declared".to_owned(),
                    BUG,
                ));
            }
            let width = kind.width();
            let frames = data.len() / width.max(1);
            if frames * width != data.len() || frames == 0 || *length.get_or_insert(frames) != frames {
                let what = format!("it has {} values, which is no whole number of frames", data.len());
                return Err(refuse(name, what, BUG));
            }
            if let Some(at) = data.not_finite() {
                let what = format!("frame {} has a value that is not a finite number", at / width.max(1));
                return Err(refuse(name, what, "leave the episode out, or correct its source"));
            }
            if let (FeatureKind::Image(width, height) | FeatureKind::Video(width, height), Data::Images(images)) =
                (kind, data)
                && let Some((at, found)) = other_size(images, (*width, *height))
            {
                let what = match found {
                    Some((w, h)) => format!("the image of frame {at} has {w} x {h} pixels, not {width} x {height}"),
                    None => format!("the image of frame {at} is not a PNG file"),
                };
                return Err(refuse(
                    name,
                    what,
                    "export the cameras with one size, or correct the source",
                ));
            }
        }
        Ok(length.unwrap_or(0))
    }

    /// Statistics of an episode, by feature, then those of the columns that every dataset has.
    fn stats(&mut self, index: usize, episode: &NewEpisode, more: &[Data; 5]) -> Result<Vec<Stats>, WriteError> {
        let widths: Vec<usize> = self.declared.features.iter().map(|of| of.kind.width()).collect();
        let widths = widths.into_iter().chain(std::iter::repeat(1));
        let mut all = Vec::with_capacity(self.totals.len());
        for ((data, width), (at, total)) in episode
            .data
            .iter()
            .chain(more)
            .zip(widths)
            .zip(self.totals.iter_mut().enumerate())
        {
            if let Data::Images(images) = data {
                let levels = Levels::of(images).map_err(|(frame, why)| WriteError::Value {
                    path: self.staging.path().to_owned(),
                    episode: index,
                    feature: self
                        .declared
                        .features
                        .get(at)
                        .map_or_else(String::new, |of| of.name.clone()),
                    what: format!("the image of frame {frame} cannot be decoded: {why}"),
                    fix: "leave the episode out, or correct its source",
                })?;
                all.push(levels.stats());
                if let Total::Images(total) = total.get_or_insert_with(|| Total::Images(Levels::default())) {
                    total.merge(&levels);
                }
            } else if let Some(numbers) = stats::numbers(data) {
                let stats = stats::of_numbers(&numbers, width);
                if let Total::Numbers(total) = total.get_or_insert_with(|| Total::Numbers(Moments::default())) {
                    total.add(&stats);
                }
                all.push(stats);
            }
        }
        Ok(all)
    }

    /// Names of all features, in the order of the statistics.
    fn names(&self) -> impl Iterator<Item = &str> {
        names(&self.declared)
    }

    /// Opens the written files with the reader, reads all numbers and writes the statistics over all episodes. v2.1 does not require
    /// these statistics, but programs that read v2.0 use them.
    fn verify(&self, stop: Stop<'_>) -> Result<(), WriteError> {
        let refused = |error: crate::LerobotError| {
            let path = self.staging.path().to_owned();
            if error.faults.stopped() {
                return WriteError::Stopped { path };
            }
            WriteError::Unreadable {
                path,
                source: Box::new(error),
            }
        };
        let dataset = Dataset::open(self.staging.building(), &Cameras::All, stop).map_err(refused)?;
        let mut histograms: Vec<Vec<stats::Histogram>> = self
            .totals
            .iter()
            .map(|total| match total {
                Some(Total::Numbers(moments)) => moments.histograms(),
                _ => Vec::new(),
            })
            .collect();
        let all = 0..dataset.episodes().len();
        let mut before = 0_u64;
        dataset
            .read(all, stop, |episode, frames| {
                let frames = frames.map_err(|faults| dataset.error(faults))?;
                let length = episode.length;
                for (name, histograms) in self.names().zip(&mut histograms) {
                    let width = histograms.len();
                    if let Some(column) = frames.column(name) {
                        for at in 0..length * width {
                            let value = column.values.number(at).unwrap_or_default();
                            histograms[at % width].add(value);
                        }
                    } else if let [histogram] = histograms.as_mut_slice() {
                        let value = |row: usize| match name {
                            "timestamp" => frames.timestamps[row],
                            "frame_index" => row as f64,
                            "episode_index" => episode.index as f64,
                            "index" => (before + row as u64) as f64,
                            _ => frames.tasks[row] as f64,
                        };
                        (0..length).for_each(|row| histogram.add(value(row)));
                    }
                }
                before += length as u64;
                Ok(())
            })
            .map_err(refused)?;
        let mut object = Map::new();
        for ((name, total), histograms) in self.names().zip(&self.totals).zip(&histograms) {
            let stats = match total {
                Some(Total::Images(levels)) => levels.stats(),
                Some(Total::Numbers(moments)) => moments.stats(histograms),
                None => continue,
            };
            object.insert(name.to_owned(), stats.to_json());
        }
        self.staging.write_json("meta/stats.json", &Value::Object(object))
    }
}

const BUG: &str = "report this as a bug of re4-pipe";

/// Names of all features, then those that every dataset has.
fn names(declared: &Declaration) -> impl Iterator<Item = &str> {
    let own = declared.features.iter().map(|feature| feature.name.as_str());
    own.chain(BOOKKEEPING)
}

/// The first image of another size, or without a size.
fn other_size(images: &[Vec<u8>], size: (usize, usize)) -> Option<(usize, Option<(usize, usize)>)> {
    let sizes = images.iter().map(|png| png_size(png));
    sizes.enumerate().find(|(_, found)| *found != Some(size))
}

/// Width and height of a PNG file, from its header.
pub fn png_size(png: &[u8]) -> Option<(usize, usize)> {
    let header = png
        .get(..24)
        .filter(|header| header.starts_with(b"\x89PNG\r\n\x1a\n"))?;
    let number = |at: usize| Some(u32::from_be_bytes(header.get(at..at + 4)?.try_into().ok()?) as usize);
    Some((number(16)?, number(20)?))
}

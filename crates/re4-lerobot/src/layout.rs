//! Where the rows and the video frames of each episode are, checked against the files that exist.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use arrow_schema::DataType;

use crate::column::{Class, class, in_words};
use crate::dataset::Episode;
use crate::fault::{Fault, Faults, Kind};
use crate::files;
use crate::info::{BOOKKEEPING, Content, Info, Version};
use crate::meta::{Stated, video_column};
use crate::table::Table;
use crate::video::{Stop, Video};

/// Maximum difference between the time of a video frame and the time that the tables state, in seconds. The official loader has the
/// same tolerance.
pub(crate) const TOLERANCE: f64 = 1e-4;

/// The column that pandas adds for the index of a table. It has no meaning.
const PANDAS_INDEX: &str = "__index_level_0__";

const RESTORE: &str = "restore it, or download the dataset again";

/// Files with the rows or frames that lie in them.
#[derive(Debug, Default)]
pub(crate) struct Files {
    pub(crate) names: Vec<String>,
    /// The first episode of each file, and the number of all its rows or frames by the metadata.
    holds: Vec<(u64, usize)>,
    by_name: BTreeMap<String, u32>,
}

impl Files {
    /// Adds an episode at the end of a file. Returns the number of the file, and the row at which the episode begins.
    fn add(&mut self, name: String, episode: &Stated) -> (u32, usize) {
        let next = self.names.len() as u32;
        let file = *self.by_name.entry(name).or_insert_with_key(|name| {
            self.names.push(name.clone());
            self.holds.push((episode.index, 0));
            next
        });
        let rows = &mut self.holds[file as usize].1;
        let first = *rows;
        *rows = rows.saturating_add(episode.length as usize);
        (file, first)
    }

    /// A fault for each file of a folder that no episode is in.
    fn strays(&self, root: &Path, folder: &str, extension: &str, faults: &mut Faults) {
        let Some(found) = faults.keep(files::below(root, folder, extension)) else {
            return;
        };
        let named: BTreeSet<&str> = self.names.iter().map(String::as_str).collect();
        for stray in found.iter().filter(|name| !named.contains(name.as_str())) {
            let fix = "remove it, or restore the metadata of its episodes";
            faults.push(Fault::of_file(
                Kind::StrayFile,
                stray,
                "the metadata names no episode in this file",
                fix,
            ));
        }
    }
}

/// A missing file, with the statement that names it.
fn missing(fault: Fault, episode: u64, stated: &str) -> Fault {
    if fault.kind != Kind::MissingFile {
        return fault;
    }
    Fault {
        what: format!("it is missing, but {stated} places episode {episode} in it"),
        fix: RESTORE.to_owned(),
        ..fault
    }
}

/// Episodes with their places, and the files of data and of each camera.
pub(crate) struct Layout {
    pub(crate) episodes: Vec<Episode>,
    pub(crate) data: Files,
    pub(crate) videos: BTreeMap<String, Files>,
}

/// Places all episodes. `cameras` are the videos that will be read.
pub(crate) fn place(
    root: &Path,
    info: &Info,
    stated: &[Stated],
    cameras: &[String],
    stop: Stop<'_>,
) -> Result<Layout, Faults> {
    let mut faults = Faults::default();
    let mut episodes = Vec::with_capacity(stated.len());
    let mut start = 0_usize;
    for episode in stated {
        let length = usize::try_from(episode.length).unwrap_or(usize::MAX);
        rows_agree(episode, start, &mut faults);
        episodes.push(Episode {
            index: episode.index as usize,
            length,
            start,
            tasks: episode.tasks.clone(),
            data: (0, 0),
            videos: BTreeMap::new(),
        });
        start = start.saturating_add(length);
    }
    let data = data(root, info, stated, &mut episodes, stop, &mut faults);
    let mut videos = BTreeMap::new();
    for (number, feature) in info.with(Content::Video).enumerate() {
        if cameras.contains(&feature.name) {
            let files = video(
                root,
                info,
                stated,
                (number, &feature.name),
                &mut episodes,
                stop,
                &mut faults,
            );
            videos.insert(feature.name.clone(), files);
        }
    }
    if info
        .with(Content::Video)
        .all(|feature| videos.contains_key(&feature.name))
    {
        let all = Files {
            names: videos.values().flat_map(|files| files.names.iter().cloned()).collect(),
            ..Files::default()
        };
        all.strays(root, "videos", "mp4", &mut faults);
    }
    if stop() {
        return Err(Fault::stopped().into());
    }
    faults.or(Layout { episodes, data, videos })
}

/// Checks the rows over the whole dataset that an episode states.
fn rows_agree(episode: &Stated, start: usize, faults: &mut Faults) {
    let expected = [start as u64, (start as u64).saturating_add(episode.length)];
    let columns = ["dataset_from_index", "dataset_to_index"];
    for ((column, stated), expected) in columns.iter().zip(episode.rows).zip(expected) {
        if let Some(stated) = stated
            && stated != expected
        {
            let (row, index) = (episode.row, episode.index);
            let what = format!("row {row}: it is {stated} for episode {index}, but the lengths give {expected}");
            let fix = "correct the column, or the column length";
            faults.push(Fault::column(Kind::Count, &episode.file, column, what, fix));
        }
    }
}

/// Places the rows of all episodes and checks the files.
fn data(
    root: &Path,
    info: &Info,
    stated: &[Stated],
    episodes: &mut [Episode],
    stop: Stop<'_>,
    faults: &mut Faults,
) -> Files {
    let mut files = Files::default();
    let unplaced = info.version == Version::V3 && stated.iter().any(|episode| episode.data.is_none());
    if unplaced {
        faults.keep(in_order(root, stated, episodes, &mut files));
    } else {
        for (episode, placed) in stated.iter().zip(episodes) {
            let numbers = match (info.version, episode.data) {
                (Version::V3, Some([chunk, file])) => [("chunk_index", chunk), ("file_index", file)],
                _ => [
                    ("episode_chunk", episode.index / info.chunks_size.max(1)),
                    ("episode_index", episode.index),
                ],
            };
            placed.data = files.add(info.data_path.fill(&numbers, ""), episode);
        }
    }
    for (name, &(first, rows)) in files.names.iter().zip(&files.holds) {
        if stop() {
            return files;
        }
        let source = stated.get(first as usize).map_or("", |episode| episode.file.as_str());
        let Some(table) = faults.keep(Table::open(root, name).map_err(|fault| missing(fault, first, source))) else {
            continue;
        };
        if table.rows() != rows {
            let what = format!(
                "it has {} rows, but {source} states {rows} for its episodes, from {first} on",
                table.rows()
            );
            faults.push(Fault::of_file(
                Kind::Count,
                name,
                what,
                "correct the lengths of the episodes, or restore the file",
            ));
        }
        schema(&table, name, info, faults);
    }
    files.strays(root, "data", "parquet", faults);
    files
}

/// Places the rows of episodes that state no file: in the order of the names of the files, as the official loader does.
fn in_order(root: &Path, stated: &[Stated], episodes: &mut [Episode], files: &mut Files) -> Result<(), Fault> {
    let mut all = files::below(root, "data", "parquet")?.into_iter();
    let mut current: Option<(String, usize)> = None;
    for (episode, placed) in stated.iter().zip(episodes) {
        if current.as_ref().is_none_or(|(_, left)| *left == 0) {
            current = match all.next() {
                Some(name) => {
                    let rows = Table::open(root, &name)?.rows();
                    Some((name, rows))
                }
                None => None,
            };
        }
        let length = placed.length;
        match &mut current {
            Some((name, left)) if *left >= length => {
                placed.data = files.add(name.clone(), episode);
                *left -= length;
            }
            place => {
                let at = place.as_ref().map_or("data".to_owned(), |(name, _)| name.clone());
                let what = format!("it has no room for the {length} rows of episode {}", episode.index);
                let fix = "restore the columns data/chunk_index and data/file_index of the episodes, or the file";
                return Err(Fault::of_file(Kind::Count, &at, what, fix));
            }
        }
    }
    Ok(())
}

/// Checks the columns of a file of data.
fn schema(table: &Table, name: &str, info: &Info, faults: &mut Faults) {
    let mut seen = BTreeSet::new();
    for field in table.schema().fields() {
        let column = field.name().as_str();
        if !seen.insert(column) {
            faults.push(Fault::column(
                Kind::Value,
                name,
                column,
                "there are two columns of this name",
                "remove one",
            ));
        }
        let known = info.feature(column).is_some() || BOOKKEEPING.contains(&column) || column == PANDAS_INDEX;
        if !known {
            let fix = "declare it in the features of meta/info.json, or remove the column";
            faults.push(Fault::column(
                Kind::Undeclared,
                name,
                column,
                "it is not one of the features",
                fix,
            ));
        }
    }
    let mut type_of = |column: &str| {
        let found = table.schema().field_with_name(column).ok();
        if found.is_none() {
            let fix = "restore the column, or remove it from the features of meta/info.json";
            faults.push(Fault::column(Kind::Missing, name, column, "it is missing", fix));
        }
        found.map(|field| field.data_type().clone())
    };
    let mut wrong = Vec::new();
    let mut expect = |column: &str, data_type: &DataType, fits: bool, expected: &str| {
        if !fits {
            let what = format!("its type is {}, but {expected} expected", in_words(data_type));
            let fix = "convert the column, or correct the dtype in meta/info.json";
            wrong.push(Fault::column(Kind::Type, name, column, what, fix));
        }
    };
    let number = |data_type: &DataType| class(data_type).is_some_and(|class| class != Class::Text);
    for column in BOOKKEEPING {
        if let Some(data_type) = type_of(column) {
            expect(column, &data_type, number(&data_type), "numbers are");
        }
    }
    for feature in info
        .features
        .iter()
        .filter(|feature| !BOOKKEEPING.contains(&feature.name.as_str()))
    {
        let column = feature.name.as_str();
        if matches!(feature.content, Content::Video | Content::Annotations) {
            continue;
        }
        let Some(data_type) = type_of(column) else {
            continue;
        };
        match feature.content {
            Content::Images => expect(column, &data_type, crate::images::is_image(&data_type), "images are"),
            Content::Text => expect(column, &data_type, class(&data_type) == Some(Class::Text), "text is"),
            _ => expect(column, &data_type, number(&data_type), "numbers are"),
        }
    }
    for fault in wrong {
        faults.push(fault);
    }
}

/// Places the frames of all episodes in the videos of a camera and checks the files.
fn video(
    root: &Path,
    info: &Info,
    stated: &[Stated],
    (number, feature): (usize, &str),
    episodes: &mut [Episode],
    stop: Stop<'_>,
    faults: &mut Faults,
) -> Files {
    let mut files = Files::default();
    let mut inside: Vec<Vec<usize>> = Vec::new();
    for (at, (episode, placed)) in stated.iter().zip(episodes.iter_mut()).enumerate() {
        let numbers = match (info.version, episode.videos.get(number)) {
            (Version::V3, Some(([chunk, file], _))) => [("chunk_index", *chunk), ("file_index", *file)],
            _ => [
                ("episode_chunk", episode.index / info.chunks_size.max(1)),
                ("episode_index", episode.index),
            ],
        };
        let place = files.add(info.video_path.fill(&numbers, feature), episode);
        placed.videos.insert(feature.to_owned(), place);
        inside.resize(files.names.len(), Vec::new());
        inside[place.0 as usize].push(at);
    }
    let mut size = None;
    for (file, (name, &(first, frames))) in files.names.iter().zip(&files.holds).enumerate() {
        if stop() {
            return files;
        }
        let source = stated.get(first as usize).map_or("", |episode| episode.file.as_str());
        let video = Video::open(&root.join(name), name).map_err(|fault| missing(fault, first, source));
        let Some(video) = faults.keep(video) else {
            continue;
        };
        if video.frames() != frames {
            let what = format!(
                "it has {} frames, but {source} states {frames} for its episodes, from {first} on",
                video.frames()
            );
            faults.push(Fault::of_file(
                Kind::Count,
                name,
                what,
                "correct the lengths of the episodes, or restore the file",
            ));
            continue;
        }
        let (width, height) = *size.get_or_insert(video.size());
        if video.size() != (width, height) {
            let (w, h) = video.size();
            let what = format!(
                "its frames have {w} x {h} pixels, those of {} have {width} x {height}",
                files.names[0]
            );
            faults.push(Fault::of_file(
                Kind::Value,
                name,
                what,
                "encode all videos of a camera with one size",
            ));
        }
        for &at in &inside[file] {
            let times = stated[at].videos.get(number).map(|(_, times)| *times);
            let start = episodes[at].videos.get(feature).map_or(0, |place| place.1);
            let of = Span {
                video: &video,
                feature,
                fps: info.fps,
                start,
            };
            of.check(&stated[at], times.filter(|_| info.version == Version::V3), faults);
        }
    }
    files
}

/// The frames of an episode in a video.
struct Span<'a> {
    video: &'a Video,
    feature: &'a str,
    fps: f64,
    start: usize,
}

impl Span<'_> {
    /// Compares the times of the frames with those that the tables state.
    fn check(&self, episode: &Stated, times: Option<[f64; 2]>, faults: &mut Faults) {
        let length = episode.length as usize;
        if length == 0 {
            return;
        }
        let Some(first) = self.video.time(self.start) else {
            return;
        };
        let name = self.video.name();
        let [from, to] = times.unwrap_or([0.0, length as f64 / self.fps]);
        if (from - first).abs() > TOLERANCE {
            let index = episode.index;
            faults.push(match times {
                Some(_) => {
                    let row = episode.row;
                    let what = format!(
                        "row {row}: episode {index} begins at {from} s, but its first frame in {name} is at {first} s"
                    );
                    let fix = "correct the column, or the lengths of the episodes before";
                    Fault::column(
                        Kind::Value,
                        &episode.file,
                        &video_column(self.feature, "from_timestamp"),
                        what,
                        fix,
                    )
                }
                None => Fault::of_file(
                    Kind::Value,
                    name,
                    format!("its first frame is at {first} s, not 0"),
                    "encode it again",
                ),
            });
            return;
        }
        let span = length as f64 / self.fps;
        // The end lies between the last frame and the next one, so half a frame is the largest harmless difference.
        if (to - from - span).abs() > 0.5 / self.fps {
            let (row, index) = (episode.row, episode.index);
            let what = format!(
                "row {row}: episode {index} ends at {to} s, but {length} frames from {from} s end at {} s",
                from + span
            );
            let column = video_column(self.feature, "to_timestamp");
            faults.push(Fault::column(
                Kind::Value,
                &episode.file,
                &column,
                what,
                "correct the column, or the fps",
            ));
        }
        for frame in 0..length {
            let (Some(time), expected) = (self.video.time(self.start + frame), first + frame as f64 / self.fps) else {
                return;
            };
            if (time - expected).abs() > TOLERANCE {
                let what = format!(
                    "frame {} is at {time} s, but at {} frames per second frame {frame} of episode {} is at {expected} s",
                    self.start + frame,
                    self.fps,
                    episode.index
                );
                faults.push(Fault::of_file(
                    Kind::Value,
                    name,
                    what,
                    "correct fps in meta/info.json, or encode it again",
                ));
                return;
            }
        }
    }
}

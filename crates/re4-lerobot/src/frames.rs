//! The numbers of episodes, read one episode at a time and compared with the metadata.

use std::collections::BTreeSet;
use std::ops::Range;

use arrow_array::RecordBatch;

use crate::column::{Class, Column, Place, Values, append, class, width};
use crate::dataset::{Dataset, Episode};
use crate::fault::{Fault, Faults, Kind, LerobotError};
use crate::info::{BOOKKEEPING, Content};
use crate::layout::TOLERANCE;
use crate::table::{Blocks, Table};
use crate::video::Stop;

/// Values that are decoded at once: 8 MiB.
const VALUES: usize = 1 << 20;

/// Maximum number of rows that are decoded at once.
const ROWS: usize = 1024;

/// The numbers and texts of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames {
    /// The features with numbers or text, in the order of `meta/info.json`, without those that count and time the frames.
    pub columns: Vec<Column>,
    /// Seconds since the first frame, one per frame.
    pub timestamps: Vec<f64>,
    /// Index of the task of each frame.
    pub tasks: Vec<u64>,
}

impl Frames {
    /// The column of a feature.
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.name == name)
    }
}

/// An open file of data, at the row that comes next.
struct Cursor {
    file: u32,
    table: Table,
    blocks: Blocks,
}

impl Dataset {
    /// Reads episodes in the given order and passes each to `take`, or its faults. One episode is in memory at a time.
    ///
    /// # Errors
    /// An error that `take` returns, or a stop.
    pub fn read<E: From<LerobotError>>(
        &self,
        episodes: impl IntoIterator<Item = usize>,
        stop: Stop<'_>,
        mut take: impl FnMut(&Episode, Result<Frames, Faults>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut cursor = None;
        for number in episodes {
            if stop() {
                return Err(self.error(Fault::stopped()).into());
            }
            let Some(episode) = self.episodes.get(number) else {
                let what = format!(
                    "episode {number} is requested, but there are {} episodes",
                    self.episodes.len()
                );
                return Err(self
                    .error(Fault::of_file(Kind::Missing, "", what, "request a smaller number"))
                    .into());
            };
            let frames = self.frames_of(episode, &mut cursor);
            if frames.is_err() {
                // The reader may be in an inconsistent state after an error.
                cursor = None;
            }
            take(episode, frames)?;
        }
        Ok(())
    }

    /// Reads one episode.
    ///
    /// # Errors
    /// All faults of the episode.
    pub fn episode(&self, number: usize) -> Result<Frames, LerobotError> {
        let mut found = None;
        self.read([number], &|| false, |_, frames| {
            found = Some(frames.map_err(|faults| self.error(faults))?);
            Ok::<(), LerobotError>(())
        })?;
        found.ok_or_else(|| self.error(Fault::stopped()))
    }

    /// Columns that are read: those that count and time the frames, then the features.
    fn columns(&self) -> Vec<(&str, &[usize])> {
        let scalar: &[usize] = &[1];
        let features = self.info.features.iter().filter(|feature| {
            matches!(feature.content, Content::Numbers | Content::Text) && !BOOKKEEPING.contains(&feature.name.as_str())
        });
        let features = features.map(|feature| (feature.name.as_str(), feature.shape.as_slice()));
        BOOKKEEPING
            .into_iter()
            .map(|name| (name, scalar))
            .chain(features)
            .collect()
    }

    fn frames_of(&self, episode: &Episode, cursor: &mut Option<Cursor>) -> Result<Frames, Faults> {
        let columns = self.columns();
        let name = self.data.names.get(episode.data.0 as usize).map_or("", String::as_str);
        let rows = episode.data.1..episode.data.1 + episode.length;
        let here = |cursor: &Cursor| cursor.file == episode.data.0 && cursor.blocks.next() == rows.start;
        if !cursor.as_ref().is_some_and(here) {
            let table = match cursor.take() {
                Some(open) if open.file == episode.data.0 => open.table,
                _ => Table::open(&self.root, name)?,
            };
            let wide: usize = columns
                .iter()
                .fold(0, |sum: usize, (_, shape)| sum.saturating_add(width(shape)));
            let size = (VALUES / wide.max(1)).clamp(1, ROWS);
            let names: Vec<&str> = columns.iter().map(|(column, _)| *column).collect();
            let blocks = table.blocks(&names, rows.start, size)?;
            *cursor = Some(Cursor {
                file: episode.data.0,
                table,
                blocks,
            });
        }
        let Some(open) = cursor.as_mut() else {
            return Err(Fault::stopped().into());
        };
        let mut reading = Reading::of(&columns, &open.table, name);
        while open.blocks.next() < rows.end {
            let first = open.blocks.next();
            let block = open.blocks.take(rows.end - first)?;
            reading.add(&block, first);
        }
        let Reading { values, mut faults, .. } = reading;
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut values = values.into_iter();
        let [timestamp, frame, number, index, task] =
            [(); 5].map(|()| values.next().unwrap_or(Values::Float(Vec::new())));
        let place = |column: &'static str| Place {
            file: name,
            column,
            first: rows.start,
        };
        counts(&frame, 0, &place("frame_index"), episode, &mut faults);
        counts(&index, episode.start as u64, &place("index"), episode, &mut faults);
        same(&number, &place("episode_index"), episode, &mut faults);
        let timestamps = self.timestamps(&timestamp, &place("timestamp"), rows.len(), &mut faults);
        let tasks = self.tasks_of(&task, &place("task_index"), episode, &mut faults);
        let shaped = columns.iter().skip(BOOKKEEPING.len()).zip(values);
        faults.or(Frames {
            columns: shaped
                .map(|((name, shape), values)| Column {
                    name: (*name).to_owned(),
                    shape: shape.to_vec(),
                    values,
                })
                .collect(),
            timestamps,
            tasks,
        })
    }

    /// Compares the times with the frame rate.
    fn timestamps(&self, values: &Values, place: &Place<'_>, count: usize, faults: &mut Faults) -> Vec<f64> {
        let times: Vec<f64> = (0..count).map(|row| values.number(row).unwrap_or(f64::NAN)).collect();
        let fps = self.info.fps;
        let off = |(row, time): &(usize, &f64)| {
            let expected = *row as f64 / fps;
            // Times are stored in single precision: from about 1700 s on, its rounding exceeds the tolerance.
            let tolerance = TOLERANCE + f64::from(f32::EPSILON) * expected;
            let near = (*time - expected).abs() <= tolerance;
            !near
        };
        if let Some((row, time)) = times.iter().enumerate().find(off) {
            let expected = row as f64 / fps;
            let what = format!("it is {time} s, but frame {row} at {fps} frames per second is at {expected} s");
            faults.push(place.fault(Kind::Value, row, what, "correct fps in meta/info.json, or the column"));
        }
        times
    }

    /// Compares the tasks of the frames with those of the episode.
    fn tasks_of(&self, values: &Values, place: &Place<'_>, episode: &Episode, faults: &mut Faults) -> Vec<u64> {
        let mut tasks = Vec::with_capacity(episode.length);
        let mut checked = BTreeSet::new();
        for row in 0..episode.length {
            let task = values
                .integer(row)
                .and_then(|task| u64::try_from(task).ok())
                .unwrap_or(u64::MAX);
            tasks.push(task);
            if !checked.insert(task) {
                continue;
            }
            let what = match self.tasks.get(&task) {
                None => format!("there is no task {task}"),
                Some(text) if !episode.tasks.is_empty() && !episode.tasks.contains(text) => {
                    format!(
                        "it is task {task} (\"{text}\"), which is not one of episode {}",
                        episode.index
                    )
                }
                Some(_) => continue,
            };
            faults.push(place.fault(
                Kind::Value,
                row,
                what,
                "correct the column, or the tables of tasks and episodes",
            ));
        }
        tasks
    }
}

/// The values of an episode while its blocks are read.
struct Reading<'a> {
    columns: &'a [(&'a str, &'a [usize])],
    file: &'a str,
    values: Vec<Values>,
    /// Columns with a fault, which are not read on.
    broken: Vec<bool>,
    faults: Faults,
}

impl<'a> Reading<'a> {
    fn of(columns: &'a [(&'a str, &'a [usize])], table: &Table, file: &'a str) -> Self {
        let class_of = |column: &str| {
            table
                .schema()
                .field_with_name(column)
                .ok()
                .and_then(|field| class(field.data_type()))
        };
        Self {
            columns,
            file,
            values: columns
                .iter()
                .map(|(column, _)| Values::empty(class_of(column).unwrap_or(Class::Float)))
                .collect(),
            broken: vec![false; columns.len()],
            faults: Faults::default(),
        }
    }

    fn add(&mut self, block: &RecordBatch, first: usize) {
        let all = self.columns.iter().zip(&mut self.values).zip(&mut self.broken);
        for (((column, shape), values), broken) in all {
            if *broken {
                continue;
            }
            let place = Place {
                file: self.file,
                column,
                first,
            };
            let read = match block.column_by_name(column) {
                Some(array) => append(values, array, shape, &place),
                None => Err(Fault::column(
                    Kind::Missing,
                    self.file,
                    column,
                    "it is missing",
                    "restore the column",
                )),
            };
            *broken = self.faults.keep(read).is_none();
        }
    }
}

/// Checks that a column counts up from a number.
fn counts(values: &Values, from: u64, place: &Place<'_>, episode: &Episode, faults: &mut Faults) {
    let expected = |row: usize| i64::try_from(from + row as u64).ok();
    if let Some(row) = (0..episode.length).find(|&row| values.integer(row) != expected(row)) {
        let found = values.number(row).unwrap_or(f64::NAN);
        let what = format!(
            "it is {found}, but frame {row} of episode {} has {}",
            episode.index,
            from + row as u64
        );
        faults.push(place.fault(
            Kind::Value,
            row,
            what,
            "restore the order of the rows, or correct the column",
        ));
    }
}

/// Checks that a column contains the number of the episode.
fn same(values: &Values, place: &Place<'_>, episode: &Episode, faults: &mut Faults) {
    let expected = i64::try_from(episode.index).ok();
    let rows: Range<usize> = 0..episode.length;
    if let Some(row) = rows.clone().find(|&row| values.integer(row) != expected) {
        let found = values.number(row).unwrap_or(f64::NAN);
        let what = format!(
            "it is {found}, but this row belongs to episode {} by the lengths of the episodes",
            episode.index
        );
        faults.push(place.fault(
            Kind::Value,
            row,
            what,
            "correct the column, or the lengths in the table of episodes",
        ));
    }
}

//! The tables of an `episodes` artifact, written as demonstrations come: the large ones by a thread of their own.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

use anyhow::{Context as _, Result};
use re4_artifact::{Columns, TableWriter, Writer, tables};
use re4_fault::fault;
use re4_ingest::robomimic::Convention;
use re4_ingest::{Episode, Frames, LeftOut, Matrix, PlanarFrames, SpatialFrames, Tally};

/// Rows that are gathered before they are handed to a table, which are also those of its row groups: a group is encoded while
/// the next one is read.
const ROWS: usize = 4_096;

/// Pictures in a row group: few enough that one picture is read without decoding many.
const PICTURES_IN_GROUP: usize = 256;

/// Demonstrations that wait for a table.
const WAITING: usize = 8;

/// Writes all tables but those of pictures, while `read` hands demonstrations on in order.
pub(super) fn write_tables(
    writer: &Writer,
    read: impl FnOnce(&mut dyn FnMut(Episode) -> Result<()>) -> Result<()>,
) -> Result<Tally> {
    std::thread::scope(|scope| {
        let (to_frames, frames) = sync_channel(WAITING);
        let (to_states, states) = sync_channel(WAITING);
        let (to_models, models) = sync_channel::<Arc<str>>(WAITING);
        let frames = scope.spawn(move || write_frames(writer, &frames));
        let states = scope.spawn(move || write_states(writer, &states));
        let models = scope.spawn(move || write_models(writer, &models));
        let mut tally = Tally::default();
        let mut demos = Demos::default();
        let result = read(&mut |mut episode: Episode| {
            let number = tally.demos.len() as u32;
            tally.add(&mut episode);
            let model = episode.model.map(|text| {
                let next = demos.models.len() as u32;
                *demos.models.entry(Arc::clone(&text)).or_insert_with(|| {
                    // A table that has stopped says why when it is joined.
                    let _ = to_models.send(text);
                    next
                })
            });
            demos.model.push(model);
            let worst = |value: fn(&(f64, f64)) -> f64| {
                let errors = episode.goal_errors.as_ref()?;
                errors.iter().map(value).reduce(f64::max)
            };
            demos.position.push(worst(|error| error.0));
            demos.rotation.push(worst(|error| error.1));
            if let Some(matrix) = episode.states {
                let _ = to_states.send((number, matrix));
            }
            let _ = to_frames.send((number, episode.frames));
            Ok(())
        });
        drop((to_frames, to_states, to_models));
        let gone =
            || fault!("cannot write tables: a thread stopped"; "run again, and report it where that does not help");
        let ended =
            [frames.join(), states.join(), models.join()].map(|ended| ended.unwrap_or_else(|_| Err(gone().into())));
        result?;
        ended.into_iter().collect::<Result<()>>()?;
        write_demos(writer, &tally, demos)?;
        Ok(tally)
    })
}

/// Columns of table `demos` that are known once a demonstration is read.
#[derive(Default)]
struct Demos {
    models: BTreeMap<Arc<str>, u32>,
    model: Vec<Option<u32>>,
    position: Vec<Option<f64>>,
    rotation: Vec<Option<f64>>,
}

fn write_demos(writer: &Writer, tally: &Tally, demos: Demos) -> Result<()> {
    let numbers: Vec<u32> = (0..tally.demos.len() as u32).collect();
    let names = || tally.demos.iter().map(|(name, _)| name);
    let mut table = writer.table(&tables::EPISODES)?;
    table.write_columns(
        Columns::new(&tables::EPISODES)
            .u32("episode", numbers.clone())
            .u32_or_null("source_episode", names().map(|demo| demo.number).collect())
            .u32("frames", tally.demos.iter().map(|&(_, frames)| frames as u32).collect()),
    )?;
    table.finish()?;
    let mut table = writer.table(&tables::DEMOS)?;
    table.write_columns(
        Columns::new(&tables::DEMOS)
            .u32("episode", numbers)
            .text("demo", names().map(|demo| &demo.name))
            .text("filter_keys", names().map(|demo| demo.filter_keys.join(",")))
            .u32_or_null("model", demos.model)
            .f64_or_null("goal_error_position", demos.position)
            .f64_or_null("goal_error_rotation", demos.rotation),
    )?;
    table.finish()?;
    Ok(())
}

/// The table of demonstrations that cannot be used, where there are any.
pub(super) fn write_left_out(writer: &Writer, left: &[LeftOut]) -> Result<()> {
    if left.is_empty() {
        return Ok(());
    }
    let mut table = writer.table(&tables::LEFT_OUT)?;
    table.write_columns(
        Columns::new(&tables::LEFT_OUT)
            .text("demo", left.iter().map(|left| &left.demo))
            .text("why", left.iter().map(|left| &left.why)),
    )?;
    table.finish()?;
    Ok(())
}

/// The table of conventions.
pub(super) fn write_conventions(writer: &Writer, rows: &[Convention]) -> Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let measured = |i: usize| -> Vec<Option<f64>> { rows.iter().map(|row| Some(row.measured?[i])).collect() };
    let rival = |row: &Convention| row.measured.filter(|_| row.rival).map(|measured| measured[1]);
    let mut table = writer.table(&tables::CONVENTIONS)?;
    table.write_columns(
        Columns::new(&tables::CONVENTIONS)
            .text("convention", rows.iter().map(|row| &row.name))
            .text("value", rows.iter().map(|row| &row.value))
            .text("basis", rows.iter().map(|row| row.basis))
            .text("evidence", rows.iter().map(|row| &row.evidence))
            .f64_or_null("residual", measured(0))
            .f64_or_null("runner_up", rows.iter().map(rival).collect())
            .f64_or_null("threshold", measured(2))
            .text("unit", rows.iter().map(|row| &row.unit))
            .u32("frames", rows.iter().map(|row| row.frames as u32).collect()),
    )?;
    table.finish()?;
    Ok(())
}

fn write_models(writer: &Writer, models: &Receiver<Arc<str>>) -> Result<()> {
    let mut table = None;
    for (number, text) in (0..).zip(models.iter()) {
        let rows = Columns::new(&tables::MODELS)
            .u32("model", vec![number])
            .text("mjcf", [text]);
        begun(&mut table, writer, &tables::MODELS)?.write_columns(rows)?;
    }
    finish(table)
}

fn write_states(writer: &Writer, states: &Receiver<(u32, Matrix)>) -> Result<()> {
    let mut table = None;
    let (mut episodes, mut frames, mut gathered) = (Vec::new(), Vec::new(), Matrix::default());
    let mut flush = |episodes: &mut Vec<u32>, frames: &mut Vec<u32>, gathered: &mut Matrix| -> Result<()> {
        if episodes.is_empty() {
            return Ok(());
        }
        let matrix = std::mem::take(gathered);
        let rows = Columns::new(&tables::STATES)
            .u32("episode", std::mem::take(episodes))
            .u32("frame", std::mem::take(frames))
            .f64_rows("state", matrix.values, matrix.columns);
        begun(&mut table, writer, &tables::STATES)?.write_columns(rows)?;
        Ok(())
    };
    for (episode, matrix) in states {
        if matrix.columns != gathered.columns || episodes.len() >= ROWS {
            flush(&mut episodes, &mut frames, &mut gathered)?;
        }
        let rows = matrix.rows();
        episodes.extend(std::iter::repeat_n(episode, rows));
        frames.extend(0..rows as u32);
        gathered.columns = matrix.columns;
        gathered.values.extend(matrix.values);
    }
    flush(&mut episodes, &mut frames, &mut gathered)?;
    finish(table)
}

/// Names of the columns of table `spatial_frames` that are gathered as numbers, in their order.
const NUMBERS: [&str; 29] = [
    "eef_x",
    "eef_y",
    "eef_z",
    "eef_qx",
    "eef_qy",
    "eef_qz",
    "eef_qw",
    "object_x",
    "object_y",
    "object_z",
    "object_qx",
    "object_qy",
    "object_qz",
    "object_qw",
    "finger_0",
    "finger_1",
    "delta_x",
    "delta_y",
    "delta_z",
    "delta_rx",
    "delta_ry",
    "delta_rz",
    "goal_x",
    "goal_y",
    "goal_z",
    "goal_rx",
    "goal_ry",
    "goal_rz",
    "gripper",
];

#[derive(Default)]
struct Spatial {
    episodes: Vec<u32>,
    places: Vec<u32>,
    numbers: [Vec<f64>; NUMBERS.len()],
    rewards: Vec<Option<f64>>,
    dones: Vec<Option<bool>>,
}

impl Spatial {
    fn gather(&mut self, episode: u32, columns: &SpatialFrames) {
        fn extend<const N: usize>(numbers: &mut [Vec<f64>], rows: &[[f64; N]]) {
            for (i, numbers) in numbers.iter_mut().enumerate() {
                numbers.extend(rows.iter().map(|row| row[i]));
            }
        }
        let frames = columns.gripper.len();
        self.episodes.extend(std::iter::repeat_n(episode, frames));
        self.places.extend(0..frames as u32);
        let [eef @ .., gripper] = &mut self.numbers;
        let (position, rest) = eef.split_at_mut(3);
        let (quaternion, rest) = rest.split_at_mut(4);
        let (object, rest) = rest.split_at_mut(7);
        let (fingers, rest) = rest.split_at_mut(2);
        let (delta, goal) = rest.split_at_mut(6);
        extend(position, &columns.eef_position);
        extend(quaternion, &columns.eef_quaternion);
        extend(object, columns.object.as_deref().unwrap_or_default());
        extend(fingers, &columns.fingers);
        extend(delta, &columns.delta);
        extend(goal, &columns.goal);
        gripper.extend(&columns.gripper);
        let place = |i: usize| columns.rewards.as_ref().and_then(|rewards| rewards.get(i).copied());
        self.rewards.extend((0..frames).map(place));
        let place = |i: usize| columns.dones.as_ref().and_then(|dones| dones.get(i).copied());
        self.dones.extend((0..frames).map(place));
    }

    fn columns(self) -> Columns {
        let mut columns = Columns::new(&tables::SPATIAL_FRAMES)
            .u32("episode", self.episodes)
            .u32("frame", self.places)
            .f64_or_null("reward", self.rewards)
            .bool_or_null("done", self.dones);
        for (name, numbers) in NUMBERS.into_iter().zip(self.numbers) {
            columns = columns.f64(name, numbers);
        }
        columns
    }
}

fn planar(episode: u32, frames: &PlanarFrames) -> Columns {
    let rows = frames.eef.len();
    let object = frames.object.as_deref().unwrap_or_default();
    let mut columns = Columns::new(&tables::FRAMES)
        .u32("episode", vec![episode; rows])
        .u32("frame", (0..rows as u32).collect())
        .f64("eef_x", frames.eef.iter().map(|row| row[0]).collect())
        .f64("eef_y", frames.eef.iter().map(|row| row[1]).collect())
        .f64("object_x", object.iter().map(|row| row[0]).collect())
        .f64("object_y", object.iter().map(|row| row[1]).collect())
        .f64("object_theta", object.iter().map(|row| row[2]).collect())
        .f64("action_x", frames.action.iter().map(|row| row[0]).collect())
        .f64("action_y", frames.action.iter().map(|row| row[1]).collect())
        .f64_or_null(
            "contacts",
            (0..rows).map(|i| Some(frames.contacts.as_ref()?[i])).collect(),
        );
    for keypoint in 0..re4_ingest::KEYPOINTS {
        for (axis, name) in ["x", "y"].into_iter().enumerate() {
            let values = (0..rows)
                .map(|i| Some(frames.keypoints.as_ref()?[i][keypoint][axis]))
                .collect();
            columns = columns.f64_or_null(&format!("keypoint_{keypoint}_{name}"), values);
        }
    }
    columns
}

fn write_frames(writer: &Writer, demos: &Receiver<(u32, Frames)>) -> Result<()> {
    let mut table = None;
    let mut gathered = Spatial::default();
    for (episode, frames) in demos {
        match frames {
            Frames::Planar(frames) => {
                begun(&mut table, writer, &tables::FRAMES)?.write_columns(planar(episode, &frames))?;
            }
            Frames::Spatial(frames) => {
                gathered.gather(episode, &frames);
                if gathered.episodes.len() >= ROWS {
                    begun(&mut table, writer, &tables::SPATIAL_FRAMES)?
                        .write_columns(std::mem::take(&mut gathered).columns())?;
                }
            }
        }
    }
    if !gathered.episodes.is_empty() {
        begun(&mut table, writer, &tables::SPATIAL_FRAMES)?.write_columns(gathered.columns())?;
    }
    finish(table)
}

/// The table of pictures.
pub(super) struct ImageTable {
    table: TableWriter,
    count: usize,
}

impl ImageTable {
    /// Begins the table.
    pub(super) fn new(writer: &Writer) -> Result<Self> {
        Ok(Self {
            table: writer.table_in_groups(&tables::IMAGES, PICTURES_IN_GROUP)?,
            count: 0,
        })
    }

    /// Writes pictures of a camera, PNG files, with their demonstrations and frames.
    pub(super) fn write(&mut self, camera: &str, places: &[(u32, u32)], pictures: Vec<Vec<u8>>) -> Result<()> {
        self.count += pictures.len();
        self.table.write_columns(
            Columns::new(&tables::IMAGES)
                .text("camera", vec![camera; places.len()])
                .u32("episode", places.iter().map(|place| place.0).collect())
                .u32("frame", places.iter().map(|place| place.1).collect())
                .binary("image", pictures),
        )?;
        Ok(())
    }

    /// Pictures that were written.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Ends the table; how many pictures it has.
    pub(super) fn finish(self) -> Result<usize> {
        self.table.finish()?;
        Ok(self.count)
    }
}

/// The table, begun with its first rows: artifacts have no empty tables.
fn begun<'a>(
    table: &'a mut Option<TableWriter>,
    writer: &Writer,
    spec: &'static re4_artifact::TableSpec,
) -> Result<&'a mut TableWriter> {
    if table.is_none() {
        *table = Some(writer.table_in_groups(spec, ROWS)?);
    }
    table.as_mut().context("no table")
}

fn finish(table: Option<TableWriter>) -> Result<()> {
    table.map(TableWriter::finish).transpose()?;
    Ok(())
}

//! The tables of robosuite's tasks, written as demonstrations come: each table by a thread of its own.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

use anyhow::{Context as _, Result, anyhow};
use re4_artifact::{Columns, TableWriter, Writer, tables};
use re4_ingest::LeftOut;
use re4_ingest::robomimic::{Convention, Demo, DemoName, Interpreted, Matrix};

/// Rows that are gathered before they are handed to a table, which are also those of its row groups: a group is encoded while
/// the next one is read.
const ROWS: usize = 4_096;

/// Demonstrations that wait for a table.
const WAITING: usize = 8;

/// What the tables take of a demonstration.
pub(super) struct Row {
    pub(super) name: DemoName,
    pub(super) demo: Demo,
    pub(super) columns: Interpreted,
}

/// What was learned while writing.
#[derive(Default)]
pub(super) struct Written {
    pub(super) frames: u64,
    /// The demonstrations that were written, in order, with their frames.
    pub(super) demos: Vec<(DemoName, usize)>,
    pub(super) goal_errors: Vec<(f64, f64)>,
    pub(super) not_compared: Vec<String>,
    pub(super) single_precision: Vec<(String, &'static str)>,
    pub(super) skipped: Vec<String>,
}

/// Writes all tables but those of pictures, while `read` hands demonstrations on in order.
pub(super) fn write_tables(
    writer: &Writer,
    read: impl FnOnce(&mut dyn FnMut(Row) -> Result<()>) -> Result<()>,
) -> Result<Written> {
    std::thread::scope(|scope| {
        let (to_frames, frames) = sync_channel(WAITING);
        let (to_states, states) = sync_channel(WAITING);
        let (to_models, models) = sync_channel::<Arc<str>>(WAITING);
        let frames = scope.spawn(move || write_frames(writer, &frames));
        let states = scope.spawn(move || write_states(writer, &states));
        let models = scope.spawn(move || write_models(writer, &models));
        let mut written = Written::default();
        let mut demos = Demos::default();
        let result = read(&mut |row: Row| {
            let episode = written.demos.len() as u32;
            let Row {
                name,
                mut demo,
                columns,
            } = row;
            let model = demo.model.take().map(|text| {
                let next = demos.models.len() as u32;
                *demos.models.entry(Arc::clone(&text)).or_insert_with(|| {
                    // A table that has stopped says why when it is joined.
                    let _ = to_models.send(text);
                    next
                })
            });
            demos.model.push(model);
            let worst = |value: fn(&(f64, f64)) -> f64| {
                let errors = columns.goal_errors.as_ref()?;
                errors.iter().map(value).reduce(f64::max)
            };
            demos.position.push(worst(|error| error.0));
            demos.rotation.push(worst(|error| error.1));
            written.goal_errors.extend(columns.goal_errors.iter().flatten());
            if columns.goal_errors.is_none() {
                written.not_compared.push(demo.name.clone());
            }
            written
                .single_precision
                .extend(demo.single_precision.iter().map(|&name| (demo.name.clone(), name)));
            written.frames += demo.frames as u64;
            written.demos.push((name, demo.frames));
            written.skipped.append(&mut demo.skipped);
            if let Some(matrix) = demo.states.take() {
                let _ = to_states.send((episode, matrix));
            }
            let _ = to_frames.send((episode, demo, columns));
            Ok(())
        });
        drop((to_frames, to_states, to_models));
        let gone =
            || anyhow!("cannot write tables: a thread stopped; run again, and report it where that does not help");
        let ended = [frames.join(), states.join(), models.join()].map(|ended| ended.unwrap_or_else(|_| Err(gone())));
        result?;
        ended.into_iter().collect::<Result<()>>()?;
        write_demos(writer, &written, demos)?;
        Ok(written)
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

fn write_demos(writer: &Writer, written: &Written, demos: Demos) -> Result<()> {
    let numbers: Vec<u32> = (0..written.demos.len() as u32).collect();
    let names = || written.demos.iter().map(|(name, _)| name);
    let mut table = writer.table(&tables::EPISODES)?;
    table.write_columns(
        Columns::new(&tables::EPISODES)
            .u32("episode", numbers.clone())
            .u32_or_null("source_episode", names().map(|demo| demo.number).collect())
            .u32(
                "frames",
                written.demos.iter().map(|&(_, frames)| frames as u32).collect(),
            ),
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
struct Frames {
    episodes: Vec<u32>,
    places: Vec<u32>,
    numbers: [Vec<f64>; NUMBERS.len()],
    rewards: Vec<Option<f64>>,
    dones: Vec<Option<bool>>,
}

impl Frames {
    fn gather(&mut self, episode: u32, demo: &Demo, columns: &Interpreted) {
        fn extend<const N: usize>(numbers: &mut [Vec<f64>], rows: &[[f64; N]]) {
            for (i, numbers) in numbers.iter_mut().enumerate() {
                numbers.extend(rows.iter().map(|row| row[i]));
            }
        }
        let frames = demo.frames;
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
        extend(object, &columns.object);
        extend(fingers, &columns.fingers);
        extend(delta, &columns.delta);
        extend(goal, &columns.goal);
        gripper.extend(columns.goal.iter().map(|action| action[6]));
        let place = |i: usize| demo.rewards.as_ref().and_then(|rewards| rewards.get(i).copied());
        self.rewards.extend((0..frames).map(place));
        let place = |i: usize| demo.dones.as_ref().and_then(|dones| dones.get(i).copied());
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

fn write_frames(writer: &Writer, demos: &Receiver<(u32, Demo, Interpreted)>) -> Result<()> {
    let mut table = writer.table_in_groups(&tables::SPATIAL_FRAMES, ROWS)?;
    let mut gathered = Frames::default();
    for (episode, demo, columns) in demos {
        gathered.gather(episode, &demo, &columns);
        if gathered.episodes.len() >= ROWS {
            table.write_columns(std::mem::take(&mut gathered).columns())?;
        }
    }
    table.write_columns(gathered.columns())?;
    table.finish()?;
    Ok(())
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

//! Writes the tables of an `episodes` artifact while demonstrations are read. Large tables have a thread of their own each.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

use anyhow::Result;
use re4_artifact::{Row, RowWriter, Writer};
use re4_fault::fault;
use re4_ingest::{
    ArmColumns, DemoName, DemoRow, Episode, EpisodeRow, FrameRow, Frames, ImageRow, LeftOutFrameRow, Matrix, ModelRow,
    PlanarColumns, SpatialColumns, StateRow, Tally,
};

/// Rows per row group. A group is encoded while the next one is read.
const ROWS: usize = 4_096;

/// Images per row group. Small, because reading one image means reading its row group.
const IMAGES_IN_GROUP: usize = 256;

/// Maximum number of demonstrations in the queue of a table, which bounds the memory.
const QUEUE: usize = 8;

/// A demonstration that was written, and its number of frames.
pub(super) type Kept = (DemoName, usize);

/// Writes all tables except images. `read` passes the demonstrations in order to its argument; `first` is the number of the first one.
pub(super) fn write_tables(
    writer: &Writer,
    first: u32,
    read: impl FnOnce(&mut dyn FnMut(Episode) -> Result<()>) -> Result<()>,
) -> Result<(Tally, Vec<Kept>)> {
    std::thread::scope(|scope| {
        let (to_frames, frames) = sync_channel(QUEUE);
        let (to_states, states) = sync_channel(QUEUE);
        let (to_models, models) = sync_channel::<Arc<str>>(QUEUE);
        let frames = scope.spawn(move || write_frames(writer, &frames));
        let states = scope.spawn(move || write_states(writer, &states));
        let models = scope.spawn(move || write_models(writer, first, &models));
        let (mut tally, mut kept) = (Tally::default(), Vec::new());
        let mut known: BTreeMap<Arc<str>, u32> = BTreeMap::new();
        let (mut episodes, mut demos) = (Vec::new(), Vec::new());
        let result = read(&mut |mut episode: Episode| {
            let number = first + kept.len() as u32;
            tally.add(&mut episode);
            kept.push((episode.name.clone(), episode.frames.count()));
            let model = episode.model.map(|text| {
                // The parts of an artifact number their models independently, so the numbers begin with that of the first demonstration.
                let next = first + known.len() as u32;
                *known.entry(Arc::clone(&text)).or_insert_with(|| {
                    // Sending fails if the table's thread has stopped with an error, which is returned when the thread is joined.
                    let _ = to_models.send(text);
                    next
                })
            });
            let worst = |value: fn(&(f64, f64)) -> f64| {
                let errors = episode.goal_errors.as_ref()?;
                errors.iter().map(value).reduce(f64::max)
            };
            demos.push(DemoRow {
                episode: number,
                demo: episode.name.name,
                filter_keys: episode.name.filter_keys.join(","),
                model,
                goal_error_position: worst(|error| error.0),
                goal_error_rotation: worst(|error| error.1),
            });
            episodes.push(EpisodeRow {
                episode: number,
                source_episode: episode.name.number,
                frames: episode.frames.count(),
            });
            if let Some(matrix) = episode.states {
                let _ = to_states.send((number, matrix));
            }
            let _ = to_frames.send((number, episode.frames));
            Ok(())
        });
        drop((to_frames, to_states, to_models));
        let gone = || fault!("cannot write tables: a thread stopped"; "run again, and report the error if it remains");
        let ended =
            [frames.join(), states.join(), models.join()].map(|ended| ended.unwrap_or_else(|_| Err(gone().into())));
        result?;
        ended.into_iter().collect::<Result<()>>()?;
        writer.write_rows(episodes)?;
        writer.write_rows(demos)?;
        Ok((tally, kept))
    })
}

/// A table that is created with its first row, so that the artifact has no empty table.
struct Begun<'a, R: Row> {
    writer: &'a Writer,
    table: Option<RowWriter<R>>,
}

impl<'a, R: Row> Begun<'a, R> {
    fn new(writer: &'a Writer) -> Self {
        Self { writer, table: None }
    }

    fn extend(&mut self, rows: impl IntoIterator<Item = R>) -> Result<()> {
        for row in rows {
            let table = match &mut self.table {
                Some(table) => table,
                none => none.insert(self.writer.rows_in_groups(ROWS)?),
            };
            table.push(&row)?;
        }
        Ok(())
    }

    fn finish(self) -> Result<()> {
        self.table.map(RowWriter::finish).transpose()?;
        Ok(())
    }
}

fn write_models(writer: &Writer, first: u32, models: &Receiver<Arc<str>>) -> Result<()> {
    let mut table = Begun::new(writer);
    for (model, text) in (first..).zip(models) {
        let mjcf = text.to_string();
        table.extend([ModelRow { model, mjcf }])?;
    }
    table.finish()
}

fn write_states(writer: &Writer, states: &Receiver<(u32, Matrix)>) -> Result<()> {
    let mut table = Begun::new(writer);
    for (episode, matrix) in states {
        let rows = (0..).zip(matrix.values.chunks_exact(matrix.columns));
        table.extend(rows.map(|(frame, state)| StateRow {
            episode,
            frame,
            state: state.to_vec(),
        }))?;
    }
    table.finish()
}

fn write_frames(writer: &Writer, demos: &Receiver<(u32, Frames)>) -> Result<()> {
    fn rows<F>(episode: u32, frames: Vec<F>) -> impl Iterator<Item = FrameRow<F>> {
        (0..).zip(frames).map(move |(frame, recorded)| FrameRow {
            episode,
            frame,
            recorded,
        })
    }
    let mut plane = Begun::<FrameRow<PlanarColumns>>::new(writer);
    let mut space = Begun::<FrameRow<SpatialColumns>>::new(writer);
    let mut arm = Begun::<FrameRow<ArmColumns>>::new(writer);
    for (episode, frames) in demos {
        match frames {
            Frames::Planar(frames) => plane.extend(rows(episode, frames))?,
            Frames::Spatial(frames) => space.extend(rows(episode, frames))?,
            Frames::Arm(frames) => arm.extend(rows(episode, frames))?,
        }
    }
    plane.finish()?;
    space.finish()?;
    arm.finish()
}

/// A writer of table `left_out_frames`.
pub(super) struct LeftOutFrames<'a>(Begun<'a, LeftOutFrameRow<SpatialColumns>>);

impl<'a> LeftOutFrames<'a> {
    /// The table is created with its first row.
    pub(super) fn new(writer: &'a Writer) -> Self {
        Self(Begun::new(writer))
    }

    /// Writes the frames of a demonstration; `left_out` is its number among those left out. Planar frames are not kept.
    pub(super) fn write(&mut self, left_out: usize, frames: Frames) -> Result<()> {
        let Frames::Spatial(frames) = frames else { return Ok(()) };
        let rows = (0..).zip(frames).map(|(frame, recorded)| LeftOutFrameRow {
            left_out: left_out as u32,
            frame,
            recorded,
        });
        self.0.extend(rows)
    }

    /// Finishes the table, if there is one.
    pub(super) fn finish(self) -> Result<()> {
        self.0.finish()
    }
}

/// A writer of table `images`.
pub(super) struct ImageTable(RowWriter<ImageRow>);

impl ImageTable {
    /// Creates the table.
    pub(super) fn new(writer: &Writer) -> Result<Self> {
        Ok(Self(writer.rows_in_groups(IMAGES_IN_GROUP)?))
    }

    /// Writes images (PNG files) of a camera; `places` are their (episode, frame).
    pub(super) fn write(&mut self, camera: &str, places: &[(u32, u32)], images: Vec<Vec<u8>>) -> Result<()> {
        let rows = places.iter().zip(images).map(|(&(episode, frame), image)| ImageRow {
            episode,
            frame,
            camera: Some(camera.to_owned().into()),
            image,
        });
        Ok(self.0.extend(rows)?)
    }

    /// Number of images written so far.
    pub(super) fn count(&self) -> usize {
        self.0.rows() as usize
    }

    /// Finishes the table. Returns the number of images.
    pub(super) fn finish(self) -> Result<usize> {
        let count = self.count();
        self.0.finish()?;
        Ok(count)
    }
}

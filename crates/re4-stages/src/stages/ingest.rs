//! Ingest: raw dataset to `episodes`.

mod drawn;
mod robosuite;
mod spatial;
mod spool;
mod worker;

use std::path::PathBuf;

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Columns, Facts, Recipe, Stage, Writer, tables};
use re4_geometry::{Point2, Pose2};
use re4_ingest::pusht::{PushtEpisodes, PushtOptions, PushtReader};
use re4_ingest::{Fault, IngestError, Warning, WarningCode, refusal};
use re4_sim::{Canvas, OBSERVATION_SIDE};
use serde_json::json;

use self::spatial::write_left_out;
use crate::inputs::pictures::encode_png;
use crate::inputs::sources::find_source;
use crate::runner::{Built, Runner};

pub use robosuite::serve_ingest;
pub use worker::SUBCOMMAND as INGEST_WORKER;

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 2;

/// Pictures in a row group: few enough that one picture is read without decoding many.
const PICTURES_IN_GROUP: usize = 256;

impl Runner {
    /// The `episodes` artifact.
    ///
    /// # Errors
    /// When an input, or a setting of the pipeline, does not allow it; or at Ctrl-C.
    pub fn ingest(&self) -> Result<Built> {
        if !self.pipeline.task.is_planar() {
            return self.ingest_robosuite();
        }
        let section = &self.pipeline.ingest;
        let path = find_source(&section.source)?;
        anyhow::ensure!(
            !path.is_file() || !matches!(path.extension().and_then(|end| end.to_str()), Some("hdf5" | "h5")),
            "cannot ingest {}: it is an HDF5 file, and Push-T is read from a zarr store; give one, or set task to the file's own, such as \"can\"",
            path.display()
        );
        let stop = || self.interrupt.requested();
        let reader = PushtReader::open_for(&path, section.images, &stop).map_err(|error| self.or_interrupted(error))?;
        let hash = reader.source_hash(&stop).map_err(|error| self.or_interrupted(error))?;
        let facts = json!({
            "format": format!("zarr v{}, Push-T replay buffer", reader.zarr_format()),
            "episodes": reader.episode_ranges().len(),
            "frames": reader.frame_count(),
        });
        anyhow::ensure!(
            section.render.is_empty() || !reader.has_images(),
            "cannot render pictures for {}: it holds recorded ones; leave ingest.render out",
            path.display()
        );
        let mut config = json!({ "images": section.images, "select": section.select });
        if let (Some(config), false) = (config.as_object_mut(), section.render.is_empty()) {
            config.insert("render".to_owned(), json!(section.render));
        }
        if let (Some(config), false) = (config.as_object_mut(), section.pusht.is_default()) {
            config.insert("pusht".to_owned(), json!(section.pusht));
        }
        let recipe = Recipe::new(Stage::Ingest, CODE_VERSION)
            .config(&config)?
            .source(&hash, facts);
        let built = self.build(&recipe, |writer| self.ingest_from(&reader, writer))?;
        self.refuse_left_out(&built.artifact)?;
        Ok(built)
    }

    fn ingest_from(&self, reader: &PushtReader, writer: &Writer) -> Result<Facts> {
        let section = &self.pipeline.ingest;
        let options = PushtOptions {
            conventions: section.pusht,
            on_bad: section.on_bad,
            images: section.images && section.render.is_empty(),
            stop: &|| self.interrupt.requested(),
        };
        let reading = reader
            .read(&section.select, &options)
            .map_err(|error| self.or_interrupted(error))?;
        let (episodes, mut warnings) = (reading.episodes, reading.warnings);
        write_episodes(&episodes, writer)?;
        write_left_out(writer, &reading.left_out)?;
        let mut pictures = 0;
        if let (true, Some(shape)) = (section.images, reader.image_shape()) {
            pictures = self.write_images(reader, &episodes, shape, writer)?;
        } else if !section.render.is_empty() {
            pictures = self.render_images(&episodes, writer)?;
        }
        if !reading.left_out.is_empty() {
            warnings.push(Warning {
                code: WarningCode::LeftOut,
                message: format!(
                    "left out: {}",
                    refusal(&reading.left_out, episodes.episode_count() + reading.left_out.len())
                ),
                episode: None,
                frame: None,
                count: reading.left_out.len() as u64,
            });
        }
        let warnings = warnings
            .iter()
            .filter(|warning| section.render.is_empty() || warning.code != WarningCode::NoImages)
            .map(serde_json::to_value)
            .collect::<Result<_, _>>()?;
        let mut summary = json!({
            "episodes": episodes.episode_count(),
            "frames": episodes.frame_count(),
            "images": pictures,
        });
        if !reading.left_out.is_empty() {
            summary["left_out"] = json!(reading.left_out.len());
        }
        if let (Some(summary), false) = (summary.as_object_mut(), section.pusht.is_default()) {
            let explained = reading.explained.map(|share| (1000.0 * share).round() / 1000.0);
            summary.insert(
                "conventions".to_owned(),
                json!({ "settings": section.pusht, "motion_explained_by_targets": explained }),
            );
        }
        // After the last byte was read: what is published is of the files that were hashed.
        reader.unchanged()?;
        Ok(Facts { summary, warnings })
    }

    /// The error, or that the user asked to stop, where that is the reason.
    fn or_interrupted(&self, error: IngestError) -> anyhow::Error {
        match *error.fault {
            Fault::Stopped => self.interrupt.check("ingest").err().unwrap_or_else(|| error.into()),
            _ => error.into(),
        }
    }

    fn write_images(
        &self,
        reader: &PushtReader,
        episodes: &PushtEpisodes,
        [height, width, channels]: [usize; 3],
        writer: &Writer,
    ) -> Result<usize> {
        let bar = self.notes.progress(episodes.frame_count() as u64, "images");
        let mut table = writer.table_in_groups(&tables::IMAGES, PICTURES_IN_GROUP)?;
        let mut episode = 0;
        let mut written = 0;
        for block in reader.image_blocks_of(episodes)? {
            self.interrupt.check("ingest")?;
            let block = block?;
            let encoded = block
                .bytes
                .par_chunks_exact(height * width * channels)
                .map(|pixels| encode_png(pixels, width as u32, height as u32))
                .collect::<Result<Vec<_>>>()?;
            let (mut numbers, mut frames) = (Vec::new(), Vec::new());
            for row in block.frames {
                while !episodes.rows.get(episode).is_none_or(|rows| rows.contains(&row)) {
                    episode += 1;
                }
                let first = episodes.rows.get(episode).map_or(0, |rows| rows.start);
                numbers.push(episode as u32);
                frames.push((row - first) as u32);
            }
            written += encoded.len();
            bar.inc(encoded.len() as u64);
            table.write_columns(
                Columns::new(&tables::IMAGES)
                    .u32("episode", numbers)
                    .u32("frame", frames)
                    .binary("image", encoded),
            )?;
        }
        table.finish()?;
        bar.finish_and_clear();
        Ok(written)
    }

    /// Draws what the states say. Contact marks are not part of a state, so these pictures have none.
    fn render_images(&self, episodes: &PushtEpisodes, writer: &Writer) -> Result<usize> {
        let bar = self.notes.progress(episodes.frame_count() as u64, "images");
        let mut table = writer.table_in_groups(&tables::IMAGES, PICTURES_IN_GROUP)?;
        let mut numbered = (0..)
            .zip(&episodes.frames)
            .flat_map(|(episode, rows)| (0..).zip(rows.clone()).map(move |(frame, row)| (episode, frame, row)))
            .peekable();
        while numbered.peek().is_some() {
            self.interrupt.check("ingest")?;
            let mut group = Group::default();
            for (episode, frame, row) in numbered.by_ref().take(PICTURES_IN_GROUP) {
                group.episodes.push(episode);
                group.frames.push(frame);
                group.states.push(episodes.state[row]);
            }
            let encoded = group
                .states
                .par_iter()
                .map_init(Canvas::new, |canvas, &[eef_x, eef_y, x, y, theta]| {
                    canvas.draw_state(Point2::new(eef_x, eef_y), Pose2::new(x, y, theta));
                    let side = OBSERVATION_SIDE as u32;
                    encode_png(&canvas.observation(), side, side)
                })
                .collect::<Result<Vec<_>>>()?;
            bar.inc(encoded.len() as u64);
            table.write_columns(
                Columns::new(&tables::IMAGES)
                    .u32("episode", group.episodes)
                    .u32("frame", group.frames)
                    .binary("image", encoded),
            )?;
        }
        table.finish()?;
        bar.finish_and_clear();
        Ok(episodes.frame_count())
    }
}

/// What one row group of table images holds.
#[derive(Default)]
struct Group {
    episodes: Vec<u32>,
    frames: Vec<u32>,
    states: Vec<[f64; 5]>,
}

impl Runner {
    /// Files that a command with this pipeline reads.
    ///
    /// # Errors
    /// When the source is nowhere.
    pub fn inputs(&self) -> Result<Vec<PathBuf>> {
        let section = &self.pipeline.ingest;
        let mut inputs = vec![self.file.clone(), find_source(&section.source)?];
        if let Some(compare) = &section.compare {
            inputs.push(find_source(compare)?);
        }
        Ok(inputs)
    }
}

fn write_episodes(episodes: &PushtEpisodes, writer: &Writer) -> Result<()> {
    let numbers: Vec<u32> = (0..episodes.episode_count() as u32).collect();
    let mut table = writer.table(&tables::EPISODES)?;
    table.write_columns(
        Columns::new(&tables::EPISODES)
            .u32("episode", numbers)
            .u32("source_episode", episodes.sources.clone())
            .u32(
                "frames",
                episodes.frames.iter().map(|range| range.len() as u32).collect(),
            ),
    )?;
    table.finish()?;

    let rows = episodes.frame_count();
    let (mut episode, mut frame) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
    for (number, range) in episodes.frames.iter().enumerate() {
        episode.extend(std::iter::repeat_n(number as u32, range.len()));
        frame.extend(0..range.len() as u32);
    }
    let state = |i: usize| episodes.state.iter().map(|row| row[i]).collect::<Vec<f64>>();
    let action = |i: usize| episodes.action.iter().map(|row| row[i]).collect::<Vec<f64>>();
    let optional = |values: Option<Vec<f64>>| {
        values.map_or_else(|| vec![None; rows], |values| values.into_iter().map(Some).collect())
    };
    let mut columns = Columns::new(&tables::FRAMES)
        .u32("episode", episode)
        .u32("frame", frame)
        .f64("eef_x", state(0))
        .f64("eef_y", state(1))
        .f64("object_x", state(2))
        .f64("object_y", state(3))
        .f64("object_theta", state(4))
        .f64("action_x", action(0))
        .f64("action_y", action(1))
        .f64_or_null("contacts", optional(episodes.contacts.clone()));
    for keypoint in 0..re4_ingest::pusht::KEYPOINTS {
        for (axis, name) in ["x", "y"].into_iter().enumerate() {
            let values = episodes
                .keypoint
                .as_ref()
                .map(|points| points.iter().map(|row| row[keypoint][axis]).collect());
            columns = columns.f64_or_null(&format!("keypoint_{keypoint}_{name}"), optional(values));
        }
    }
    let mut table = writer.table(&tables::FRAMES)?;
    table.write_columns(columns)?;
    table.finish()?;
    Ok(())
}

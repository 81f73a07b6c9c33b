//! Writes the `episodes` artifact of a source of any format.

use std::path::Path;

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Store, Writer};
use re4_fault::{OrFault as _, ensure, fault};
use re4_ingest::robomimic::GoalErrors;
use re4_ingest::{Convention, DemoName, DemoSource, Episode, Frames, LeftOut, OnBad, Tally, WarningCode};
use re4_sim::{Canvas, OBSERVATION_SIDE};
use serde_json::{Map, Value, json};

use super::STAGE;
use super::rendered::Rendering;
use super::spool::Spool;
use super::tables::{ImageTable, LeftOutFrames, write_tables};
use crate::inputs::images::encode_png;
use crate::interrupt::Interrupt;
use crate::pipeline::IngestSection;

/// Camera name of rendered Push-T images, which is that of the recorded ones.
const PUSHT_CAMERA: &str = "img";

/// Origin of the images.
pub(super) enum Images<'a> {
    /// Recorded in the source.
    Recorded,
    /// Rendered from recorded Push-T states.
    PushT,
    /// Rendered by MuJoCo from recorded states of a robosuite task.
    Rendered(Rendering<'a>, Spool),
}

/// Everything that writing an `episodes` artifact needs besides the source.
pub(super) struct Ingest<'a> {
    pub(super) section: &'a IngestSection,
    /// Path of the dataset.
    pub(super) source: &'a Path,
    /// Path of the file of `ingest.compare`.
    pub(super) compare: Option<&'a Path>,
    pub(super) conventions: &'a [Convention],
    pub(super) images: Images<'a>,
    pub(super) threads: usize,
    pub(super) interrupt: &'a Interrupt,
    /// Called with the number of finished demonstrations or images and their total number.
    pub(super) progress: &'a (dyn Fn(u64, u64) + Sync),
}

impl Ingest<'_> {
    /// Makes and publishes the artifact.
    pub(super) fn publish<S: DemoSource>(self, source: &S, store: &Store, recipe: &Recipe) -> Result<Artifact> {
        let mut excluded = Vec::new();
        let artifact = loop {
            let writer = store.begin(recipe)?;
            let written = self.write(source, &excluded, &writer);
            // If a file changed while it was read, that is the error to report, not its consequences.
            if written.is_err() {
                self.interrupt.check(STAGE)?;
                source.unchanged()?;
            }
            match written? {
                Ok(summary) => {
                    self.interrupt.check(STAGE)?;
                    // Checked after the last byte was read, so that the artifact is made from the files that were hashed.
                    source.unchanged()?;
                    break writer.publish(summary)?;
                }
                // Images of these demonstrations turned out to be unreadable after other tables had been written, so the artifact
                // is written again without them. The loop ends because each time fewer demonstrations are left.
                Err(more) => excluded.extend(more),
            }
        };
        if let Images::Rendered(_, spool) = self.images {
            spool.remove()?;
        }
        Ok(artifact)
    }

    /// Writes all tables. Returns the summary, or the demonstrations whose recorded images cannot be decoded.
    fn write<S: DemoSource>(
        &self,
        source: &S,
        excluded: &[LeftOut],
        writer: &Writer,
    ) -> Result<Result<ArtifactSummary, Vec<LeftOut>>> {
        if !self.conventions.is_empty() {
            writer.write_rows(self.conventions.iter().cloned())?;
        }
        if !source.signals().is_empty() {
            writer.write_rows(source.signals().iter().cloned())?;
        }
        let demos = source.demos().len();
        let refuse = self.section.on_bad == OnBad::Refuse;
        let mut left: Vec<LeftOut> = Vec::new();
        let mut left_frames = LeftOutFrames::new(writer);
        let mut tally = write_tables(writer, |take| {
            source.episodes(|place, episode| {
                self.interrupt.check(STAGE)?;
                (self.progress)(place as u64 + 1, demos as u64);
                let name = &source.demos()[place].name;
                let known = excluded.iter().find(|left| left.demo == *name);
                match known.map_or(episode, |known| Err(known.clone())) {
                    Err(bad) => left.push(bad),
                    Ok(Episode {
                        contradiction: Some(why),
                        frames,
                        ..
                    }) => {
                        if !refuse {
                            left_frames.write(left.len(), frames)?;
                        }
                        let demo = name.clone();
                        left.push(LeftOut { demo, why });
                    }
                    // The dataset will be refused; the rest is read only to find all bad demonstrations.
                    Ok(_) if refuse && !left.is_empty() => {}
                    Ok(episode) => take(episode)?,
                }
                anyhow::Ok(())
            })
        })?;
        left_frames.finish()?;
        tally.left_out = left;
        self.refuse(&tally.left_out, demos, refuse || tally.demos.is_empty())?;
        if let Some(compare) = self.compare {
            ensure!(
                !tally.goal_errors.is_empty(),
                "cannot compare with {}: it has none of the demonstrations of {}",
                compare.display(),
                self.source.display();
                "remove ingest.compare, or set it to a file with the same demonstrations"
            );
        }
        let images = match &self.images {
            Images::Recorded => match self.write_recorded(source, &tally, writer)? {
                Ok(images) => images,
                Err(more) => {
                    tally.left_out.extend(more.iter().cloned());
                    let none = tally.left_out.len() == demos;
                    self.refuse(&tally.left_out, demos, refuse || none)?;
                    return Ok(Err(more));
                }
            },
            Images::PushT => self.render_pusht(source, &tally, writer)?,
            Images::Rendered(rendering, spool) => self.render(source, rendering, spool, &tally, writer)?,
        };
        if !tally.left_out.is_empty() {
            writer.write_rows(tally.left_out.iter().cloned())?;
        }
        let warnings = source
            .warnings(&tally)?
            .iter()
            .filter(|warning| self.section.render.is_empty() || warning.code != WarningCode::NoImages)
            .map(serde_json::to_value)
            .collect::<Result<_, _>>()?;
        let summary = self.summary(source, &tally, images);
        Ok(Ok(ArtifactSummary { summary, warnings }))
    }

    fn summary<S: DemoSource>(&self, source: &S, tally: &Tally, images: usize) -> Value {
        let info = source.info();
        let mut summary = Map::new();
        let mut set = |name: &str, value: Value| summary.insert(name.to_owned(), value);
        set("episodes", json!(tally.demos.len()));
        set("frames", json!(tally.frames()));
        set("images", json!(images));
        set(
            "cameras",
            match &self.images {
                Images::Recorded => json!(info.cameras),
                Images::PushT => json!([PUSHT_CAMERA]),
                Images::Rendered(rendering, _) => json!(rendering.cameras()),
            },
        );
        if !source.signals().is_empty() {
            set("rate", json!(info.rate));
        }
        for key in ["actions", "conventions", "image_coding"] {
            if let Some(value) = info.details.get(key) {
                set(key, value.clone());
            }
        }
        if !tally.left_out.is_empty() {
            set("left_out", json!(tally.left_out.len()));
        }
        if let Images::Rendered(rendering, _) = &self.images {
            set("rendered", rendering.summary());
        }
        if let Some(errors) = GoalErrors::of(&tally.goal_errors) {
            set("goal_error", json!(errors));
        }
        Value::Object(summary)
    }

    /// Returns an error about these demonstrations if there are any and `refuse` is set.
    fn refuse(&self, left: &[LeftOut], of: usize, refuse: bool) -> Result<()> {
        if left.is_empty() || !refuse {
            return Ok(());
        }
        Err(super::refused(self.source, left, of).into())
    }

    /// Writes the recorded images. Returns their number, or the demonstrations whose images cannot be decoded.
    fn write_recorded<S: DemoSource>(
        &self,
        source: &S,
        tally: &Tally,
        writer: &Writer,
    ) -> Result<Result<usize, Vec<LeftOut>>> {
        let cameras = &source.info().cameras;
        if cameras.is_empty() {
            return Ok(Ok(0));
        }
        let all = (tally.frames() * cameras.len()) as u64;
        let mut table = ImageTable::new(writer)?;
        let mut left: Vec<LeftOut> = Vec::new();
        for camera in cameras {
            source.images(camera, &tally.demos, |block| {
                self.interrupt.check(STAGE)?;
                let block = match block {
                    Ok(block) => block,
                    Err(bad) => {
                        if left.iter().all(|left| left.demo != bad.demo) {
                            left.push(bad);
                        }
                        return Ok(());
                    }
                };
                if !left.is_empty() {
                    return Ok(());
                }
                let (height, width) = (block.height as u32, block.width as u32);
                let encoded = block
                    .bytes
                    .par_chunks_exact(block.height * block.width * 3)
                    .map(|pixels| encode_png(pixels, width, height))
                    .collect::<Result<Vec<_>>>()?;
                table.write(camera, &block.places, encoded)?;
                (self.progress)(table.count() as u64, all);
                anyhow::Ok(())
            })?;
        }
        if !left.is_empty() {
            return Ok(Err(left));
        }
        table.finish().map(Ok)
    }

    /// Reads the demonstrations that were written again, and passes them with their numbers to `take`.
    fn read_kept<S: DemoSource>(
        source: &S,
        kept: &[(DemoName, usize)],
        mut take: impl FnMut(u32, Episode) -> Result<()>,
    ) -> Result<()> {
        let mut number = 0;
        source.episodes(|_, episode| match episode {
            Ok(episode) if kept.get(number as usize).is_some_and(|(name, _)| *name == episode.name) => {
                number += 1;
                take(number - 1, episode)
            }
            _ => Ok(()),
        })
    }

    /// Renders Push-T images from recorded states. Contact marks are not part of a state, so these images have none.
    fn render_pusht<S: DemoSource>(&self, source: &S, tally: &Tally, writer: &Writer) -> Result<usize> {
        let mut table = ImageTable::new(writer)?;
        let side = OBSERVATION_SIDE as u32;
        Self::read_kept(source, &tally.demos, |number, episode| {
            self.interrupt.check(STAGE)?;
            let Frames::Planar(frames) = &episode.frames else {
                return Ok(());
            };
            let encoded = frames
                .par_iter()
                .map_init(Canvas::new, |canvas, frame| {
                    let object = frame.object.or_fault(|| fault!("cannot render images of demonstrations without object poses"; "remove ingest.render"))?;
                    canvas.render_state(frame.eef, object);
                    encode_png(&canvas.observation(), side, side)
                })
                .collect::<Result<Vec<_>>>()?;
            let places: Vec<(u32, u32)> = (0..encoded.len() as u32).map(|frame| (number, frame)).collect();
            table.write(PUSHT_CAMERA, &places, encoded)?;
            (self.progress)(table.count() as u64, tally.frames() as u64);
            Ok(())
        })?;
        table.finish()
    }

    fn render<S: DemoSource>(
        &self,
        source: &S,
        rendering: &Rendering<'_>,
        spool: &Spool,
        tally: &Tally,
        writer: &Writer,
    ) -> Result<usize> {
        let all = (tally.frames() * rendering.cameras().len()) as u64;
        rendering.render(
            spool,
            self.threads,
            self.interrupt,
            &|images| (self.progress)(images as u64, all),
            |take| Self::read_kept(source, &tally.demos, take),
        )?;
        let lengths: Vec<usize> = tally.demos.iter().map(|(_, frames)| *frames).collect();
        rendering.write(spool, &lengths, ImageTable::new(writer)?)
    }
}

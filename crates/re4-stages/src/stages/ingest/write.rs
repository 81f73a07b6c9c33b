//! What an ingest writes of a source, whatever its format.

use std::path::Path;

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Store, Writer};
use re4_fault::{OrFault as _, ensure, fault};
use re4_ingest::robomimic::GoalErrors;
use re4_ingest::{Convention, DemoName, DemoSource, Frames, LeftOut, OnBad, Tally, WarningCode};
use re4_sim::{Canvas, OBSERVATION_SIDE};
use serde_json::{Map, Value, json};

use super::STAGE;
use super::rendered::Drawing;
use super::spool::Spool;
use super::tables::{ImageTable, write_tables};
use crate::inputs::images::encode_png;
use crate::interrupt::Interrupt;
use crate::pipeline::IngestSection;

/// What the camera of images that are painted from states in the plane is called: as that of recorded ones.
const PAINTED: &str = "img";

/// Where the images come from.
pub(super) enum Images<'a> {
    /// From the source.
    Recorded,
    /// They are painted from the states in the plane.
    Painted,
    /// They are drawn by the simulator from the recorded states.
    Drawn(Drawing<'a>, Spool),
}

/// An ingest at work.
pub(super) struct Ingest<'a> {
    pub(super) section: &'a IngestSection,
    /// Where the dataset lies.
    pub(super) source: &'a Path,
    /// Where another file of the same demonstrations lies, whose actions are compared.
    pub(super) compare: Option<&'a Path>,
    pub(super) conventions: &'a [Convention],
    pub(super) images: Images<'a>,
    pub(super) threads: usize,
    pub(super) interrupt: &'a Interrupt,
    /// Hears how many demonstrations, or images, of all are done.
    pub(super) progress: &'a (dyn Fn(u64, u64) + Sync),
}

impl Ingest<'_> {
    /// Makes and publishes the artifact.
    pub(super) fn publish<S: DemoSource>(self, source: &S, store: &Store, recipe: &Recipe) -> Result<Artifact> {
        let mut excluded = Vec::new();
        let artifact = loop {
            let writer = store.begin(recipe)?;
            let written = self.write(source, &excluded, &writer);
            // Whatever is wrong with a file that changed is not what has to be fixed.
            if written.is_err() {
                self.interrupt.check(STAGE)?;
                source.unchanged()?;
            }
            match written? {
                Ok(summary) => {
                    self.interrupt.check(STAGE)?;
                    // After the last byte was read: what is published is of the files that were hashed.
                    source.unchanged()?;
                    break writer.publish(summary)?;
                }
                // These proved to be of no use after they had been written. Each time there are fewer.
                Err(more) => excluded.extend(more),
            }
        };
        if let Images::Drawn(_, spool) = self.images {
            spool.remove()?;
        }
        Ok(artifact)
    }

    /// Writes all tables; the demonstrations whose recorded images cannot be decoded, where there are any.
    fn write<S: DemoSource>(
        &self,
        source: &S,
        excluded: &[LeftOut],
        writer: &Writer,
    ) -> Result<Result<ArtifactSummary, Vec<LeftOut>>> {
        if !self.conventions.is_empty() {
            writer.write_rows(self.conventions.iter().cloned())?;
        }
        let demos = source.demos().len();
        let refuse = self.section.on_bad == OnBad::Refuse;
        let mut left = Vec::new();
        let mut tally = write_tables(writer, |take| {
            source.episodes(|place, episode| {
                self.interrupt.check(STAGE)?;
                (self.progress)(place as u64 + 1, demos as u64);
                let name = &source.demos()[place].name;
                let known = excluded.iter().find(|left| left.demo == *name);
                match known.map_or(episode, |known| Err(known.clone())) {
                    Err(bad) => left.push(bad),
                    // What is refused in the end is only read on to learn what else is wrong.
                    Ok(_) if refuse && !left.is_empty() => {}
                    Ok(episode) => take(episode)?,
                }
                anyhow::Ok(())
            })
        })?;
        tally.left_out = left;
        self.refuse(&tally.left_out, demos, refuse || tally.demos.is_empty())?;
        if let Some(compare) = self.compare {
            ensure!(
                !tally.goal_errors.is_empty(),
                "cannot compare with {}: it holds none of the demonstrations of {}",
                compare.display(),
                self.source.display();
                "leave ingest.compare out, or give the file of the same demonstrations"
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
            Images::Painted => self.paint(source, &tally, writer)?,
            Images::Drawn(drawing, spool) => self.draw(source, drawing, spool, &tally, writer)?,
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
        let mut say = |name: &str, value: Value| summary.insert(name.to_owned(), value);
        say("episodes", json!(tally.demos.len()));
        say("frames", json!(tally.frames()));
        say("images", json!(images));
        say(
            "cameras",
            match &self.images {
                Images::Recorded => json!(info.cameras),
                Images::Painted => json!([PAINTED]),
                Images::Drawn(drawing, _) => json!(drawing.cameras()),
            },
        );
        for told in ["actions", "conventions"] {
            if let Some(value) = info.details.get(told) {
                say(told, value.clone());
            }
        }
        if !tally.left_out.is_empty() {
            say("left_out", json!(tally.left_out.len()));
        }
        if let Images::Drawn(drawing, _) = &self.images {
            say("drawn", drawing.summary());
        }
        if let Some(errors) = GoalErrors::of(&tally.goal_errors) {
            say("goal_error", json!(errors));
        }
        Value::Object(summary)
    }

    /// Refuses the dataset for these demonstrations.
    fn refuse(&self, left: &[LeftOut], of: usize, refuse: bool) -> Result<()> {
        if left.is_empty() || !refuse {
            return Ok(());
        }
        Err(super::refused(self.source, left, of).into())
    }

    /// Writes the recorded images; the demonstrations whose images cannot be decoded, where there are any.
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

    /// Hands on the demonstrations that were written, with their numbers.
    fn again<S: DemoSource>(
        source: &S,
        kept: &[(DemoName, usize)],
        mut take: impl FnMut(u32, re4_ingest::Episode) -> Result<()>,
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

    /// Paints what the states in the plane say. Contact marks are not part of a state, so these images have none.
    fn paint<S: DemoSource>(&self, source: &S, tally: &Tally, writer: &Writer) -> Result<usize> {
        let mut table = ImageTable::new(writer)?;
        let side = OBSERVATION_SIDE as u32;
        Self::again(source, &tally.demos, |number, episode| {
            self.interrupt.check(STAGE)?;
            let Frames::Planar(frames) = &episode.frames else {
                return Ok(());
            };
            let encoded = frames
                .par_iter()
                .map_init(Canvas::new, |canvas, frame| {
                    let object = frame.object.or_fault(|| fault!("cannot render images of demonstrations whose object pose is not known"; "leave ingest.render out"))?;
                    canvas.draw_state(frame.eef, object);
                    encode_png(&canvas.observation(), side, side)
                })
                .collect::<Result<Vec<_>>>()?;
            let places: Vec<(u32, u32)> = (0..encoded.len() as u32).map(|frame| (number, frame)).collect();
            table.write(PAINTED, &places, encoded)?;
            (self.progress)(table.count() as u64, tally.frames() as u64);
            Ok(())
        })?;
        table.finish()
    }

    fn draw<S: DemoSource>(
        &self,
        source: &S,
        drawing: &Drawing<'_>,
        spool: &Spool,
        tally: &Tally,
        writer: &Writer,
    ) -> Result<usize> {
        let all = (tally.frames() * drawing.cameras().len()) as u64;
        drawing.draw(
            spool,
            self.threads,
            self.interrupt,
            &|images| (self.progress)(images as u64, all),
            |take| Self::again(source, &tally.demos, take),
        )?;
        let lengths: Vec<usize> = tally.demos.iter().map(|(_, frames)| *frames).collect();
        drawing.write(spool, &lengths, ImageTable::new(writer)?)
    }
}

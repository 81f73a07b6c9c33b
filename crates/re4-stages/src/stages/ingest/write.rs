//! Writes the `episodes` artifact of a source of any format.

use std::path::Path;

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Part, Recipe, Store, Writer};
use re4_fault::{OrFault as _, ensure, fault};
use re4_ingest::robomimic::GoalErrors;
use re4_ingest::{Convention, DemoSource, Episode, Frames, LeftOut, OnBad, Tally, WarningCode};
use re4_sim::{Canvas, OBSERVATION_SIDE};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::STAGE;
use super::rendered::Rendering;
use super::renumber::renumbered;
use super::spool::Spool;
use super::tables::{ImageTable, Kept, LeftOutFrames, write_tables};
use crate::inputs::images::encode_png;
use crate::interrupt::Interrupt;
use crate::parts::{DEMOS_IN_PART, Parting, Partly, Share, parts_of};
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

/// The demonstrations of a part of an artifact, or of all of it.
struct Range {
    /// Their indices among the requested ones.
    demos: std::ops::Range<usize>,
    /// Number of the first one in the artifact if all demonstrations before it are used.
    first: u32,
}

/// What was written of some demonstrations. It is the summary of a part.
#[derive(Default, Serialize, Deserialize)]
struct Written {
    tally: Tally,
    images: usize,
}

fn frames_of(kept: &[Kept]) -> usize {
    kept.iter().map(|(_, frames)| frames).sum()
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
    /// What this process makes of an artifact in parts.
    pub(super) share: Share,
    pub(super) interrupt: &'a Interrupt,
    /// Called with the number of finished demonstrations or images and their total number.
    pub(super) progress: &'a (dyn Fn(u64, u64) + Sync),
}

impl Ingest<'_> {
    /// Makes and publishes the artifact, or this process's shard of it.
    pub(super) fn publish<S: DemoSource>(self, source: &S, store: &Store, recipe: &Recipe) -> Result<Artifact> {
        let demos = source.count();
        let parts = parts_of(demos, DEMOS_IN_PART);
        let artifact = if parts == 1 || !source.can_be_read_in_parts() {
            let whole = self.share.builds_whole(store, recipe);
            whole.map_err(|error| Partly::of_demos(error, demos))?;
            self.publish_whole(source, store, recipe)?
        } else {
            self.publish_parts(source, store, recipe, parts)?
        };
        if let Images::Rendered(_, spool) = self.images {
            spool.remove()?;
        }
        Ok(artifact)
    }

    fn publish_whole<S: DemoSource>(&self, source: &S, store: &Store, recipe: &Recipe) -> Result<Artifact> {
        let demos = source.count();
        let part = Range {
            demos: 0..demos,
            first: 0,
        };
        let (writer, written) = self.written(source, &part, &|| Ok(store.begin(recipe)?))?;
        let left = &written.tally.left_out;
        self.refuse(left, demos, self.refuses() || written.tally.episodes == 0)?;
        self.write_common(source, &written.tally, &writer)?;
        let summary = self.artifact_summary(source, &written)?;
        Ok(writer.publish(summary)?)
    }

    fn publish_parts<S: DemoSource>(&self, source: &S, store: &Store, recipe: &Recipe, parts: u32) -> Result<Artifact> {
        let demos = source.count();
        let parting = Parting {
            store,
            recipe,
            parts,
            share: self.share,
            interrupt: self.interrupt,
        };
        // If the dataset is to be refused, the other parts are still read to find all bad demonstrations.
        let mut refused: Vec<LeftOut> = Vec::new();
        let mut last = 0;
        let made = parting.make_each(
            |number| {
                last = number;
                let start = number as usize * DEMOS_IN_PART;
                let part = Range {
                    demos: start..demos.min(start + DEMOS_IN_PART),
                    first: start as u32,
                };
                let begin = || Ok(store.begin_part(recipe, Part::Numbered(number))?);
                let (writer, written) = self.written(source, &part, &begin)?;
                if self.refuses() && !written.tally.left_out.is_empty() {
                    refused.extend(written.tally.left_out);
                    return Ok(None);
                }
                let summary = ArtifactSummary {
                    summary: json!(written),
                    warnings: Vec::new(),
                };
                Ok(Some((writer, summary)))
            },
            |numbered, writer| {
                let mut all = Written::default();
                for place in numbered.iter_mut() {
                    let of_part: Written = serde_json::from_value(place.manifest().summary.clone())
                        .with_context(|| format!("cannot read the summary of {}", place.path().display()))?;
                    let before = (all.tally.episodes as u32, all.tally.left_out.len() as u32);
                    *place = renumbered(store, recipe, place, before)?;
                    all.tally.append(of_part.tally);
                    all.images += of_part.images;
                }
                self.refuse(&all.tally.left_out, demos, self.refuses() || all.tally.episodes == 0)?;
                self.write_common(source, &all.tally, writer)?;
                self.artifact_summary(source, &all)
            },
        );
        self.refuse(&refused, demos, true)?;
        made
    }

    fn refuses(&self) -> bool {
        self.section.on_bad == OnBad::Refuse
    }

    /// Writes the tables of some demonstrations.
    fn written<S: DemoSource>(
        &self,
        source: &S,
        part: &Range,
        begin: &dyn Fn() -> Result<Writer>,
    ) -> Result<(Writer, Written)> {
        let mut excluded = Vec::new();
        loop {
            let writer = begin()?;
            let written = self.write(source, part, &excluded, &writer);
            // If a file changed while it was read, that is the error to report, not its consequences.
            if written.is_err() {
                self.interrupt.check(STAGE)?;
                source.unchanged()?;
            }
            match written? {
                Ok(written) => {
                    self.interrupt.check(STAGE)?;
                    // Checked after the last byte was read, so that the artifact is made from the files that were hashed.
                    source.unchanged()?;
                    return Ok((writer, written));
                }
                // Images of these demonstrations turned out to be unreadable after other tables had been written, so the tables
                // are written again without them. The loop ends because each time fewer demonstrations are left.
                Err(more) => excluded.extend(more),
            }
        }
    }

    /// Writes the tables of demonstrations. Returns statistics about them, or those whose recorded images cannot be decoded.
    fn write<S: DemoSource>(
        &self,
        source: &S,
        part: &Range,
        excluded: &[LeftOut],
        writer: &Writer,
    ) -> Result<Result<Written, Vec<LeftOut>>> {
        let demos = source.count();
        let refuse = self.refuses();
        let mut left: Vec<LeftOut> = Vec::new();
        let mut left_frames = LeftOutFrames::new(writer);
        let (mut tally, kept) = write_tables(writer, part.first, |take| {
            source.episodes(part.demos.clone(), |place, episode| {
                self.interrupt.check(STAGE)?;
                (self.progress)(place as u64 + 1, demos as u64);
                let name = match &episode {
                    Ok(episode) => episode.name.name.clone(),
                    Err(left) => left.demo.clone(),
                };
                let known = excluded.iter().find(|left| left.demo == name);
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
                        left.push(LeftOut { demo: name, why });
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
        if refuse && !tally.left_out.is_empty() {
            return Ok(Ok(Written { tally, images: 0 }));
        }
        let images = match &self.images {
            Images::Recorded => match self.write_recorded(source, part.first, &kept, writer)? {
                Ok(images) => images,
                Err(more) if refuse => {
                    tally.left_out.extend(more);
                    return Ok(Ok(Written { tally, images: 0 }));
                }
                Err(more) => return Ok(Err(more)),
            },
            Images::PushT => self.render_pusht(source, part, &kept, writer)?,
            Images::Rendered(rendering, spool) => self.render(source, part, rendering, spool, &kept, writer)?,
        };
        Ok(Ok(Written { tally, images }))
    }

    /// Writes the tables that describe all demonstrations.
    fn write_common<S: DemoSource>(&self, source: &S, tally: &Tally, writer: &Writer) -> Result<()> {
        if !self.conventions.is_empty() {
            writer.write_rows(self.conventions.iter().cloned())?;
        }
        if !source.signals().is_empty() {
            writer.write_rows(source.signals().iter().cloned())?;
        }
        if !tally.left_out.is_empty() {
            writer.write_rows(tally.left_out.iter().cloned())?;
        }
        Ok(())
    }

    fn artifact_summary<S: DemoSource>(&self, source: &S, written: &Written) -> Result<ArtifactSummary> {
        if let Some(compare) = self.compare {
            ensure!(
                !written.tally.goal_errors.is_empty(),
                "cannot compare with {}: it has none of the demonstrations of {}",
                compare.display(),
                self.source.display();
                "remove ingest.compare, or set it to a file with the same demonstrations"
            );
        }
        let warnings = source
            .warnings(&written.tally)?
            .iter()
            .filter(|warning| self.section.render.is_empty() || warning.code != WarningCode::NoImages)
            .map(serde_json::to_value)
            .collect::<Result<_, _>>()?;
        let summary = self.summary(source, &written.tally, written.images);
        Ok(ArtifactSummary { summary, warnings })
    }

    fn summary<S: DemoSource>(&self, source: &S, tally: &Tally, images: usize) -> Value {
        let info = source.info();
        let mut summary = Map::new();
        let mut set = |name: &str, value: Value| summary.insert(name.to_owned(), value);
        set("episodes", json!(tally.episodes));
        set("frames", json!(tally.frames));
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
        first: u32,
        kept: &[Kept],
        writer: &Writer,
    ) -> Result<Result<usize, Vec<LeftOut>>> {
        let cameras = &source.info().cameras;
        if cameras.is_empty() || kept.is_empty() {
            return Ok(Ok(0));
        }
        let all = (frames_of(kept) * cameras.len()) as u64;
        let mut table = ImageTable::new(writer)?;
        let mut left: Vec<LeftOut> = Vec::new();
        for camera in cameras {
            source.images(camera, kept, |block| {
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
                let places: Vec<(u32, u32)> = block
                    .places
                    .iter()
                    .map(|&(number, frame)| (first + number, frame))
                    .collect();
                table.write(camera, &places, encoded)?;
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
        part: &Range,
        kept: &[Kept],
        mut take: impl FnMut(u32, Episode) -> Result<()>,
    ) -> Result<()> {
        let mut number = 0;
        source.episodes(part.demos.clone(), |_, episode| match episode {
            Ok(episode) if kept.get(number as usize).is_some_and(|(name, _)| *name == episode.name) => {
                number += 1;
                take(part.first + number - 1, episode)
            }
            _ => Ok(()),
        })
    }

    /// Renders Push-T images from recorded states. Contact marks are not part of a state, so these images have none.
    fn render_pusht<S: DemoSource>(&self, source: &S, part: &Range, kept: &[Kept], writer: &Writer) -> Result<usize> {
        let mut table = ImageTable::new(writer)?;
        let side = OBSERVATION_SIDE as u32;
        Self::read_kept(source, part, kept, |number, episode| {
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
            (self.progress)(table.count() as u64, frames_of(kept) as u64);
            Ok(())
        })?;
        table.finish()
    }

    fn render<S: DemoSource>(
        &self,
        source: &S,
        part: &Range,
        rendering: &Rendering<'_>,
        spool: &Spool,
        kept: &[Kept],
        writer: &Writer,
    ) -> Result<usize> {
        let all = (frames_of(kept) * rendering.cameras().len()) as u64;
        rendering.render(
            spool,
            self.threads,
            self.interrupt,
            &|images| (self.progress)(images as u64, all),
            |take| Self::read_kept(source, part, kept, take),
        )?;
        let lengths = (part.first..).zip(kept.iter().map(|(_, frames)| *frames));
        rendering.write(spool, &lengths, ImageTable::new(writer)?)
    }
}

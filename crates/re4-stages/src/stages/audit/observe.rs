//! The stage `observe`: makes `observations` from `episodes` and `modes`, the first pass of the audit of many demonstrations in SE(3).
//!
//! A part has what was measured of its demonstrations. What is derived from all of them is in the part of the dataset, so that a process that
//! audits some demonstrations reads only their own observations and that part, and the paths of all for the score novelty.

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactError, ArtifactSummary, ByEpisode, Recipe, Row, Stage, Writer};
use re4_audit::{Copies, MeasuredRow, Neighbours, Observation, ObservationRow, Survey, Thresholds, observe_spatial};
use re4_fault::{OrFault as _, ensure, fault};
use re4_ingest::{Convention, LeftOut, LeftOutFrameRow, SpatialColumns};
use re4_scores::{PathRow, ReferenceRow, SketchRow, reference};
use re4_task::Domain;
use serde_json::{Value, json};

use super::{Audible, kept_of, recorded_goals};
use crate::inputs::demos::in_batches;
use crate::inputs::sources::left_out;
use crate::parts::sum_of_summaries;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 1;

/// How the demonstrations of an audit are cut into parts: as `episodes`, with the demonstrations that were left out as the last part.
pub(super) struct Cut<'a> {
    episodes: &'a Artifact,
    modes: &'a Artifact,
    pub(super) left: Vec<LeftOut>,
}

impl<'a> Cut<'a> {
    pub(super) fn new(episodes: &'a Artifact, modes: &'a Artifact) -> Result<Self> {
        // A process that makes some parts has not verified the tables that describe all of them.
        for table in [
            LeftOut::table(),
            LeftOutFrameRow::<SpatialColumns>::table(),
            Convention::table(),
        ] {
            if episodes.has_table(table) {
                episodes.verify_table(table)?;
            }
        }
        Ok(Self {
            episodes,
            modes,
            left: left_out(episodes)?,
        })
    }

    /// Number of parts.
    pub(super) fn parts(&self) -> u32 {
        self.episodes.parts() + u32::from(!self.left.is_empty())
    }

    /// Whether a part has the demonstrations that were left out.
    pub(super) fn is_left_out(&self, part: u32) -> bool {
        part == self.episodes.parts()
    }

    /// Number of demonstrations that were not left out.
    pub(super) fn kept(&self) -> u32 {
        kept_of(self.episodes)
    }

    /// The demonstrations of a part.
    pub(super) fn demos<'r>(
        &self,
        runner: &'r Runner,
        part: u32,
    ) -> Result<Box<dyn Iterator<Item = Result<Audible>> + 'r>> {
        Ok(if self.is_left_out(part) {
            Box::new(runner.left_demos(self.episodes, &self.left, self.kept())?)
        } else {
            let (episodes, modes) = (self.episodes.part(part)?, self.modes.part(part)?);
            Box::new(runner.kept_demos(&episodes, &modes, &Ok)?)
        })
    }
}

impl Runner {
    /// Makes the `observations` artifact, or returns the existing one.
    ///
    /// # Errors
    /// If the demonstrations are not of a robosuite task, an input cannot be read, or the run is interrupted.
    pub fn observe(&self, episodes: &Built, modes: &Built) -> Result<Built> {
        ensure!(
            self.pipeline.task.domain() == Domain::Space,
            "cannot observe the demonstrations of {}: one process audits demonstrations of the task {}",
            self.file.display(), self.pipeline.task.name();
            "run re4-pipe audit"
        );
        let recipe = Recipe::new(Stage::Observe, CODE_VERSION)
            .config(&self.audit_config())?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        let cut = Cut::new(&episodes.artifact, &modes.artifact)?;
        self.build_parts(
            &recipe,
            cut.parts(),
            |writer, part| self.observe_part(&cut, part, writer),
            |parts, writer| self.reduce(parts, &episodes.artifact, writer),
        )
    }

    fn observe_part(&self, cut: &Cut<'_>, part: u32, writer: &Writer) -> Result<ArtifactSummary> {
        let limits = self.spatial_limits();
        let mut observations = writer.rows::<ObservationRow>()?;
        let mut measured = writer.rows::<MeasuredRow>()?;
        let mut sketches = writer.rows::<SketchRow>()?;
        let mut paths = writer.rows::<PathRow>()?;
        let (mut kept, mut left, mut chunks) = (0_u64, 0_u64, 0_u64);
        for batch in in_batches(cut.demos(self, part)?) {
            self.interrupt.check("observe")?;
            let observe = |own: &Audible| {
                let sketch = own.kept.then(|| self.sketch_spatial(&own.demo));
                (observe_spatial(&own.demo, &limits), sketch)
            };
            let batch: Vec<_> = batch?.par_iter().map(observe).collect();
            for (observation, sketch) in &batch {
                observations.push(&ObservationRow::new(observation, sketch.is_some()))?;
                measured.extend(MeasuredRow::of(observation))?;
                let Some(sketch) = sketch else {
                    left += 1;
                    continue;
                };
                kept += 1;
                chunks += sketch.chunks() as u64;
                sketches.push(&sketch.to_row())?;
                paths.extend(sketch.to_path_row())?;
            }
        }
        observations.finish()?;
        measured.finish()?;
        sketches.finish()?;
        paths.finish()?;
        Ok(ArtifactSummary {
            summary: json!({ "episodes": kept, "left_out": left, "chunks": chunks }),
            warnings: Vec::new(),
        })
    }

    /// Derives what depends on all demonstrations. Their observations are read several times and not held.
    fn reduce(&self, parts: &[Artifact], episodes: &Artifact, writer: &Writer) -> Result<ArtifactSummary> {
        parts.iter().try_for_each(Artifact::verify_bytes)?;
        let mut summary = Value::Object(sum_of_summaries(parts));
        let count = |name: &str| summary[name].as_u64().unwrap_or_default();
        let (kept, left, chunks) = (count("episodes"), count("left_out"), count("chunks"));
        let bar = self.notes.progress(3 * (kept + left), "observe");
        let each = |values: Values, visit: &mut dyn FnMut(&Observation, bool) -> Result<()>| {
            for part in parts {
                self.interrupt.check("observe")?;
                let observed = observed(part, values)?;
                bar.inc(observed.len() as u64);
                observed.iter().try_for_each(|(own, kept)| visit(own, *kept))?;
            }
            anyhow::Ok(())
        };
        let (mut survey, mut neighbours) = (Survey::default(), Neighbours::new(kept as usize));
        // Demonstrations that contradict the others have no part in the thresholds.
        each(Values::Read, &mut |own, kept| {
            if kept {
                survey.add(own);
                neighbours.sample(own);
            }
            Ok(())
        })?;
        each(Values::Skip, &mut |own, kept| {
            if kept {
                neighbours.compare(own);
            }
            Ok(())
        })?;
        let thresholds: Thresholds = survey
            .thresholds(neighbours, &self.pipeline.audit, &self.spatial_dataset())
            .with_recorded_goals(recorded_goals(episodes)?);
        let mut copies = Copies::new(&thresholds);
        let mut table = writer.rows()?;
        each(Values::Skip, &mut |own, _| Ok(table.extend(copies.add(own))?))?;
        summary["copies"] = json!(table.rows());
        table.finish()?;
        bar.finish_and_clear();
        let (rows, usual) = thresholds.to_rows();
        writer.write_rows(rows)?;
        writer.write_rows([usual])?;
        write_reference(parts, chunks, writer)?;
        Ok(ArtifactSummary {
            summary,
            warnings: Vec::new(),
        })
    }
}

/// Whether the measured values of demonstrations are read, which are most of the rows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Values {
    Read,
    Skip,
}

/// The observations of a part, and whether each demonstration was kept.
fn observed(part: &Artifact, values: Values) -> Result<Vec<(Observation, bool)>> {
    let mut measured = match values {
        Values::Read => Some(ByEpisode::open(part, |row: &MeasuredRow| row.episode)?),
        Values::Skip => None,
    };
    let observed = part.read::<ObservationRow>()?.into_iter().map(|row| {
        let (episode, kept) = (row.episode, row.kept);
        let observation = match &mut measured {
            None => row.into_observation(&[]),
            // Every demonstration has measured values.
            Some(measured) => {
                let values = measured.next().transpose()?.filter(|(number, _)| *number == episode);
                values.and_then(|(_, values)| row.into_observation(&values))
            }
        };
        Ok((observation.or_fault(|| unusable(part))?, kept))
    });
    observed.collect()
}

/// The error for rows that this build did not write.
pub(super) fn unusable(observations: &Artifact) -> re4_fault::Fault {
    fault!(
        "cannot use {}: its tables do not match each other", observations.path().display();
        "delete the artifact, and run re4-pipe observe again"
    )
}

/// Writes the chunks that those of all demonstrations are compared with.
fn write_reference(parts: &[Artifact], chunks: u64, writer: &Writer) -> Result<()> {
    let mut table = writer.rows::<ReferenceRow>()?;
    let mut places = reference(chunks as usize).peekable();
    let mut before = 0;
    for part in parts {
        for row in part.read::<SketchRow>()? {
            let own = row.chunks().or_fault(|| unusable(part))?;
            while let Some(place) = places.next_if(|place| *place < before + own.len()) {
                let chunk = own.get(place - before).or_fault(|| unusable(part))?;
                table.push(&ReferenceRow {
                    episode: row.episode,
                    chunk: chunk.as_flattened().to_vec(),
                })?;
            }
            before += own.len();
        }
    }
    table.finish()?;
    Ok(())
}

/// All rows of a table, after verifying its files.
pub(super) fn verified<R: Row>(artifact: &Artifact) -> Result<Vec<R>, ArtifactError> {
    artifact.verify_table(R::table())?;
    artifact.read()
}

//! The audit of many demonstrations in SE(3), in parts.
//!
//! A part has the rows of its demonstrations. Findings are numbered and scores are ranked over all demonstrations, so these two tables are
//! written again for all parts, and the artifact does not list those of the parts.

use std::collections::BTreeMap;

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Row, Writer};
use re4_audit::{
    AuditedEpisodeRow, CopyRow, FindingRow, GraspRow, RuleAgreementRow, ThresholdRow, Thresholds, UsualRow,
};
use re4_episode::Mode;
use re4_fault::OrFault as _;
use re4_scores::{Chunk, Others, PathRow, ReferenceRow, ScoreRow, Sketch, SketchRow, rank};
use serde_json::{Value, json};

use super::observe::{Cut, unusable, verified};
use super::summary::{OfDomain, Tally};
use super::{Audited, checks};
use crate::inputs::demos::in_batches;
use crate::parts::Lazy;
use crate::runner::{Built, Runner};

/// What the audit of a demonstration depends on of the others.
struct Known {
    thresholds: Thresholds,
    copies: BTreeMap<u32, CopyRow>,
    others: Others,
}

impl Known {
    fn read(observations: &Artifact) -> Result<Self> {
        let copies = verified::<CopyRow>(observations)?;
        let chunk = |row: ReferenceRow| -> Option<Chunk> {
            let (halves, _) = row.chunk.as_chunks();
            halves.try_into().ok()
        };
        let reference: Option<Vec<Chunk>> = verified(observations)?.into_iter().map(chunk).collect();
        let reference = reference.or_fault(|| unusable(observations))?;
        observations.verify_table(PathRow::table())?;
        let mut failed = None;
        let table = observations.table(PathRow::table())?;
        let (count, rows) = (table.rows() as usize, table.stream()?);
        let paths = rows.map_while(|row| row.map_err(|error| failed = Some(error)).ok());
        let others = Others::new(&reference, count, paths);
        if let Some(error) = failed {
            return Err(error.into());
        }
        Ok(Self {
            thresholds: thresholds(observations)?,
            copies: copies.into_iter().map(|row| (row.episode, row)).collect(),
            others: others.or_fault(|| unusable(observations))?,
        })
    }
}

/// The thresholds that `observe` derived.
fn thresholds(observations: &Artifact) -> Result<Thresholds> {
    let rows: Vec<ThresholdRow> = verified(observations)?;
    let usual: Vec<UsualRow> = verified(observations)?;
    let thresholds = usual.first().and_then(|usual| Thresholds::from_rows(rows, usual));
    thresholds.or_fault(|| unusable(observations))
}

impl Runner {
    /// Makes the `audit` artifact of an `episodes` artifact in parts.
    pub(super) fn audit_in_parts(&self, episodes: &Built, modes: &Built, recipe: Recipe) -> Result<Built> {
        let observations = self.observe(episodes, modes)?.artifact;
        let recipe = recipe.input("observations", observations.key());
        let cut = Cut::new(&episodes.artifact, &modes.artifact)?;
        let known = Lazy::new();
        self.build_parts(
            &recipe,
            cut.parts(),
            |writer, part| {
                let known = known.get(|| Known::read(&observations))?;
                self.audit_part(&cut, part, known, &observations, writer)
            },
            |parts, writer| self.merge_audit(parts, &observations, writer),
        )
    }

    fn audit_part(
        &self,
        cut: &Cut<'_>,
        part: u32,
        known: &Known,
        observations: &Artifact,
        writer: &Writer,
    ) -> Result<ArtifactSummary> {
        let limits = self.spatial_limits();
        let mut audited = Audited {
            thresholds: known.thresholds.clone(),
            listed: Vec::new(),
            findings: Vec::new(),
            grasps: Vec::new(),
            domain: OfDomain::Space,
            sketches: Vec::new(),
            agreements: Vec::new(),
        };
        let mut first = cut.is_left_out(part).then(|| cut.kept());
        for batch in in_batches(cut.demos(self, part)?) {
            self.interrupt.check("audit")?;
            let batch = batch?;
            let judged = self.judge_demos(&batch, &known.thresholds, &limits)?;
            for (own, judged) in batch.iter().zip(judged) {
                let demo = &own.demo;
                let place = demo.number - *first.get_or_insert(demo.number);
                // Demonstrations without readable frames have a number, too.
                let left = |place: usize| cut.left.get(place).map_or("", |left| &left.demo);
                while audited.listed.len() < place as usize {
                    let name = left(audited.listed.len());
                    audited.listed.push(super::Listed::new(name, 0, Vec::new(), 0.0));
                }
                audited.listed.push(own.listed());
                let frames = demo.episode.frames.len() as u32;
                let copy = known.copies.get(&demo.number);
                let copy = copy.and_then(|copy| copy.finding(&demo.episode.name, frames, &known.thresholds));
                audited.findings.extend(copy);
                audited.findings.extend(judged.findings);
                audited.grasps.extend(judged.grasps);
                audited.agreements.extend(judged.agreements);
            }
        }
        let first = first.unwrap_or_default();
        if cut.is_left_out(part) {
            audited.report_left_out(&cut.left, first, cut.kept());
        }
        audited.complete(first);
        writer.write_rows(
            (0..)
                .zip(&audited.findings)
                .map(|(number, found)| FindingRow::new(number, found)),
        )?;
        writer.write_rows(audited.listed.iter().map(|listed| listed.row.clone()))?;
        let observed = observations.part(part)?;
        let sketches = observed.read::<SketchRow>()?;
        let score = |row: &SketchRow| Some(known.others.score(&Sketch::from_row(row)?));
        let scores: Option<Vec<ScoreRow>> = sketches.par_iter().map(score).collect();
        writer.write_rows(scores.or_fault(|| unusable(observations))?)?;
        writer.write_rows(audited.grasps)?;
        writer.write_rows(audited.agreements)?;
        let lengths = |mode| {
            let segments = audited.listed.iter().flat_map(|listed| &listed.segments);
            let own = segments.filter(|segment| segment.mode == mode);
            own.map(|segment| segment.frames.len()).collect::<Vec<_>>()
        };
        let lengths: BTreeMap<&str, _> = Mode::ALL
            .into_iter()
            .map(|mode| (mode.as_str(), lengths(mode)))
            .collect();
        Ok(ArtifactSummary {
            // Quartiles need all lengths, which no table has.
            summary: json!({ "segment_frames": lengths }),
            warnings: Vec::new(),
        })
    }

    /// Numbers the findings, ranks the scores, and counts.
    fn merge_audit(&self, parts: &mut [Artifact], observations: &Artifact, writer: &Writer) -> Result<ArtifactSummary> {
        let mut tally = Tally::default();
        let mut findings = writer.rows::<FindingRow>()?;
        let mut scores: Vec<ScoreRow> = Vec::new();
        let mut number = 0;
        let bar = self.notes.progress(parts.len() as u64, "audit");
        for part in &mut *parts {
            self.interrupt.check("audit")?;
            part.verify_bytes()?;
            for row in part.read::<FindingRow>()? {
                tally.add_finding(&row.code, row.severity, row.episode);
                findings.push(&FindingRow { finding: number, ..row })?;
                number += 1;
            }
            for row in part.read::<AuditedEpisodeRow>()? {
                tally.add_episode(&row);
            }
            for row in part.read::<GraspRow>()? {
                tally.add_grasp(&row);
            }
            for row in part.read::<RuleAgreementRow>()? {
                tally.add_agreement(&row);
            }
            for mode in Mode::ALL {
                let lengths = part.manifest().summary["segment_frames"][mode.as_str()].as_array();
                let lengths = lengths.into_iter().flatten().filter_map(Value::as_u64);
                lengths.for_each(|frames| tally.add_segment(mode, frames as usize));
            }
            scores.extend(part.read::<ScoreRow>()?);
            *part = part.clone().without(&[FindingRow::NAME, ScoreRow::NAME]);
            bar.inc(1);
        }
        bar.finish_and_clear();
        findings.finish()?;
        rank(&mut scores);
        writer.write_rows(scores)?;
        let thresholds = thresholds(observations)?;
        writer.write_rows(checks(&thresholds, &tally))?;
        Ok(ArtifactSummary {
            summary: tally.summary(&thresholds, OfDomain::Space),
            warnings: Vec::new(),
        })
    }
}

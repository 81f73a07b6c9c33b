//! The stage `audit`: makes `audit`, which lists findings, from `episodes` and `modes`.

mod scores;
mod summary;

use std::collections::BTreeMap;

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage, Writer};
use re4_audit::{
    AuditedEpisodeRow, CheckRow, Finding, FindingRow, GraspLimits, GraspRow, JudgedGrasp, PlanarDemo, Severity,
    SpatialDemo, Thresholds, audit_copies, audit_planar, audit_spatial, contact_and_motion, observe_planar,
    observe_spatial,
};
use re4_episode::{Mode, Segment};
use re4_ingest::LeftOut;
use re4_scores::Sketch;
use re4_segment::segment_planar;
use re4_sim::{GOAL, coverage};

use self::summary::{Contacts, summary};
use crate::inputs::demos::{SegmentedEpisodes, SpatialEpisodes, in_batches};
use crate::inputs::episodes::read_episodes;
use crate::inputs::sources::left_out;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 6;

/// A demonstration's row in table `episodes`, and its segments.
struct Listed {
    row: AuditedEpisodeRow,
    segments: Vec<Segment>,
}

impl Listed {
    fn new(demo: &str, frames: usize, segments: Vec<Segment>, displacement: f64) -> Self {
        let of = |mode| segments.iter().filter(move |segment| segment.mode == mode);
        let frames_in = |mode| of(mode).map(|segment| segment.frames.len()).sum();
        let row = AuditedEpisodeRow {
            // The number and the counts of findings are filled in by `write`.
            episode: 0,
            demo: demo.to_owned(),
            frames,
            transit_frames: frames_in(Mode::Transit),
            transfer_frames: frames_in(Mode::Transfer),
            segments: segments.len(),
            transfers: of(Mode::Transfer).count(),
            grasp_frame: of(Mode::Transfer).next().map(|segment| segment.frames.start),
            object_displacement: displacement,
            errors: 0,
            warnings: 0,
            notes: 0,
        };
        Self { row, segments }
    }
}

/// The result of an audit.
struct Audited {
    thresholds: Thresholds,
    listed: Vec<Listed>,
    findings: Vec<Finding>,
    grasps: Vec<GraspRow>,
    contacts: Option<Contacts>,
    sketches: Vec<Sketch>,
}

impl Audited {
    /// Appends the demonstrations that ingest left out, each with no frames and one finding.
    fn report_left_out(&mut self, left: Vec<LeftOut>) {
        for left in left {
            self.findings.push(Finding {
                severity: Severity::Error,
                code: "left_out",
                episode: self.listed.len() as u32,
                demo: left.demo.clone(),
                frames: 0..0,
                value: None,
                threshold: None,
                unit: "",
                message: left.why,
            });
            self.listed.push(Listed::new(&left.demo, 0, Vec::new(), 0.0));
        }
    }
}

impl Runner {
    /// Makes the `audit` artifact, or returns the existing one.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn audit(&self, episodes: &Built, modes: &Built) -> Result<Built> {
        let recipe = Recipe::new(Stage::Audit, CODE_VERSION)
            .config(&self.audit_config())?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        self.build(&recipe, |writer| {
            let mut audited = if self.pipeline.task.is_planar() {
                self.audit_planar(&episodes.artifact)?
            } else {
                self.audit_spatial(&episodes.artifact, &modes.artifact, &Ok)?
            };
            audited.report_left_out(left_out(&episodes.artifact)?);
            audited
                .findings
                .sort_by(|a, b| (a.episode, a.frames.start, a.code).cmp(&(b.episode, b.frames.start, b.code)));
            write(&mut audited, writer)?;
            Ok(ArtifactSummary {
                summary: summary(&audited),
                warnings: Vec::new(),
            })
        })
    }

    /// The settings that the findings depend on besides the inputs. The goal of Push-T is a constant.
    pub(super) fn audit_config(&self) -> serde_json::Value {
        serde_json::json!({ "audit": self.pipeline.audit, "segment": self.pipeline.segment })
    }

    /// The findings of demonstrations after `transform`.
    pub(super) fn findings(
        &self,
        episodes: &Artifact,
        modes: &Artifact,
        transform: &dyn Fn(SpatialDemo) -> Result<SpatialDemo>,
    ) -> Result<Vec<Finding>> {
        Ok(self.audit_spatial(episodes, modes, transform)?.findings)
    }

    fn audit_spatial(
        &self,
        episodes: &Artifact,
        modes: &Artifact,
        transform: &dyn Fn(SpatialDemo) -> Result<SpatialDemo>,
    ) -> Result<Audited> {
        // Demonstrations are read twice: thresholds depend on all of them, and they need not fit in memory.
        let read = || -> Result<_> { Ok(SegmentedEpisodes::open(episodes, modes)?.map(|demo| transform(demo?))) };
        let gripper = self.pipeline.segment.gripper.clone().unwrap_or_default();
        let demos = SpatialEpisodes::open(episodes)?.demos();
        let bar = self.notes.progress(2 * demos as u64, "audit");
        let given = |code: &'static str| self.pipeline.audit.threshold(code).or_else(|| constant(code));
        let limits = GraspLimits {
            closed: given("missed_grasp").unwrap_or(gripper.closed),
            lost: given("lost_grasp").unwrap_or_default(),
            flicker: given("flicker").unwrap_or_default().ceil() as usize,
        };
        let mut observations = Vec::with_capacity(demos);
        let mut listed = Vec::with_capacity(demos);
        let mut sketches = Vec::with_capacity(demos);
        for batch in in_batches(read()?) {
            self.interrupt.check("audit")?;
            let demos = batch?;
            observations.par_extend(demos.par_iter().map(|demo| observe_spatial(demo, &limits)));
            listed.extend(demos.iter().map(list_spatial));
            sketches.par_extend(demos.par_iter().map(|demo| self.sketch_spatial(demo)));
            bar.inc(demos.len() as u64);
        }
        let thresholds = Thresholds::derive(&observations, &self.pipeline.audit, false, gripper.closed);
        let mut findings = audit_copies(&observations, &thresholds);
        let mut grasps = Vec::new();
        for batch in in_batches(read()?) {
            self.interrupt.check("audit")?;
            let demos = batch?;
            let audits: Vec<_> = demos
                .par_iter()
                .map(|demo| audit_spatial(demo, &thresholds, &limits))
                .collect();
            for (demo, audit) in demos.iter().zip(audits) {
                findings.extend(audit.findings);
                grasps.extend(audit.grasps.into_iter().filter_map(|judged| list_grasp(demo, judged)));
            }
            bar.inc(demos.len() as u64);
        }
        bar.finish_and_clear();
        Ok(Audited {
            thresholds,
            listed,
            findings,
            grasps,
            contacts: None,
            sketches,
        })
    }

    /// Audits Push-T demonstrations. Their evidence is a function of their frames, so they are segmented again and the `modes`
    /// artifact is not read.
    fn audit_planar(&self, episodes: &Artifact) -> Result<Audited> {
        let demos = read_episodes(episodes)?
            .into_par_iter()
            .enumerate()
            .map(|(number, episode)| {
                let segmented = segment_planar(&episode, &self.pipeline.segment)?;
                let coverage = episode
                    .frames
                    .iter()
                    .map(|frame| coverage(frame.object, GOAL))
                    .collect();
                Ok(PlanarDemo {
                    number: number as u32,
                    episode,
                    segmented,
                    coverage,
                })
            })
            .collect::<Result<Vec<_>>>()?;
        self.interrupt.check("audit")?;
        let observations: Vec<_> = demos.par_iter().map(observe_planar).collect();
        let thresholds = Thresholds::derive(&observations, &self.pipeline.audit, true, 0.0);
        let mut findings = audit_copies(&observations, &thresholds);
        findings.extend(demos.iter().flat_map(|demo| audit_planar(demo, &thresholds)));
        let contacts = demos
            .iter()
            .flat_map(|demo| contact_and_motion(&demo.segmented.evidence));
        Ok(Audited {
            thresholds,
            contacts: Some(contacts.flatten().collect()),
            listed: demos.iter().map(list_planar).collect(),
            sketches: demos.par_iter().map(|demo| self.sketch_planar(demo)).collect(),
            findings,
            grasps: Vec::new(),
        })
    }
}

/// The built-in threshold of a check.
fn constant(code: &str) -> Option<f64> {
    let check = re4_audit::CHECKS.iter().find(|check| check.code == code)?;
    match check.basis {
        re4_audit::Basis::Constant { spatial, .. } => Some(spatial),
        _ => None,
    }
}

fn list_spatial(demo: &SpatialDemo) -> Listed {
    let frames = &demo.episode.frames;
    let at = |frame: Option<&re4_episode::SpatialFrame>| frame.map(|frame| frame.object.translation.vector);
    let displacement = match (at(frames.first()), at(frames.last())) {
        (Some(first), Some(last)) => (last - first).norm(),
        _ => 0.0,
    };
    let segments = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
    Listed::new(&demo.episode.name, frames.len(), segments, displacement)
}

fn list_planar(demo: &PlanarDemo) -> Listed {
    let frames = &demo.episode.frames;
    let displacement = match (frames.first(), frames.last()) {
        (Some(first), Some(last)) => (last.object.translation() - first.object.translation()).norm(),
        _ => 0.0,
    };
    let segments = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
    Listed::new(&demo.episode.name(), frames.len(), segments, displacement)
}

fn list_grasp(demo: &SpatialDemo, judged: JudgedGrasp) -> Option<GraspRow> {
    let grasp = demo.segmented.segments.get(judged.segment)?.grasp?;
    Some(GraspRow {
        episode: demo.number,
        segment: judged.segment,
        frames: judged.frames,
        outcome: judged.outcome.as_str().into(),
        grasp: grasp.transform,
        finger_separation: grasp.finger_separation,
        rigidity_residual: judged.residual,
        object_rise: judged.rise,
    })
}

fn write(audited: &mut Audited, writer: &Writer) -> Result<()> {
    for (number, listed) in (0..).zip(&mut audited.listed) {
        listed.row.episode = number;
    }
    for finding in &audited.findings {
        if let Some(Listed { row, .. }) = audited.listed.get_mut(finding.episode as usize) {
            *match finding.severity {
                Severity::Error => &mut row.errors,
                Severity::Warning => &mut row.warnings,
                Severity::Note => &mut row.notes,
            } += 1;
        }
    }
    writer.write_rows(
        (0..)
            .zip(&audited.findings)
            .map(|(number, found)| FindingRow::new(number, found)),
    )?;
    let counts = by_code(&audited.findings);
    let planar = audited.thresholds.planar();
    writer.write_rows(audited.thresholds.iter().map(|(check, threshold)| {
        let (findings, episodes) = counts.get(check.code).copied().unwrap_or_default();
        CheckRow {
            code: check.code.into(),
            severity: check.severity,
            meaning: check.meaning.to_owned(),
            measure: check.measure.to_owned(),
            threshold: threshold.value,
            unit: check.unit_of(planar).into(),
            origin: threshold.origin.as_str().into(),
            derivation: threshold.derivation.clone(),
            findings,
            episodes,
        }
    }))?;
    writer.write_rows(audited.listed.iter().map(|listed| listed.row.clone()))?;
    writer.write_rows(re4_scores::score(&audited.sketches))?;
    if audited.contacts.is_none() {
        writer.write_rows(audited.grasps.iter().cloned())?;
    }
    Ok(())
}

/// The number of findings and the number of demonstrations with findings, by code.
fn by_code(findings: &[Finding]) -> BTreeMap<&'static str, (u32, u32)> {
    let mut counts: BTreeMap<&'static str, (u32, Option<u32>, u32)> = BTreeMap::new();
    // Findings are sorted by demonstration, so a change of demonstration means a new one.
    for finding in findings {
        let (found, last, episodes) = counts.entry(finding.code).or_default();
        *found += 1;
        if *last != Some(finding.episode) {
            *last = Some(finding.episode);
            *episodes += 1;
        }
    }
    counts
        .into_iter()
        .map(|(code, (found, _, episodes))| (code, (found, episodes)))
        .collect()
}

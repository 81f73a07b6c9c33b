//! The stage `audit`: makes `audit`, which lists findings, from `episodes` and `modes`.

mod arm;
mod scores;
mod summary;

use std::collections::BTreeMap;

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage, Writer};
use re4_audit::{
    AuditedEpisodeRow, CheckRow, Finding, FindingRow, FingerUnit, GraspLimits, GraspRow, JudgedGrasp, PlanarDemo,
    RuleAgreementRow, Severity, SpatialDemo, Thresholds, audit_copies, audit_planar, audit_spatial, contact_and_motion,
    observe_planar, observe_spatial,
};
use re4_episode::{Mode, Segment};
use re4_ingest::{Convention, LeftOut};
use re4_scores::Sketch;
use re4_segment::{Rule, SegmentConfig, segment_planar, segment_spatial};
use re4_sim::{GOAL, coverage};
use re4_task::Domain;

use self::summary::{Contacts, summary};
use crate::inputs::demos::{LeftOutEpisodes, SegmentedEpisodes, SpatialEpisodes, in_batches};
use crate::inputs::episodes::read_episodes;
use crate::inputs::sources::left_out;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 7;

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
    /// What is known about a dataset of an arm without an object, for the summary.
    arm: Option<serde_json::Value>,
    sketches: Vec<Sketch>,
    agreements: Vec<RuleAgreementRow>,
}

impl Audited {
    /// Reports the demonstrations that ingest left out, each with one finding. They follow the others, and are listed with no frames.
    fn report_left_out(&mut self, left: &[LeftOut], kept: usize) {
        for (number, left) in left.iter().enumerate() {
            let place = kept + number;
            if self.listed.len() <= place {
                self.listed.push(Listed::new(&left.demo, 0, Vec::new(), 0.0));
            }
            self.findings.push(Finding {
                severity: Severity::Error,
                code: "left_out",
                episode: place as u32,
                demo: left.demo.clone(),
                frames: 0..0,
                value: None,
                threshold: None,
                unit: "",
                message: left.why.clone(),
                other: None,
                other_demo: None,
            });
        }
    }
}

/// The rules whose modes are compared with those of the pipeline.
const RULES: [Rule; 4] = [Rule::GripperCommand, Rule::Grasp, Rule::Evidence, Rule::RigidMotion];

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
            let left = left_out(&episodes.artifact)?;
            let mut audited = match self.pipeline.task.domain() {
                Domain::Plane => self.audit_planar(&episodes.artifact)?,
                Domain::Space => self.audit_spatial(&episodes.artifact, &modes.artifact, &left, &Ok)?,
                Domain::Arm => self.audit_arm(&episodes.artifact, &modes.artifact)?,
            };
            let kept = episodes.artifact.manifest().summary["episodes"].as_u64();
            audited.report_left_out(&left, kept.unwrap_or_default() as usize);
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
        Ok(self.audit_spatial(episodes, modes, &[], transform)?.findings)
    }

    /// The demonstrations of a dataset with their segmentation, and after them those that were left out although they can be read.
    /// Grasps are judged by the gripper command, so demonstrations with other modes are segmented again.
    fn demos_to_audit<'a>(
        &'a self,
        episodes: &Artifact,
        modes: &Artifact,
        left: &'a [LeftOut],
        transform: &'a dyn Fn(SpatialDemo) -> Result<SpatialDemo>,
    ) -> Result<impl Iterator<Item = Result<Audible>> + use<'a>> {
        let config = &self.pipeline.segment;
        let by_command = SegmentConfig {
            rule: Rule::GripperCommand,
            ..config.clone()
        };
        let kept = SegmentedEpisodes::open(episodes, modes)?.map(move |demo| {
            let demo = transform(demo?)?;
            let modes = demo.segmented.modes.clone();
            let demo = match config.rule {
                Rule::Grasp | Rule::Evidence => SpatialDemo {
                    segmented: segment_spatial(&demo.episode, &by_command)?,
                    ..demo
                },
                _ => demo,
            };
            Ok(Audible {
                demo,
                modes,
                kept: true,
            })
        });
        let by_command = SegmentConfig {
            rule: Rule::GripperCommand,
            ..config.clone()
        };
        let first = episodes.manifest().summary["episodes"].as_u64().unwrap_or_default() as u32;
        let others = LeftOutEpisodes::open(episodes, left)?.map(move |read| {
            let (number, episode) = read?;
            let modes = segment_spatial(&episode, config)?.modes;
            let segmented = segment_spatial(&episode, &by_command)?;
            let demo = SpatialDemo {
                number: first + number,
                episode,
                segmented,
            };
            Ok(Audible {
                demo,
                modes,
                kept: false,
            })
        });
        Ok(kept.chain(others))
    }

    fn audit_spatial(
        &self,
        episodes: &Artifact,
        modes: &Artifact,
        left: &[LeftOut],
        transform: &dyn Fn(SpatialDemo) -> Result<SpatialDemo>,
    ) -> Result<Audited> {
        // Demonstrations are read twice: thresholds depend on all of them, and they need not fit in memory.
        let read = || self.demos_to_audit(episodes, modes, left, transform);
        let gripper = self.pipeline.segment.gripper.clone().unwrap_or_default();
        let demos = SpatialEpisodes::open(episodes)?.demos();
        let bar = self.notes.progress(2 * (demos + left.len()) as u64, "audit");
        let limits = self.grasp_limits(gripper.closed);
        let mut observations = Vec::with_capacity(demos);
        let mut listed = Vec::with_capacity(demos);
        let mut numbers = Vec::new();
        let mut sketches = Vec::with_capacity(demos);
        for batch in in_batches(read()?) {
            self.interrupt.check("audit")?;
            let batch = batch?;
            observations.par_extend(batch.par_iter().map(|own| observe_spatial(&own.demo, &limits)));
            let kept = batch.par_iter().filter(|own| own.kept);
            sketches.par_extend(kept.map(|own| self.sketch_spatial(&own.demo)));
            for own in &batch {
                // Demonstrations without readable frames have a number, too.
                listed.resize_with(own.demo.number as usize, || Listed::new("", 0, Vec::new(), 0.0));
                // The frames of a demonstration that was left out are in no other table.
                listed.push(if own.kept {
                    list_spatial(&own.demo)
                } else {
                    Listed::new(&own.demo.episode.name, 0, Vec::new(), 0.0)
                });
                numbers.extend((!own.kept).then_some(own.demo.number));
            }
            bar.inc(batch.len() as u64);
        }
        for (number, left) in left.iter().enumerate() {
            match listed.get_mut(demos + number) {
                Some(listed) => listed.row.demo.clone_from(&left.demo),
                None => listed.push(Listed::new(&left.demo, 0, Vec::new(), 0.0)),
            }
        }
        // Demonstrations that contradict the others have no part in the thresholds.
        let usual = observations.len() - numbers.len();
        let thresholds = Thresholds::derive(&observations[..usual], &self.pipeline.audit, false, gripper.closed)
            .with_recorded_goals(recorded_goals(episodes)?);
        let mut findings = audit_copies(&observations, &thresholds);
        let (mut grasps, mut agreements) = (Vec::new(), Vec::new());
        for batch in in_batches(read()?) {
            self.interrupt.check("audit")?;
            let batch = batch?;
            let audits: Vec<_> = batch
                .par_iter()
                .map(|own| Ok((audit_spatial(&own.demo, &thresholds, &limits), self.agreement(own)?)))
                .collect::<Result<_>>()?;
            for (own, (audit, agreement)) in batch.iter().zip(audits) {
                findings.extend(audit.findings);
                let judged = audit.grasps.into_iter().filter(|_| own.kept);
                grasps.extend(judged.filter_map(|judged| list_grasp(&own.demo, judged)));
                agreements.extend(agreement);
            }
            bar.inc(batch.len() as u64);
        }
        bar.finish_and_clear();
        Ok(Audited {
            thresholds,
            listed,
            findings,
            grasps,
            contacts: None,
            arm: None,
            sketches,
            agreements,
        })
    }

    /// The limits by which grasps are judged.
    fn grasp_limits(&self, closed: f64) -> GraspLimits {
        let given = |code: &'static str| self.pipeline.audit.threshold(code).or_else(|| constant(code));
        GraspLimits {
            closed: given("missed_grasp").unwrap_or(closed),
            lost: given("lost_grasp").unwrap_or_default(),
            flicker: given("flicker").unwrap_or_default().ceil() as usize,
            frozen: given("frozen_object").unwrap_or_default().ceil() as usize,
            swapped: given("swapped_object").unwrap_or_default(),
            fingers: FingerUnit::Metres,
        }
    }

    /// Compares the modes of a demonstration with those by each rule.
    fn agreement(&self, own: &Audible) -> Result<Vec<RuleAgreementRow>> {
        let config = &self.pipeline.segment;
        let demo = &own.demo;
        RULES
            .into_iter()
            .map(|rule| {
                let configured = rule == config.rule;
                let modes = if configured {
                    own.modes.clone()
                } else {
                    segment_spatial(&demo.episode, &SegmentConfig { rule, ..config.clone() })?.modes
                };
                Ok(RuleAgreementRow::new(
                    demo.number,
                    &demo.episode.name,
                    rule,
                    configured,
                    &modes,
                    &own.modes,
                ))
            })
            .collect()
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
            arm: None,
            listed: demos.iter().map(list_planar).collect(),
            sketches: demos.par_iter().map(|demo| self.sketch_planar(demo)).collect(),
            findings,
            grasps: Vec::new(),
            agreements: Vec::new(),
        })
    }
}

/// A demonstration to audit.
struct Audible {
    /// Segmented by the gripper command, or by the pipeline's rule if that is not about the gripper.
    demo: SpatialDemo,
    /// Modes by the pipeline's rule.
    modes: Vec<Mode>,
    /// Whether it is in the artifact. Otherwise it was left out.
    kept: bool,
}

/// Whether the dataset records absolute actions.
fn recorded_goals(episodes: &Artifact) -> Result<bool> {
    if !episodes.has::<Convention>() {
        return Ok(true);
    }
    let rows: Vec<Convention> = episodes.read()?;
    Ok(rows
        .iter()
        .any(|row| &*row.convention == "action_kind" && &*row.value == "absolute"))
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
    let domain = audited.thresholds.domain();
    writer.write_rows(audited.thresholds.iter().map(|(check, threshold)| {
        let (findings, episodes) = counts.get(check.code).copied().unwrap_or_default();
        CheckRow {
            code: check.code.into(),
            severity: check.severity,
            meaning: check.meaning.to_owned(),
            measure: check.measure.to_owned(),
            threshold: threshold.value,
            unit: check.unit_of(domain).into(),
            origin: threshold.origin.as_str().into(),
            derivation: threshold.derivation.clone(),
            findings,
            episodes,
        }
    }))?;
    writer.write_rows(audited.listed.iter().map(|listed| listed.row.clone()))?;
    writer.write_rows(re4_scores::score(&audited.sketches))?;
    if domain == Domain::Space {
        writer.write_rows(audited.grasps.iter().cloned())?;
        writer.write_rows(audited.agreements.iter().cloned())?;
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

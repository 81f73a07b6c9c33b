//! The stage `audit`: makes `audit`, which lists findings, from `episodes` and `modes`.
//!
//! Demonstrations are read twice, because thresholds depend on all of them. If `episodes` is in parts, the first pass is the stage `observe`
//! (module [`observe`]), and the parts of the second pass read its artifact (module [`parts`]).

mod arm;
mod observe;
mod parts;
mod scores;
mod summary;

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage, Writer};
use re4_audit::{
    AuditedEpisodeRow, CheckRow, Dataset, Finding, FindingRow, FingerUnit, GraspLimits, GraspRow, JudgedGrasp,
    PlanarDemo, RuleAgreementRow, Severity, SpatialDemo, Thresholds, audit_copies, audit_planar, audit_spatial,
    contact_and_motion, observe_planar, observe_spatial,
};
use re4_episode::{Mode, Segment};
use re4_ingest::{Convention, LeftOut};
use re4_scores::Sketch;
use re4_segment::{Rule, SegmentConfig, segment_planar, segment_spatial};
use re4_sim::{GOAL, coverage};
use re4_task::Domain;

use self::summary::{Contacts, OfDomain, Tally};
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
    domain: OfDomain,
    sketches: Vec<Sketch>,
    agreements: Vec<RuleAgreementRow>,
}

impl Audited {
    /// Reports the demonstrations that ingest left out, each with one finding. They follow the `kept` others, and are listed with no
    /// frames. `first` is the number of the first demonstration that is listed.
    fn report_left_out(&mut self, left: &[LeftOut], first: u32, kept: u32) {
        for (number, left) in (kept..).zip(left) {
            if self.listed.len() <= (number - first) as usize {
                self.listed.push(Listed::new(&left.demo, 0, Vec::new(), 0.0));
            }
            self.findings.push(Finding {
                severity: Severity::Error,
                code: "left_out",
                episode: number,
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

    /// Sorts the findings, and fills in the numbers and counts of the listed demonstrations, whose first has the number `first`.
    fn complete(&mut self, first: u32) {
        self.findings
            .sort_by(|a, b| (a.episode, a.frames.start, a.code).cmp(&(b.episode, b.frames.start, b.code)));
        for (number, listed) in (first..).zip(&mut self.listed) {
            listed.row.episode = number;
        }
        for finding in &self.findings {
            let place = finding.episode.checked_sub(first).map(|place| place as usize);
            if let Some(Listed { row, .. }) = place.and_then(|place| self.listed.get_mut(place)) {
                *match finding.severity {
                    Severity::Error => &mut row.errors,
                    Severity::Warning => &mut row.warnings,
                    Severity::Note => &mut row.notes,
                } += 1;
            }
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
        if episodes.artifact.parts() > 1 && self.pipeline.task.domain() == Domain::Space {
            return self.audit_in_parts(episodes, modes, recipe);
        }
        self.build(&recipe, |writer| {
            let left = left_out(&episodes.artifact)?;
            let mut audited = match self.pipeline.task.domain() {
                Domain::Plane => self.audit_planar(&episodes.artifact)?,
                Domain::Space => self.audit_spatial(&episodes.artifact, &modes.artifact, &left, &Ok)?,
                Domain::Arm => self.audit_arm(&episodes.artifact, &modes.artifact)?,
            };
            audited.report_left_out(&left, 0, kept_of(&episodes.artifact));
            write(audited, writer)
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

    /// Demonstrations with their segmentation, of whole artifacts or of parts. Grasps are judged by the gripper command, so
    /// demonstrations with other modes are segmented again.
    fn kept_demos<'a>(
        &'a self,
        episodes: &Artifact,
        modes: &Artifact,
        transform: &'a dyn Fn(SpatialDemo) -> Result<SpatialDemo>,
    ) -> Result<impl Iterator<Item = Result<Audible>> + use<'a>> {
        let config = &self.pipeline.segment;
        let by_command = self.by_command();
        Ok(SegmentedEpisodes::open(episodes, modes)?.map(move |demo| {
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
        }))
    }

    /// The demonstrations that were left out although they can be read. They are numbered after the `kept` others.
    fn left_demos<'a>(
        &'a self,
        episodes: &Artifact,
        left: &[LeftOut],
        kept: u32,
    ) -> Result<impl Iterator<Item = Result<Audible>> + use<'a>> {
        let config = &self.pipeline.segment;
        let by_command = self.by_command();
        Ok(LeftOutEpisodes::open(episodes, left)?.map(move |read| {
            let (number, episode) = read?;
            let modes = segment_spatial(&episode, config)?.modes;
            let segmented = segment_spatial(&episode, &by_command)?;
            let demo = SpatialDemo {
                number: kept + number,
                episode,
                segmented,
            };
            Ok(Audible {
                demo,
                modes,
                kept: false,
            })
        }))
    }

    fn by_command(&self) -> SegmentConfig {
        SegmentConfig {
            rule: Rule::GripperCommand,
            ..self.pipeline.segment.clone()
        }
    }

    fn audit_spatial(
        &self,
        episodes: &Artifact,
        modes: &Artifact,
        left: &[LeftOut],
        transform: &dyn Fn(SpatialDemo) -> Result<SpatialDemo>,
    ) -> Result<Audited> {
        let kept = kept_of(episodes);
        let read = || {
            let kept_demos = self.kept_demos(episodes, modes, transform)?;
            anyhow::Ok(kept_demos.chain(self.left_demos(episodes, left, kept)?))
        };
        let demos = SpatialEpisodes::open(episodes)?.demos();
        let bar = self.notes.progress(2 * (demos + left.len()) as u64, "audit");
        let limits = self.spatial_limits();
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
                listed.push(own.listed());
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
        let thresholds = Thresholds::of(&observations[..usual], &self.pipeline.audit, &self.spatial_dataset())
            .with_recorded_goals(recorded_goals(episodes)?);
        let mut findings = audit_copies(&observations, &thresholds);
        let (mut grasps, mut agreements) = (Vec::new(), Vec::new());
        for batch in in_batches(read()?) {
            self.interrupt.check("audit")?;
            let batch = batch?;
            for judged in self.judge_demos(&batch, &thresholds, &limits)? {
                findings.extend(judged.findings);
                grasps.extend(judged.grasps);
                agreements.extend(judged.agreements);
            }
            bar.inc(batch.len() as u64);
        }
        bar.finish_and_clear();
        Ok(Audited {
            thresholds,
            listed,
            findings,
            grasps,
            domain: OfDomain::Space,
            sketches,
            agreements,
        })
    }

    /// Makes all checks of demonstrations in SE(3).
    fn judge_demos(&self, batch: &[Audible], thresholds: &Thresholds, limits: &GraspLimits) -> Result<Vec<Judged>> {
        let judge = |own: &Audible| {
            let audit = audit_spatial(&own.demo, thresholds, limits);
            let grasps = audit.grasps.into_iter().filter(|_| own.kept);
            Ok(Judged {
                findings: audit.findings,
                grasps: grasps.filter_map(|grasp| list_grasp(&own.demo, grasp)).collect(),
                agreements: self.agreement(own)?,
            })
        };
        batch.par_iter().map(judge).collect()
    }

    /// What thresholds in SE(3) depend on besides the demonstrations.
    fn spatial_dataset(&self) -> Dataset {
        let gripper = self.pipeline.segment.gripper.clone().unwrap_or_default();
        Dataset::new(Domain::Space, gripper.closed)
    }

    /// The limits by which grasps in SE(3) are judged.
    fn spatial_limits(&self) -> GraspLimits {
        self.grasp_limits(self.spatial_dataset().closed)
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
            domain: OfDomain::Plane(contacts.flatten().collect::<Contacts>()),
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

impl Audible {
    /// The row of the demonstration. The frames of a demonstration that was left out are in no other table.
    fn listed(&self) -> Listed {
        if self.kept {
            list_spatial(&self.demo)
        } else {
            Listed::new(&self.demo.episode.name, 0, Vec::new(), 0.0)
        }
    }
}

/// What the checks of a demonstration found.
struct Judged {
    findings: Vec<Finding>,
    grasps: Vec<GraspRow>,
    agreements: Vec<RuleAgreementRow>,
}

/// Number of demonstrations that ingest used.
fn kept_of(episodes: &Artifact) -> u32 {
    episodes.manifest().summary["episodes"].as_u64().unwrap_or_default() as u32
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

/// Writes all tables of an artifact that is not in parts.
fn write(mut audited: Audited, writer: &Writer) -> Result<ArtifactSummary> {
    audited.complete(0);
    let mut tally = Tally::default();
    for listed in &audited.listed {
        tally.add_episode(&listed.row);
        let segments = listed.segments.iter();
        segments.for_each(|segment| tally.add_segment(segment.mode, segment.frames.len()));
    }
    for finding in &audited.findings {
        tally.add_finding(finding.code, finding.severity, finding.episode);
    }
    audited.grasps.iter().for_each(|row| tally.add_grasp(row));
    audited.agreements.iter().for_each(|row| tally.add_agreement(row));
    let findings = (0..).zip(&audited.findings);
    writer.write_rows(findings.map(|(number, found)| FindingRow::new(number, found)))?;
    writer.write_rows(checks(&audited.thresholds, &tally))?;
    writer.write_rows(audited.listed.iter().map(|listed| listed.row.clone()))?;
    writer.write_rows(re4_scores::score(&audited.sketches))?;
    if audited.thresholds.domain() == Domain::Space {
        writer.write_rows(audited.grasps)?;
        writer.write_rows(audited.agreements)?;
    }
    Ok(ArtifactSummary {
        summary: tally.summary(&audited.thresholds, audited.domain),
        warnings: Vec::new(),
    })
}

/// The rows of table `checks`.
fn checks(thresholds: &Thresholds, tally: &Tally) -> impl Iterator<Item = CheckRow> {
    let domain = thresholds.domain();
    thresholds.iter().map(move |(check, threshold)| {
        let (findings, episodes) = tally.found(check.code);
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
    })
}

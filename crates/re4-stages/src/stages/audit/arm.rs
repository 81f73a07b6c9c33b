//! The audit of demonstrations of an arm without an object.

use anyhow::Result;
use rayon::prelude::*;
use re4_artifact::Artifact;
use re4_audit::{
    ArmDemo, ArmFacts, ArmSurvey, FingerUnit, GraspLimits, Observation, Thresholds, audit_arm, audit_copies,
    observe_arm,
};
use re4_stats::median;
use serde_json::{Value, json};

use super::summary::OfDomain;
use super::{Audited, Listed};
use crate::inputs::arm::{ArmEpisodes, SegmentedArms, gripper, rate, signals};
use crate::inputs::demos::in_batches;
use crate::runner::Runner;

impl Runner {
    /// Audits demonstrations of an arm. They are read three times: for what is known about the dataset, for the thresholds, and for the
    /// checks.
    pub(super) fn audit_arm(&self, episodes: &Artifact, modes: &Artifact) -> Result<Audited> {
        let facts = self.arm_facts(episodes)?;
        let limits = self.arm_limits(&facts);
        let demos = ArmEpisodes::open(episodes)?.demos();
        let bar = self.notes.progress(2 * demos as u64, "audit");
        let (mut observations, mut listed, mut sketches) = (Vec::new(), Vec::new(), Vec::new());
        for batch in in_batches(SegmentedArms::open(episodes, modes)?) {
            self.interrupt.check("audit")?;
            let batch = batch?;
            observations.par_extend(batch.par_iter().map(|demo| observe_arm(demo, &facts, &limits)));
            sketches.par_extend(batch.par_iter().map(|demo| self.sketch_arm(demo, &facts)));
            listed.extend(batch.iter().map(list));
            bar.inc(batch.len() as u64);
        }
        let thresholds = Thresholds::of(&observations, &self.pipeline.audit, &facts.dataset());
        let mut findings = audit_copies(&observations, &thresholds);
        for batch in in_batches(SegmentedArms::open(episodes, modes)?) {
            self.interrupt.check("audit")?;
            let batch = batch?;
            let found: Vec<_> = batch
                .par_iter()
                .map(|demo| audit_arm(demo, &facts, &thresholds, &limits))
                .collect();
            findings.extend(found.into_iter().flatten());
            bar.inc(batch.len() as u64);
        }
        bar.finish_and_clear();
        Ok(Audited {
            domain: OfDomain::Arm(described(&facts, &observations, &thresholds)),
            thresholds,
            listed,
            findings,
            grasps: Vec::new(),
            sketches,
            agreements: Vec::new(),
        })
    }

    fn arm_facts(&self, episodes: &Artifact) -> Result<ArmFacts> {
        let gripper = gripper(episodes, &self.pipeline.segment)?;
        let mut eef = false;
        for episode in ArmEpisodes::open(episodes)?.take(1) {
            eef = episode?.1.frames.iter().all(|frame| frame.eef.is_some());
        }
        let survey = ArmSurvey::new(signals(episodes)?, eef);
        let mut observations = Vec::new();
        for batch in in_batches(ArmEpisodes::open(episodes)?) {
            self.interrupt.check("audit")?;
            let batch = batch?;
            observations.par_extend(batch.par_iter().map(|(_, episode)| survey.observe(episode)));
        }
        Ok(survey.facts(&observations, gripper, self.pipeline.segment.rule, rate(episodes)))
    }

    /// The limits by which closings of the gripper are judged. Openings are fractions of the travel.
    fn arm_limits(&self, facts: &ArmFacts) -> GraspLimits {
        let dataset = facts.dataset();
        let metres = self.grasp_limits(dataset.closed);
        let known = facts.gripper.as_ref().is_some_and(|gripper| gripper.shut.is_some());
        let frames = |steps: usize| facts.gripper.as_ref().map_or(steps, |gripper| gripper.frames(steps));
        GraspLimits {
            // Without a shut opening, no closing is a missed grasp.
            closed: if known { metres.closed } else { f64::MIN },
            flicker: frames(metres.flicker),
            frozen: frames(metres.frozen),
            fingers: FingerUnit::Travel,
            ..metres
        }
    }
}

fn list(demo: &ArmDemo) -> Listed {
    let segments = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
    Listed::new(&demo.episode.name, demo.episode.frames.len(), segments, 0.0)
}

/// What is known about the dataset, for the summary.
fn described(facts: &ArmFacts, observations: &[Observation], thresholds: &Thresholds) -> Value {
    let usual = thresholds.usual_response();
    let explained: Vec<f64> = observations
        .iter()
        .filter_map(|observation| observation.response.as_ref())
        .map(|fit| fit.correlation.powi(2))
        .collect();
    json!({
        "gripper": facts.gripper,
        "actions": {
            "kind": if facts.absolute { "absolute" } else { "delta" },
            "lag_frames": usual.map(|usual| usual.lag),
            "gain": usual.map(|usual| usual.gain),
            "median_explained": median(&explained),
        },
        "frame_seconds": facts.period,
    })
}

//! The tables of an `audit` artifact. Planar and spatial demonstrations have the same tables; where units differ, a column of the
//! row names them.

use std::ops::Range;

use nalgebra::Isometry3;
use re4_artifact::{Label, Word, table};
use re4_episode::Mode;
use re4_segment::Rule;

use crate::{Finding, GraspOutcome, Severity};

table! {
    /// One row per finding: what looks wrong, in which frames, and which value was compared with which threshold. Sorted by
    /// episode, first frame and code.
    #[table("findings", version = 3)]
    pub struct FindingRow {
        /// Number of the finding in this artifact, from 0.
        pub finding: u32,
        /// error: the segmentation or the data is wrong in these frames; warning: probably not what the demonstrator intended, or
        /// harmful to a policy that uses it; note: for information.
        pub severity: Severity,
        /// Code of the check that made the finding; table checks has its meaning.
        pub code: Label,
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// The affected frames.
        #[prefix = ""]
        pub frames: Range<u32>,
        /// Measured value; null if the check measures none.
        pub value: Option<f64>,
        /// Threshold that the value was compared with; null if the check has none.
        pub threshold: Option<f64>,
        /// Unit of value and threshold; empty if they have none.
        pub unit: Label,
        /// Description of the finding in one sentence.
        pub message: String,
        /// Name of the demonstration in its source: the group below /data of an HDF5 file, such as demo_12; for Push-T the word
        /// episode and its number. Null in older artifacts.
        #[since = 2]
        pub demo_name: Option<String>,
        /// Number of the other demonstration that the finding is about, such as the original of a copy; null if there is none,
        /// and in older artifacts.
        #[since = 3]
        pub other_episode: Option<u32>,
        /// Name of that demonstration in its source.
        #[since = 3]
        pub other_demo: Option<String>,
    }
}

impl FindingRow {
    /// Makes the row of a finding; `finding` is its number in the artifact.
    pub fn new(finding: u32, found: &Finding) -> Self {
        Self {
            finding,
            severity: found.severity,
            code: found.code.into(),
            episode: found.episode,
            frames: found.frames.clone(),
            value: found.value,
            threshold: found.threshold,
            unit: found.unit.into(),
            message: found.message.clone(),
            demo_name: Some(found.demo.clone()),
            other_episode: found.other,
            other_demo: found.other_demo.clone(),
        }
    }
}

table! {
    /// One row per check that applies to the dataset, whether or not it has findings, with its threshold and the threshold's
    /// origin. Sorted by code.
    #[table("checks", version = 1)]
    pub struct CheckRow {
        /// Code of the check and of its findings.
        pub code: Label,
        /// Severity of its findings.
        pub severity: Severity,
        /// What a finding means, and what to do about it.
        pub meaning: String,
        /// What is measured.
        pub measure: String,
        /// Threshold that the measured value is compared with; null if the check has none, or does not run.
        pub threshold: Option<f64>,
        /// Unit of the threshold; empty if it has none.
        pub unit: Label,
        /// Origin of the threshold: data, derived from this dataset; setting, from the pipeline file; default, built in.
        pub origin: Label,
        /// Description of how the threshold was determined.
        pub derivation: String,
        /// Number of its findings.
        pub findings: u32,
        /// Number of demonstrations with such a finding.
        pub episodes: u32,
    }
}

table! {
    /// One row per demonstration: its length, its modes and the number of its findings. Sorted by episode.
    #[table("audited_episodes", version = 1)]
    pub struct AuditedEpisodeRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Name of the demonstration in its source.
        pub demo: String,
        /// Number of frames.
        pub frames: usize,
        /// Number of frames in transit.
        pub transit_frames: usize,
        /// Number of frames in transfer.
        pub transfer_frames: usize,
        /// Number of segments.
        pub segments: usize,
        /// Number of transfer segments.
        pub transfers: usize,
        /// First transfer frame; null if there is none.
        pub grasp_frame: Option<usize>,
        /// Distance between the positions of the object's origin at the first and the last frame, in px for Push-T and in m for
        /// robosuite tasks.
        pub object_displacement: f64,
        /// Number of findings of severity error.
        pub errors: u32,
        /// Number of findings of severity warning.
        pub warnings: u32,
        /// Number of findings of severity note.
        pub notes: u32,
    }
}

table! {
    /// One row per demonstration with a gripper and rule of segmentation: how far the modes by the rule agree with those of the
    /// artifact. Sorted by episode and rule.
    #[table("rule_agreement", version = 1)]
    pub struct RuleAgreementRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Name of the demonstration in its source.
        pub demo: String,
        /// The rule: gripper_command, grasp, evidence or rigid_motion.
        pub rule: Label,
        /// Whether it is the rule of the pipeline.
        pub configured: bool,
        /// Number of frames in transfer by the rule.
        pub transfer_frames: usize,
        /// First transfer frame by the rule; null if there is none.
        pub first_transfer: Option<usize>,
        /// Fraction of the frames with the same mode as by the pipeline's rule.
        pub agreement: f64,
        /// Intersection over union of the transfer frames of the two rules; null if neither has any.
        pub overlap: Option<f64>,
    }
}

impl RuleAgreementRow {
    /// Compares the modes by a rule with those of the artifact.
    pub fn new(episode: u32, demo: &str, rule: Rule, configured: bool, modes: &[Mode], own: &[Mode]) -> Self {
        let transfer = |mode: &Mode| *mode == Mode::Transfer;
        let pairs = || modes.iter().zip(own);
        let both = pairs().filter(|(a, b)| transfer(a) && transfer(b)).count();
        let either = pairs().filter(|(a, b)| transfer(a) || transfer(b)).count();
        Self {
            episode,
            demo: demo.to_owned(),
            rule: rule.as_str().into(),
            configured,
            transfer_frames: modes.iter().filter(|mode| transfer(mode)).count(),
            first_transfer: modes.iter().position(transfer),
            agreement: pairs().filter(|(a, b)| a == b).count() as f64 / modes.len().max(1) as f64,
            overlap: (either > 0).then(|| both as f64 / either as f64),
        }
    }
}

table! {
    /// One row per transfer segment of a demonstration with a gripper: where the object was grasped, and the outcome. Sorted by
    /// episode and segment.
    #[table("grasps", version = 1)]
    pub struct GraspRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Number of the segment in its episode, from 0.
        pub segment: usize,
        /// Frames of the segment.
        #[prefix = ""]
        pub frames: Range<usize>,
        /// held: the object stays fixed to the end effector; missed: the fingers closed on nothing, or on something that does not
        /// follow the end effector; lost: the object was held, but slipped out before the command to open; brief: too short to be
        /// judged, or cut off by the end of the recording.
        pub outcome: Label,
        /// Pose of the end effector in the object's frame at the frame where the fingers have stopped closing, or at the first
        /// frame of the segment if they never stop.
        #[frame = "object"]
        pub grasp: Isometry3<f64>,
        /// Distance between the fingers at that frame.
        #[unit = "m"]
        pub finger_separation: f64,
        /// Largest distance of the end effector, in the object's frame, from the grasp transform, over the part of the segment in
        /// which the object is held.
        #[unit = "m"]
        pub rigidity_residual: f64,
        /// Maximum height of the object over its height at the start of the segment.
        #[unit = "m"]
        pub object_rise: f64,
    }
}

impl GraspRow {
    /// Whether the object was held until the command to open.
    pub fn is_held(&self) -> bool {
        self.outcome == GraspOutcome::Held.as_str()
    }
}

impl Word for Severity {
    const ALL: &'static [Self] = &[Self::Note, Self::Warning, Self::Error];

    fn word(self) -> &'static str {
        self.as_str()
    }
}

//! The tables of an `audit` artifact: of planar and of spatial demonstrations alike. Units are those of the row.

use std::ops::Range;

use nalgebra::Isometry3;
use re4_artifact::{Label, Word, table};

use crate::{Finding, GraspOutcome, Severity};

table! {
    /// One row a finding: what looks wrong, where, by which measure against which threshold. Sorted by episode, first frame and
    /// code.
    #[table("findings", version = 2)]
    pub struct FindingRow {
        /// Number of the finding in this artifact, from 0.
        pub finding: u32,
        /// error: the segmentation or the data is wrong here; warning: probably not what the demonstrator wanted, or a trap for a
        /// learner; note: worth knowing.
        pub severity: Severity,
        /// Kind of the finding; its meaning stands in table checks.
        pub code: Label,
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Frames that it concerns.
        #[prefix = ""]
        pub frames: Range<u32>,
        /// What was measured; null where there is nothing to measure.
        pub value: Option<f64>,
        /// What it was compared with; null likewise.
        pub threshold: Option<f64>,
        /// Unit of value and threshold; empty for none.
        pub unit: Label,
        /// The finding in one sentence.
        pub message: String,
        /// Name of the demonstration in its source: the group below /data of an HDF5 file, such as demo_12; of Push-T the word
        /// episode and its number. Null in older artifacts.
        #[since = 2]
        pub demo_name: Option<String>,
    }
}

impl FindingRow {
    /// The row of the finding of this number.
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
        }
    }
}

table! {
    /// One row a check that was made, whether or not it found something, with its threshold and where that comes from. Sorted by
    /// code.
    #[table("checks", version = 1)]
    pub struct CheckRow {
        /// Kind of finding that it makes.
        pub code: Label,
        /// Severity of its findings.
        pub severity: Severity,
        /// What such a finding means, and what to do about it.
        pub meaning: String,
        /// What is measured.
        pub measure: String,
        /// What it is compared with; null where there is none.
        pub threshold: Option<f64>,
        /// Unit of the threshold; empty for none.
        pub unit: Label,
        /// Where the threshold comes from: data, derived from this dataset; setting, from the pipeline file; default, built in.
        pub origin: Label,
        /// How it was derived, in words.
        pub derivation: String,
        /// How many findings it made.
        pub findings: u32,
        /// In how many demonstrations.
        pub episodes: u32,
    }
}

table! {
    /// One row a demonstration: its length, its modes and how much was found in it. Sorted by episode.
    #[table("audited_episodes", version = 1)]
    pub struct AuditedEpisodeRow {
        /// Number of the demonstration in this artifact, from 0.
        pub episode: u32,
        /// Name of the demonstration in its source.
        pub demo: String,
        /// Frames.
        pub frames: usize,
        /// Frames in transit.
        pub transit_frames: usize,
        /// Frames in transfer.
        pub transfer_frames: usize,
        /// Segments.
        pub segments: usize,
        /// Transfer segments.
        pub transfers: usize,
        /// First transfer frame; null where there is none.
        pub grasp_frame: Option<usize>,
        /// Distance of the object's origin at the end from where it was at the start; px or m, as the task's tables.
        pub object_displacement: f64,
        /// Findings of severity error.
        pub errors: u32,
        /// Findings of severity warning.
        pub warnings: u32,
        /// Findings of severity note.
        pub notes: u32,
    }
}

table! {
    /// One row a transfer segment of a demonstration with a gripper: where the object was grasped and how it went. Sorted by
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
        /// held: the object stays fixed to the end effector; missed: the fingers closed on nothing; lost: it was held, and slipped
        /// out before the command to open; brief: too short to tell.
        pub outcome: Label,
        /// End effector in the object's frame at the settled frame.
        #[frame = "object"]
        pub grasp: Isometry3<f64>,
        /// Distance between the fingers at the settled frame.
        #[unit = "m"]
        pub finger_separation: f64,
        /// Largest distance of the end effector in the object's frame from the grasp transform, over the part of the segment that is
        /// held.
        #[unit = "m"]
        pub rigidity_residual: f64,
        /// Maximum height of the object over where it was at the start of the segment.
        #[unit = "m"]
        pub object_rise: f64,
    }
}

impl GraspRow {
    /// Whether the object stays fixed to the end effector.
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

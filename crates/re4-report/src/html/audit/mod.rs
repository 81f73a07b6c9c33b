//! One self-contained HTML page over the audit of a dataset: every demonstration as a timeline of its modes with the
//! findings on it, the evidence of a chosen one, where objects were grasped, how long segments are, and which checks were
//! made against which thresholds.
//!
//! The page's bytes follow from [`Audit`] alone. Nothing is thinned: evidence is drawn from 32-bit floats, one a frame and
//! series; every figure in words is the artifact's own 64-bit number.

mod data;
mod sections;

use maud::{Markup, html};
use re4_artifact::episodes::Convention;
use re4_audit::{AuditedEpisodeRow, CheckRow, FindingRow, Severity};

use super::shell::Document;

/// What the page shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Audit {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// The dataset's name.
    pub dataset: String,
    /// The task's name.
    pub task: String,
    /// The command that made the page.
    pub command: String,
    /// Artifacts that went in: their kind and key.
    pub artifacts: Vec<(String, String)>,
    /// Duration of a frame, s.
    pub frame_seconds: f64,
    /// How lengths are given and shown.
    pub length: Measure,
    /// Demonstrations, by number.
    pub demos: Vec<AuditedEpisodeRow>,
    /// Checks, in the order of the artifact.
    pub checks: Vec<CheckRow>,
    /// Findings, in the order of the artifact.
    pub findings: Vec<FindingRow>,
    /// Segments, by demonstration and frame.
    pub segments: Vec<Segment>,
    /// Grasps: where the end effector took the object, in the object's frame. In the plane, where contact begins.
    pub grasps: Vec<Grasp>,
    /// Outline of the object in its own frame, where it is planar; there grasps have no height.
    pub outline: Option<Vec<[f64; 2]>>,
    /// Steps by contact and motion of the object, where contacts are recorded.
    pub contacts: Option<Contacts>,
    /// Conventions of the dataset.
    pub conventions: Vec<Convention>,
    /// Summary of each frame that hold or not, beside the mode.
    pub flags: Vec<Flag>,
    /// Evidence by frame, plot by plot.
    pub panels: Vec<Panel>,
}

/// How a quantity is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct Measure {
    /// Unit on the page.
    pub unit: String,
    /// By what the artifact's values are multiplied to be in that unit.
    pub factor: f64,
}

/// A segment; lengths in the artifact's unit, angles in rad.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Segment {
    /// Number of its demonstration.
    pub episode: u32,
    /// Number in its demonstration.
    pub number: u32,
    /// Whether it is transfer; else transit.
    pub transfer: bool,
    /// First frame.
    pub first_frame: u32,
    /// Frame after the last one.
    pub end_frame: u32,
    /// First frame at which the fingers have stopped closing.
    pub settled_frame: Option<u32>,
    /// Distance between the fingers there.
    pub finger_separation: Option<f64>,
    /// Largest distance of the end effector in the object's frame from the grasp.
    pub residual: Option<f64>,
    /// Largest angle likewise.
    pub residual_rotation: Option<f64>,
    /// Distance of the object's origin at the end from where it was at the start.
    pub object_displacement: f64,
    /// Height of the object's origin at the end over that at the start.
    pub object_rise: Option<f64>,
}

/// A grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Number of its demonstration.
    pub episode: u32,
    /// Number of its segment.
    pub segment: u32,
    /// First frame of the segment, or of the contact.
    pub first_frame: u32,
    /// Frame after the last one of the segment, or of the contact.
    pub end_frame: u32,
    /// How it went; empty where that is not told.
    pub outcome: String,
    /// The end effector in the object's frame, in the artifact's unit; the height is 0 in the plane.
    pub position: [f64; 3],
}

/// Steps by contact and motion of the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contacts {
    /// With contact and with motion.
    pub both: u64,
    /// With contact, and the object rests.
    pub contact_alone: u64,
    /// With motion, and without contact.
    pub motion_alone: u64,
    /// With neither.
    pub neither: u64,
    /// Steps with both over steps with either; `None` where there are none.
    pub jaccard: Option<f64>,
}

/// A fact of each frame that holds or not.
#[derive(Debug, Clone, PartialEq)]
pub struct Flag {
    /// Its name on the page.
    pub label: String,
    /// For all frames of all demonstrations, in order.
    pub values: Vec<Option<bool>>,
}

/// A plot of evidence over frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What it shows.
    pub title: String,
    /// How its values are shown.
    pub measure: Measure,
    /// Its curves.
    pub series: Vec<Series>,
}

/// A curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Its name; empty where it is the plot's only one.
    pub label: String,
    /// For all frames of all demonstrations, in order; not a number where there is none.
    pub values: Vec<f64>,
}

/// Severities, the worst first.
pub(crate) const SEVERITIES: [Severity; 3] = [Severity::Error, Severity::Warning, Severity::Note];

/// The script, part by part, after what all pages share.
const SCRIPT: [&str; 7] = [
    include_str!("script/data.js"),
    include_str!("script/state.js"),
    include_str!("script/filters.js"),
    include_str!("script/timelines.js"),
    include_str!("script/evidence.js"),
    include_str!("script/grasps.js"),
    include_str!("script/main.js"),
];

/// The page.
pub fn page(audit: &Audit) -> String {
    Document {
        tool_version: &audit.tool_version,
        title: format!("Audit of {}", audit.dataset),
        style: include_str!("page.css"),
        script: &SCRIPT,
        data: &data::json(audit),
        body: body(audit),
    }
    .render()
}

fn body(audit: &Audit) -> Markup {
    html! {
        a.skip href="#evidence" { "Skip to the chosen demonstration" }
        (sections::header(audit))
        main {
            (sections::findings(audit))
            (sections::workbench(audit))
            (sections::dataset(audit))
            (sections::checks(audit))
            (sections::conventions(audit))
        }
        (sections::footer(audit))
    }
}

#[cfg(test)]
mod tests;

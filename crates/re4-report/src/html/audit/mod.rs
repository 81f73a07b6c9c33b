//! A self-contained HTML page of the audit of a dataset. It shows a timeline of every demonstration with its modes and findings,
//! the evidence of a selected demonstration, the positions at which objects were grasped, the lengths of segments, and all checks
//! with their thresholds.
//!
//! The page's bytes depend only on [`Audit`]. The evidence is not subsampled: it is plotted from 32-bit floats, one per frame and
//! series. Numbers in text are the 64-bit values of the artifact.

mod data;
mod scores;
mod sections;

use maud::{Markup, html};
use re4_artifact::episodes::Convention;
use re4_audit::{AuditedEpisodeRow, CheckRow, FindingRow, Severity};
use re4_scores::ScoreRow;

use super::shell::Document;

/// The content of the page.
#[derive(Debug, Clone, PartialEq)]
pub struct Audit {
    /// Version of the program that makes the page.
    pub tool_version: String,
    /// Name of the dataset.
    pub dataset: String,
    /// Name of the task.
    pub task: String,
    /// The command that made the page.
    pub command: String,
    /// Kind and key of every artifact that the page was made from.
    pub artifacts: Vec<(String, String)>,
    /// Duration of a frame, in s.
    pub frame_seconds: f64,
    /// Unit in which lengths are shown.
    pub length: Measure,
    /// Demonstrations, sorted by number.
    pub demos: Vec<AuditedEpisodeRow>,
    /// Checks, in the order of the artifact.
    pub checks: Vec<CheckRow>,
    /// Findings, in the order of the artifact.
    pub findings: Vec<FindingRow>,
    /// Segments, sorted by demonstration and frame.
    pub segments: Vec<Segment>,
    /// The grasps of all demonstrations; for Push-T, the frames at which contact begins.
    pub grasps: Vec<Grasp>,
    /// Whether the demonstrations have an object. Otherwise, there are neither grasps nor measurements of the object.
    pub object: bool,
    /// Outline of the object in its own frame; only for a planar object, whose grasps have no height.
    pub outline: Option<Vec<[f64; 2]>>,
    /// Numbers of steps by contact and motion of the object, if contacts were recorded.
    pub contacts: Option<Contacts>,
    /// Conventions of the dataset.
    pub conventions: Vec<Convention>,
    /// Boolean evidence by frame.
    pub flags: Vec<Flag>,
    /// Numeric evidence by frame, one entry per plot.
    pub panels: Vec<Panel>,
    /// Quality scores, sorted by demonstration; empty for artifacts without them.
    pub scores: Vec<ScoreRow>,
    /// Camera images at findings, in the order of the findings.
    pub shots: Vec<Shot>,
}

/// A camera image at a finding.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// Place of the finding in the list of findings.
    pub finding: usize,
    /// Frame of the image.
    pub frame: u32,
    /// The bytes of a PNG file.
    pub png: Vec<u8>,
}

/// The unit in which a quantity is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct Measure {
    /// Unit on the page.
    pub unit: String,
    /// Factor from the artifact's unit to the unit on the page.
    pub factor: f64,
}

/// A segment. Lengths are in the artifact's unit, angles in rad.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Segment {
    /// Number of its demonstration in the artifact.
    pub episode: u32,
    /// Number of the segment in its demonstration.
    pub number: u32,
    /// Whether the mode is transfer; otherwise it is transit.
    pub transfer: bool,
    /// First frame.
    pub first_frame: u32,
    /// Frame after the last one.
    pub end_frame: u32,
    /// First frame at which the fingers have stopped closing.
    pub settled_frame: Option<u32>,
    /// Distance between the fingers at the grasp.
    pub finger_separation: Option<f64>,
    /// Largest distance of the end effector, in the object's frame, from the grasp transform.
    pub residual: Option<f64>,
    /// Largest angle of the end effector, in the object's frame, from the grasp transform.
    pub residual_rotation: Option<f64>,
    /// Distance between the positions of the object's origin at the start and at the end.
    pub object_displacement: f64,
    /// Height of the object's origin at the end, minus that at the start.
    pub object_rise: Option<f64>,
}

/// A grasp, or a contact of Push-T's pusher.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Number of its demonstration in the artifact.
    pub episode: u32,
    /// Number of its segment in the demonstration.
    pub segment: u32,
    /// First frame of the segment, or of the contact.
    pub first_frame: u32,
    /// Frame after the last one of the segment, or of the contact.
    pub end_frame: u32,
    /// Outcome of the grasp; empty for a contact, which has none.
    pub outcome: String,
    /// Position of the end effector in the object's frame, in the artifact's unit; the height is 0 for a planar object.
    pub position: [f64; 3],
}

/// Numbers of steps by contact and motion of the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contacts {
    /// Steps with contact and with motion.
    pub both: u64,
    /// Steps with contact, but without motion.
    pub contact_alone: u64,
    /// Steps with motion, but without contact.
    pub motion_alone: u64,
    /// Steps with neither.
    pub neither: u64,
    /// Jaccard index: steps with both, divided by steps with at least one of them; `None` if there are none.
    pub jaccard: Option<f64>,
}

/// Boolean evidence by frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Flag {
    /// Name on the page.
    pub label: String,
    /// Values of all frames of all demonstrations, in order; `None` if unknown.
    pub values: Vec<Option<bool>>,
}

/// A plot of numeric evidence over frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Title of the plot.
    pub title: String,
    /// Unit in which its values are shown.
    pub measure: Measure,
    /// Its curves.
    pub series: Vec<Series>,
}

/// A curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name of the curve; empty if it is the only one of its plot.
    pub label: String,
    /// Values of all frames of all demonstrations, in order; NaN if there is none.
    pub values: Vec<f64>,
}

/// Severities, the most severe first.
pub(crate) const SEVERITIES: [Severity; 3] = [Severity::Error, Severity::Warning, Severity::Note];

/// Script parts of this page. They run after the parts that all pages have.
const SCRIPT: [&str; 9] = [
    include_str!("script/data.js"),
    include_str!("script/state.js"),
    include_str!("script/keep.js"),
    include_str!("script/filters.js"),
    include_str!("script/timelines.js"),
    include_str!("script/evidence.js"),
    include_str!("script/grasps.js"),
    include_str!("script/scores.js"),
    include_str!("script/main.js"),
];

/// Renders the page.
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
        a.skip href="#evidence" { "Skip to the selected demonstration" }
        (sections::header(audit))
        main {
            (sections::findings(audit))
            (scores::left_out(audit))
            (sections::workbench(audit))
            (scores::keep_list(audit))
            (scores::scores(audit))
            (sections::dataset(audit))
            (sections::checks(audit))
            (sections::conventions(audit))
        }
        (sections::footer(audit))
    }
}

#[cfg(test)]
mod tests;

//! What an audit finds.

use std::ops::Range;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Worth knowing.
    Note,
    /// Probably not what the demonstrator wanted, or a trap for a learner.
    Warning,
    /// The segmentation or the data is wrong here.
    Error,
}

impl Severity {
    /// The word used in tables and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Note => "note",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// What looks wrong, where, by which measure.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// Kind of the finding.
    pub code: &'static str,
    /// Number of the demonstration in the artifact, from 0.
    pub episode: u32,
    /// Its name in its source.
    pub demo: String,
    /// Frames that it concerns.
    pub frames: Range<u32>,
    /// What was measured.
    pub value: Option<f64>,
    /// What it was compared with.
    pub threshold: Option<f64>,
    /// Unit of both.
    pub unit: &'static str,
    /// The finding in one sentence.
    pub message: String,
}

//! The findings of an audit.

use std::ops::Range;

/// The severity of a finding, in increasing order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// For information.
    Note,
    /// Probably not what the demonstrator intended, or harmful to a policy that uses it.
    Warning,
    /// The segmentation or the data is wrong in these frames.
    Error,
}

impl Severity {
    /// The name used in tables and messages.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Note => "note",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// Something that looks wrong in a demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Its severity.
    pub severity: Severity,
    /// Code of the check that made it.
    pub code: &'static str,
    /// Number of the demonstration in the artifact, from 0.
    pub episode: u32,
    /// Name of the demonstration in its source.
    pub demo: String,
    /// The affected frames.
    pub frames: Range<u32>,
    /// The measured value; `None` if the check measures none.
    pub value: Option<f64>,
    /// The threshold that the value was compared with; `None` if the check has none.
    pub threshold: Option<f64>,
    /// Unit of value and threshold; empty if they have none.
    pub unit: &'static str,
    /// Describes the finding in one sentence.
    pub message: String,
    /// Number of the other demonstration that the finding is about, such as the original of a copy.
    pub other: Option<u32>,
    /// Name of that demonstration in its source.
    pub other_demo: Option<String>,
}

//! What the audits of all demonstrations share.

use std::ops::Range;

use re4_episode::Segment;

use crate::checks::find;
use crate::finding::{Finding, Severity};
use crate::thresholds::{Observation, Thresholds};

/// Collects findings of one demonstration.
pub(crate) struct Sink<'a> {
    episode: u32,
    demo: String,
    pub(crate) thresholds: &'a Thresholds,
    pub(crate) findings: Vec<Finding>,
}

impl<'a> Sink<'a> {
    pub(crate) fn new(episode: u32, demo: &str, thresholds: &'a Thresholds) -> Self {
        Self {
            episode,
            demo: demo.to_owned(),
            thresholds,
            findings: Vec::new(),
        }
    }

    /// A finding of this check, with the severity, the unit and the threshold that the check has.
    pub(crate) fn add(&mut self, code: &'static str, frames: Range<usize>, value: Option<f64>, message: String) {
        let check = find(code);
        self.findings.push(Finding {
            severity: check.map_or(Severity::Note, |check| check.severity),
            code,
            episode: self.episode,
            demo: self.demo.clone(),
            frames: frames.start as u32..frames.end as u32,
            value,
            threshold: self.thresholds.value(code),
            unit: check.map_or("", |check| check.unit_of(self.thresholds.planar())),
            message,
        });
    }

    /// A finding if the value exceeds the check's threshold.
    pub(crate) fn exceeding(
        &mut self,
        code: &'static str,
        frames: Range<usize>,
        value: f64,
        message: impl FnOnce(f64) -> String,
    ) {
        if value > self.thresholds.over(code) {
            self.add(code, frames, Some(value), message(value));
        }
    }

    /// One finding for all crossings of one seam.
    pub(crate) fn seam(&mut self, what: &str, crossings: &[usize]) {
        if let (Some(first), Some(last)) = (crossings.first(), crossings.last()) {
            let count = crossings.len();
            let message = match count {
                1 => format!("{what} once"),
                2 => format!("{what} twice"),
                _ => format!("{what} {count} times"),
            };
            self.add("seam", *first..*last + 2, Some(count as f64), message);
        }
    }
}

/// Outlying length, and segments too short to mean anything.
pub(crate) fn lengths_and_flicker(sink: &mut Sink<'_>, segments: &[Segment], frames: usize) {
    let thresholds = sink.thresholds;
    if thresholds.length_deviation > 0.0 {
        let z = (frames as f64 - thresholds.usual_length) / thresholds.length_deviation;
        sink.exceeding("outlier_length", 0..frames, z.abs(), |_| {
            format!("{frames} frames, where {} are usual", thresholds.usual_length)
        });
    }
    let minimum = thresholds.over("flicker");
    let inner = segments.get(1..segments.len().saturating_sub(1)).unwrap_or_default();
    for segment in inner {
        let length = segment.frames.len();
        if (length as f64) < minimum && minimum.is_finite() {
            sink.add(
                "flicker",
                segment.frames.clone(),
                Some(length as f64),
                match length {
                    1 => format!("one frame of {} between two others", segment.mode),
                    _ => format!("{length} frames of {} between two others", segment.mode),
                },
            );
        }
    }
}

/// Demonstrations that are the same as one before, or have the same actions.
pub fn audit_copies(observations: &[Observation], thresholds: &Thresholds) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (place, observation) in observations.iter().enumerate() {
        let before = observations.get(..place).unwrap_or_default();
        let all = 0..observation.frames as usize;
        let mut sink = Sink::new(observation.episode, &observation.demo, thresholds);
        if let Some(same) = before.iter().find(|other| other.recording == observation.recording) {
            let message = format!("the same as {}, bit for bit", same.demo);
            sink.add("duplicate", all, None, message);
        } else if let Some(same) = before.iter().find(|other| other.actions == observation.actions) {
            let message = format!("the same actions as {}, from other states", same.demo);
            sink.add("same_actions", all, None, message);
        }
        findings.append(&mut sink.findings);
    }
    findings
}

/// Hash of numbers, bit for bit.
pub(crate) fn hash(values: impl IntoIterator<Item = f64>) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    for value in values {
        hasher.update(&value.to_le_bytes());
    }
    *hasher.finalize().as_bytes()
}

//! Code shared by the planar and the spatial audit.

use std::ops::Range;

use re4_episode::Segment;

use crate::checks::find;
use crate::finding::{Finding, Severity};
use crate::thresholds::{Observation, Thresholds};

/// Collects the findings of one demonstration.
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

    /// Adds a finding of a check, with the severity, the unit and the threshold of that check.
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

    /// Adds a finding if the value exceeds the threshold of the check.
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

    /// Adds one finding for all jumps of one kind in the representation. `crossings` are the frames before the jumps, in
    /// increasing order.
    pub(crate) fn seam(&mut self, what: &str, crossings: &[usize]) {
        if let (Some(first), Some(last)) = (crossings.first(), crossings.last()) {
            let count = crossings.len();
            let message = match count {
                1 => format!("{what} once"),
                2 => format!("{what} twice"),
                _ => format!("{what} {count} times"),
            };
            // The last jump is between frames `last` and `last + 1`; the end of the range is exclusive.
            self.add("seam", *first..*last + 2, Some(count as f64), message);
        }
    }
}

/// Reports a demonstration of unusual length, and segments that are too short to be meaningful.
pub(crate) fn lengths_and_flicker(sink: &mut Sink<'_>, segments: &[Segment], frames: usize) {
    let thresholds = sink.thresholds;
    if thresholds.length_deviation > 0.0 {
        let z = (frames as f64 - thresholds.usual_length) / thresholds.length_deviation;
        sink.exceeding("outlier_length", 0..frames, z.abs(), |_| {
            format!("{frames} frames; the median is {}", thresholds.usual_length)
        });
    }
    let minimum = thresholds.over("flicker");
    // The first and the last segment may be short because the recording starts or ends there.
    let inner = segments.get(1..segments.len().saturating_sub(1)).unwrap_or_default();
    for segment in inner {
        let length = segment.frames.len();
        if (length as f64) < minimum && minimum.is_finite() {
            sink.add(
                "flicker",
                segment.frames.clone(),
                Some(length as f64),
                match length {
                    1 => format!("one frame of {} between two other segments", segment.mode),
                    _ => format!("{length} frames of {} between two other segments", segment.mode),
                },
            );
        }
    }
}

/// Reports demonstrations that are identical to an earlier one, or have the same actions as an earlier one.
pub fn audit_copies(observations: &[Observation], thresholds: &Thresholds) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (place, observation) in observations.iter().enumerate() {
        let before = observations.get(..place).unwrap_or_default();
        let all = 0..observation.frames as usize;
        let mut sink = Sink::new(observation.episode, &observation.demo, thresholds);
        if let Some(same) = before.iter().find(|other| other.recording == observation.recording) {
            let message = format!("identical to {}, bit for bit", same.demo);
            sink.add("duplicate", all, None, message);
        } else if let Some(same) = before.iter().find(|other| other.actions == observation.actions) {
            let message = format!("the same actions as {}, but other states", same.demo);
            sink.add("same_actions", all, None, message);
        }
        findings.append(&mut sink.findings);
    }
    findings
}

/// Hashes the bits of numbers. Equal hashes mean bit-for-bit equal sequences.
pub(crate) fn hash(values: impl IntoIterator<Item = f64>) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    for value in values {
        hasher.update(&value.to_le_bytes());
    }
    *hasher.finalize().as_bytes()
}

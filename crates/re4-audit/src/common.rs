//! Code shared by the planar and the spatial audit.

use std::ops::Range;

use re4_episode::Segment;
use re4_task::Domain;

use crate::checks::find;
use crate::finding::{Finding, Severity};
use crate::runs::{bursts, runs};
use crate::thresholds::Thresholds;

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
        // A check that an arm's dataset does not allow may still have measured something.
        if self.thresholds.domain() == Domain::Arm && !self.thresholds.made(code) {
            return;
        }
        let check = find(code);
        self.findings.push(Finding {
            severity: check.map_or(Severity::Note, |check| check.severity),
            code,
            episode: self.episode,
            demo: self.demo.clone(),
            frames: frames.start as u32..frames.end as u32,
            value,
            threshold: self.thresholds.value(code),
            unit: check.map_or("", |check| check.unit_of(self.thresholds.domain())),
            message,
            other: None,
            other_demo: None,
        });
    }

    /// Links the last finding with another demonstration.
    pub(crate) fn link(&mut self, other: u32, demo: &str) {
        if let Some(finding) = self.findings.last_mut() {
            finding.other = Some(other);
            finding.other_demo = Some(demo.to_owned());
        }
    }

    /// Adds one finding for each burst of values that exceed the threshold of the check, with the largest value. The values are
    /// those of steps; a step from frame t concerns the frames t and t + 1.
    pub(crate) fn bursts(&mut self, code: &'static str, steps: &[f64], message: impl Fn(f64) -> String) {
        for (steps, largest) in bursts(steps, self.thresholds.over(code)) {
            self.add(code, steps.start..steps.end + 1, Some(largest), message(largest));
        }
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
    let short = |segment: &Segment| (segment.frames.len() as f64) < minimum && minimum.is_finite();
    for row in runs(inner.iter().map(short), 1) {
        let row = inner.get(row).unwrap_or_default();
        let lengths = || row.iter().map(|segment| segment.frames.len());
        let (Some(first), Some(last), Some(shortest), Some(longest)) =
            (row.first(), row.last(), lengths().min(), lengths().max())
        else {
            continue;
        };
        sink.add(
            "flicker",
            first.frames.start..last.frames.end,
            Some(shortest as f64),
            match (row.len(), shortest) {
                (1, 1) => format!("one frame of {} between two other segments", first.mode),
                (1, _) => format!("{shortest} frames of {} between two other segments", first.mode),
                (count, _) if shortest == longest => format!("{count} segments of {shortest} frames in a row"),
                (count, _) => format!("{count} segments of {shortest} to {longest} frames in a row"),
            },
        );
    }
}

/// Hashes the bits of numbers. Equal hashes mean bit-for-bit equal sequences.
pub(crate) fn hash(values: impl IntoIterator<Item = f64>) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    for value in values {
        hasher.update(&value.to_le_bytes());
    }
    *hasher.finalize().as_bytes()
}

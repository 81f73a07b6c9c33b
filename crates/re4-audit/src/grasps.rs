//! What became of every command to close, and of the object after every command to open.

use std::ops::Range;

use nalgebra::Vector3;
use re4_episode::{Mode, SpatialFrame};
use re4_segment::{SpatialEvidence, SpatialSegment};

use crate::spatial::SpatialDemo;

/// How a transfer segment went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GraspOutcome {
    /// The object stays fixed to the end effector.
    Held,
    /// The fingers closed on nothing, or on something that does not follow.
    Missed,
    /// It was held, and slipped out before the command to open, from this frame on.
    Lost(usize),
    /// Too short to tell.
    Brief,
}

impl GraspOutcome {
    /// The word used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Held => "held",
            Self::Missed => "missed",
            Self::Lost(_) => "lost",
            Self::Brief => "brief",
        }
    }
}

/// A transfer segment, judged.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedGrasp {
    /// Number of the segment in its demonstration.
    pub segment: usize,
    /// Frames of the segment.
    pub frames: Range<usize>,
    /// How it went.
    pub outcome: GraspOutcome,
    /// Frame from which on the fingers had stopped, or the first one.
    pub settled: usize,
    /// Narrowest distance between the fingers in the segment.
    pub narrowest: f64,
    /// Largest distance of the end effector, in the object's frame, from the grasp transform, while it was held.
    pub residual: f64,
    /// Largest angle, likewise.
    pub residual_rotation: f64,
    /// Maximum height of the object over where it was at the start of the segment.
    pub rise: f64,
    /// Whether the object has stayed in the hand since the transfer segment before, across a flicker of the command.
    pub continues: bool,
}

/// What happens after the command to open.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Release {
    /// First frame after the command.
    pub(crate) frame: usize,
    /// Frame at which the object has come to rest.
    pub(crate) rest: usize,
    /// How far it has fallen by then.
    pub(crate) fall: f64,
    /// Where it rests.
    pub(crate) place: Vector3<f64>,
}

/// The parts of the configuration that grasps are judged by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspLimits {
    /// Fingers nearer than this hold nothing.
    pub closed: f64,
    /// An object further than this from its place in the hand is no longer held.
    pub lost: f64,
    /// Segments shorter than this, in frames, are flicker.
    pub flicker: usize,
}

/// Judges every transfer segment.
pub(crate) fn judge(demo: &SpatialDemo, limits: &GraspLimits) -> Vec<JudgedGrasp> {
    let frames = &demo.episode.frames;
    let mut judged: Vec<JudgedGrasp> = Vec::new();
    for (number, summary) in demo.segmented.segments.iter().enumerate() {
        if summary.segment.mode != Mode::Transfer {
            continue;
        }
        let mut grasp = judge_one(number, summary, frames, limits);
        if let Some(before) = judged.last()
            && summary.segment.frames.start - before.frames.end < limits.flicker
            && (before.outcome == GraspOutcome::Held || before.continues)
            && let (Some(then), Some(now)) = (frames.get(before.settled), frames.get(grasp.settled))
        {
            let strayed = in_object(now) - in_object(then);
            grasp.continues = strayed.norm() <= limits.lost && now.finger_separation() > limits.closed;
        }
        judged.push(grasp);
    }
    judged
}

/// The end effector's position in the object's frame.
fn in_object(frame: &SpatialFrame) -> Vector3<f64> {
    frame.object.inv_mul(&frame.eef).translation.vector
}

fn judge_one(number: usize, summary: &SpatialSegment, frames: &[SpatialFrame], limits: &GraspLimits) -> JudgedGrasp {
    let range = summary.segment.frames.clone();
    let within = frames.get(range.clone()).unwrap_or_default();
    let narrowest = within
        .iter()
        .map(SpatialFrame::finger_separation)
        .fold(f64::INFINITY, f64::min);
    let low = within.first().map_or(0.0, |frame| frame.object.translation.z);
    let rise = within
        .iter()
        .map(|frame| frame.object.translation.z - low)
        .fold(0.0, f64::max);
    let mut grasp = JudgedGrasp {
        segment: number,
        frames: range.clone(),
        outcome: GraspOutcome::Held,
        settled: summary.settled_frame.unwrap_or(range.start),
        narrowest,
        residual: 0.0,
        residual_rotation: 0.0,
        rise,
        continues: false,
    };
    if range.len() < limits.flicker {
        grasp.outcome = GraspOutcome::Brief;
        return grasp;
    }
    let Some(settled) = summary.settled_frame else {
        // The end of the recording may have cut it off.
        let cut_off = range.end == frames.len();
        grasp.outcome = if cut_off {
            GraspOutcome::Brief
        } else {
            GraspOutcome::Missed
        };
        return grasp;
    };
    let Some(start) = frames.get(settled) else { return grasp };
    if start.finger_separation() < limits.closed {
        grasp.outcome = GraspOutcome::Missed;
        return grasp;
    }
    let held_at = start.object.inv_mul(&start.eef);
    let (mut object_way, mut eef_way) = (0.0_f64, 0.0_f64);
    for (frame, now) in frames.iter().enumerate().take(range.end).skip(settled) {
        let seen = now.object.inv_mul(&now.eef);
        let strayed = (seen.translation.vector - held_at.translation.vector).norm();
        if strayed > limits.lost || now.finger_separation() < limits.closed {
            // An object that has not come along half of the hand's way was never held.
            let followed = object_way > 0.5 * eef_way && object_way > 0.0;
            grasp.outcome = if followed {
                GraspOutcome::Lost(frame)
            } else {
                GraspOutcome::Missed
            };
            return grasp;
        }
        let way = |from: &nalgebra::Isometry3<f64>, to: &nalgebra::Isometry3<f64>| {
            (to.translation.vector - from.translation.vector).norm()
        };
        object_way = object_way.max(way(&start.object, &now.object));
        eef_way = eef_way.max(way(&start.eef, &now.eef));
        grasp.residual = grasp.residual.max(strayed);
        grasp.residual_rotation = grasp.residual_rotation.max(seen.rotation.angle_to(&held_at.rotation));
    }
    grasp
}

/// Steps in a row without motion after which the object counts as at rest.
const RESTING: usize = 3;

/// Frames after a command to open, or after the start, within which the object has to come to rest.
const SETTLING: usize = 24;

/// How much wider than in the grasp the fingers are when they have let go, in m.
const LET_GO: f64 = 0.005;

/// First frame from `from` on at which the object rests, at most [`SETTLING`] later and not beyond `end`.
pub(crate) fn rest(evidence: &[SpatialEvidence], from: usize, end: usize) -> usize {
    let last = end.min(from + SETTLING);
    let rests = |frame: usize| {
        evidence
            .iter()
            .skip(frame)
            .take(RESTING)
            .all(|e| e.object_moving != Some(true))
    };
    (from..last).find(|&frame| rests(frame)).unwrap_or(last)
}

/// Where the object goes after the command to open that ends a held grasp; none where the demonstration ends in the grasp.
pub(crate) fn release(demo: &SpatialDemo, grasp: &JudgedGrasp) -> Option<Release> {
    let frames = &demo.episode.frames;
    let evidence = &demo.segmented.evidence;
    let opened = frames.get(grasp.frames.end)?;
    let end = demo
        .segmented
        .segments
        .get(grasp.segment + 1)
        .map_or(frames.len(), |next| next.segment.frames.end);
    let gripped = frames.get(grasp.settled)?.finger_separation();
    let free = (grasp.frames.end..end).find(|&frame| {
        frames
            .get(frame)
            .is_some_and(|f| f.finger_separation() > gripped + LET_GO)
    })?;
    let rest = rest(evidence, free, end).min(frames.len() - 1);
    let place = frames.get(rest)?.object.translation.vector;
    Some(Release {
        frame: grasp.frames.end,
        rest,
        fall: opened.object.translation.z - place.z,
        place,
    })
}

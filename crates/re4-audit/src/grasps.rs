//! The outcome of every command to close, and the motion of the object after every command to open.

use std::ops::Range;

use nalgebra::Vector3;
use re4_episode::{Mode, SpatialFrame};
use re4_segment::{SpatialEvidence, SpatialSegment};

use crate::object::WrongPose;
use crate::spatial::SpatialDemo;

/// The outcome of a transfer segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GraspOutcome {
    /// The object stays fixed to the end effector until the command to open.
    Held,
    /// The fingers closed on nothing, or on something that does not follow the end effector.
    Missed,
    /// The object was held, but slipped out before the command to open. The value is the first frame at which it is lost.
    Lost(usize),
    /// The segment is too short to be judged, or the end of the recording cut it off.
    Brief,
}

impl GraspOutcome {
    /// The name used in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Held => "held",
            Self::Missed => "missed",
            Self::Lost(_) => "lost",
            Self::Brief => "brief",
        }
    }
}

/// A transfer segment and its outcome. Lengths are in m, angles in rad.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedGrasp {
    /// Number of the segment in its demonstration.
    pub segment: usize,
    /// Frames of the segment.
    pub frames: Range<usize>,
    /// The outcome.
    pub outcome: GraspOutcome,
    /// First frame at which the fingers have stopped closing, or the first frame of the segment if they never stop.
    pub settled: usize,
    /// Frames in which the object slips in the gripper: from the first at which a tenth of the residual is exceeded to the first
    /// at which nine tenths are. If the object is lost, from the first at which a tenth of the limit is exceeded until it is lost.
    pub slip: Range<usize>,
    /// Smallest distance between the fingers in the segment.
    pub narrowest: f64,
    /// Largest distance of the end effector, in the object's frame, from the grasp transform, while the object was held.
    pub residual: f64,
    /// Largest angle of the end effector, in the object's frame, from the grasp transform, while the object was held.
    pub residual_rotation: f64,
    /// Maximum height of the object over its height at the start of the segment.
    pub rise: f64,
    /// Whether the object has stayed in the gripper since the previous transfer segment, across a flicker of the command.
    pub continues: bool,
}

/// The release of an object after a command to open.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Release {
    /// First frame after the command.
    pub(crate) frame: usize,
    /// Frame at which the object has come to rest.
    pub(crate) rest: usize,
    /// Distance that the object has fallen until then, in m.
    pub(crate) fall: f64,
    /// Position at which it rests, world frame, in m.
    pub(crate) place: Vector3<f64>,
    /// Horizontal distance, in m, that the end effector moves in the step of the command to open.
    pub(crate) sideways: f64,
}

/// The limits from the configuration by which grasps are judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspLimits {
    /// Fingers closer together than this, in m, hold nothing.
    pub closed: f64,
    /// An object further than this, in m, from its position in the gripper is no longer held.
    pub lost: f64,
    /// Segments shorter than this, in frames, are flicker.
    pub flicker: usize,
    /// An object pose repeated in at least this many frames is frozen.
    pub frozen: usize,
    /// An object pose that jumps further than this, in m, from fingers that keep their distance is that of another object.
    pub swapped: f64,
    /// Unit of distances between fingers.
    pub fingers: FingerUnit,
}

/// Unit of the distances between fingers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FingerUnit {
    /// Metres.
    #[default]
    Metres,
    /// The full travel of the gripper.
    Travel,
}

/// Distance between the fingers of the simulated gripper when it is open, in m.
const SIMULATED: f64 = 0.08;

impl FingerUnit {
    /// A distance of the simulated gripper in this unit.
    pub(crate) fn of(self, metres: f64) -> f64 {
        match self {
            Self::Metres => metres,
            Self::Travel => metres / SIMULATED,
        }
    }

    /// A distance in words.
    pub(crate) fn size(self, value: f64, digits: usize) -> String {
        match self {
            Self::Metres => format!("{:.digits$} mm", 1e3 * value),
            Self::Travel => format!("{:.0} % of their travel", 1e2 * value),
        }
    }

    /// The distance between the fingers in words.
    pub(crate) fn apart(self, value: f64, digits: usize) -> String {
        match self {
            Self::Metres => format!("{} apart", self.size(value, digits)),
            Self::Travel => format!("open to {}", self.size(value, digits)),
        }
    }
}

/// Judges every transfer segment of a demonstration, in order of time.
pub(crate) fn judge(demo: &SpatialDemo, limits: &GraspLimits, wrong: &[WrongPose]) -> Vec<JudgedGrasp> {
    let frames = &demo.episode.frames;
    let mut judged: Vec<JudgedGrasp> = Vec::new();
    for (number, summary) in demo.segmented.segments.iter().enumerate() {
        if summary.segment.mode != Mode::Transfer {
            continue;
        }
        let mut grasp = judge_one(number, summary, frames, limits, wrong);
        if let Some(before) = judged.last()
            && summary.segment.frames.start - before.frames.end < limits.flicker
            && (before.outcome == GraspOutcome::Held || before.continues)
            && let (Some(then), Some(now)) = (frames.get(before.settled), frames.get(grasp.settled))
        {
            let drift = eef_in_object(now) - eef_in_object(then);
            grasp.continues = drift.norm() <= limits.lost && now.finger_separation() > limits.closed;
        }
        judged.push(grasp);
    }
    judged
}

/// Returns the end effector's position in the object's frame.
fn eef_in_object(frame: &SpatialFrame) -> Vector3<f64> {
    frame.object.inv_mul(&frame.eef).translation.vector
}

fn judge_one(
    number: usize,
    summary: &SpatialSegment,
    frames: &[SpatialFrame],
    limits: &GraspLimits,
    wrong: &[WrongPose],
) -> JudgedGrasp {
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
        slip: range.clone(),
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
        // If the recording ends in this segment, the fingers may have stopped later.
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
    let object_from_eef_start = start.object.inv_mul(&start.eef);
    let (mut object_distance, mut eef_distance) = (0.0_f64, 0.0_f64);
    let mut drifts = Vec::new();
    // First frame of the current drift by more than a tenth of the limit.
    let mut leaving = settled;
    // Contacts move a held object where it is put down or inserted. A grasp that is not released has no such place.
    let place = frames.get(range.end).map(|frame| frame.object.translation.vector);
    let is_wrong = |frame: usize| wrong.iter().any(|wrong| wrong.frames.contains(&frame));
    for (frame, now) in frames.iter().enumerate().take(range.end).skip(settled) {
        if is_wrong(frame) {
            continue;
        }
        let object_from_eef = now.object.inv_mul(&now.eef);
        let drift = (object_from_eef.translation.vector - object_from_eef_start.translation.vector).norm();
        if drift > limits.lost || now.finger_separation() < limits.closed {
            // An object that has moved less than half as far as the end effector was never held.
            let followed = object_distance > 0.5 * eef_distance && object_distance > 0.0;
            grasp.outcome = if followed {
                GraspOutcome::Lost(frame)
            } else {
                GraspOutcome::Missed
            };
            grasp.slip = leaving.min(frame)..frame;
            return grasp;
        }
        let distance = |from: &nalgebra::Isometry3<f64>, to: &nalgebra::Isometry3<f64>| {
            (to.translation.vector - from.translation.vector).norm()
        };
        object_distance = object_distance.max(distance(&start.object, &now.object));
        eef_distance = eef_distance.max(distance(&start.eef, &now.eef));
        if drift <= 0.1 * limits.lost {
            leaving = frame + 1;
        }
        let carried = place.is_none_or(|place| (now.object.translation.vector - place).norm() > AT_PLACE);
        if carried {
            drifts.push((frame, drift));
            grasp.residual = grasp.residual.max(drift);
        }
        let angle = object_from_eef.rotation.angle_to(&object_from_eef_start.rotation);
        grasp.residual_rotation = grasp.residual_rotation.max(angle);
    }
    grasp.slip = slip(&drifts, 0.1 * grasp.residual, 0.9 * grasp.residual);
    grasp
}

/// An object this close, in m, to the place where it is released can be in contact with it.
const AT_PLACE: f64 = 0.03;

/// The frames from the one after which the drift stays above `least` until it reaches `most`, to the first one at which it does.
fn slip(drifts: &[(usize, f64)], least: f64, most: f64) -> Range<usize> {
    let reached = drifts
        .iter()
        .position(|(_, drift)| *drift >= most)
        .unwrap_or(drifts.len());
    let before = drifts.get(..reached).unwrap_or_default();
    let start = before
        .iter()
        .rposition(|(_, drift)| *drift <= least)
        .map_or(0, |last| last + 1);
    let frame = |place: usize| {
        drifts
            .get(place)
            .or_else(|| drifts.last())
            .map_or(0, |(frame, _)| *frame)
    };
    frame(start)..frame(reached) + 1
}

/// Number of consecutive steps without motion after which the object counts as at rest.
const RESTING: usize = 3;

/// Number of frames, after the fingers have opened or after the start, within which the object has to come to rest. Objects fall
/// onto the table at the start, and fall and roll after a release.
const SETTLING: usize = 24;

/// Fingers have released the object when they are this much further apart than in the grasp, in m.
const LET_GO: f64 = 0.005;

/// Returns the first frame at or after `from` at which the object rests, but at most `from` + [`SETTLING`] and at most `end`.
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

/// Number of frames after a command to open within which the fingers let the object go: the simulated gripper needs five control
/// steps to release an object half as wide as its opening, and at most ten for its full travel.
const RELEASING: usize = 12;

/// Horizontal distance that the end effector moves in the step to this frame.
fn sideways(frames: &[SpatialFrame], frame: usize) -> f64 {
    let position = |frame: usize| frames.get(frame).map(|frame| frame.eef.translation.vector.xy());
    let before = frame.checked_sub(1).and_then(position);
    before
        .zip(position(frame))
        .map_or(0.0, |(before, now)| (now - before).norm())
}

/// Returns the motion of the object after the command to open that ends a held grasp. `None` if the demonstration ends in the
/// grasp, before the fingers have opened, or if the fingers close again before the object has left them.
pub(crate) fn release(demo: &SpatialDemo, grasp: &JudgedGrasp, limits: &GraspLimits) -> Option<Release> {
    let frames = &demo.episode.frames;
    let evidence = &demo.segmented.evidence;
    frames.get(grasp.frames.end)?;
    let start = frames.get(grasp.settled)?;
    let (gripped, held) = (start.finger_separation(), eef_in_object(start));
    // A release can end in the next grasp. Until then, the object comes to rest.
    let next = demo.segmented.segments.iter().skip(grasp.segment + 1);
    let end = next
        .filter(|next| next.segment.mode == Mode::Transfer)
        .find_map(|next| {
            next.settled_frame
                .filter(|settled| *settled > grasp.frames.end + RELEASING)
        })
        .unwrap_or(frames.len());
    let last = frames.len() - 1;
    let free = (grasp.frames.end..end.min(grasp.frames.end + RELEASING)).find(|&frame| {
        frames
            .get(frame)
            .is_some_and(|f| f.finger_separation() > gripped + LET_GO || (eef_in_object(f) - held).norm() > limits.lost)
    })?;
    let rest = rest(evidence, free, end).min(last);
    let place = frames.get(rest)?.object.translation.vector;
    let height = |frame: &SpatialFrame| frame.object.translation.z;
    let highest = frames
        .get(grasp.frames.end..=free)?
        .iter()
        .map(height)
        .fold(f64::NEG_INFINITY, f64::max);
    Some(Release {
        frame: grasp.frames.end,
        rest,
        fall: highest - place.z,
        place,
        sideways: sideways(frames, grasp.frames.end),
    })
}

//! Modes from what the fingers hold: a frame is transfer while something stops the closed fingers.
//!
//! After a command to close, the mode by the command is transfer at once, but the fingers need several frames to reach the object;
//! after a command to open, they need several frames to let it go. The rules here use the distance between the fingers instead.

use std::ops::Range;

use re4_episode::{Mode, SpatialFrame};

use crate::config::{Command, GripperConfig};
use crate::spatial::command_modes;

/// What has to be held in a transfer frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Holding {
    /// Something stops the fingers.
    Fingers,
    /// Something stops the fingers, and the recorded object stays where it was in the gripper.
    Object,
}

/// Number of frames within which fingers that stop must have been closing. The full travel of the simulated fingers takes 8
/// control steps in robosuite 1.4 and 10 in 1.5.
const CLOSING: usize = 10;

/// Fingers squeeze what they hold by at most this much between contact and rest, in m. Also the change that counts as a motion of
/// the fingers.
const SQUEEZE: f64 = 0.002;

/// Fingers have let go, or something has slipped out of them, when the distance between them differs by more than this from that
/// in the grasp, in m.
const LET_GO: f64 = 0.005;

/// An object further than this, in m, from its position in the gripper is no longer held: half of a finger's travel.
const LOST: f64 = 0.02;

/// Number of frames after contact within which the object settles in the gripper.
const SETTLING: usize = 2;

/// Returns the modes of all frames: transfer in the frames in which the gripper holds something.
///
/// A hold begins where fingers that have been closing after a command come to rest at more than `gripper.closed`, or up to 2 mm
/// before, where they touch the object. It ends where the distance between them has changed by 5 mm, either because they open or
/// because they close further. With [`Holding::Object`], it also ends where the object has moved by 2 cm in the gripper. Frames in
/// which the object's pose is repeated bit for bit do not count: its pose was not recorded there.
pub fn hold_modes(frames: &[SpatialFrame], gripper: &GripperConfig, holding: Holding) -> Vec<Mode> {
    let mut modes = vec![Mode::Transit; frames.len()];
    for hold in holds(frames, gripper) {
        let end = match holding {
            Holding::Fingers => hold.end,
            Holding::Object => followed(frames, &hold),
        };
        for mode in modes.get_mut(hold.start..end).unwrap_or_default() {
            *mode = Mode::Transfer;
        }
    }
    modes
}

/// The stretches in which something stops the fingers.
fn holds(frames: &[SpatialFrame], gripper: &GripperConfig) -> Vec<Range<usize>> {
    let separation: Vec<f64> = frames.iter().map(SpatialFrame::finger_separation).collect();
    let commands = command_modes(frames, Command::Last);
    let closes = |frame: usize| commands.get(frame) == Some(&Mode::Transfer);
    let limits = HoldLimits {
        closed: gripper.closed,
        still: gripper.still,
        squeeze: SQUEEZE,
        let_go: LET_GO,
        closing: CLOSING,
    };
    stopped(&separation, closes, &limits)
}

/// By which distances between the fingers, in one unit, a hold is recognized.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct HoldLimits {
    /// Fingers closer together than this hold nothing.
    pub(crate) closed: f64,
    /// Fingers are at rest if the distance between them changes by less than this in a step.
    pub(crate) still: f64,
    /// As [`SQUEEZE`].
    pub(crate) squeeze: f64,
    /// As [`LET_GO`].
    pub(crate) let_go: f64,
    /// As [`CLOSING`].
    pub(crate) closing: usize,
}

impl HoldLimits {
    /// The limits of a gripper whose full travel is 1, without a closed value: those of the simulated gripper, whose fingers are 8 cm
    /// apart when it is open, as fractions.
    pub(crate) const OF_TRAVEL: Self = Self {
        closed: f64::NEG_INFINITY,
        still: 0.0005 / SIMULATED,
        squeeze: SQUEEZE / SIMULATED,
        let_go: LET_GO / SIMULATED,
        closing: CLOSING,
    };
}

/// Distance between the fingers of the simulated gripper when it is open, in m.
pub(crate) const SIMULATED: f64 = 0.08;

/// The stretches in which something stops fingers that have been closing. `closes` states whether the gripper is commanded to close
/// when it arrives at a frame.
pub(crate) fn stopped(separation: &[f64], closes: impl Fn(usize) -> bool, limits: &HoldLimits) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    let mut frame = 0;
    while let Some(&grip) = separation.get(frame) {
        let earliest = found.last().map_or(0, |hold| hold.end);
        let recent = separation
            .get(frame.saturating_sub(limits.closing)..=frame)
            .unwrap_or_default();
        let closed_here = recent.iter().any(|before| *before > grip + limits.let_go);
        if !(closes(frame) && grip > limits.closed && closed_here && rests(separation, frame, limits.still)) {
            frame += 1;
            continue;
        }
        let touches = |frame: usize| {
            separation
                .get(frame)
                .is_some_and(|s| (0.0..limits.squeeze).contains(&(s - grip)))
        };
        let start = (earliest..frame)
            .rev()
            .take_while(|&before| closes(before) && touches(before))
            .last()
            .unwrap_or(frame);
        let end = (frame..separation.len())
            .find(|&after| separation.get(after).is_none_or(|s| (s - grip).abs() >= limits.let_go))
            .unwrap_or(separation.len());
        found.push(start..end);
        frame = end.max(frame + 1);
    }
    found
}

/// Whether the fingers are at rest in the step that begins at the frame; at the last frame, in the step that ends there.
fn rests(separation: &[f64], frame: usize, still: f64) -> bool {
    let step = |from: usize| Some(separation.get(from + 1)? - separation.get(from)?);
    step(frame)
        .or_else(|| step(frame.checked_sub(1)?))
        .is_none_or(|speed| speed.abs() < still)
}

/// The end of the part of a hold in which the object stays in the gripper.
fn followed(frames: &[SpatialFrame], hold: &Range<usize>) -> usize {
    let eef_in_object = |frame: usize| {
        let frame = frames.get(frame)?;
        Some(frame.object.inv_mul(&frame.eef).translation.vector)
    };
    let Some(held) = eef_in_object((hold.start + SETTLING).min(hold.end - 1)) else {
        return hold.end;
    };
    let repeated = |frame: usize| {
        let before = frame.checked_sub(1).and_then(|before| frames.get(before));
        before.zip(frames.get(frame)).is_some_and(|(a, b)| a.object == b.object)
    };
    hold.clone()
        .find(|&frame| !repeated(frame) && eef_in_object(frame).is_some_and(|now| (now - held).norm() > LOST))
        .unwrap_or(hold.end)
}

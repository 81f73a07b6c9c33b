//! Segmentation of demonstrations of an arm without an object, by its gripper.

use nalgebra::Vector3;
use re4_artifact::columns;
use re4_artifact::episodes::ArmColumns;
use re4_episode::{Mode, Segment, segments};

use crate::Segmented;
use crate::config::Rule;
use crate::error::SegmentError;
use crate::gripper::Gripper;
use crate::hold::{HoldLimits, stopped};

/// A demonstration of an arm without an object.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmEpisode {
    /// Name of the demonstration in its source.
    pub name: String,
    /// Frames in temporal order.
    pub frames: Vec<ArmColumns>,
}

/// Modes, evidence and segments of one demonstration of an arm.
pub type SegmentedArm = Segmented<ArmEvidence, ArmSegment>;

columns! {
    /// The measurements at one frame. Steps, rotations and speeds are those from the frame to the next one of its episode, and are
    /// null at the last frame and where the dataset does not have what they are measured from.
    #[domain = "arm"]
    #[derive(Copy)]
    pub struct ArmEvidence {
        /// Whether the gripper is commanded to close, with hysteresis; null if no command is known to move the gripper.
        pub command_closes: Option<bool>,
        /// Opening of the gripper as a fraction of its travel: 0 is shut, or as far closed as in any demonstration if the shut opening
        /// is not known, and 1 is open. Null if it was not recorded.
        pub opening: Option<f64>,
        /// Change of the opening to the next frame; negative while closing.
        #[unit = "1/frame"]
        pub opening_speed: Option<f64>,
        /// Distance that the end effector moves.
        #[unit = "m"]
        pub eef_step: Option<f64>,
        /// Geodesic angle by which the end effector rotates.
        #[unit = "rad"]
        pub eef_rotation: Option<f64>,
        /// Whether something stops the gripper, which has been closing, or whether it is commanded to close if no opening was recorded.
        pub holds: bool,
    }
}

columns! {
    /// A segment and its measurements. Its motion is that of its steps: from its first frame to the frame after its last one, or
    /// to the last frame of the episode.
    #[domain = "arm"]
    pub struct ArmSegment {
        /// Mode and frames.
        #[prefix = ""]
        pub segment: Segment,
        /// Position of the end effector at the first frame of the segment; null if it was not recorded.
        #[frame = "recorded"]
        pub start: Option<Vector3<f64>>,
        /// Opening of the gripper, as a fraction of its travel, in the middle of the segment; null if it was not recorded.
        pub opening: Option<f64>,
        /// Length of the end effector's path: the sum of its steps over the segment; null if its position was not recorded.
        #[unit = "m"]
        pub eef_path: Option<f64>,
    }
}

/// Segments a demonstration of an arm: returns the modes by the rule, the evidence of every frame, and the summary of every segment.
/// `gripper` is `None` if the arm has none; every frame is then transit.
///
/// # Errors
/// [`SegmentError::Empty`] if there is no frame.
pub fn segment_arm(episode: &ArmEpisode, rule: Rule, gripper: Option<&Gripper>) -> Result<SegmentedArm, SegmentError> {
    let frames = &episode.frames;
    if frames.is_empty() {
        return Err(SegmentError::Empty {
            demo: episode.name.clone(),
        });
    }
    let track = Track::of(frames, gripper);
    let holds = match gripper {
        Some(gripper) => track.holds(frames.len(), gripper),
        None => vec![false; frames.len()],
    };
    let modes: Vec<Mode> = holds
        .iter()
        .map(|holds| match rule {
            Rule::Gripper if *holds => Mode::Transfer,
            _ => Mode::Transit,
        })
        .collect();
    let evidence: Vec<ArmEvidence> = (0..frames.len())
        .map(|frame| track.evidence(frames, frame, &holds))
        .collect();
    let segments = segments(&modes)
        .into_iter()
        .map(|segment| summary(segment, frames, &evidence))
        .collect();
    Ok(SegmentedArm {
        grasp_frame: modes.iter().position(|mode| *mode == Mode::Transfer),
        modes,
        evidence,
        segments,
    })
}

/// Opening and command of a demonstration, in the terms of its gripper.
struct Track {
    opening: Option<Vec<f64>>,
    closes: Option<Vec<bool>>,
}

impl Track {
    fn of(frames: &[ArmColumns], gripper: Option<&Gripper>) -> Self {
        let opening = gripper
            .filter(|gripper| gripper.measured)
            .and_then(|gripper| frames.iter().map(|frame| gripper.fraction(frame.opening?)).collect());
        let commands = || frames.iter().map(|frame| frame.gripper);
        Self {
            opening,
            closes: gripper.and_then(|gripper| gripper.closing_commands(commands())),
        }
    }

    /// Whether the gripper holds something, frame by frame.
    fn holds(&self, count: usize, gripper: &Gripper) -> Vec<bool> {
        let Some(opening) = &self.opening else {
            // Without an opening, the command of the frame before is all that is known.
            let closes = self.closes.iter().flatten().copied().chain(std::iter::repeat(false));
            return std::iter::once(false).chain(closes).take(count).collect();
        };
        // The noise of a reading at rest has to stay below all limits. Six times its median step leaves a margin of four standard
        // deviations.
        let noise = 6.0 * gripper.noise;
        let limits = HoldLimits::OF_TRAVEL;
        let limits = HoldLimits {
            closed: gripper.shut.map_or(limits.closed, |_| SHUT),
            still: limits.still.max(noise),
            squeeze: limits.squeeze.max(noise),
            let_go: limits.let_go.max(2.0 * noise),
            closing: gripper.frames(limits.closing),
        };
        // A target follows the object's size, so only a command of two values states when the gripper closes.
        let two_values = gripper.commands.is_some_and(|commands| commands.two_values);
        let closes = self.closes.as_ref().filter(|_| two_values);
        let closes = |frame: usize| match (closes, frame.checked_sub(1)) {
            (None, _) => true,
            (Some(closes), Some(before)) => closes.get(before) == Some(&true),
            (Some(_), None) => false,
        };
        let mut holds = vec![false; count];
        for hold in stopped(opening, closes, &limits) {
            holds.get_mut(hold).unwrap_or_default().fill(true);
        }
        holds
    }

    fn evidence(&self, frames: &[ArmColumns], frame: usize, holds: &[bool]) -> ArmEvidence {
        let opening = |frame: usize| self.opening.as_ref()?.get(frame).copied();
        let now = frames.get(frame);
        let next = frames.get(frame + 1);
        let both = now.zip(next);
        ArmEvidence {
            command_closes: self.closes.as_ref().and_then(|closes| closes.get(frame).copied()),
            opening: opening(frame),
            opening_speed: opening(frame + 1).zip(opening(frame)).map(|(next, now)| next - now),
            eef_step: both.and_then(|(now, next)| Some((next.eef? - now.eef?).norm())),
            eef_rotation: both.and_then(|(now, next)| Some(now.eef_orientation?.angle_to(&next.eef_orientation?))),
            holds: holds.get(frame).copied().unwrap_or(false),
        }
    }
}

/// A gripper that settles below this fraction of its travel is shut and holds nothing: the fraction of the simulated gripper's
/// opening that the paper's value for a failed grasp is.
pub(crate) const SHUT: f64 = 0.01 / crate::hold::SIMULATED;

fn summary(segment: Segment, frames: &[ArmColumns], evidence: &[ArmEvidence]) -> ArmSegment {
    let range = segment.frames.clone();
    let middle = usize::midpoint(range.start, range.end - 1);
    let steps = evidence.get(range.clone()).unwrap_or_default();
    let known = frames.get(range.start).and_then(|frame| frame.eef);
    ArmSegment {
        start: known,
        opening: evidence.get(middle).and_then(|evidence| evidence.opening),
        eef_path: known.map(|_| steps.iter().filter_map(|evidence| evidence.eef_step).sum()),
        segment,
    }
}

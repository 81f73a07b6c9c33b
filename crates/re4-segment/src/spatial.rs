//! Segmentation of demonstrations of an arm with a two-finger gripper.

use nalgebra::Isometry3;
use re4_artifact::columns;
use re4_episode::{Mode, Segment, SpatialEpisode, SpatialFrame, segments};

use crate::Segmented;
use crate::config::{AnchorAt, Command, GripperConfig, Rule, SegmentConfig};
use crate::error::SegmentError;
use crate::hold::{Holding, hold_modes};
use crate::motion::{Pair, SpatialPair, StepMotion, rigid_motion_modes};

/// Modes, evidence and segments of one demonstration with a gripper.
pub type SegmentedSpatial = Segmented<SpatialEvidence, SpatialSegment>;

columns! {
    /// The measurements at one frame. Steps, rotations and speeds are those from the frame to the next one of its episode, and
    /// are null at the last frame.
    #[domain = "space"]
    #[derive(Copy)]
    pub struct SpatialEvidence {
        /// Whether the action at this frame commands the gripper to close.
        pub command_closes: bool,
        /// Distance between the fingers, |finger_0 - finger_1|.
        #[unit = "m"]
        pub finger_separation: f64,
        /// Change of the finger separation to the next frame; negative while closing.
        #[unit = "m/frame"]
        pub finger_speed: Option<f64>,
        /// Distance that the end effector moves.
        #[unit = "m"]
        pub eef_step: Option<f64>,
        /// Geodesic angle by which the end effector rotates.
        #[unit = "rad"]
        #[formerly = "eef_turn"]
        pub eef_rotation: Option<f64>,
        /// Distance that the object's origin moves.
        #[unit = "m"]
        pub object_step: Option<f64>,
        /// Geodesic angle by which the object rotates.
        #[unit = "rad"]
        #[formerly = "object_turn"]
        pub object_rotation: Option<f64>,
        /// Distance that the end effector moves in the object's frame: |o'^-1 x' - o^-1 x|.
        #[unit = "m"]
        pub relative_translation: Option<f64>,
        /// Angle by which the end effector rotates in the object's frame.
        #[unit = "rad"]
        pub relative_rotation: Option<f64>,
        /// Distance from the grip site to the object's origin.
        #[unit = "m"]
        pub eef_object_distance: f64,
        /// Whether the object translates or rotates further than the configured thresholds.
        pub object_moving: Option<bool>,
        /// Whether the frame looks like a grasp: the gripper is commanded to close, the fingers have stopped before they are
        /// shut, and the object is fixed to the end effector.
        pub holds: bool,
    }
}

columns! {
    /// A segment and its measurements. Its motion is that of its steps: from its first frame to the frame after its last one, or
    /// to the last frame of the episode.
    pub struct SpatialSegment {
        /// Mode and frames.
        #[prefix = ""]
        pub segment: Segment,
        /// Anchor of the demonstration (p*_d): the end effector's pose at the grasp frame. Null in segments after the first
        /// transfer segment, where the object is no longer at the anchor, and in demonstrations without transfer.
        #[frame = "world"]
        pub anchor: Option<Isometry3<f64>>,
        /// First frame of a transfer segment at which the fingers have stopped closing; null in transit, or if they never stop.
        pub settled_frame: Option<usize>,
        /// The grasp, which a transfer segment should preserve; null in transit.
        #[prefix = ""]
        pub grasp: Option<Grasp>,
        /// Distance between the positions of the object's origin at the start and at the end of the segment.
        #[unit = "m"]
        pub object_displacement: f64,
        /// Height of the object's origin at the end of the segment, minus that at its start.
        #[unit = "m"]
        pub object_rise: f64,
        /// Geodesic angle between the object's orientations at the start and at the end of the segment, in [0, pi].
        #[unit = "rad"]
        pub object_rotation: f64,
        /// Length of the path of the object's origin: the sum of its steps over the segment.
        #[unit = "m"]
        pub object_path: f64,
    }
}

columns! {
    /// The pose of the end effector in the object's frame, and its largest deviation from it within a transfer segment.
    #[derive(Copy)]
    pub struct Grasp {
        /// Pose of the end effector in the object's frame at the settled frame, or at the first frame of the segment if the
        /// fingers never stop.
        #[frame = "object"]
        #[prefix = "grasp"]
        pub transform: Isometry3<f64>,
        /// Distance between the fingers at that frame.
        #[unit = "m"]
        pub finger_separation: f64,
        /// Largest distance of the end effector, in the object's frame, from the grasp transform, from that frame to the end of the
        /// segment.
        #[unit = "m"]
        #[prefix = "rigidity_residual"]
        pub residual: f64,
        /// Largest angle of the end effector, in the object's frame, from the grasp transform, from that frame to the end of the
        /// segment.
        #[unit = "rad"]
        #[prefix = "rigidity_residual_rotation"]
        pub residual_rotation: f64,
    }
}

/// Segments a demonstration with a gripper: returns the modes by the configured rule, the evidence of every frame, and the
/// summary of every segment. Lengths are in metres, angles in radians. Only the anchor and the rise depend on the choice of the
/// world frame.
///
/// # Errors
/// [`SegmentError::Config`] if a threshold is out of range, [`SegmentError::Empty`] if there is no frame,
/// [`SegmentError::NotFinite`] if a coordinate of a pose or of a finger is not a finite number.
pub fn segment_spatial(episode: &SpatialEpisode, config: &SegmentConfig) -> Result<SegmentedSpatial, SegmentError> {
    config.check()?;
    let frames = &episode.frames;
    if frames.is_empty() {
        return Err(SegmentError::Empty {
            demo: episode.name.clone(),
        });
    }
    check_finite(episode)?;
    let gripper = config.gripper.clone().unwrap_or_default();
    let pairs: Vec<SpatialPair> = frames.iter().map(pair).collect();
    let steps: Vec<StepMotion> = pairs
        .iter()
        .zip(pairs.iter().skip(1))
        .map(|(now, next)| now.step_to(next))
        .collect();
    let modes = match config.rule {
        Rule::AlwaysTransit => vec![Mode::Transit; frames.len()],
        Rule::RigidMotion => rigid_motion_modes(&pairs, config),
        Rule::GripperCommand => command_modes(frames, gripper.command),
        Rule::Grasp | Rule::Gripper => hold_modes(frames, &gripper, Holding::Fingers),
        Rule::Evidence => hold_modes(frames, &gripper, Holding::Object),
    };
    let evidence = evidence(frames, &steps, config, &gripper);
    let grasp_frame = grasp_frame(frames, &modes, &gripper);
    let segments = segments(&modes)
        .into_iter()
        .map(|segment| {
            let anchor = grasp_frame
                .filter(|&grasp| segment.frames.start <= grasp)
                .and_then(|grasp| frames.get(grasp))
                .map(|frame| frame.eef);
            summary(segment, frames, &steps, &evidence, anchor, gripper.still)
        })
        .collect();
    Ok(SegmentedSpatial {
        modes,
        evidence,
        segments,
        grasp_frame,
    })
}

/// The grasp frame by the configured definition; `None` without transfer.
fn grasp_frame(frames: &[SpatialFrame], modes: &[Mode], gripper: &GripperConfig) -> Option<usize> {
    let first = |modes: &[Mode]| modes.iter().position(|&mode| mode == Mode::Transfer);
    let transfer = first(modes)?;
    match gripper.anchor {
        AnchorAt::FirstTransfer => Some(transfer),
        AnchorAt::FirstHold => first(&hold_modes(frames, gripper, Holding::Object)).or(Some(transfer)),
    }
}

fn pair(frame: &SpatialFrame) -> SpatialPair {
    SpatialPair {
        eef: frame.eef,
        object: frame.object,
    }
}

pub(crate) fn command_modes(frames: &[SpatialFrame], command: Command) -> Vec<Mode> {
    let closes = frames.iter().map(SpatialFrame::closes);
    let commands: Vec<bool> = match command {
        Command::Current => closes.collect(),
        Command::Last => std::iter::once(false).chain(closes).take(frames.len()).collect(),
    };
    commands
        .into_iter()
        .map(|closes| if closes { Mode::Transfer } else { Mode::Transit })
        .collect()
}

fn check_finite(episode: &SpatialEpisode) -> Result<(), SegmentError> {
    for (i, frame) in episode.frames.iter().enumerate() {
        let (eef, object) = (&frame.eef, &frame.object);
        for (column, value) in [
            ("eef position", eef.translation.vector.sum()),
            ("eef orientation", eef.rotation.coords.sum()),
            ("object position", object.translation.vector.sum()),
            ("object orientation", object.rotation.coords.sum()),
            ("finger position", frame.finger_separation()),
        ] {
            if !value.is_finite() {
                return Err(SegmentError::NotFinite {
                    demo: episode.name.clone(),
                    frame: i,
                    column,
                    value,
                });
            }
        }
    }
    Ok(())
}

fn evidence(
    frames: &[SpatialFrame],
    steps: &[StepMotion],
    config: &SegmentConfig,
    gripper: &GripperConfig,
) -> Vec<SpatialEvidence> {
    let separations: Vec<f64> = frames.iter().map(SpatialFrame::finger_separation).collect();
    let speeds: Vec<f64> = separations
        .iter()
        .zip(separations.iter().skip(1))
        .map(|(now, next)| next - now)
        .collect();
    let last_commands = command_modes(frames, Command::Last);
    frames
        .iter()
        .enumerate()
        .map(|(i, frame)| {
            // No step follows the last frame, so the step before it is used there.
            let nearest_step = i.min(steps.len().saturating_sub(1));
            let stopped = speeds.get(nearest_step).is_none_or(|speed| speed.abs() < gripper.still);
            let fixed = steps.get(nearest_step).is_none_or(|step| {
                step.relative_translation < config.translation_epsilon
                    && step
                        .relative_rotation
                        .is_none_or(|angle| angle < config.rotation_epsilon)
            });
            SpatialEvidence {
                command_closes: frame.closes(),
                finger_separation: separations[i],
                finger_speed: speeds.get(i).copied(),
                eef_step: steps.get(i).map(|step| step.eef_translation),
                eef_rotation: frames
                    .get(i + 1)
                    .map(|next| frame.eef.rotation.angle_to(&next.eef.rotation)),
                object_step: steps.get(i).map(|step| step.object_translation),
                object_rotation: steps.get(i).map(|step| step.object_rotation),
                relative_translation: steps.get(i).map(|step| step.relative_translation),
                relative_rotation: steps.get(i).and_then(|step| step.relative_rotation),
                eef_object_distance: (frame.eef.translation.vector - frame.object.translation.vector).norm(),
                object_moving: steps.get(i).map(|step| step.object_moves(config)),
                holds: last_commands[i] == Mode::Transfer && separations[i] > gripper.closed && stopped && fixed,
            }
        })
        .collect()
}

/// Number of frames within which the fingers start to move after a command.
const FINGER_LATENCY: usize = 3;

/// Returns the first frame of a transfer segment at which the fingers no longer close: either they have closed in an earlier
/// frame of the segment, or [`FINGER_LATENCY`] has passed.
fn settled(evidence: &[SpatialEvidence], segment: &Segment, still: f64) -> Option<usize> {
    let mut closing_seen = false;
    for i in segment.frames.clone() {
        match evidence.get(i).and_then(|e| e.finger_speed) {
            // No speed is known at the last frame of the episode.
            None => return None,
            Some(speed) if speed <= -still => closing_seen = true,
            Some(_) if closing_seen || i >= segment.frames.start + FINGER_LATENCY => return Some(i),
            Some(_) => {}
        }
    }
    None
}

fn summary(
    segment: Segment,
    frames: &[SpatialFrame],
    steps: &[StepMotion],
    evidence: &[SpatialEvidence],
    anchor: Option<Isometry3<f64>>,
    still: f64,
) -> SpatialSegment {
    let range = segment.frames.clone();
    // The step from the segment's last frame to the frame after it belongs to the segment, too.
    let reached: Vec<&SpatialFrame> = frames.iter().skip(range.start).take(range.len() + 1).collect();
    let transfer = segment.mode == Mode::Transfer;
    let settled_frame = transfer.then(|| settled(evidence, &segment, still)).flatten();
    let grasped = settled_frame.unwrap_or(range.start) - range.start;
    let grasp = reached.get(grasped).filter(|_| transfer).map(|frame| {
        let transform = object_from_eef(frame);
        let later: Vec<Isometry3<f64>> = reached
            .iter()
            .skip(grasped)
            .map(|frame| object_from_eef(frame))
            .collect();
        Grasp {
            transform,
            finger_separation: frame.finger_separation(),
            residual: later
                .iter()
                .map(|pose| (pose.translation.vector - transform.translation.vector).norm())
                .fold(0.0, f64::max),
            residual_rotation: later
                .iter()
                .map(|pose| pose.rotation.angle_to(&transform.rotation))
                .fold(0.0, f64::max),
        }
    });
    let (displacement, rotation) = match (reached.first(), reached.last()) {
        (Some(first), Some(last)) => (
            last.object.translation.vector - first.object.translation.vector,
            first.object.rotation.angle_to(&last.object.rotation),
        ),
        _ => (nalgebra::Vector3::zeros(), 0.0),
    };
    SpatialSegment {
        anchor,
        settled_frame,
        grasp,
        object_displacement: displacement.norm(),
        object_rise: displacement.z,
        object_rotation: rotation,
        object_path: steps
            .iter()
            .skip(range.start)
            .take(range.len())
            .map(|step| step.object_translation)
            .sum(),
        segment,
    }
}

/// Returns the pose of the end effector in the object's frame.
fn object_from_eef(frame: &SpatialFrame) -> Isometry3<f64> {
    frame.object.inv_mul(&frame.eef)
}

//! Segmentation of planar demonstrations.

use re4_artifact::columns;
use re4_episode::{Mode, PlanarEpisode, PlanarFrame, Segment, segments};
use re4_geometry::{Point2, Pose2};

use crate::Segmented;
use crate::config::{Rule, SegmentConfig};
use crate::error::SegmentError;
use crate::motion::{Pair, StepMotion, rigid_motion_modes};

/// Modes, evidence and segments of one planar demonstration.
pub type SegmentedEpisode = Segmented<Evidence, SegmentSummary>;

columns! {
    /// The measurements at one frame. Steps and rotations are those from the frame to the next one of its episode, and are null
    /// at the last frame.
    #[domain = "plane"]
    #[derive(Copy)]
    pub struct Evidence {
        /// Number of contact points between pusher and block, counted during the control step that led to this frame; null if
        /// contacts were not recorded.
        pub contacts: Option<f64>,
        /// Whether any contact was counted; null if contacts were not recorded.
        pub contact: Option<bool>,
        /// Distance that the pusher moves.
        #[unit = "px"]
        pub eef_step: Option<f64>,
        /// Distance that the origin of the block's frame moves; null if the block's pose was not recorded, as in the other columns
        /// about the block.
        #[unit = "px"]
        pub object_step: Option<f64>,
        /// Angle by which the block rotates, signed, in [-pi, pi).
        #[unit = "rad"]
        #[formerly = "object_turn"]
        pub object_rotation: Option<f64>,
        /// Distance that the pusher moves in the block's frame: |o'^-1 x' - o^-1 x|.
        #[unit = "px"]
        pub relative_translation: Option<f64>,
        /// Angle by which the end effector rotates in the object's frame; always null, since the pusher is a point.
        #[unit = "rad"]
        pub relative_rotation: Option<f64>,
        /// Distance from the pusher's centre to the origin of the block's frame.
        #[unit = "px"]
        pub eef_object_distance: Option<f64>,
        /// Whether the object translates or rotates further than the configured thresholds.
        pub object_moving: Option<bool>,
    }
}

columns! {
    /// A segment and its measurements. Its motion is that of its steps: from its first frame to the frame after its last one, or
    /// to the last frame of the episode.
    pub struct SegmentSummary {
        /// Mode and frames.
        #[prefix = ""]
        pub segment: Segment,
        /// Anchor of the demonstration (p*_d): the end effector's position at the grasp frame. Null in segments after the first
        /// transfer segment, where the object is no longer at the anchor, and in demonstrations without transfer.
        #[frame = "world"]
        pub anchor: Option<Point2>,
        /// Position of the end effector in the object's frame at the first frame of a transfer segment. A rigid grasp preserves
        /// it over the segment. Null in transit.
        #[frame = "object"]
        pub grasp: Option<Point2>,
        /// Largest distance, over a transfer segment, of the end effector in the object's frame from the grasp; null in transit.
        #[unit = "px"]
        pub rigidity_residual: Option<f64>,
        /// Distance between the positions of the object's origin at the start and at the end of the segment; null if the block's pose
        /// was not recorded.
        #[unit = "px"]
        pub object_displacement: Option<f64>,
        /// Sum of the object's signed rotations over the segment; not wrapped, so that it can exceed pi. Null if
        /// the block's pose was not recorded.
        #[unit = "rad"]
        pub object_rotation: Option<f64>,
    }
}

/// Segments a planar demonstration: returns the modes by the configured rule, the evidence of every frame, and the summary of every
/// segment.
///
/// A NaN in the contacts of a frame means that they were not recorded.
///
/// # Errors
/// [`SegmentError::Config`] if a threshold is out of range, [`SegmentError::Empty`] if there is no frame,
/// [`SegmentError::NoGripper`] if the rule needs a gripper, [`SegmentError::NoObject`] if it needs the pose of the block and this is
/// unknown,
/// [`SegmentError::NotFinite`] if a coordinate of a pose is not a finite number.
pub fn segment_planar(episode: &PlanarEpisode, config: &SegmentConfig) -> Result<SegmentedEpisode, SegmentError> {
    config.check()?;
    if config.rule.needs_gripper() {
        return Err(SegmentError::NoGripper);
    }
    let frames = &episode.frames;
    if frames.is_empty() {
        return Err(SegmentError::Empty { demo: episode.name() });
    }
    check_finite(episode)?;
    let known = frames.iter().all(|frame| frame.known_object().is_some());
    if !known && config.rule == Rule::RigidMotion {
        return Err(SegmentError::NoObject { demo: episode.name() });
    }
    let steps: Vec<StepMotion> = frames
        .iter()
        .zip(frames.iter().skip(1))
        .map(|(now, next)| now.step_to(next))
        .collect();
    let modes = match config.rule {
        Rule::AlwaysTransit | Rule::GripperCommand | Rule::Grasp | Rule::Evidence | Rule::Gripper => {
            vec![Mode::Transit; frames.len()]
        }
        Rule::RigidMotion => rigid_motion_modes(frames, config),
    };
    let evidence = frames
        .iter()
        .enumerate()
        .map(|(i, frame)| evidence(frame, steps.get(i), config))
        .collect();
    let grasp_frame = modes.iter().position(|&mode| mode == Mode::Transfer);
    let segments = segments(&modes)
        .into_iter()
        .map(|segment| {
            let anchor = grasp_frame
                .filter(|&grasp| segment.frames.start <= grasp)
                .and_then(|grasp| frames.get(grasp))
                .map(|frame| frame.eef);
            summary(segment, frames, &steps, anchor)
        })
        .collect();
    Ok(SegmentedEpisode {
        modes,
        evidence,
        segments,
        grasp_frame,
    })
}

fn check_finite(episode: &PlanarEpisode) -> Result<(), SegmentError> {
    for (i, frame) in episode.frames.iter().enumerate() {
        let object = frame.known_object().unwrap_or(Pose2::IDENTITY);
        for (column, value) in [
            ("eef_x", frame.eef.x),
            ("eef_y", frame.eef.y),
            ("object_x", object.x),
            ("object_y", object.y),
            ("object_theta", object.theta),
        ] {
            if !value.is_finite() {
                return Err(SegmentError::NotFinite {
                    demo: episode.name(),
                    frame: i,
                    column,
                    value,
                });
            }
        }
    }
    Ok(())
}

fn evidence(frame: &PlanarFrame, step: Option<&StepMotion>, config: &SegmentConfig) -> Evidence {
    let contacts = (!frame.contacts.is_nan()).then_some(frame.contacts);
    let object = frame.known_object();
    let with_object = step.filter(|step| !step.object_translation.is_nan());
    Evidence {
        contacts,
        contact: contacts.map(|count| count > 0.0),
        eef_step: step.map(|step| step.eef_translation),
        object_step: with_object.map(|step| step.object_translation),
        object_rotation: with_object.map(|step| step.object_rotation),
        relative_translation: with_object.map(|step| step.relative_translation),
        relative_rotation: step.and_then(|step| step.relative_rotation),
        eef_object_distance: object.map(|object| (frame.eef - object.translation()).norm()),
        object_moving: with_object.map(|step| step.object_moves(config)),
    }
}

fn summary(segment: Segment, frames: &[PlanarFrame], steps: &[StepMotion], anchor: Option<Point2>) -> SegmentSummary {
    let range = segment.frames.clone();
    // The step from the segment's last frame to the frame after it belongs to the segment, too.
    let reached: Vec<&PlanarFrame> = frames.iter().skip(range.start).take(range.len() + 1).collect();
    let eef_in_object = |frame: &PlanarFrame| frame.object.inverse_transform_point(frame.eef);
    let grasp = reached
        .first()
        .filter(|_| segment.mode == Mode::Transfer)
        .map(|frame| eef_in_object(frame));
    let residual = |grasp: Point2| {
        reached
            .iter()
            .map(|frame| (eef_in_object(frame) - grasp).norm())
            .fold(0.0, f64::max)
    };
    let known = reached.iter().all(|frame| frame.known_object().is_some());
    let displacement = match (reached.first(), reached.last()) {
        (Some(first), Some(last)) => (last.object.translation() - first.object.translation()).norm(),
        _ => 0.0,
    };
    let rotation = || {
        steps
            .iter()
            .skip(range.start)
            .take(range.len())
            .map(|step| step.object_rotation)
            .sum()
    };
    SegmentSummary {
        anchor,
        grasp,
        rigidity_residual: grasp.map(residual),
        object_displacement: known.then_some(displacement),
        object_rotation: known.then(rotation),
        segment,
    }
}

//! Segmentation of planar demonstrations.

use re4_episode::{Mode, PlanarEpisode, PlanarFrame, Segment, segments};
use re4_geometry::Point2;

use crate::config::{Rule, SegmentConfig};
use crate::error::SegmentError;
use crate::motion::{Pair, StepMotion, rigid_motion_modes};

/// Modes, evidence and segments of one demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentedEpisode {
    /// Mode of every frame.
    pub modes: Vec<Mode>,
    /// Evidence for or against it, one a frame, whichever rule gave the modes.
    pub evidence: Vec<Evidence>,
    /// Maximal runs of one mode, in the order of time.
    pub segments: Vec<SegmentFacts>,
    /// The grasp frame g(d): the first transfer frame, if there is one (paper, appendix, "Anchors").
    pub grasp_frame: Option<usize>,
}

/// What can be measured at one frame. Steps and turns lead to the next frame; they are absent at the last one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Contact points counted during the control step that led to this frame; absent where they were not recorded.
    pub contacts: Option<f64>,
    /// Whether any was counted.
    pub contact: Option<bool>,
    /// Distance that the end effector moves.
    pub eef_step: Option<f64>,
    /// Distance that the object's origin moves.
    pub object_step: Option<f64>,
    /// Angle that the object turns, the short way round, in [-π, π).
    pub object_turn: Option<f64>,
    /// Distance that the end effector moves as seen from the object.
    pub relative_translation: Option<f64>,
    /// Angle that the end effector turns as seen from the object; absent where it is a point.
    pub relative_rotation: Option<f64>,
    /// Distance from the end effector to the object's origin.
    pub eef_object_distance: f64,
    /// Whether the object moves or turns further than the configured thresholds.
    pub object_moving: Option<bool>,
}

/// A segment and what can be said of it. Its motion is that of its steps: from its first frame to the frame after its last
/// one, or to the last of the episode.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentFacts {
    /// Mode and frames.
    pub segment: Segment,
    /// Anchor p*_d of the demonstration, world frame: the end effector at the grasp frame. Absent in segments after the
    /// first transfer segment, where the object is no longer at the anchor, and in demonstrations without transfer.
    pub anchor: Option<Point2>,
    /// End effector in the object's frame at the first frame of a transfer segment, the transform that the segment
    /// preserves; absent in transit.
    pub grasp: Option<Point2>,
    /// Largest distance, over a transfer segment, of the end effector in the object's frame from the grasp; absent in
    /// transit.
    pub rigidity_residual: Option<f64>,
    /// Distance from where the object's origin was at the start of the segment to where it is at its end.
    pub object_displacement: f64,
    /// Sum of the object's turns over the segment, in radians; more than half a turn is not wrapped.
    pub object_rotation: f64,
}

/// Segments a demonstration: modes by the configured rule, the evidence of every frame, and the facts of every segment.
///
/// A NaN among the contacts says that they were not recorded.
///
/// # Errors
/// [`SegmentError::Config`] when a threshold is out of range, [`SegmentError::Empty`] when there is no frame,
/// [`SegmentError::NoGripper`] when the rule asks for a gripper,
/// [`SegmentError::NotFinite`] when a coordinate of a pose is not a finite number.
pub fn segment_planar(episode: &PlanarEpisode, config: &SegmentConfig) -> Result<SegmentedEpisode, SegmentError> {
    config.check()?;
    if config.rule == Rule::GripperCommand {
        return Err(SegmentError::NoGripper);
    }
    let frames = &episode.frames;
    if frames.is_empty() {
        return Err(SegmentError::Empty { demo: episode.name() });
    }
    check_finite(episode)?;
    let steps: Vec<StepMotion> = frames
        .iter()
        .zip(frames.iter().skip(1))
        .map(|(now, next)| now.step_to(next))
        .collect();
    let modes = match config.rule {
        Rule::AlwaysTransit | Rule::GripperCommand => vec![Mode::Transit; frames.len()],
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
            facts(segment, frames, &steps, anchor)
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
        for (column, value) in [
            ("eef_x", frame.eef.x),
            ("eef_y", frame.eef.y),
            ("object_x", frame.object.x),
            ("object_y", frame.object.y),
            ("object_theta", frame.object.theta),
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
    Evidence {
        contacts,
        contact: contacts.map(|count| count > 0.0),
        eef_step: step.map(|step| step.eef_translation),
        object_step: step.map(|step| step.object_translation),
        object_turn: step.map(|step| step.object_rotation),
        relative_translation: step.map(|step| step.relative_translation),
        relative_rotation: step.and_then(|step| step.relative_rotation),
        eef_object_distance: (frame.eef - frame.object.translation()).norm(),
        object_moving: step.map(|step| step.object_moves(config)),
    }
}

fn facts(segment: Segment, frames: &[PlanarFrame], steps: &[StepMotion], anchor: Option<Point2>) -> SegmentFacts {
    let range = segment.frames.clone();
    // The step of its last frame leads to the frame after it, and belongs to the segment too.
    let reached: Vec<&PlanarFrame> = frames.iter().skip(range.start).take(range.len() + 1).collect();
    let seen = |frame: &PlanarFrame| frame.object.inverse_transform_point(frame.eef);
    let grasp = reached
        .first()
        .filter(|_| segment.mode == Mode::Transfer)
        .map(|frame| seen(frame));
    let residual = |grasp: Point2| {
        reached
            .iter()
            .map(|frame| (seen(frame) - grasp).norm())
            .fold(0.0, f64::max)
    };
    let displacement = match (reached.first(), reached.last()) {
        (Some(first), Some(last)) => (last.object.translation() - first.object.translation()).norm(),
        _ => 0.0,
    };
    SegmentFacts {
        anchor,
        grasp,
        rigidity_residual: grasp.map(residual),
        object_displacement: displacement,
        object_rotation: steps
            .iter()
            .skip(range.start)
            .take(range.len())
            .map(|step| step.object_rotation)
            .sum(),
        segment,
    }
}

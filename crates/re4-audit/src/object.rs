//! Recorded object poses that cannot be those of the object in the gripper: repeated ones, and those of another object.
//!
//! An object that leaves the gripper lets the fingers close. While the fingers keep their distance, they still hold it, and a pose
//! that does not follow them is wrong.

use std::ops::Range;

use nalgebra::Vector3;
use re4_episode::{Mode, SpatialFrame, segments};
use re4_segment::{GripperConfig, Holding, hold_modes};

use crate::common::Sink;
use crate::grasps::GraspLimits;
use crate::runs::runs;

/// Frames in which the recorded object pose is wrong.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct WrongPose {
    /// `frozen_object` or `swapped_object`.
    pub(crate) code: &'static str,
    /// The frames.
    pub(crate) frames: Range<usize>,
    /// Number of frames with the same pose, or the length of the jump in m.
    pub(crate) value: f64,
}

/// Steps of the end effector in the object's frame shorter than this, in m, are rest.
const REST: f64 = 0.002;

/// An object has followed the end effector if it has moved by more than this, in m.
const FOLLOWED: f64 = 0.005;

/// Number of frames for which the fingers keep their distance after a jump of the pose, if they still hold the object.
const STILL_HELD: usize = 3;

/// Finds all wrong object poses while the fingers hold something.
pub(crate) fn wrong_poses(frames: &[SpatialFrame], limits: &GraspLimits) -> Vec<WrongPose> {
    let gripper = GripperConfig {
        closed: limits.closed,
        ..GripperConfig::default()
    };
    let modes = hold_modes(frames, &gripper, Holding::Fingers);
    let holds = segments(&modes)
        .into_iter()
        .filter(|segment| segment.mode == Mode::Transfer);
    holds
        .flat_map(|hold| {
            // Fingers that are commanded to open may stay where they are, but no longer hold the object.
            let commanded = |frame: &usize| {
                let before = frame.checked_sub(1).and_then(|before| frames.get(before));
                before.is_some_and(SpatialFrame::closes)
            };
            let end = hold
                .frames
                .clone()
                .rev()
                .find(commanded)
                .map_or(hold.frames.start, |last| last + 1);
            let held = hold.frames.start..end;
            let mut found = frozen(frames, &held, limits);
            found.extend(swapped(frames, &held, &found, limits));
            found
        })
        .collect()
}

fn object_at(frames: &[SpatialFrame], frame: usize) -> Option<Vector3<f64>> {
    Some(frames.get(frame)?.object.translation.vector)
}

fn eef_in_object(frames: &[SpatialFrame], frame: usize) -> Option<Vector3<f64>> {
    let frame = frames.get(frame)?;
    Some(frame.object.inv_mul(&frame.eef).translation.vector)
}

/// Stretches of a hold in which the object's pose is repeated while the end effector moves.
fn frozen(frames: &[SpatialFrame], hold: &Range<usize>, limits: &GraspLimits) -> Vec<WrongPose> {
    let own = frames.get(hold.clone()).unwrap_or_default();
    let same = own.iter().zip(own.iter().skip(1)).map(|(a, b)| a.object == b.object);
    let distance = |a: Option<Vector3<f64>>, b: Option<Vector3<f64>>| a.zip(b).map_or(0.0, |(a, b)| (a - b).norm());
    let eef = |frame: usize| frames.get(frame).map(|frame| frame.eef.translation.vector);
    runs(same, limits.frozen.saturating_sub(1))
        .into_iter()
        .map(|run| hold.start + run.start..hold.start + run.end + 1)
        .filter(|run| {
            // An object that rests although the fingers have closed on something else has never followed them.
            let before = distance(object_at(frames, hold.start), object_at(frames, run.start)) > FOLLOWED;
            let back = run.end < hold.end
                && distance(eef_in_object(frames, run.start), eef_in_object(frames, run.end)) < limits.lost
                && distance(object_at(frames, run.start), object_at(frames, run.end)) > REST;
            distance(eef(run.start), eef(run.end - 1)) > REST && (before || back)
        })
        .map(|run| WrongPose {
            code: "frozen_object",
            value: run.len() as f64,
            frames: run,
        })
        .collect()
}

/// Stretches of a hold in which the object's pose has jumped away from the fingers, although they still hold something.
fn swapped(frames: &[SpatialFrame], hold: &Range<usize>, frozen: &[WrongPose], limits: &GraspLimits) -> Vec<WrongPose> {
    let step = |frame: usize| {
        let (before, now) = (
            eef_in_object(frames, frame.checked_sub(1)?)?,
            eef_in_object(frames, frame)?,
        );
        Some((now - before).norm())
    };
    let repeated = |frame: usize| frozen.iter().any(|wrong| wrong.frames.contains(&(frame - 1)));
    let mut found = Vec::new();
    let mut from = hold.start + 2;
    while let Some((frame, jump)) = (from..hold.end)
        .filter(|&frame| !repeated(frame) && step(frame - 1).is_some_and(|rest| rest < REST))
        .find_map(|frame| {
            step(frame)
                .filter(|jump| *jump > limits.swapped)
                .map(|jump| (frame, jump))
        })
    {
        let Some(held) = eef_in_object(frames, frame - 1) else {
            break;
        };
        let returns =
            |frame: &usize| eef_in_object(frames, *frame).is_some_and(|now| (now - held).norm() < limits.lost / 2.0);
        let end = (frame..hold.end).find(returns).unwrap_or(hold.end);
        let still_held = end < hold.end || hold.end == frames.len() || hold.end - frame >= STILL_HELD;
        if still_held {
            found.push(WrongPose {
                code: "swapped_object",
                frames: frame..end,
                value: jump,
            });
        }
        // The jump back is no second one.
        from = end + 1;
    }
    found
}

/// Reports wrong object poses.
pub(crate) fn check_object_poses(wrong: &[WrongPose], sink: &mut Sink<'_>) {
    for wrong in wrong {
        let message = if wrong.code == "frozen_object" {
            format!(
                "exactly the same object pose in {} consecutive frames, while the fingers carry the object",
                wrong.value
            )
        } else {
            format!(
                "the object's pose jumps by {:.0} mm from the fingers, which keep holding something",
                1e3 * wrong.value
            )
        };
        sink.add(wrong.code, wrong.frames.clone(), Some(wrong.value), message);
    }
}

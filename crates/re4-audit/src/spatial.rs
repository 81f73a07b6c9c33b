//! The audit of one demonstration with a gripper.

use std::f64::consts::PI;
use std::ops::Range;

use nalgebra::Vector3;
use re4_episode::{Mode, SpatialEpisode, SpatialFrame};
use re4_segment::SegmentedSpatial;

use crate::actions::{
    ActionFit, LEAST_TRAVEL, Response, against_command, check_actions_and_motion, check_commands, is_idle,
    saturated_fraction,
};
use crate::common::{Sink, hash, lengths_and_flicker};
use crate::copies::Path;
use crate::finding::Finding;
use crate::grasps::{FingerUnit, GraspLimits, GraspOutcome, JudgedGrasp, Release, judge, release, rest};
use crate::motion::{Steps, check_motion, translates};
use crate::object::{check_object_poses, wrong_poses};
use crate::runs::{longest, runs};
use crate::thresholds::{Observation, Thresholds};

/// A demonstration with a gripper, and its segmentation.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialDemo {
    /// Number in the artifact, from 0.
    pub number: u32,
    /// The demonstration.
    pub episode: SpatialEpisode,
    /// Its modes, evidence and segments.
    pub segmented: SegmentedSpatial,
}

/// The result of the audit of one demonstration.
#[derive(Debug, Clone, PartialEq)]
pub struct SpatialAudit {
    /// Findings, unordered.
    pub findings: Vec<Finding>,
    /// Transfer segments with their outcomes, in order of time.
    pub grasps: Vec<JudgedGrasp>,
}

/// Fingers count as moved when the distance between them has changed by more than this, in m.
const FINGERS_MOVED: f64 = 0.002;

/// Fingers further apart than this, in m, are open: the gripper opens to 0.08 m.
const OPEN: f64 = 0.07;

/// The first pass: measures the values from which thresholds are derived.
pub fn observe_spatial(demo: &SpatialDemo, limits: &GraspLimits) -> Observation {
    let frames = &demo.episode.frames;
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    let evidence = &demo.segmented.evidence;
    let wrong = wrong_poses(frames, limits);
    let grasps = judge(demo, limits, &wrong);
    let mut values = vec![
        (
            "discontinuity_eef",
            largest(&mut evidence.iter().filter_map(|e| e.eef_step)),
        ),
        (
            "discontinuity_rotation",
            largest(&mut evidence.iter().filter_map(|e| e.eef_rotation)),
        ),
        ("idle", longest(frames.iter().map(is_idle)) as f64),
        ("saturated", saturated_fraction(frames, 1)),
        ("saturated_together", saturated_fraction(frames, 2)),
        ("regrasp", transfers(&grasps) as f64),
    ];
    for grasp in grasps.iter().filter(|grasp| grasp.outcome == GraspOutcome::Held) {
        values.push(("non_rigid_transfer", grasp.residual));
        values.push(("non_rigid_rotation", grasp.residual_rotation));
    }
    if let Some(release) = grasps.last().and_then(|grasp| released(demo, grasp, limits)) {
        values.push(("released_high", release.fall));
        values.push(("released_moving", release.sideways));
    }
    let rewards: Vec<f64> = frames.iter().filter_map(|frame| frame.reward).collect();
    Observation {
        episode: demo.number,
        demo: demo.episode.name.clone(),
        frames: frames.len() as u32,
        values,
        last_object: frames
            .last()
            .map_or_else(Vector3::zeros, |f| f.object.translation.vector),
        rewarded: (!rewards.is_empty()).then(|| rewards.iter().any(|reward| *reward > 0.0)),
        recording: hash(frames.iter().flat_map(|f| state(f).into_iter().chain(action(f)))),
        actions: hash(frames.iter().flat_map(action)),
        response: ActionFit::of(frames),
        path: Path::new(
            frames
                .iter()
                .map(|frame| (frame.eef.translation.vector, frame.object.translation.vector)),
        ),
    }
}

/// The second pass: makes all checks that apply, and reports every value that exceeds its threshold.
pub fn audit_spatial(demo: &SpatialDemo, thresholds: &Thresholds, limits: &GraspLimits) -> SpatialAudit {
    let mut sink = Sink::new(demo.number, &demo.episode.name, thresholds);
    let frames = &demo.episode.frames;
    let wrong = wrong_poses(frames, limits);
    let grasps = judge(demo, limits, &wrong);
    lengths_and_flicker(
        &mut sink,
        &demo
            .segmented
            .segments
            .iter()
            .map(|summary| summary.segment.clone())
            .collect::<Vec<_>>(),
        demo.episode.frames.len(),
    );
    check_grasps(demo, &grasps, limits, &mut sink);
    check_object_poses(&wrong, &mut sink);
    check_transit(demo, &mut sink);
    check_fingers(&Fingers::of(demo), &mut sink);
    check_motion(&Steps::of(demo), &|stretch| translates(frames, stretch), &mut sink);
    let separation: Vec<f64> = frames.iter().map(SpatialFrame::finger_separation).collect();
    let closes: Vec<bool> = frames.iter().map(SpatialFrame::closes).collect();
    let fit = ActionFit::of(frames);
    let response = Response {
        frames: frames.len(),
        fit: fit.as_ref(),
        against: against_command(&separation, &closes, LEAST_TRAVEL),
        arm: "the end effector",
        axes: &["x", "y", "z"],
    };
    check_actions_and_motion(&response, &mut sink);
    let idle: Vec<bool> = frames.iter().map(is_idle).collect();
    let saturated = [saturated_fraction(frames, 1), saturated_fraction(frames, 2)];
    check_commands(&idle, saturated, &mut sink);
    let rewards: Vec<Option<f64>> = frames.iter().map(|frame| frame.reward).collect();
    check_success(&rewards, &mut sink);
    check_seams(frames, &mut sink);
    SpatialAudit {
        findings: sink.findings,
        grasps,
    }
}

/// Counts the transfer segments. Segments that continue a grasp across a flicker are counted once; segments that are too short
/// to have an outcome are not counted.
pub(crate) fn transfers(grasps: &[JudgedGrasp]) -> usize {
    grasps
        .iter()
        .filter(|grasp| !grasp.continues && grasp.outcome != GraspOutcome::Brief)
        .count()
}

pub(crate) fn check_grasps(demo: &SpatialDemo, grasps: &[JudgedGrasp], limits: &GraspLimits, sink: &mut Sink<'_>) {
    let all = 0..demo.episode.frames.len();
    if demo.segmented.grasp_frame.is_none() {
        sink.add(
            "no_transfer",
            all.clone(),
            Some(0.0),
            "no frame is in transfer: the demonstration has no grasp and no anchor".to_owned(),
        );
    }
    for (place, grasp) in grasps.iter().enumerate() {
        match grasp.outcome {
            GraspOutcome::Missed => sink.add(
                "missed_grasp",
                grasp.frames.clone(),
                Some(grasp.narrowest),
                why_missed(demo, grasp, sink.thresholds.over("missed_grasp"), limits.fingers),
            ),
            GraspOutcome::Lost(frame) => sink.add(
                "lost_grasp",
                grasp.slip.start..grasp.frames.end,
                distance_from_grasp(demo, grasp, frame).filter(|_| limits.fingers == FingerUnit::Metres),
                format!(
                    "the object leaves the gripper at frame {frame}, but the command to close lasts until frame {}",
                    grasp.frames.end
                ),
            ),
            GraspOutcome::Held => {
                sink.exceeding("non_rigid_transfer", grasp.slip.clone(), grasp.residual, |value| {
                    format!("the object moves in the gripper by {:.1} mm", 1e3 * value)
                });
                sink.exceeding(
                    "non_rigid_rotation",
                    grasp.frames.clone(),
                    grasp.residual_rotation,
                    |value| format!("the object rotates in the gripper by {:.1} degrees", value.to_degrees()),
                );
                // A grasp that continues in the next segment has not ended in a release.
                let continues = grasps.get(place + 1).is_some_and(|next| next.continues);
                if !continues {
                    let again = grasps
                        .iter()
                        .skip(place + 1)
                        .any(|next| next.outcome != GraspOutcome::Brief);
                    check_release(demo, grasp, limits, again, sink);
                }
            }
            GraspOutcome::Brief => {}
        }
    }
    let count = transfers(grasps);
    let second = grasps
        .iter()
        .filter(|grasp| !grasp.continues && grasp.outcome != GraspOutcome::Brief)
        .nth(1);
    if let Some(second) = second {
        sink.exceeding("regrasp", second.frames.start..all.end, count as f64, |value| {
            format!("{value} transfer segments; the second one begins here")
        });
    }
}

fn why_missed(demo: &SpatialDemo, grasp: &JudgedGrasp, closed: f64, unit: FingerUnit) -> String {
    let stopped = demo
        .segmented
        .segments
        .get(grasp.segment)
        .is_some_and(|summary| summary.settled_frame.is_some());
    let apart = unit.apart(grasp.narrowest, 1);
    let to = unit.size(grasp.narrowest, 1);
    if grasp.narrowest < closed {
        format!("the fingers close to {to} with nothing between them")
    } else if stopped {
        format!("the fingers stop {apart} on something that does not follow the end effector")
    } else {
        format!("the fingers close to {to}, and are commanded to open again before anything has stopped them")
    }
}

/// Returns the largest distance of the end effector, in the object's frame, from its position in the grasp, between `frame` and
/// the end of the segment.
fn distance_from_grasp(demo: &SpatialDemo, grasp: &JudgedGrasp, frame: usize) -> Option<f64> {
    let eef_in_object = |frame: usize| {
        let frame = demo.episode.frames.get(frame)?;
        Some(frame.object.inv_mul(&frame.eef).translation.vector)
    };
    // `frame` may be reported because the fingers shut there, when the object has hardly moved yet. The maximum over the rest
    // of the segment shows how far it moves.
    let held = eef_in_object(grasp.settled)?;
    (frame..grasp.frames.end)
        .filter_map(eef_in_object)
        .map(|position| (position - held).norm())
        .reduce(f64::max)
}

/// The release after a held grasp, if the grasp is one and is followed by a release.
fn released(demo: &SpatialDemo, grasp: &JudgedGrasp, limits: &GraspLimits) -> Option<Release> {
    (grasp.outcome == GraspOutcome::Held)
        .then(|| release(demo, grasp, limits))
        .flatten()
}

/// Judges a release by the height of the fall and by what follows: `again` states whether the gripper closes again.
fn check_release(demo: &SpatialDemo, grasp: &JudgedGrasp, limits: &GraspLimits, again: bool, sink: &mut Sink<'_>) {
    let all = &demo.episode.frames;
    let Some(release) = release(demo, grasp, limits) else {
        return;
    };
    let frames = release.frame..(release.rest + 1).min(all.len());
    let failed = sink.thresholds.rewards && !succeeds_at_end(all);
    if again || failed {
        let then = if again {
            "the gripper closes again"
        } else {
            "the demonstration ends without success"
        };
        sink.exceeding("dropped", frames.clone(), release.fall, |value| {
            format!("the object falls {:.0} mm after its release, and {then}", 1e3 * value)
        });
    }
    sink.exceeding("released_high", frames.clone(), release.fall, |value| {
        format!("the object falls {:.0} mm after its release", 1e3 * value)
    });
    sink.exceeding("released_moving", frames.clone(), release.sideways, |value| {
        format!(
            "the gripper is commanded to open while it moves sideways by {:.1} mm per step",
            1e3 * value
        )
    });
    if let Some(end) = sink.thresholds.usual_end {
        sink.exceeding("early_release", frames, (release.place - end).norm(), |value| {
            format!(
                "the object is released and comes to rest {:.0} mm from where the demonstrations leave it",
                1e3 * value
            )
        });
    }
}

/// Number of frames at the end of a recording in one of which a success is rewarded.
const LAST_FRAMES: usize = 3;

/// Whether the demonstration is rewarded at its end.
fn succeeds_at_end(frames: &[SpatialFrame]) -> bool {
    let last = frames.iter().rev().take(LAST_FRAMES);
    last.filter_map(|frame| frame.reward).any(|reward| reward > 0.0)
}

fn check_transit(demo: &SpatialDemo, sink: &mut Sink<'_>) {
    let frames = &demo.episode.frames;
    let evidence = &demo.segmented.evidence;
    for summary in &demo.segmented.segments {
        let range = summary.segment.frames.clone();
        if summary.segment.mode != Mode::Transit || range.len() < 2 {
            continue;
        }
        let start = rest(evidence, settle_from(demo, &range), range.end);
        let Some(rested) = frames.get(start) else { continue };
        let window = frames.get(start..range.end).unwrap_or_default();
        let distance =
            |frame: &SpatialFrame| (frame.object.translation.vector - rested.object.translation.vector).norm();
        let farthest = window.iter().map(distance).fold(0.0, f64::max);
        // The finding covers the frames of the push itself: between 10 % and 90 % of the largest distance.
        let first = window.iter().position(|f| distance(f) > 0.1 * farthest).unwrap_or(0);
        let last = window.iter().position(|f| distance(f) > 0.9 * farthest).unwrap_or(0);
        sink.exceeding(
            "pushed_in_transit",
            start + first..start + last + 1,
            farthest,
            |value| format!("the object moves by {:.0} mm without a grasp", 1e3 * value),
        );
    }
}

/// Returns the frame of a transit segment from which on the object has to come to rest. After a transfer, this is the first frame
/// at which the fingers have opened; at the start of the demonstration, it is the first frame.
fn settle_from(demo: &SpatialDemo, range: &Range<usize>) -> usize {
    let evidence = &demo.segmented.evidence;
    let Some(before) = range.start.checked_sub(1).and_then(|frame| evidence.get(frame)) else {
        return range.start;
    };
    let gripped = before.finger_separation;
    range
        .clone()
        .find(|&frame| {
            evidence
                .get(frame)
                .is_some_and(|e| e.finger_separation > gripped + FINGERS_MOVED)
        })
        .unwrap_or(range.end)
}

/// What the fingers do, frame by frame.
pub(crate) struct Fingers {
    /// Whether the gripper is commanded to close.
    pub(crate) closes: Vec<bool>,
    /// Distance between the fingers, in m, or the opening as a fraction of the travel.
    pub(crate) separation: Vec<f64>,
    /// Whether they hold something.
    pub(crate) holds: Vec<bool>,
    /// Unit of the distances.
    pub(crate) unit: FingerUnit,
}

impl Fingers {
    fn of(demo: &SpatialDemo) -> Self {
        let evidence = &demo.segmented.evidence;
        Self {
            closes: evidence.iter().map(|e| e.command_closes).collect(),
            separation: evidence.iter().map(|e| e.finger_separation).collect(),
            holds: evidence.iter().map(|e| e.holds).collect(),
            unit: FingerUnit::Metres,
        }
    }
}

pub(crate) fn check_fingers(fingers: &Fingers, sink: &mut Sink<'_>) {
    let Fingers {
        closes: commands,
        separation,
        holds,
        unit,
    } = fingers;
    let (moved, open) = (unit.of(FINGERS_MOVED), unit.of(OPEN));
    let lag = sink.thresholds.over("command_fingers_disagree");
    let closed = sink.thresholds.over("missed_grasp");
    for closes in [true, false] {
        for run in runs(commands.iter().map(|command| *command == closes), 1) {
            // The fingers can first respond in the frame after the first command, so the run needs one frame more than the lag.
            if run.len() as f64 <= lag {
                continue;
            }
            let late = run.start + lag as usize;
            let (Some(start), Some(then)) = (separation.get(run.start), separation.get(late)) else {
                continue;
            };
            let change = then - start;
            let stuck = if closes {
                // Fingers that hold an object do not have to move.
                let holding = holds.get(run.clone()).unwrap_or_default().iter().any(|holds| *holds);
                change > -moved && *then > closed && (*then > open || !holding)
            } else {
                change < moved && *then < open
            };
            if stuck {
                sink.add(
                    "command_fingers_disagree",
                    run.start..run.end,
                    Some(lag),
                    format!(
                        "{lag} frames after the command to {} at frame {}, the fingers are {} and have not moved",
                        if closes { "close" } else { "open" },
                        run.start,
                        unit.apart(*then, 0)
                    ),
                );
            }
        }
    }
}

pub(crate) fn check_success(rewards: &[Option<f64>], sink: &mut Sink<'_>) {
    let best = rewards.iter().copied().flatten().reduce(f64::max);
    let needed = sink.thresholds.over("ends_before_success");
    if let Some(best) = best.filter(|best| sink.thresholds.rewards && *best <= needed) {
        let end = rewards.len();
        sink.add(
            "ends_before_success",
            end.saturating_sub(1)..end,
            Some(best),
            "no frame has a reward above 0, but frames of other demonstrations have".to_owned(),
        );
    }
    let last = rewards
        .iter()
        .rposition(|reward| reward.is_some_and(|reward| reward > needed));
    if let Some(last) = last {
        let lost = last + 1..rewards.len();
        sink.exceeding("success_lost", lost.clone(), lost.len() as f64, |value| {
            format!("the last reward is at frame {last}; the {value} frames after it have none")
        });
    }
}

/// The frames after which a quaternion changes its sign.
pub(crate) fn flips<'a>(orientations: impl Iterator<Item = &'a nalgebra::UnitQuaternion<f64>> + Clone) -> Vec<usize> {
    orientations
        .clone()
        .zip(orientations.skip(1))
        .enumerate()
        .filter(|(_, (now, next))| now.coords.dot(&next.coords) < 0.0)
        .map(|(frame, _)| frame)
        .collect()
}

fn check_seams(frames: &[SpatialFrame], sink: &mut Sink<'_>) {
    let pairs = || frames.iter().zip(frames.iter().skip(1));
    let flips =
        |orientation: fn(&SpatialFrame) -> &nalgebra::UnitQuaternion<f64>| flips(frames.iter().map(orientation));
    let goal = |frame: &SpatialFrame| Vector3::new(frame.goal[3], frame.goal[4], frame.goal[5]);
    // A goal rotates by less than pi in a step. If its rotation vector changes by more, the vector has passed pi and changed its
    // sign.
    let passes = pairs()
        .enumerate()
        .filter(|(_, (now, next))| (goal(next) - goal(now)).norm() > PI)
        .map(|(frame, _)| frame)
        .collect();
    let recorded_goals = sink.thresholds.recorded_goals;
    for (what, crossings, matters) in [
        (
            "the quaternion of the end effector changes its sign",
            flips(|f| &f.eef.rotation),
            true,
        ),
        (
            "the quaternion of the object changes its sign",
            flips(|f| &f.object.rotation),
            true,
        ),
        ("the rotation vector of the goal passes pi", passes, recorded_goals),
    ] {
        if matters {
            sink.seam(what, &crossings);
        }
    }
}

/// Returns the poses (position, then quaternion x, y, z, w) of end effector and object, and the finger positions.
pub(crate) fn state(frame: &SpatialFrame) -> [f64; 16] {
    let mut values = [0.0; 16];
    let pose = |pose: &nalgebra::Isometry3<f64>| {
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
    };
    values[..7].copy_from_slice(&pose(&frame.eef));
    values[7..14].copy_from_slice(&pose(&frame.object));
    values[14..].copy_from_slice(&frame.fingers);
    values
}

fn action(frame: &SpatialFrame) -> [f64; 7] {
    let mut values = [0.0; 7];
    values[..6].copy_from_slice(&frame.delta);
    values[6] = frame.gripper;
    values
}

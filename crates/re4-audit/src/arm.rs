//! The audit of one demonstration of an arm without an object.
//!
//! The checks of the gripper are those of the audit in SE(3), with the object assumed at the end effector, so that only the fingers
//! decide. Openings are fractions of the gripper's travel.

use std::ops::Range;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::episodes::ArmColumns;
use re4_episode::{SpatialEpisode, SpatialFrame};
use re4_segment::{ArmEpisode, GripperConfig, Rule, SegmentConfig, SegmentedArm, segment_spatial};

use crate::actions::{ActionFit, LEAST_TRAVEL, Response, against_command, check_actions_and_motion, check_commands};
use crate::arm_facts::ArmFacts;
use crate::common::{Sink, hash, lengths_and_flicker};
use crate::copies::Path;
use crate::finding::Finding;
use crate::grasps::{FingerUnit, GraspLimits, JudgedGrasp, judge};
use crate::motion::{Steps, check_motion};
use crate::rows::{Rows, norm};
use crate::runs::{longest, runs};
use crate::spatial::{Fingers, SpatialDemo, check_fingers, check_grasps, check_success, flips, transfers};
use crate::thresholds::{Observation, Thresholds};

/// A demonstration of an arm, and its segmentation.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmDemo {
    /// Number in the artifact, from 0.
    pub number: u32,
    /// The demonstration.
    pub episode: ArmEpisode,
    /// Its modes, evidence and segments.
    pub segmented: SegmentedArm,
}

/// What the checks read of a demonstration.
struct View {
    positions: Rows,
    steps: Steps,
    idle: Vec<bool>,
    saturated: [f64; 2],
    fit: Option<ActionFit>,
    /// The gripper's motion, with the object at the end effector; `None` without a gripper.
    grasping: Option<Grasping>,
}

struct Grasping {
    demo: SpatialDemo,
    grasps: Vec<JudgedGrasp>,
    fingers: Fingers,
}

impl View {
    fn of(demo: &ArmDemo, facts: &ArmFacts, limits: &GraspLimits) -> Self {
        let frames = &demo.episode.frames;
        let positions = facts.positions(frames);
        let moves = positions.steps();
        let fit = facts
            .commands(frames)
            .and_then(|commands| ActionFit::between(&moves, &commands));
        let pairs = || frames.iter().zip(frames.iter().skip(1));
        let evidence = &demo.segmented.evidence;
        let known = |step: fn(&re4_segment::ArmEvidence) -> Option<f64>| -> Vec<f64> {
            let steps = evidence.get(..evidence.len().saturating_sub(1)).unwrap_or_default();
            steps.iter().map(|evidence| step(evidence).unwrap_or(0.0)).collect()
        };
        let eef = |frame: &ArmColumns| (frame.eef, frame.eef_orientation);
        let joints = frames.iter().any(|frame| frame.eef.is_none());
        let steps = Steps {
            eef: if joints {
                moves.iter().map(norm).collect()
            } else {
                known(|e| e.eef_step)
            },
            rotation: known(|e| e.eef_rotation),
            object: vec![0.0; frames.len().saturating_sub(1)],
            same_state: pairs().map(|(now, next)| now.state == next.state).collect(),
            same_eef: pairs()
                .map(|(now, next)| now.eef.is_some() && eef(now) == eef(next))
                .collect(),
        };
        Self {
            idle: facts.idle(frames),
            saturated: facts.saturated(frames),
            grasping: Grasping::of(demo, facts, &positions, limits),
            positions,
            steps,
            fit,
        }
    }
}

impl Grasping {
    fn of(demo: &ArmDemo, facts: &ArmFacts, positions: &Rows, limits: &GraspLimits) -> Option<Self> {
        let gripper = facts.gripper.as_ref()?;
        let evidence = &demo.segmented.evidence;
        let openings: Option<Vec<f64>> = evidence.iter().map(|evidence| evidence.opening).collect();
        let commands: Option<Vec<bool>> = evidence.iter().map(|evidence| evidence.command_closes).collect();
        let two_values = gripper.commands.is_some_and(|commands| commands.two_values);
        let noise = 6.0 * gripper.noise;
        let closes = match (&openings, commands) {
            (_, Some(commands)) if two_values || openings.is_none() => commands,
            (Some(openings), _) => closed_phases(openings, (2.0 * FingerUnit::Travel.of(0.005)).max(2.0 * noise)),
            (None, _) => return None,
        };
        let openings =
            openings.unwrap_or_else(|| closes.iter().map(|closes| if *closes { 0.0 } else { 1.0 }).collect());
        let frames = pseudo(&demo.episode.frames, positions, &openings, &closes);
        let gripper_config = GripperConfig {
            closed: limits.closed,
            still: FingerUnit::Travel.of(GripperConfig::default().still).max(noise),
            ..GripperConfig::default()
        };
        let config = SegmentConfig {
            rule: Rule::GripperCommand,
            gripper: Some(gripper_config),
            ..SegmentConfig::spatial()
        };
        let episode = SpatialEpisode {
            name: demo.episode.name.clone(),
            frames,
        };
        // Fails only for an empty demonstration or one with numbers that are not finite, which ingest refuses.
        let segmented = segment_spatial(&episode, &config).ok()?;
        let spatial = SpatialDemo {
            number: demo.number,
            episode,
            segmented,
        };
        let grasps = judge(&spatial, limits, &[]);
        let fingers = Fingers {
            closes,
            separation: openings,
            holds: evidence.iter().map(|evidence| evidence.holds).collect(),
            unit: FingerUnit::Travel,
        };
        Some(Self {
            demo: spatial,
            grasps,
            fingers,
        })
    }
}

/// The frames with the object at the end effector. Without a position of the end effector, the length of the arm's path stands for it.
fn pseudo(frames: &[ArmColumns], positions: &Rows, openings: &[f64], closes: &[bool]) -> Vec<SpatialFrame> {
    let mut path = 0.0;
    let steps: Vec<f64> = positions.steps().iter().map(norm).collect();
    let places = frames.iter().enumerate().map(|(place, frame)| {
        path += place
            .checked_sub(1)
            .and_then(|before| steps.get(before))
            .copied()
            .unwrap_or(0.0);
        frame.eef.unwrap_or_else(|| Vector3::new(path, 0.0, 0.0))
    });
    let places: Vec<Vector3<f64>> = places.collect();
    frames
        .iter()
        .zip(places)
        .zip(openings.iter().zip(closes))
        .map(|((frame, place), (opening, closes))| {
            let orientation = frame.eef_orientation.unwrap_or_else(UnitQuaternion::identity);
            let eef = Isometry3::from_parts(Translation3::from(place), orientation);
            SpatialFrame {
                eef,
                object: eef,
                fingers: [0.5 * opening, -0.5 * opening],
                delta: [0.0; 6],
                goal: [0.0; 6],
                gripper: if *closes { 1.0 } else { -1.0 },
                reward: frame.reward,
            }
        })
        .collect()
}

/// Whether the gripper is closed, or on its way there, by the motion of its opening alone: from where it has fallen by more than `step`
/// below the last maximum, until it has risen by more than `step` above the last minimum.
fn closed_phases(openings: &[f64], step: f64) -> Vec<bool> {
    let first = openings.first().copied().unwrap_or_default();
    let (mut low, mut high, mut closed) = (first, first, false);
    openings
        .iter()
        .map(|&opening| {
            if closed {
                low = low.min(opening);
                if opening > low + step {
                    (closed, high) = (false, opening);
                }
            } else {
                high = high.max(opening);
                if opening < high - step {
                    (closed, low) = (true, opening);
                }
            }
            closed
        })
        .collect()
}

/// The longest stretch in which an element repeats while others of its kind move: the frames and the name of the element.
fn frozen_signals<'a>(frames: &[ArmColumns], facts: &'a ArmFacts) -> Vec<(Range<usize>, &'a str)> {
    let mut found = Vec::new();
    for group in facts.signal_groups() {
        let same = |step: usize, element: usize| frames[step].state.get(element) == frames[step + 1].state.get(element);
        for &(element, name) in &group {
            let frozen = (0..frames.len().saturating_sub(1)).map(|step| {
                same(step, element)
                    && facts.is_commanded(frames, step, element)
                    && group.iter().any(|(other, _)| *other != element && !same(step, *other))
            });
            found.extend(runs(frozen, 1).into_iter().map(|run| (run.start..run.end + 1, name)));
        }
    }
    found
}

/// Deviations of the differences between consecutive times from the duration of a frame, in durations of a frame.
fn late(frames: &[ArmColumns], facts: &ArmFacts) -> Vec<f64> {
    let Some(period) = facts.period.filter(|period| *period > 0.0) else {
        return Vec::new();
    };
    let pairs = frames.iter().zip(frames.iter().skip(1));
    let step = |(now, next): (&ArmColumns, &ArmColumns)| Some(((next.time? - now.time?) / period - 1.0).abs());
    pairs.map(|pair| step(pair).unwrap_or(0.0)).collect()
}

/// The first pass: measures the values from which thresholds are derived.
pub fn observe_arm(demo: &ArmDemo, facts: &ArmFacts, limits: &GraspLimits) -> Observation {
    let frames = &demo.episode.frames;
    let view = View::of(demo, facts, limits);
    let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let stretches = frozen_signals(frames, facts);
    let mut values = vec![
        ("discontinuity_eef", largest(&view.steps.eef)),
        ("discontinuity_rotation", largest(&view.steps.rotation)),
        ("idle", longest(view.idle.iter().copied()) as f64),
        ("saturated", view.saturated[0]),
        ("saturated_together", view.saturated[1]),
        (
            "frozen_signal",
            stretches.iter().map(|(stretch, _)| stretch.len()).max().unwrap_or(0) as f64,
        ),
    ];
    if let Some(grasping) = &view.grasping {
        values.push(("regrasp", transfers(&grasping.grasps) as f64));
    }
    let rewards: Vec<f64> = frames.iter().filter_map(|frame| frame.reward).collect();
    let all = |frame: &ArmColumns| frame.state.iter().chain(&frame.action).copied().collect::<Vec<f64>>();
    Observation {
        episode: demo.number,
        demo: demo.episode.name.clone(),
        frames: frames.len() as u32,
        values,
        last_object: Vector3::zeros(),
        rewarded: (!rewards.is_empty()).then(|| rewards.iter().any(|reward| *reward > 0.0)),
        recording: hash(frames.iter().flat_map(all)),
        actions: hash(frames.iter().flat_map(|frame| frame.action.iter().copied())),
        response: view.fit,
        path: path(&view.positions, frames.len()),
    }
}

/// The path for comparisons. The end effector counts twice, so that distances are those of its position; of joints, the first six are
/// compared.
fn path(positions: &Rows, frames: usize) -> Path {
    let points: Vec<(Vector3<f64>, Vector3<f64>)> = (0..frames)
        .map(|frame| {
            let row = positions.get(frame).unwrap_or_default();
            let at = |axis: usize| row.get(axis).copied().unwrap_or(0.0);
            let first = Vector3::new(at(0), at(1), at(2));
            let second = if positions.width() <= 3 {
                first
            } else {
                Vector3::new(at(3), at(4), at(5))
            };
            (first, second)
        })
        .collect();
    Path::new(points.into_iter())
}

/// The second pass: makes all checks that the dataset allows, and reports every value that exceeds its threshold. The findings are
/// unordered.
pub fn audit_arm(demo: &ArmDemo, facts: &ArmFacts, thresholds: &Thresholds, limits: &GraspLimits) -> Vec<Finding> {
    let frames = &demo.episode.frames;
    let view = View::of(demo, facts, limits);
    let mut sink = Sink::new(demo.number, &demo.episode.name, thresholds);
    let segments = match &view.grasping {
        Some(grasping) => grasping
            .demo
            .segmented
            .segments
            .iter()
            .map(|s| s.segment.clone())
            .collect(),
        None => Vec::new(),
    };
    lengths_and_flicker(&mut sink, &segments, frames.len());
    let mut against = None;
    if let Some(grasping) = &view.grasping {
        check_grasps(&grasping.demo, &grasping.grasps, limits, &mut sink);
        let Fingers { closes, separation, .. } = &grasping.fingers;
        if thresholds.made("gripper_reversed") {
            check_fingers(&grasping.fingers, &mut sink);
            against = against_command(separation, closes, FingerUnit::Travel.of(LEAST_TRAVEL));
        }
    }
    let commanded = |stretch: Range<usize>| view.idle.get(stretch).unwrap_or_default().iter().any(|idle| !idle);
    check_motion(&view.steps, &commanded, &mut sink);
    let axes = facts.axes();
    let response = Response {
        frames: frames.len(),
        fit: view.fit.as_ref(),
        against,
        arm: facts.subject(),
        axes: &axes,
    };
    check_actions_and_motion(&response, &mut sink);
    check_commands(&view.idle, view.saturated, &mut sink);
    let rewards: Vec<Option<f64>> = frames.iter().map(|frame| frame.reward).collect();
    check_success(&rewards, &mut sink);
    let orientations: Option<Vec<UnitQuaternion<f64>>> = frames.iter().map(|frame| frame.eef_orientation).collect();
    if let Some(orientations) = orientations {
        sink.seam(
            "the quaternion of the end effector changes its sign",
            &flips(orientations.iter()),
        );
    }
    let minimum = thresholds.over("frozen_signal");
    for (stretch, name) in frozen_signals(frames, facts) {
        let length = stretch.len();
        if length as f64 > minimum {
            sink.add(
                "frozen_signal",
                stretch,
                Some(length as f64),
                format!("{name} is exactly the same in {length} consecutive frames, while others of its kind move"),
            );
        }
    }
    sink.bursts("timestamps", &late(frames, facts), |value| {
        format!("the time to the next frame differs by {value:.1} durations of a frame from the usual one")
    });
    sink.findings
}

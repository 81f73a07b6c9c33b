//! The motion of a demonstration, and the scores that follow from it directly.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::episodes::ArmColumns;
use re4_episode::pace::{IDLE_FRACTION, fast_step, reach};
use re4_episode::{Mode, PlanarEpisode, Segment, SpatialEpisode, SpatialFrame};

/// Numbers that describe a state, or the actions of a chunk.
pub(crate) const FEATURES: usize = 7;

/// Duration of a chunk of actions in seconds.
const CHUNK_SECONDS: f64 = 0.4;

/// Radius of gyration of Push-T's block in px, rounded. It converts the block's rotation to a distance.
const BLOCK: f64 = 40.0;

/// The motion of a demonstration, in the world frame: in metres, or in px if it is planar.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Positions of the end effector, one per frame.
    pub eef: Vec<Vector3<f64>>,
    /// Positions of the object, one per frame.
    pub object: Vec<Vector3<f64>>,
    /// Distances that the end effector moves, one per step, with rotations converted by [`re4_episode::pace::LEVER`].
    pub steps: Vec<f64>,
    /// Changes of the finger separation, one per step; empty without a gripper.
    pub fingers: Vec<f64>,
    /// The state of every frame as numbers.
    pub states: Vec<[f64; FEATURES]>,
    /// The action of every frame as numbers. The action of a chunk is their sum.
    pub actions: Vec<[f64; FEATURES]>,
    /// Mode segments.
    pub segments: Vec<Segment>,
    /// Duration of a frame, in s.
    pub period: f64,
}

impl Motion {
    /// The motion of a demonstration with a gripper. `period` is the duration of a frame, in s.
    pub fn spatial(episode: &SpatialEpisode, segments: &[Segment], period: f64) -> Self {
        let frames = &episode.frames;
        let pairs = || frames.iter().zip(frames.iter().skip(1));
        Self {
            eef: frames.iter().map(|frame| frame.eef.translation.vector).collect(),
            object: frames.iter().map(|frame| frame.object.translation.vector).collect(),
            steps: pairs().map(|(now, next)| reach(&now.eef, &next.eef)).collect(),
            fingers: pairs()
                .map(|(now, next)| (next.finger_separation() - now.finger_separation()).abs())
                .collect(),
            states: frames.iter().map(spatial_state).collect(),
            actions: frames.iter().map(spatial_action).collect(),
            segments: segments.to_vec(),
            period,
        }
    }

    /// The motion of a demonstration of an arm without an object. `openings` are those of the gripper, as fractions of its travel;
    /// `period` is the duration of a frame, in s. Without positions of the end effector, the scores of its path are not defined, and
    /// steps are those of the whole recorded state.
    pub fn arm(frames: &[ArmColumns], openings: Option<&[f64]>, segments: &[Segment], period: f64) -> Self {
        let pairs = || frames.iter().zip(frames.iter().skip(1));
        let eef: Option<Vec<Vector3<f64>>> = frames.iter().map(|frame| frame.eef).collect();
        let opening = |frame: usize| {
            openings
                .and_then(|openings| openings.get(frame))
                .copied()
                .unwrap_or(0.0)
        };
        let pose = |frame: &ArmColumns| {
            let orientation = frame.eef_orientation.unwrap_or_else(UnitQuaternion::identity);
            Some(Isometry3::from_parts(Translation3::from(frame.eef?), orientation))
        };
        let steps = pairs().map(|(now, next)| match pose(now).zip(pose(next)) {
            Some((now, next)) => reach(&now, &next),
            None => apart(&now.state, &next.state),
        });
        let first = |numbers: &[f64], last: f64| {
            let mut features = [0.0; FEATURES];
            features
                .iter_mut()
                .zip(numbers)
                .for_each(|(feature, number)| *feature = *number);
            features[FEATURES - 1] = last;
            features
        };
        let states = frames.iter().enumerate().map(|(place, frame)| {
            let position: Vec<f64> = match frame.eef {
                Some(eef) => eef.iter().copied().collect(),
                None => frame.state.clone(),
            };
            first(&position, opening(place))
        });
        let actions = frames
            .iter()
            .map(|frame| first(&frame.action, frame.gripper.unwrap_or_default()));
        let fingers = openings
            .unwrap_or_default()
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).abs());
        let eef = eef.unwrap_or_else(|| vec![Vector3::zeros(); frames.len()]);
        Self {
            object: eef.clone(),
            steps: steps.collect(),
            fingers: fingers.collect(),
            states: states.collect(),
            actions: actions.collect(),
            segments: segments.to_vec(),
            eef,
            period,
        }
    }

    /// The motion of a Push-T demonstration. `period` is the duration of a frame, in s.
    pub fn planar(episode: &PlanarEpisode, segments: &[Segment], period: f64) -> Self {
        let frames = &episode.frames;
        let eef: Vec<Vector3<f64>> = frames
            .iter()
            .map(|frame| Vector3::new(frame.eef.x, frame.eef.y, 0.0))
            .collect();
        let states = frames.iter().map(|frame| {
            let (sin, cos) = frame.object.theta.sin_cos();
            let (eef, object) = (frame.eef, frame.object);
            [eef.x, eef.y, object.x, object.y, BLOCK * cos, BLOCK * sin, 0.0]
        });
        // Targets are absolute. Their offsets from the pusher are the commanded motion.
        let actions = frames.iter().map(|frame| {
            let offset = frame.action - frame.eef;
            [offset.x, offset.y, 0.0, 0.0, 0.0, 0.0, 0.0]
        });
        Self {
            steps: eef
                .iter()
                .zip(eef.iter().skip(1))
                .map(|(now, next)| (next - now).norm())
                .collect(),
            object: frames
                .iter()
                .map(|frame| Vector3::new(frame.object.x, frame.object.y, 0.0))
                .collect(),
            fingers: Vec::new(),
            states: states.collect(),
            actions: actions.collect(),
            segments: segments.to_vec(),
            eef,
            period,
        }
    }

    /// Duration in s.
    pub fn duration(&self) -> f64 {
        self.eef.len() as f64 * self.period
    }

    /// The positions of the end effector in a segment, with the first position of the next segment.
    pub(crate) fn path(&self, segment: &Segment) -> &[Vector3<f64>] {
        let end = (segment.frames.end + 1).min(self.eef.len());
        self.eef.get(segment.frames.start..end).unwrap_or_default()
    }
}

/// End effector in the world, object relative to it, and the fingers.
fn spatial_state(frame: &SpatialFrame) -> [f64; FEATURES] {
    let (eef, object) = (frame.eef.translation.vector, frame.object.translation.vector);
    let apart = object - eef;
    [
        eef.x,
        eef.y,
        eef.z,
        apart.x,
        apart.y,
        apart.z,
        frame.finger_separation(),
    ]
}

fn spatial_action(frame: &SpatialFrame) -> [f64; FEATURES] {
    let [x, y, z, rx, ry, rz] = frame.delta;
    [x, y, z, rx, ry, rz, frame.gripper]
}

/// Euclidean distance.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (b - a).powi(2)).sum::<f64>().sqrt()
}

/// Length of a path.
pub(crate) fn length(path: &[Vector3<f64>]) -> f64 {
    path.iter().zip(path.iter().skip(1)).map(|(a, b)| (b - a).norm()).sum()
}

/// Path efficiency: the distances between the ends of the mode segments, summed, divided by the length of the end effector's path.
/// It is 1 if every segment is straight, and near 0 if the end effector moves back and forth. `None` if it does not move.
pub fn path_efficiency(motion: &Motion) -> Option<f64> {
    let ends = |path: &[Vector3<f64>]| Some((path.last()? - path.first()?).norm());
    let straight: f64 = motion
        .segments
        .iter()
        .filter_map(|segment| ends(motion.path(segment)))
        .sum();
    let travelled = length(&motion.eef);
    (travelled > 0.0).then(|| (straight / travelled).min(1.0))
}

/// Idle share: the fraction of steps in which the end effector moves at less than [`IDLE_FRACTION`] of its peak speed and the fingers
/// at less than that fraction of theirs. The peak is the 95th percentile over the demonstration's moving steps, so one jump of the
/// recorder does not count. `None` if there is no step or no motion.
pub fn idle_share(motion: &Motion) -> Option<f64> {
    let slow = |steps: &[f64]| {
        let limit = IDLE_FRACTION * fast_step(steps.iter().copied());
        steps.iter().map(|&step| step <= limit).collect::<Vec<_>>()
    };
    if fast_step(motion.steps.iter().copied()) == 0.0 {
        return None;
    }
    let (arm, fingers) = (slow(&motion.steps), slow(&motion.fingers));
    let idle = arm.iter().enumerate();
    let idle = idle.filter(|&(step, &still)| still && fingers.get(step).copied().unwrap_or(true));
    Some(idle.count() as f64 / arm.len() as f64)
}

/// Regrasps: the number of transfer segments after the first one. `None` without a gripper.
pub fn regrasps(motion: &Motion) -> Option<f64> {
    let transfers = motion.segments.iter().filter(|segment| segment.mode == Mode::Transfer);
    (!motion.fingers.is_empty()).then(|| transfers.count().saturating_sub(1) as f64)
}

/// Chunks of a demonstration: the state at the start, then the summed action. Chunks follow each other without overlap.
pub fn chunks(motion: &Motion) -> Vec<[[f64; FEATURES]; 2]> {
    let length = (CHUNK_SECONDS / motion.period).round().max(1.0) as usize;
    let chunk = |start: usize| {
        let mut action = [0.0; FEATURES];
        for frame in motion.actions.get(start..start + length)? {
            for (sum, part) in action.iter_mut().zip(frame) {
                *sum += part;
            }
        }
        Some([*motion.states.get(start)?, action])
    };
    (0..motion.eef.len()).step_by(length).filter_map(chunk).collect()
}

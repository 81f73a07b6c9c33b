//! Steps of end effector and object: jumps, gaps in time, repeated states.

use std::ops::Range;

use re4_episode::SpatialFrame;
use re4_segment::SpatialEvidence;
use re4_task::Domain;

use crate::common::Sink;
use crate::runs::runs;
use crate::spatial::{SpatialDemo, state};

/// Number of steps before and after a gap that are compared with it.
const AROUND: usize = 2;

/// A step that is a gap is at least this many times as long as the steps around it.
const ISOLATED: f64 = 2.0;

/// Smallest usual top speeds (m and rad per step) in multiples of which gaps are measured.
const SLOWEST: (f64, f64) = (0.005, 0.05);

/// The arm is commanded to translate if the action is at least this long: a twentieth of its limit.
const COMMANDED: f64 = 0.05;

/// The steps of a demonstration, and which of them are repetitions.
pub(crate) struct Steps {
    /// Distances that the end effector moves, in m.
    pub(crate) eef: Vec<f64>,
    /// Angles by which it rotates, in rad.
    pub(crate) rotation: Vec<f64>,
    /// Distances that the object moves, in m.
    pub(crate) object: Vec<f64>,
    /// Whether the whole state is the same before and after the step, bit for bit.
    pub(crate) same_state: Vec<bool>,
    /// The same of the end effector's pose alone.
    pub(crate) same_eef: Vec<bool>,
}

impl Steps {
    /// The steps of a demonstration with a gripper.
    pub(crate) fn of(demo: &SpatialDemo) -> Self {
        let frames = &demo.episode.frames;
        let pairs = || frames.iter().zip(frames.iter().skip(1));
        let steps = |step: fn(&SpatialEvidence) -> Option<f64>| -> Vec<f64> {
            demo.segmented.evidence.iter().filter_map(step).collect()
        };
        Self {
            eef: steps(|e| e.eef_step),
            rotation: steps(|e| e.eef_rotation),
            object: steps(|e| e.object_step),
            same_state: pairs().map(|(now, next)| state(now) == state(next)).collect(),
            same_eef: pairs().map(|(now, next)| now.eef == next.eef).collect(),
        }
    }
}

/// Whether the arm is commanded to translate in a stretch of frames.
pub(crate) fn translates(frames: &[SpatialFrame], stretch: Range<usize>) -> bool {
    let own = frames.get(stretch).unwrap_or_default();
    let [x, y, z] = [0, 1, 2].map(|axis| own.iter().map(|frame| frame.delta[axis].abs()).fold(0.0, f64::max));
    nalgebra::Vector3::new(x, y, z).norm() >= COMMANDED
}

/// Reports jumps, gaps and repeated states. `commanded` states whether the arm is commanded to move in a stretch of frames.
pub(crate) fn check_motion(steps: &Steps, commanded: &dyn Fn(Range<usize>) -> bool, sink: &mut Sink<'_>) {
    let repeats = check_repeats(steps, commanded, sink);
    // A jump at the end of a stretch of repeated states is part of that fault.
    let unexplained = |values: &[f64]| -> Vec<f64> {
        let all = values.iter().copied().enumerate();
        all.map(|(place, value)| if repeats.contains(&place) { 0.0 } else { value })
            .collect()
    };
    let (eef, rotation) = (unexplained(&steps.eef), unexplained(&steps.rotation));
    sink.bursts("discontinuity_eef", &eef, |value| {
        format!("the end effector jumps by {:.0} mm in one step", 1e3 * value)
    });
    sink.bursts("discontinuity_object", &unexplained(&steps.object), |value| {
        format!("the object jumps by {:.0} mm in one step", 1e3 * value)
    });
    sink.bursts("discontinuity_rotation", &rotation, |value| {
        format!(
            "the end effector rotates by {:.0} degrees in one step",
            value.to_degrees()
        )
    });
    check_gaps(&eef, &rotation, sink);
}

/// Reports single steps that are faster than usual and much faster than the steps around them, unless they are jumps.
fn check_gaps(eef: &[f64], rotation: &[f64], sink: &mut Sink<'_>) {
    let (top_step, top_rotation) = sink.thresholds.top_speed;
    let jumps = |step: f64, angle: f64| {
        step > sink.thresholds.over("discontinuity_eef") || angle > sink.thresholds.over("discontinuity_rotation")
    };
    let speeds: Vec<f64> = eef
        .iter()
        .zip(rotation)
        .map(|(step, angle)| (step / top_step.max(SLOWEST.0)).max(angle / top_rotation.max(SLOWEST.1)))
        .collect();
    let gaps: Vec<f64> = (0..speeds.len())
        .map(|place| {
            let before = speeds.get(place.saturating_sub(AROUND)..place).unwrap_or_default();
            let after = speeds
                .get(place + 1..(place + 1 + AROUND).min(speeds.len()))
                .unwrap_or_default();
            let around = before.iter().chain(after).copied().fold(0.0, f64::max);
            let isolated = !before.is_empty() && !after.is_empty() && speeds[place] > ISOLATED * around;
            if isolated && !jumps(eef[place], rotation[place]) {
                speeds[place]
            } else {
                0.0
            }
        })
        .collect();
    sink.bursts("time_gap", &gaps, |value| {
        format!("in one step, the arm moves {value:.1} times as far as usual at its top speed, and much less before and after")
    });
}

/// Reports repeated states and end-effector poses. Returns the last frames of these stretches, whose steps are jumps.
fn check_repeats(steps: &Steps, commanded: &dyn Fn(Range<usize>) -> bool, sink: &mut Sink<'_>) -> Vec<usize> {
    let mut ends = Vec::new();
    let mut repeated = vec![false; steps.same_state.len() + 1];
    let minimum = sink.thresholds.over("frozen");
    // An arm that rests can repeat its readings; only simulated joints never do.
    let real = sink.thresholds.domain() == Domain::Arm;
    for run in runs(steps.same_state.iter().copied(), 1) {
        // A run of n steps spans n + 1 frames.
        let stretch = run.start..run.end + 1;
        if stretch.len() as f64 >= minimum && (!real || commanded(stretch.clone())) {
            let length = stretch.len();
            ends.push(run.end);
            repeated.get_mut(run).unwrap_or_default().fill(true);
            sink.add(
                "frozen",
                stretch,
                Some(length as f64),
                format!("exactly the same state in {length} consecutive frames"),
            );
        }
    }
    let minimum = sink.thresholds.over("frozen_eef");
    let same = steps
        .same_eef
        .iter()
        .zip(&repeated)
        .map(|(same, repeated)| *same && !repeated);
    for run in runs(same, 1) {
        let stretch = run.start..run.end + 1;
        if stretch.len() as f64 >= minimum && commanded(stretch.clone()) {
            let length = stretch.len();
            ends.push(run.end);
            sink.add(
                "frozen_eef",
                stretch,
                Some(length as f64),
                format!("exactly the same end-effector pose in {length} consecutive frames, while the arm is commanded to move"),
            );
        }
    }
    ends
}

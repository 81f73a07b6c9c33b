//! Steps of end effector and object: jumps, gaps in time, repeated states.

use re4_episode::SpatialFrame;
use re4_segment::SpatialEvidence;

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

/// Reports jumps, gaps and repeated states.
pub(crate) fn check_motion(demo: &SpatialDemo, sink: &mut Sink<'_>) {
    let frames = &demo.episode.frames;
    let repeats = check_repeats(frames, sink);
    // A jump at the end of a stretch of repeated states is part of that fault.
    let explained = |step: usize| repeats.contains(&step);
    let steps = |step: fn(&SpatialEvidence) -> Option<f64>| -> Vec<f64> {
        let all = demo.segmented.evidence.iter().filter_map(step).enumerate();
        all.map(|(place, value)| if explained(place) { 0.0 } else { value })
            .collect()
    };
    let (eef, rotation) = (steps(|e| e.eef_step), steps(|e| e.eef_rotation));
    sink.bursts("discontinuity_eef", &eef, |value| {
        format!("the end effector jumps by {:.0} mm in one step", 1e3 * value)
    });
    sink.bursts("discontinuity_object", &steps(|e| e.object_step), |value| {
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
fn check_repeats(frames: &[SpatialFrame], sink: &mut Sink<'_>) -> Vec<usize> {
    let pairs = || frames.iter().zip(frames.iter().skip(1));
    let mut ends = Vec::new();
    let mut repeated = vec![false; frames.len()];
    let minimum = sink.thresholds.over("frozen");
    for run in runs(pairs().map(|(now, next)| state(now) == state(next)), 1) {
        // A run of n steps spans n + 1 frames.
        let stretch = run.start..run.end + 1;
        if stretch.len() as f64 >= minimum {
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
    let same = pairs()
        .zip(&repeated)
        .map(|((now, next), repeated)| now.eef == next.eef && !repeated);
    for run in runs(same, 1) {
        let stretch = run.start..run.end + 1;
        let own = frames.get(stretch.clone()).unwrap_or_default();
        let [x, y, z] = [0, 1, 2].map(|axis| own.iter().map(|frame| frame.delta[axis].abs()).fold(0.0, f64::max));
        let commanded = nalgebra::Vector3::new(x, y, z).norm() >= COMMANDED;
        if stretch.len() as f64 >= minimum && commanded {
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

//! The audit of one demonstration of Push-T.

use nalgebra::Vector3;
use re4_episode::{PlanarEpisode, PlanarFrame};
use re4_segment::{Evidence, SegmentedEpisode};

use crate::common::{Sink, hash, lengths_and_flicker};
use crate::copies::Path;
use crate::finding::Finding;
use crate::runs::{longest, runs};
use crate::thresholds::{Observation, Thresholds};

/// A demonstration of Push-T, and its segmentation.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanarDemo {
    /// Number in the artifact, from 0.
    pub number: u32,
    /// The demonstration.
    pub episode: PlanarEpisode,
    /// Its modes, evidence and segments.
    pub segmented: SegmentedEpisode,
    /// Coverage of the goal at every frame.
    pub coverage: Vec<f64>,
}

/// The first pass: measures the values from which thresholds are derived.
pub fn observe_planar(demo: &PlanarDemo) -> Observation {
    let frames = &demo.episode.frames;
    let steps = demo.segmented.evidence.iter().filter_map(|e| e.eef_step);
    Observation {
        episode: demo.number,
        demo: demo.episode.name(),
        frames: frames.len() as u32,
        values: vec![
            ("discontinuity_eef", steps.fold(0.0, f64::max)),
            ("idle", longest(waits(frames)) as f64),
        ],
        last_object: frames
            .last()
            .map_or_else(Vector3::zeros, |f| Vector3::new(f.object.x, f.object.y, f.object.theta)),
        rewarded: None,
        recording: hash(
            frames
                .iter()
                .flat_map(|f| state(f).into_iter().chain([f.action.x, f.action.y])),
        ),
        actions: hash(frames.iter().flat_map(|f| [f.action.x, f.action.y])),
        response: None,
        path: Path::new(frames.iter().map(|f| {
            (
                Vector3::new(f.eef.x, f.eef.y, 0.0),
                Vector3::new(f.object.x, f.object.y, 0.0),
            )
        })),
    }
}

/// The second pass: makes all checks that apply, and reports every value that exceeds its threshold. The findings are unordered.
pub fn audit_planar(demo: &PlanarDemo, thresholds: &Thresholds) -> Vec<Finding> {
    let frames = &demo.episode.frames;
    let mut sink = Sink::new(demo.number, &demo.episode.name(), thresholds);
    let segments: Vec<_> = demo.segmented.segments.iter().map(|s| s.segment.clone()).collect();
    lengths_and_flicker(&mut sink, &segments, frames.len());
    check_contacts(&demo.segmented.evidence, &mut sink);
    let steps =
        |step: fn(&Evidence) -> Option<f64>| -> Vec<f64> { demo.segmented.evidence.iter().filter_map(step).collect() };
    sink.bursts("discontinuity_eef", &steps(|e| e.eef_step), |value| {
        format!("the pusher jumps by {value:.0} px in one step")
    });
    sink.bursts("discontinuity_object", &steps(|e| e.object_step), |value| {
        format!("the block jumps by {value:.0} px in one step")
    });
    check_stretches(frames, &mut sink);
    let needed = thresholds.over("ends_before_success");
    let best = demo.coverage.iter().copied().reduce(f64::max);
    if let (Some(&last), Some(best)) = (demo.coverage.last(), best)
        && last <= needed
    {
        let end = frames.len();
        sink.add(
            "ends_before_success",
            end.saturating_sub(1)..end,
            Some(last),
            format!("the block covers {last:.3} of the goal at the last frame, and {best:.3} at the best one"),
        );
    }
    let wraps: Vec<usize> = frames
        .iter()
        .zip(frames.iter().skip(1))
        .enumerate()
        .filter(|(_, (now, next))| (next.object.theta - now.object.theta).abs() > std::f64::consts::PI)
        .map(|(frame, _)| frame)
        .collect();
    sink.seam("the block's angle wraps around", &wraps);
    sink.findings
}

/// Returns contact and motion of every frame but the last: whether contact was counted during the step that led to the frame, and
/// whether the block moves in the step to the next frame. `None` if contacts were not recorded.
///
/// On the human demonstrations, contact and motion agree better with this pairing than with the contacts of the next frame.
pub fn contact_and_motion(evidence: &[Evidence]) -> Vec<Option<(bool, bool)>> {
    evidence
        .iter()
        .take(evidence.len().saturating_sub(1))
        .map(|evidence| Some((evidence.contact?, evidence.object_moving?)))
        .collect()
}

fn check_contacts(evidence: &[Evidence], sink: &mut Sink<'_>) {
    let steps = contact_and_motion(evidence);
    for (code, pattern, message) in [
        (
            "contact_without_motion",
            (true, false),
            "contact, but the block does not move",
        ),
        (
            "motion_without_contact",
            (false, true),
            "no contact, but the block moves",
        ),
    ] {
        let minimum = sink.thresholds.over(code);
        for run in runs(steps.iter().map(|step| *step == Some(pattern)), 1) {
            let length = run.len();
            if length as f64 >= minimum {
                sink.add(
                    code,
                    run,
                    Some(length as f64),
                    format!("{message}, in {length} consecutive steps"),
                );
            }
        }
    }
}

fn check_stretches(frames: &[PlanarFrame], sink: &mut Sink<'_>) {
    for run in runs(waits(frames), 1) {
        sink.exceeding("idle", run.start..run.end + 1, run.len() as f64, |value| {
            format!("the same target in {} consecutive frames", value + 1.0)
        });
    }
    let minimum = sink.thresholds.over("frozen");
    let same = frames
        .iter()
        .zip(frames.iter().skip(1))
        .map(|(now, next)| state(now) == state(next));
    for run in runs(same, 1) {
        let stretch = run.start..run.end + 1;
        let length = stretch.len();
        if length as f64 >= minimum {
            sink.add(
                "frozen",
                stretch,
                Some(length as f64),
                format!("exactly the same state in {length} consecutive frames"),
            );
        }
    }
}

/// For every step, whether the target is the same before and after it.
fn waits(frames: &[PlanarFrame]) -> impl Iterator<Item = bool> {
    frames
        .iter()
        .zip(frames.iter().skip(1))
        .map(|(now, next)| now.action == next.action)
}

fn state(frame: &PlanarFrame) -> [f64; 5] {
    let (eef, object) = (frame.eef, frame.object);
    [eef.x, eef.y, object.x, object.y, object.theta]
}

//! Measures the errors of an encoder's poses after training: table `pose_errors`, and a summary. This is the only part of
//! `train-pose` that reads recorded object poses of robosuite tasks.

use anyhow::Result;
use nalgebra::Isometry3;
use re4_artifact::{Artifact, Writer};
use re4_episode::Mode;
use re4_fault::{OrFault as _, ensure, fault};
use re4_geometry::spatial::rotation_vector;
use re4_pose::PoseErrorRow;
use re4_pose::spatial::{Arrival, Demonstration, Evaluation, FrameError, GraspPhase, Measured, evaluate as measure};
use re4_stats::spread;
use serde_json::{Map, Value, json};

use crate::inputs::demos::SegmentedEpisodes;
use crate::pipeline::Task;

/// Quantiles of the errors in the summary.
const QUANTILES: [f64; 2] = [0.5, 0.9];

/// A transferred grasp whose rotation error exceeds this, in rad, grasps the opposite side of the object.
const OTHER_SIDE: f64 = std::f64::consts::FRAC_PI_2;

/// Compares the estimates of all demonstrations with the recorded poses. Writes table `pose_errors`, and returns the entry
/// `evaluation` of the summary. `poses` are the estimates by demonstration and frame, world frame, in the order of the artifacts;
/// `trained_on` has one entry per demonstration: whether it was trained on.
///
/// Demonstrations are read one at a time; only poses stay in memory, some 200 bytes per frame.
///
/// # Errors
/// If the artifacts cannot be read, or the estimates do not belong to their demonstrations.
pub(super) fn evaluate(
    writer: &Writer,
    episodes: &Artifact,
    modes: &Artifact,
    poses: &[Vec<Isometry3<f64>>],
    trained_on: &[bool],
    task: Task,
) -> Result<Value> {
    let symmetry = task.symmetry();
    let demonstrations = read(episodes, modes, poses, trained_on)?;
    let evaluation = measure(&demonstrations, symmetry)?;
    write(writer, &demonstrations, evaluation.estimates.as_ref())?;
    let mut summary = summary(&demonstrations, &evaluation);
    if let Some(summary) = summary.as_object_mut() {
        summary.insert("symmetry".to_owned(), serde_json::to_value(symmetry)?);
    }
    Ok(summary)
}

fn read(
    episodes: &Artifact,
    modes: &Artifact,
    poses: &[Vec<Isometry3<f64>>],
    trained_on: &[bool],
) -> Result<Vec<Demonstration>> {
    let mut estimates = poses.iter().zip(trained_on);
    let mut demonstrations = Vec::with_capacity(poses.len());
    for demo in SegmentedEpisodes::open(episodes, modes)? {
        let demo = demo?;
        let frames = &demo.episode.frames;
        let own = estimates.next().filter(|(poses, _)| poses.len() == frames.len());
        let (poses, &trained_on) = own.or_fault(|| {
            fault!(
                "cannot evaluate the estimated poses: they do not match the {} frames of {} of {}",
                frames.len(),
                demo.episode.name,
                episodes.path().display();
                "train again"
            )
        })?;
        let held: Vec<bool> = demo
            .segmented
            .modes
            .iter()
            .map(|mode| *mode == Mode::Transfer)
            .collect();
        demonstrations.push(Demonstration {
            trained_on,
            phases: GraspPhase::of(&held),
            estimated: poses.clone(),
            recorded: frames.iter().map(|frame| frame.object).collect(),
            eef: frames.iter().map(|frame| frame.eef).collect(),
        });
    }
    ensure!(
        estimates.next().is_none(),
        "cannot evaluate the estimated poses: there are more demonstrations than in {}", episodes.path().display();
        "train again"
    );
    Ok(demonstrations)
}

fn write(writer: &Writer, demonstrations: &[Demonstration], measured: Option<&Measured>) -> Result<()> {
    let mut table = writer.rows()?;
    let of_demos = measured.map_or(&[][..], |measured| &measured.errors);
    for ((episode, demo), errors) in (0_u32..).zip(demonstrations).zip(of_demos) {
        // Every frame has an estimate, so `flatten` drops nothing.
        let errors = (0..).zip(&demo.phases).zip(errors.iter().flatten());
        table.extend(errors.map(|((frame, &phase), &error)| PoseErrorRow {
            episode,
            frame,
            trained_on: demo.trained_on,
            phase,
            error,
        }))?;
    }
    table.finish()?;
    Ok(())
}

/// The entry `evaluation` of the summary. Values that could not be measured are null.
fn summary(demonstrations: &[Demonstration], evaluation: &Evaluation) -> Value {
    let of = |measured: Option<&Measured>| measured.map(|measured| scores(demonstrations, measured));
    let offset = evaluation.estimates.as_ref().map(|measured| {
        let pose = measured.offset.pose();
        json!({
            "translation_mm": pose.translation.vector.iter().map(|part| 1e3 * part).collect::<Vec<_>>(),
            "rotation_vector_rad": rotation_vector(&pose.rotation).iter().copied().collect::<Vec<_>>(),
            "up_to_pi_about_the_approach_axis": measured.offset.allows_pi(),
        })
    });
    json!({
        "against": "recorded poses, which were not read before, with one constant rigid offset removed",
        "offset": offset,
        "estimates": of(evaluation.estimates.as_ref()),
        "labels": of(evaluation.labels.as_ref()),
        "mean_pose": of(evaluation.mean.as_ref()),
        "carried_grasps": carried(&evaluation.arrivals),
    })
}

/// Errors by phase, separately for demonstrations that were trained on and for those that were held out.
fn scores(demonstrations: &[Demonstration], measured: &Measured) -> Value {
    let of = |trained_on: bool| {
        let chosen = || {
            let all = demonstrations.iter().zip(&measured.errors);
            all.filter(move |(own, _)| own.trained_on == trained_on)
        };
        let errors = |phase: Option<GraspPhase>| -> Vec<FrameError> {
            let frames = chosen().flat_map(|(own, errors)| own.phases.iter().zip(errors));
            let wanted = frames.filter(|(own, _)| phase.is_none_or(|phase| phase == **own));
            wanted.filter_map(|(_, error)| *error).collect()
        };
        let mut scores = Map::new();
        scores.insert("demonstrations".to_owned(), json!(chosen().count()));
        scores.insert("overall".to_owned(), score(&errors(None)));
        for phase in GraspPhase::ALL {
            scores.insert(phase.as_str().to_owned(), score(&errors(Some(phase))));
        }
        Value::Object(scores)
    };
    json!({ "held_out": of(false), "trained_on": of(true) })
}

fn score(errors: &[FrameError]) -> Value {
    let spread =
        |value: fn(&FrameError) -> f64, unit: fn(f64) -> f64| spread(errors.iter().map(|e| unit(value(e))), &QUANTILES);
    json!({
        "frames": errors.len(),
        "translation_mm": spread(|e| e.translation, millimetres),
        "translation_at_grasp_mm": spread(|e| e.translation_at_grasp, millimetres),
        "rotation_deg": spread(|e| e.rotation, f64::to_degrees),
    })
}

fn carried(arrivals: &[Arrival]) -> Value {
    if arrivals.is_empty() {
        return Value::Null;
    }
    let other_side = arrivals.iter().filter(|arrival| arrival.angle > OTHER_SIDE).count();
    json!({
        "queries": arrivals.len(),
        "distance_mm": spread(arrivals.iter().map(|a| millimetres(a.distance)), &QUANTILES),
        "angle_deg": spread(arrivals.iter().map(|a| a.angle.to_degrees()), &QUANTILES),
        "fraction_on_the_other_side": other_side as f64 / arrivals.len() as f64,
    })
}

fn millimetres(metres: f64) -> f64 {
    1e3 * metres
}

#[cfg(test)]
mod tests {
    use super::*;
    use re4_geometry::spatial::Symmetry;

    fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
        Isometry3::translation(x, y, z)
    }

    /// Four frames, of which the last two are held. The estimate is off by `off` metres along x.
    fn demonstration(number: f64, trained_on: bool, off: f64) -> Demonstration {
        let recorded = [at(number, 0.0, 0.8); 4];
        Demonstration {
            trained_on,
            phases: GraspPhase::of(&[false, false, true, true]),
            estimated: recorded.map(|pose| at(off, 0.0, 0.02) * pose).to_vec(),
            recorded: recorded.to_vec(),
            eef: recorded.to_vec(),
        }
    }

    #[test]
    fn scores_without_frames_are_null() {
        let trained = [
            demonstration(0.0, true, 0.0),
            demonstration(0.1, true, 0.0),
            demonstration(0.2, true, 0.0),
        ];
        let all_trained = summary(&trained, &measure(&trained, Symmetry::None).unwrap());
        let scores = &all_trained["estimates"];
        assert_eq!(scores["trained_on"]["overall"]["frames"], 12);
        assert_eq!(
            scores["trained_on"]["after_release"],
            json!({ "frames": 0, "translation_mm": null, "translation_at_grasp_mm": null, "rotation_deg": null })
        );
        assert_eq!(scores["held_out"]["overall"]["translation_mm"], Value::Null);
        assert_eq!(all_trained["carried_grasps"], Value::Null);
        let empty = summary(&[], &measure(&[], Symmetry::None).unwrap());
        assert_eq!(empty["estimates"], Value::Null);
        assert_eq!(empty["offset"], Value::Null);
    }

    #[test]
    fn held_out_demonstrations_are_scored_separately() {
        let mut all: Vec<_> = (0..5).map(|i| demonstration(0.01 * f64::from(i), true, 0.0)).collect();
        all.push(demonstration(0.02, false, 0.004));
        let scored = summary(&all, &measure(&all, Symmetry::None).unwrap());
        let close = |value: &Value, expected: f64| (value.as_f64().unwrap() - expected).abs() < 1e-9;
        let estimates = &scored["estimates"];
        for (part, off) in [("trained_on", 0.0), ("held_out", 4.0)] {
            for phase in ["overall", "before_grasp", "held"] {
                assert!(
                    close(&estimates[part][phase]["translation_mm"]["p50"], off),
                    "{part} {phase}"
                );
                assert!(close(&estimates[part][phase]["rotation_deg"]["p90"], 0.0));
            }
        }
        assert!(close(&scored["offset"]["translation_mm"][2], -20.0));
        // The mean of the labels is at the third of the five demonstrations; the others are 1 or 2 cm away.
        assert!(close(
            &scored["mean_pose"]["trained_on"]["before_grasp"]["translation_mm"]["p50"],
            10.0
        ));
        assert!(close(
            &scored["labels"]["trained_on"]["held"]["translation_mm"]["p90"],
            0.0
        ));
        assert_eq!(scored["carried_grasps"]["queries"], 2);
        assert!(close(&scored["carried_grasps"]["distance_mm"]["p50"], 4.0));
    }
}

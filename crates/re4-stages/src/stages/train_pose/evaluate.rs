//! Measures the errors of an encoder's poses: table `pose_errors`, warnings, and the summary. This is the only part of `train-pose` and
//! `train-encoder` that reads recorded object poses of robosuite tasks.
//!
//! Demonstrations are read one at a time. Beyond [`EVALUATED`] demonstrations, the offset and the figures in the summary are those of an
//! even selection of them, so that memory and the search for the nearest frames do not grow with the dataset. Table `pose_errors` has
//! every frame.

use anyhow::Result;
use nalgebra::Isometry3;
use re4_artifact::{Artifact, ArtifactSummary, Writer};
use re4_audit::SpatialDemo;
use re4_encoder::EncoderConfig;
use re4_episode::Mode;
use re4_fault::{OrFault as _, ensure, fault};
use re4_geometry::spatial::rotation_vector;
use re4_pose::PoseErrorRow;
use re4_pose::spatial::{Arrival, Demonstration, Evaluation, FrameError, GraspPhase, Measured, evaluate as measure};
use re4_stats::spread;
use serde_json::{Map, Value, json};

use super::demos::{Agreement, Demo};
use crate::inputs::demos::{Names, SegmentedEpisodes};
use crate::runner::Runner;

/// Quantiles of the errors in the summary.
const QUANTILES: [f64; 2] = [0.5, 0.9];

/// A transferred grasp whose rotation error exceeds this, in rad, grasps the opposite side of the object.
const OTHER_SIDE: f64 = std::f64::consts::FRAC_PI_2;

/// Maximum number of demonstrations that are evaluated together, about. They take some 300 bytes per frame.
const EVALUATED: usize = 2048;

/// Opens the estimates of all demonstrations, in their order. Each item has the poses of a demonstration, by frame, world frame.
pub(super) type Poses<'a> = dyn Fn() -> Box<dyn Iterator<Item = Result<Vec<Isometry3<f64>>>> + 'a> + 'a;

/// What is done with a demonstration and its estimates.
type Visit<'a> = dyn FnMut(&SpatialDemo, Vec<Isometry3<f64>>) -> Result<()> + 'a;

/// The demonstrations of which poses were estimated.
pub(super) struct Demos<'a> {
    pub(super) episodes: &'a Artifact,
    pub(super) modes: &'a Artifact,
    pub(super) config: &'a EncoderConfig,
}

impl Demos<'_> {
    /// Calls `visit` with each demonstration and its estimates.
    fn each(&self, poses: &Poses<'_>, visit: &mut Visit<'_>) -> Result<()> {
        let mut estimates = poses();
        for demo in SegmentedEpisodes::open(self.episodes, self.modes)? {
            let demo = demo?;
            let frames = demo.episode.frames.len();
            let own = estimates.next().transpose()?.filter(|poses| poses.len() == frames);
            let poses = own.or_fault(|| {
                fault!(
                    "cannot evaluate the estimated poses: they do not match the {frames} frames of {} of {}",
                    demo.episode.name,
                    self.episodes.path().display();
                    "delete the poses artifact and estimate again"
                )
            })?;
            visit(&demo, poses)?;
        }
        ensure!(
            estimates.next().is_none(),
            "cannot evaluate the estimated poses: there are more demonstrations than in {}", self.episodes.path().display();
            "delete the poses artifact and estimate again"
        );
        Ok(())
    }
}

/// An even selection of demonstrations, of those that were trained on and of the others.
struct Selection {
    /// One in this many is selected.
    stride: usize,
    seen: [usize; 2],
}

impl Selection {
    fn of(demos: usize) -> Self {
        Self {
            stride: demos.div_ceil(EVALUATED).max(1),
            seen: [0; 2],
        }
    }

    /// Whether the next demonstration is selected.
    fn selects(&mut self, trained_on: bool) -> bool {
        let seen = &mut self.seen[usize::from(trained_on)];
        let selected = seen.is_multiple_of(self.stride);
        *seen += 1;
        selected
    }
}

impl Runner {
    /// Compares the estimates with the anchors and with the recorded poses. Writes table `pose_errors`, and returns the summary of the
    /// `poses` artifact.
    ///
    /// # Errors
    /// If the artifacts cannot be read, the estimates do not belong to their demonstrations, or the run is interrupted.
    pub(super) fn evaluate(&self, demos: &Demos<'_>, poses: &Poses<'_>, writer: &Writer) -> Result<ArtifactSummary> {
        let symmetry = self.pipeline.task.symmetry();
        let names = Names::read(demos.episodes)?;
        let mut selection = Selection::of(names.count());
        let mut agreement = Agreement::default();
        let mut selected = Vec::new();
        let mut frames = 0;
        demos.each(poses, &mut |demo, poses| {
            self.interrupt.check("train-pose")?;
            let own = Demo::of(demo, demos.config);
            agreement.add(&own, &poses, demos.config);
            frames += poses.len();
            if selection.selects(own.trained_on) {
                selected.push(demonstration(demo, own.trained_on, poses));
            }
            Ok(())
        })?;
        let evaluation = measure(&selected, symmetry)?;
        let mut table = writer.rows()?;
        if let Some(measured) = &evaluation.estimates {
            demos.each(poses, &mut |demo, poses| {
                self.interrupt.check("train-pose")?;
                let trained_on = Demo::is_trained_on(demo.number, demos.config);
                let rows = (0..).zip(phases(demo)).zip(poses.iter().zip(&demo.episode.frames));
                let rows = rows.map(|((frame, phase), (pose, recorded))| PoseErrorRow {
                    episode: demo.number,
                    frame,
                    trained_on,
                    phase,
                    error: measured.offset.error(pose, &recorded.object),
                });
                Ok(table.extend(rows)?)
            })?;
        }
        table.finish()?;
        let mut scores = summary(&selected, &evaluation);
        if let Some(scores) = scores.as_object_mut() {
            scores.insert("symmetry".to_owned(), serde_json::to_value(symmetry)?);
        }
        let [held_out, trained_on] = selection.seen;
        Ok(ArtifactSummary {
            summary: json!({
                "episodes": held_out + trained_on,
                "frames": frames,
                "trained_on": trained_on,
                "evaluation": scores,
            }),
            warnings: agreement.warnings(demos.config, &|demo| names.of(demo).unwrap_or_default()),
        })
    }
}

fn demonstration(demo: &SpatialDemo, trained_on: bool, estimated: Vec<Isometry3<f64>>) -> Demonstration {
    let frames = &demo.episode.frames;
    Demonstration {
        trained_on,
        phases: phases(demo),
        estimated,
        recorded: frames.iter().map(|frame| frame.object).collect(),
        eef: frames.iter().map(|frame| frame.eef).collect(),
    }
}

fn phases(demo: &SpatialDemo) -> Vec<GraspPhase> {
    let modes = &demo.segmented.modes;
    GraspPhase::of(&modes.iter().map(|mode| *mode == Mode::Transfer).collect::<Vec<_>>())
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
    fn many_demonstrations_are_selected_evenly_of_both_sets() {
        let select = |demos: usize| {
            let mut selection = Selection::of(demos);
            // As with pose.encoder.held_out = 0.1, one in ten is held out.
            let sets = (0..demos).map(|demo| !demo.is_multiple_of(10));
            let selected: Vec<bool> = sets.filter(|&trained_on| selection.selects(trained_on)).collect();
            let trained_on = selected.iter().filter(|trained_on| **trained_on).count();
            [selected.len() - trained_on, trained_on]
        };
        assert_eq!(select(2048), [205, 1843]);
        assert_eq!(select(20_480), [205, 1844]);
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

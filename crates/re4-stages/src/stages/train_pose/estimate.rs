//! The stage `train-pose` for robosuite tasks: writes an encoder's estimates for `episodes` to `poses`, in the parts of `episodes`.
//!
//! Until the poses are written, only the columns of `EefOf` (module `demos`), modes and images are read. The evaluation reads recorded object
//! poses afterwards, and no stage reads its results.

use std::sync::Arc;

use anyhow::Result;
use nalgebra::Isometry3;
use re4_artifact::{Artifact, ArtifactSummary, ByEpisode, Recipe, Row as _, Stage, TableSpec, Writer, columns};
use re4_encoder::{Calibration, EncoderConfig, Predictor};
use re4_fault::{OrFault as _, ensure, fault};
use re4_ingest::{DemoRow, FrameRow, SpatialColumns};
use re4_pose::{PoseRow, SpatialEstimate};
use re4_segment::{ModeRow, SegmentRow, SpatialEvidence, SpatialSegment};
use serde_json::json;

use super::demos::read_demos;
use super::evaluate::Demos;
use crate::inputs::demos::Names;
use crate::inputs::estimators::{WEIGHTS, read_calibration};
use crate::parts::Lazy;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 7;

/// Images that are estimated at a time.
pub(super) const BATCH: usize = 64;

/// A trained encoder.
struct Trained {
    predictor: Predictor,
    calibration: Option<Arc<Calibration>>,
}

columns! {
    /// The columns of table `poses` that the evaluation reads.
    pub struct ObjectOf {
        /// Demonstration.
        pub episode: u32,
        /// Estimated pose.
        pub object: Isometry3<f64>,
    }
}

impl Runner {
    /// Makes the `poses` artifact of a robosuite task, or returns the existing one.
    pub(super) fn estimate_spatial(&self, episodes: &Built, modes: &Built, encoder: &Built) -> Result<Built> {
        let config = self.pipeline.pose()?.encoder().into_owned();
        let (episodes, modes, encoder) = (&episodes.artifact, &modes.artifact, &encoder.artifact);
        let recipe = Recipe::new(Stage::TrainPose, CODE_VERSION)
            .config(&json!({ "pose": { "source": "encoder", "encoder": config } }))?
            .input("episodes", episodes.key())
            .input("modes", modes.key())
            .input("encoder", encoder.key());
        let trained = Lazy::new();
        let make = |episodes: &Artifact, modes: &Artifact, writer: &Writer| {
            let trained = trained.get(|| {
                Ok(Trained {
                    predictor: Predictor::open(&encoder.path().join(WEIGHTS), &config)?,
                    calibration: read_calibration(encoder.path())?,
                })
            })?;
            self.estimate(trained, &config, (episodes, modes), writer)
        };
        let demos = Demos {
            episodes,
            modes,
            config: &config,
        };
        let parts = episodes.parts();
        if parts == 1 {
            return self.build(&recipe, |writer| {
                let poses = make(episodes, modes, writer)?;
                self.evaluate(&demos, &|| Box::new(poses.iter().cloned().map(Ok)), writer)
            });
        }
        self.build_parts(
            &recipe,
            parts,
            |writer, part| {
                let poses = make(&episodes.part(part)?, &modes.part(part)?, writer)?;
                Ok(ArtifactSummary {
                    summary: json!({ "episodes": poses.len(), "frames": poses.iter().map(Vec::len).sum::<usize>() }),
                    warnings: Vec::new(),
                })
            },
            |parts, writer| {
                parts.iter().try_for_each(Artifact::verify_bytes)?;
                // A process that makes some parts has verified only theirs. The images are not read here.
                let of_episodes: [&'static TableSpec; 2] = [FrameRow::<SpatialColumns>::table(), DemoRow::table()];
                let of_modes: [&'static TableSpec; 2] = [
                    ModeRow::<SpatialEvidence>::table(),
                    SegmentRow::<SpatialSegment>::table(),
                ];
                of_episodes.iter().try_for_each(|table| episodes.verify_table(table))?;
                of_modes.iter().try_for_each(|table| modes.verify_table(table))?;
                self.evaluate(&demos, &|| Box::new(parts.iter().flat_map(poses_of)), writer)
            },
        )
    }

    /// Estimates the poses of all frames of an artifact or of a part of one, and writes table `poses`. Returns the poses by
    /// demonstration and frame, world frame.
    fn estimate(
        &self,
        trained: &Trained,
        config: &EncoderConfig,
        (episodes, modes): (&Artifact, &Artifact),
        writer: &Writer,
    ) -> Result<Vec<Vec<Isometry3<f64>>>> {
        let demos = read_demos(config, episodes, modes)?;
        let frames: usize = demos.iter().map(|demo| demo.eef.len()).sum();
        let bar = self.notes.progress(frames as u64, "poses");
        let names = Names::read(episodes)?;
        let name = |demo| names.of(demo).unwrap_or_else(|| format!("demonstration {demo}"));
        let mut images = self.images_of(episodes, &config.camera, &name)?;
        let other_frames = || {
            fault!(
                "cannot estimate poses: the images of camera {:?} in {} are not those of its frames",
                config.camera, episodes.path().display();
                "delete the artifact and ingest again"
            )
        };
        let mut table = writer.rows()?;
        let mut all = Vec::with_capacity(demos.len());
        for demo in &demos {
            let frames = demo.eef.len();
            let mut poses = Vec::with_capacity(frames);
            while poses.len() < frames {
                self.interrupt.check("train-pose")?;
                let chunk = (poses.len()..frames.min(poses.len() + BATCH)).map(|frame| {
                    let image = images.next().transpose()?;
                    let own = image.filter(|image| (image.episode, image.frame as usize) == (demo.episode, frame));
                    Ok(own.or_fault(other_frames)?.pixels)
                });
                let chunk: Vec<Vec<u8>> = chunk.collect::<Result<_>>()?;
                let chunk: Vec<&[u8]> = chunk.iter().map(Vec::as_slice).collect();
                for prediction in trained.predictor.predict(&chunk)? {
                    let scored = trained.calibration.as_ref().zip(prediction.disagreement);
                    let confidence = scored.map(|(calibration, score)| calibration.confidence(score));
                    table.push(&PoseRow {
                        episode: demo.episode,
                        frame: poses.len() as u32,
                        estimate: SpatialEstimate {
                            trained_on: demo.trained_on,
                            object: prediction.pose,
                            confidence,
                            unsure: confidence.map(Calibration::is_unsure),
                            embedding: prediction.embedding,
                        },
                    })?;
                    poses.push(prediction.pose);
                }
            }
            bar.inc(frames as u64);
            all.push(poses);
        }
        ensure!(images.next().transpose()?.is_none(), "{}", other_frames());
        table.finish()?;
        bar.finish_and_clear();
        Ok(all)
    }
}

/// The poses of a part of a `poses` artifact, by demonstration and frame.
fn poses_of(part: &Artifact) -> Box<dyn Iterator<Item = Result<Vec<Isometry3<f64>>>>> {
    let rows = part
        .table(PoseRow::<SpatialEstimate>::table())
        .and_then(|table| ByEpisode::of(&table, |row: &ObjectOf| row.episode));
    match rows {
        Ok(rows) => Box::new(rows.map(|rows| Ok(rows?.1.into_iter().map(|row| row.object).collect()))),
        Err(error) => Box::new(std::iter::once(Err(error.into()))),
    }
}

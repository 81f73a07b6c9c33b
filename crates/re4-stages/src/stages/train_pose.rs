//! The stages `train-encoder` and `train-pose`, which make `poses` from `episodes`. Push-T's log-polar estimator is not trained but
//! calibrated with the goal pose. For robosuite tasks, `train-encoder` trains an encoder (module `encoder`), and `train-pose` writes its
//! estimates (module `estimate`).

mod card;
mod demos;
mod encoder;
mod estimate;
mod evaluate;
mod images;

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use anyhow::{Context as _, Result};
use arrow_array::RecordBatch;
use image::ImageFormat;
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Row as _, Stage, Table, Writer, col_binary, col_u32, columns};
use re4_fault::{OrFault as _, ensure, fault};
use re4_geometry::{Pose2, periodic_distance};
use re4_ingest::{FrameRow, ImageRow, PlanarColumns};
use re4_policy::DemoNames;
use re4_pose::{
    Anchor, AnchorBuilder, AnchorRow, Estimate, Flag, ImageError, LogPolarEstimator, PoseRow, PushtImage, SIDE, Storage,
};
use re4_stats::spread;
use serde_json::{Value, json};

use crate::inputs::demos::demo_names;
use crate::inputs::estimators::{outline, storage};
use crate::inputs::images::check_images;
use crate::pipeline::PoseSource;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 5;

/// Every `CALIBRATION_STRIDE`-th frame of a demonstration, starting with the first, is used to find the goal. The goal does not
/// move, so more frames would add little.
const CALIBRATION_STRIDE: u32 = 16;

/// Angle errors above this, in degrees, count as flips: the estimator confused the ends of the block.
const FLIP: f64 = 90.0;

impl Runner {
    /// Makes the `poses` artifact of Push-T, or returns the existing one; `None` if poses are not estimated from images.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn train_pose(&self, episodes: &Built) -> Result<Option<Built>> {
        match self.pipeline.pose()?.source {
            PoseSource::Recorded | PoseSource::Encoder => Ok(None),
            PoseSource::LogPolar => self.estimate_planar(&episodes.artifact).map(Some),
        }
    }

    /// Makes the `encoder` artifact of a robosuite task, or returns the existing one; `None` if poses are not estimated from
    /// images.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn train_encoder(&self, episodes: &Built, modes: &Built) -> Result<Option<Built>> {
        let pose = self.pipeline.pose()?;
        if pose.source != PoseSource::Encoder {
            return Ok(None);
        }
        check_images(&episodes.artifact, &pose.encoder().camera)?;
        self.make_encoder(episodes, modes).map(Some)
    }

    /// Makes the `poses` artifact of a robosuite task, or returns the existing one; `None` without an encoder.
    ///
    /// # Errors
    /// As [`Runner::train_encoder`].
    pub fn estimate_poses(&self, episodes: &Built, modes: &Built, encoder: Option<&Built>) -> Result<Option<Built>> {
        let estimate = |encoder| self.estimate_spatial(episodes, modes, encoder);
        encoder.map(estimate).transpose()
    }

    /// Makes the `encoder` and `poses` artifacts of a robosuite task, and returns the latter; `None` if poses are not estimated from
    /// images.
    ///
    /// # Errors
    /// As [`Runner::train_encoder`].
    pub fn train_spatial(&self, episodes: &Built, modes: &Built) -> Result<Option<Built>> {
        let encoder = self.train_encoder(episodes, modes)?;
        self.estimate_poses(episodes, modes, encoder.as_ref())
    }

    fn estimate_planar(&self, episodes: &Artifact) -> Result<Built> {
        let recipe = Recipe::new(Stage::TrainPose, CODE_VERSION)
            .config(&json!({ "pose": self.pipeline.pose()? }))?
            .input("episodes", episodes.key());
        self.build(&recipe, |writer| {
            let images = Images::open(episodes)?;
            let pose = self.pipeline.pose()?;
            let storage = storage(episodes, pose);
            let anchor = self.calibrate(&images, storage)?;
            write_anchor(&anchor, writer)?;
            let estimator = LogPolarEstimator::new(&anchor, outline(), pose.refine).for_images(storage);
            let estimates = self.estimate_all(&estimator, &images, writer)?;
            // Recorded poses are read only now, after all estimates are written, and only to measure the errors.
            let evaluation = evaluate(&estimates, episodes)?;
            let flags = count(&estimates);
            let mut summary = json!({
                "frames": estimates.len(),
                "frames_not_clear": estimates.iter().filter(|row| row.estimate.flag != Flag::Clear).count(),
                "flags": flags,
                "confidence": spread(estimates.iter().map(|row| row.estimate.confidence), &[0.0, 0.01, 0.5]),
            });
            if let (Some(summary), Some(evaluation)) = (summary.as_object_mut(), evaluation) {
                summary.insert("evaluation".to_owned(), evaluation);
            }
            Ok(ArtifactSummary {
                summary,
                warnings: warnings(&estimates, &flags, &images.names),
            })
        })
    }

    fn calibrate(&self, images: &Images, storage: Storage) -> Result<Anchor> {
        let mut builder = AnchorBuilder::default();
        for group in 0..images.table.row_groups() {
            self.interrupt.check("train-pose")?;
            let rows = images.table.read_row_group(group)?;
            let frames = col_u32(&rows, "frame")?;
            let chosen: Vec<usize> = (0..frames.len())
                .filter(|&row| frames[row].is_multiple_of(CALIBRATION_STRIDE))
                .collect();
            let decoded = images.decode(&rows, &chosen)?;
            for pixels in &decoded {
                builder.add(&PushtImage::new(pixels, SIDE, SIDE)?);
            }
        }
        let goal = self.pipeline.pose()?.goal();
        builder
            .finish(goal, &outline(), storage)
            .with_context(|| format!("cannot calibrate on the images of {}", images.path.display()))
    }

    fn estimate_all(
        &self,
        estimator: &LogPolarEstimator,
        images: &Images,
        writer: &Writer,
    ) -> Result<Vec<PoseRow<Estimate>>> {
        let bar = self.notes.progress(images.table.rows(), "poses");
        let mut table = writer.rows()?;
        let mut all = Vec::with_capacity(images.table.rows() as usize);
        for group in 0..images.table.row_groups() {
            self.interrupt.check("train-pose")?;
            let rows = images.table.read_row_group(group)?;
            let estimates = images.map(&rows, |image| estimator.estimate(image))?;
            bar.inc(estimates.len() as u64);
            let ids = col_u32(&rows, "episode")?.iter().zip(col_u32(&rows, "frame")?);
            for ((&episode, &frame), estimate) in ids.zip(estimates) {
                let row = PoseRow {
                    episode,
                    frame,
                    estimate,
                };
                table.push(&row)?;
                all.push(row);
            }
        }
        table.finish()?;
        bar.finish_and_clear();
        Ok(all)
    }
}

/// The images of an `episodes` artifact.
struct Images {
    table: Table,
    path: std::path::PathBuf,
    names: DemoNames,
}

impl Images {
    fn open(episodes: &Artifact) -> Result<Self> {
        let path = episodes.path().to_owned();
        ensure!(
            episodes.has::<ImageRow>(),
            "cannot estimate poses: {} has no images", path.display();
            "set ingest.images = true and, if the dataset has no images, ingest.render = [\"image\"]"
        );
        Ok(Self {
            table: episodes.table(ImageRow::table())?,
            path,
            names: demo_names(episodes)?,
        })
    }

    /// Applies `estimate` to each image of a batch, in parallel. Results are in the order of the batch.
    fn map<T: Send>(&self, rows: &RecordBatch, estimate: impl Fn(&PushtImage<'_>) -> T + Sync) -> Result<Vec<T>> {
        let all: Vec<usize> = (0..rows.num_rows()).collect();
        self.each(rows, &all, |pixels| {
            Ok(estimate(&PushtImage::new(
                pixels.as_raw(),
                pixels.width() as usize,
                pixels.height() as usize,
            )?))
        })
    }

    /// Decodes the chosen images of a batch to RGB bytes, and checks their size.
    fn decode(&self, rows: &RecordBatch, chosen: &[usize]) -> Result<Vec<Vec<u8>>> {
        self.each(rows, chosen, |pixels| {
            // For its check of the size only.
            PushtImage::new(pixels.as_raw(), pixels.width() as usize, pixels.height() as usize)?;
            Ok(pixels.into_raw())
        })
    }

    fn each<T: Send>(
        &self,
        rows: &RecordBatch,
        chosen: &[usize],
        apply: impl Fn(image::RgbImage) -> Result<T, ImageError> + Sync,
    ) -> Result<Vec<T>> {
        let encoded = col_binary(rows, "image")?;
        let (episodes, frames) = (col_u32(rows, "episode")?, col_u32(rows, "frame")?);
        let place = |row: usize| {
            format!(
                "cannot estimate poses from {}: the image of {}, frame {}",
                self.path.display(),
                self.names.of(episodes[row]),
                frames[row]
            )
        };
        chosen
            .par_iter()
            .map(|&row| {
                let image = image::load_from_memory_with_format(encoded.value(row), ImageFormat::Png)
                    .or_fault(|| fault!("{} is not a PNG image", place(row); "delete the artifact and ingest again"))?;
                apply(image.into_rgb8()).with_context(|| place(row))
            })
            // Collected in order before the errors are examined, so that the reported error does not depend on the threads.
            .collect::<Vec<_>>()
            .into_iter()
            .collect()
    }
}

fn write_anchor(anchor: &Anchor, writer: &Writer) -> Result<()> {
    writer.write_rows(
        anchor
            .fractions()
            .iter()
            .enumerate()
            .map(|(pixel, fraction)| AnchorRow {
                row: pixel / SIDE,
                column: pixel % SIDE,
                goal_fraction: f64::from(*fraction),
            }),
    )?;
    Ok(())
}

fn count(rows: &[PoseRow<Estimate>]) -> BTreeMap<&'static str, usize> {
    let mut flags: BTreeMap<_, _> = Flag::ALL.iter().map(|flag| (flag.as_str(), 0)).collect();
    for row in rows {
        *flags.entry(row.estimate.flag.as_str()).or_default() += 1;
    }
    flags
}

fn warnings(rows: &[PoseRow<Estimate>], flags: &BTreeMap<&'static str, usize>, names: &DemoNames) -> Vec<Value> {
    let mut doubtful = rows.iter().filter(|row| row.estimate.flag != Flag::Clear);
    let Some(first) = doubtful.next() else {
        return Vec::new();
    };
    let counted: Vec<String> = flags
        .iter()
        .filter(|&(flag, &frames)| *flag != Flag::Clear.as_str() && frames > 0)
        .map(|(flag, frames)| format!("{frames} {flag}"))
        .collect();
    vec![json!({
        "code": "pose_not_clear",
        "message": format!(
            "the estimated pose is not clear in {} of {} frames ({}), first in {}, frame {}; these frames are not retrieved",
            1 + doubtful.count(),
            rows.len(),
            counted.join(", "),
            names.of(first.episode),
            first.frame,
        ),
    })]
}

/// The errors of the estimates against recorded poses, for the summary only; no stage reads them. `None` if the dataset has no
/// recorded poses.
fn evaluate(rows: &[PoseRow<Estimate>], episodes: &Artifact) -> Result<Option<Value>> {
    columns! {
        /// The column of table `frames` that is read.
        pub struct Recorded {
            /// Pose of the block; null if the dataset has none.
            pub object: Option<Pose2>,
        }
    }
    let recorded: Vec<Recorded> = episodes.table(FrameRow::<PlanarColumns>::table())?.read()?;
    let (mut position, mut angle) = (Vec::new(), Vec::new());
    for (row, Recorded { object }) in rows.iter().zip(recorded) {
        if let (Some(pose), Some(object)) = (row.estimate.pose, object) {
            position.push((pose.x - object.x).hypot(pose.y - object.y));
            angle.push(periodic_distance(pose.theta, object.theta, TAU).to_degrees());
        }
    }
    if position.is_empty() {
        return Ok(None);
    }
    let flips = angle.iter().filter(|error| **error > FLIP).count();
    let mut evaluation = json!({
        "against": "recorded poses, which were not used to make the estimates",
        "flips": flips,
    });
    if let Some(evaluation) = evaluation.as_object_mut() {
        evaluation.insert("position_px".to_owned(), spread(position, &[0.5, 0.9, 0.99, 1.0]));
        evaluation.insert("angle_deg".to_owned(), spread(angle, &[0.5, 0.9, 0.99, 1.0]));
    }
    Ok(Some(evaluation))
}

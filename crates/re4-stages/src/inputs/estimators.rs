//! Opens pose estimators from a `poses` artifact.

use anyhow::{Context as _, Result};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_f64};
use re4_pose::{Anchor, LogPolarEstimator, Outline};
use re4_sim::{OUTLINE_RADIUS, tee_rectangles};

use crate::pipeline::PoseSection;

/// Name of the weights file in the artifact.
pub(crate) const WEIGHTS: &str = "encoder.safetensors";

/// The estimator with which a `poses` artifact was made.
pub(crate) fn open_estimator(artifact: &Artifact, pose: &PoseSection) -> Result<LogPolarEstimator> {
    let table = artifact
        .table(re4_pose::AnchorRow::table())?
        .read_columns(&["goal_fraction"])?;
    let goal_fraction: Vec<f32> = col_f64(&table, "goal_fraction")?
        .iter()
        .map(|fraction| *fraction as f32)
        .collect();
    let anchor = Anchor::from_goal_mask(&goal_fraction, pose.goal(), &outline()).with_context(|| {
        format!(
            "cannot read {}: table anchor does not show a goal",
            artifact.path().display()
        )
    })?;
    Ok(LogPolarEstimator::new(&anchor, outline(), pose.refine))
}

/// The outline of the block as Push-T renders it.
pub(crate) fn outline() -> Outline {
    Outline::new(&tee_rectangles(), OUTLINE_RADIUS)
}

/// File name of the calibration of an encoder's confidence.
pub(crate) const CONFIDENCE: &str = "confidence.json";

//! Pose estimators out of a `poses` artifact.

use anyhow::{Context as _, Result};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_f64};
use re4_pose::{Anchor, LogPolarEstimator, Outline};
use re4_sim::{OUTLINE_RADIUS, tee_rectangles};

use crate::pipeline::PoseSection;

/// File of the weights in the artifact.
pub(crate) const WEIGHTS: &str = "encoder.safetensors";

/// The estimator that a `poses` artifact was made with.
pub(crate) fn open_estimator(artifact: &Artifact, pose: &PoseSection) -> Result<LogPolarEstimator> {
    let table = artifact
        .table(re4_pose::AnchorRow::table())?
        .read_columns(&["goal_fraction"])?;
    let share: Vec<f32> = col_f64(&table, "goal_fraction")?
        .iter()
        .map(|share| *share as f32)
        .collect();
    let anchor = Anchor::from_goal_mask(&share, pose.goal(), &outline()).with_context(|| {
        format!(
            "cannot read {}: table anchor is not that of a goal",
            artifact.path().display()
        )
    })?;
    Ok(LogPolarEstimator::new(&anchor, outline(), pose.refine))
}

/// The block as Push-T draws it.
pub(crate) fn outline() -> Outline {
    Outline::new(&tee_rectangles(), OUTLINE_RADIUS)
}

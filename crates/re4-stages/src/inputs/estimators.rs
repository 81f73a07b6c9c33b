//! Opens pose estimators from a `poses` artifact.

use anyhow::{Context as _, Result};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_f64};
use re4_pose::{Anchor, LogPolarEstimator, Outline, Storage};
use re4_sim::{OUTLINE_RADIUS, tee_rectangles};

use crate::pipeline::PoseSection;

/// Name of the weights file in the artifact.
pub(crate) const WEIGHTS: &str = "encoder.safetensors";

/// The estimator of a `poses` artifact, for images of the simulator, which are lossless.
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

/// How the images of an `episodes` artifact of Push-T were stored in its source: as the setting says, or as the source does.
pub(crate) fn storage(episodes: &Artifact, pose: &PoseSection) -> Storage {
    let codings = episodes.manifest().source["image_coding"].as_object();
    let of_source = || codings.is_some_and(|all| all.values().any(|coding| coding["lossy"] == true));
    if pose.lossy.unwrap_or_else(of_source) {
        Storage::Lossy
    } else {
        Storage::Lossless
    }
}

/// The outline of the block as Push-T renders it.
pub(crate) fn outline() -> Outline {
    Outline::new(&tee_rectangles(), OUTLINE_RADIUS)
}

/// File name of the calibration of an encoder's confidence.
pub(crate) const CONFIDENCE: &str = "confidence.json";

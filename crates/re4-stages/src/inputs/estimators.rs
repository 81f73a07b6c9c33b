//! Opens pose estimators: of Push-T from a `poses` artifact, of robosuite tasks from an `encoder` artifact.

use std::io::ErrorKind;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_f64};
use re4_encoder::Calibration;
use re4_fault::{OrFault as _, fault};
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

/// Reads the calibration of an encoder's confidence; `None` if it has none.
///
/// # Errors
/// If the file cannot be read or is not a calibration.
pub(crate) fn read_calibration(encoder: &Path) -> Result<Option<Arc<Calibration>>> {
    let path = encoder.join(CONFIDENCE);
    let text = match std::fs::read(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        read => read.or_fault(|| fault!("cannot read {}", path.display(); "train the encoder again"))?,
    };
    let calibration = serde_json::from_slice(&text)
        .or_fault(|| fault!("{} is not a calibration", path.display(); "train the encoder again"))?;
    Ok(Some(Arc::new(calibration)))
}

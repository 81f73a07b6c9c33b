//! Pose estimators that observe the object for a policy from images.

use std::sync::Arc;

use anyhow::Result;
use re4_encoder::{Calibration, EncoderError, Predictor, is_blank};
use re4_fault::Remedy as _;
use re4_geometry::Pose2;
use re4_pose::{Flag, LogPolarEstimator, PushtImage};
use re4_rollout::{CLEAR, Estimator, Image, ObservedPose, Plane, PolicyError, Space};

/// The log-polar estimator for one episode of Push-T. If an estimate is not [`Flag::Clear`], the policy gets the last clear one
/// instead.
pub(super) struct LogPolar {
    estimator: Arc<LogPolarEstimator>,
    last_clear: Option<Pose2>,
}

impl LogPolar {
    pub(super) fn new(estimator: &Arc<LogPolarEstimator>) -> Self {
        Self {
            estimator: Arc::clone(estimator),
            last_clear: None,
        }
    }
}

impl Estimator<Plane> for LogPolar {
    fn estimate(&mut self, image: &Image) -> Result<ObservedPose<Plane>, PolicyError> {
        let image = PushtImage::new(&image.pixels, image.width, image.height).map_err(PolicyError::unobservable)?;
        let estimate = self.estimator.estimate(&image);
        if estimate.flag == Flag::Clear {
            self.last_clear = estimate.pose;
        }
        // The block is slow, so a recent clear estimate is more accurate than a doubtful one. Without a clear one, a doubtful one
        // is still better than none.
        let pose = self
            .last_clear
            .or(estimate.pose)
            .ok_or(PolicyError::BlockNeverVisible)?;
        Ok(ObservedPose {
            pose,
            confidence: Some(estimate.confidence),
            flag: Some(estimate.flag.as_str()),
        })
    }
}

/// The trained encoder of a robosuite task. An estimate with a low confidence is flagged; the policy knows whether an earlier one
/// is still valid.
pub(super) struct Encoder {
    predictor: Predictor,
    calibration: Option<Arc<Calibration>>,
}

impl Encoder {
    pub(super) fn new(predictor: &Predictor, calibration: Option<&Arc<Calibration>>) -> Self {
        Self {
            predictor: predictor.clone(),
            calibration: calibration.cloned(),
        }
    }
}

impl Estimator<Space> for Encoder {
    fn estimate(&mut self, image: &Image) -> Result<ObservedPose<Space>, PolicyError> {
        if is_blank(&image.pixels) {
            return Err(PolicyError::unobservable(EncoderError::Blank.sentence()));
        }
        let mut predictions = self
            .predictor
            .predict(&[&image.pixels])
            .map_err(PolicyError::unobservable)?;
        let prediction = predictions.pop();
        let prediction =
            prediction.ok_or_else(|| PolicyError::unobservable("the encoder returned no pose for an image"))?;
        let scored = self.calibration.as_ref().zip(prediction.disagreement);
        let confidence = scored.map(|(calibration, score)| calibration.confidence(score));
        Ok(ObservedPose {
            pose: prediction.pose,
            confidence,
            flag: confidence.map(|own| if Calibration::is_unsure(own) { "unsure" } else { CLEAR }),
        })
    }
}

//! What policies are told of the object by images.

use std::sync::Arc;

use re4_encoder::Predictor;
use re4_geometry::Pose2;
use re4_pose::{Flag, LogPolarEstimator, PushtImage};
use re4_rollout::{Estimator, Image, ObservedPose, Plane, PolicyError, Space};

/// The log-polar estimator through one episode of Push-T. An estimate that is not [`Flag::Clear`] is not told on: the last
/// clear one is.
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
        let image = PushtImage::new(&image.pixels, image.width, image.height).map_err(PolicyError::look)?;
        let estimate = self.estimator.estimate(&image);
        if estimate.flag == Flag::Clear {
            self.last_clear = estimate.pose;
        }
        // A doubtful pose is better than none, and worse than a clear one of a moment ago: the block is slow.
        let pose = self.last_clear.or(estimate.pose).ok_or(PolicyError::Blind)?;
        Ok(ObservedPose {
            pose,
            confidence: Some(estimate.confidence),
            flag: Some(estimate.flag.as_str()),
        })
    }
}

/// An encoder of images of robosuite's tasks.
pub(super) struct Encoder(pub(super) Predictor);

impl Estimator<Space> for Encoder {
    fn estimate(&mut self, image: &Image) -> Result<ObservedPose<Space>, PolicyError> {
        let mut predictions = self.0.predict(&[&image.pixels]).map_err(PolicyError::look)?;
        let seen = predictions.pop();
        let seen = seen.ok_or_else(|| PolicyError::look("the encoder says nothing of an image"))?;
        Ok(ObservedPose {
            pose: seen.pose,
            confidence: None,
            flag: None,
        })
    }
}

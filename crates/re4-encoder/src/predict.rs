//! Poses from pictures.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::Isometry3;

use crate::EncoderError;
use crate::config::Backend;

/// Side of the pictures in pixels.
pub const SIDE: usize = 84;

/// Bytes of a picture: 84 x 84 pixels, RGB, first row at the top.
pub const PICTURE_BYTES: usize = SIDE * SIDE * 3;

/// What the encoder says of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Pose of the object, world frame, in metres: that of the gripper as it would hold the object.
    pub pose: Isometry3<f64>,
    /// Embedding, 256 numbers.
    pub embedding: Vec<f32>,
}

/// The network behind a [`Predictor`], whatever computes it.
trait Network: Send {
    fn predict(&self, pictures: &[&[u8]]) -> Result<Vec<Prediction>, EncoderError>;
}

/// A trained encoder. Clones share its weights; estimates do not depend on which pictures are asked for together.
#[derive(Clone)]
pub struct Predictor {
    network: Arc<Mutex<dyn Network>>,
}

impl Predictor {
    /// Reads the weights that a training wrote.
    ///
    /// # Errors
    /// When the file cannot be read or is not one of an encoder, or this program was built without the backend.
    pub fn open(_weights: &Path, _backend: Backend) -> Result<Self, EncoderError> {
        todo!("arrives with the training")
    }

    /// What the encoder says of pictures of [`PICTURE_BYTES`] bytes each, in their order.
    ///
    /// # Errors
    /// When a picture has another size.
    pub fn predict(&self, pictures: &[&[u8]]) -> Result<Vec<Prediction>, EncoderError> {
        // A panic elsewhere leaves the weights as they are.
        let network = self.network.lock().unwrap_or_else(PoisonError::into_inner);
        network.predict(pictures)
    }
}

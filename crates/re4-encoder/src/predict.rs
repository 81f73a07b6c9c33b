//! Estimates poses from images with a trained encoder.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use burn::tensor::{Tensor, TensorData};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::config::Backend;
use crate::images::{INPUTS, MIDDLE, crop_and_normalise};
use crate::resnet::{EMBEDDING, Encoder};
use crate::{CROP, EncoderError};

/// Side of the images, in pixels.
pub const SIDE: usize = 84;

/// Bytes of an image: 84 x 84 pixels, RGB, first row at the top.
pub const IMAGE_BYTES: usize = SIDE * SIDE * 3;

/// The encoder's output for an image.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Pose of the object, world frame, in metres: the pose of a gripper that would hold the object.
    pub pose: Isometry3<f64>,
    /// The embedding, 256 numbers.
    pub embedding: Vec<f32>,
}

/// A trained encoder. Clones share the weights. An estimate does not depend on the other images of the same call.
#[derive(Clone)]
pub struct Predictor {
    // The mutex is needed because burn's modules are `Send` but not `Sync`.
    encoder: Arc<Mutex<Encoder>>,
}

impl Predictor {
    /// Reads the weights file of a trained encoder.
    ///
    /// # Errors
    /// If the file cannot be read or is not an encoder's, or this program was built without the backend.
    pub fn open(weights: &Path, backend: Backend) -> Result<Self, EncoderError> {
        let device = backend.device()?;
        Ok(Self::new(crate::weights::load(weights, &device)?))
    }

    /// A predictor from an encoder in memory, such as one that was just trained.
    pub fn new(encoder: Encoder) -> Self {
        Self {
            encoder: Arc::new(Mutex::new(encoder)),
        }
    }

    /// The encoder's outputs for images of [`IMAGE_BYTES`] bytes each, in the same order, with a centre crop.
    ///
    /// # Errors
    /// If an image has another size.
    pub fn predict(&self, images: &[&[u8]]) -> Result<Vec<Prediction>, EncoderError> {
        if let Some(wrong) = images.iter().find(|image| image.len() != IMAGE_BYTES) {
            return Err(EncoderError::Image(wrong.len()));
        }
        // A panic in another thread cannot leave the weights inconsistent, so a poisoned lock is usable.
        let encoder = self.encoder.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let device = encoder.device();
        let mut inputs = vec![0.0; images.len() * INPUTS];
        for (image, values) in images.iter().zip(inputs.chunks_exact_mut(INPUTS)) {
            crop_and_normalise(image, MIDDLE, values);
        }
        let inputs = Tensor::<4>::from_data(TensorData::new(inputs, [images.len(), 3, CROP, CROP]), &device);
        let (embeddings, poses) = encoder.poses(inputs);
        let numbers = |tensor: Tensor<2>| -> Vec<f32> { tensor.into_data().iter::<f32>().collect() };
        let translations = numbers(poses.translation);
        let columns = poses.columns.map(numbers);
        let embeddings = numbers(embeddings);
        Ok((0..images.len())
            .map(|i| {
                let vector = |values: &[f32]| Vector3::from_fn(|k, _| f64::from(values[3 * i + k]));
                let [a, b, c] = [0, 1, 2].map(|k| vector(&columns[k]));
                let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[a, b, c]));
                Prediction {
                    pose: Isometry3::from_parts(
                        vector(&translations).into(),
                        UnitQuaternion::from_rotation_matrix(&rotation),
                    ),
                    embedding: embeddings[i * EMBEDDING..(i + 1) * EMBEDDING].to_vec(),
                }
            })
            .collect())
    }
}

//! Estimates poses from images with a trained encoder.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use burn::tensor::Tensor;
use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3, Vector4};

use crate::batches::AS_RECORDED;
use crate::config::EncoderConfig;
use crate::images::{Crop, MIDDLE};
use crate::network::{Crops, Encoder, Estimates, Kernels, estimate};
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
    /// The embedding: 256 numbers, or the positions of the keypoints in the centre crop.
    pub embedding: Vec<f32>,
    /// How much the estimates of the image's crops differ: their mean distance from their mean, in metres. `None` for one crop.
    pub disagreement: Option<f64>,
}

/// A trained encoder. Clones share the weights. An estimate does not depend on the other images of the same call.
#[derive(Clone)]
pub struct Predictor {
    // The mutex is needed because burn's modules are `Send` but not `Sync`.
    encoder: Arc<Mutex<Encoder>>,
    kernels: Option<Kernels>,
    corners: Vec<[u8; 2]>,
}

/// The corners of the crops of an image whose estimates are averaged: the centre crop first.
pub(crate) fn corners(count: usize) -> Vec<[u8; 2]> {
    let last = (SIDE - CROP) as u8;
    let all = [MIDDLE, [0, 0], [0, last], [last, 0], [last, last]];
    all.into_iter().take(count.max(1)).collect()
}

/// Whether all pixels of an image are equal, as if the camera did not work.
pub fn is_blank(image: &[u8]) -> bool {
    image.chunks_exact(3).all(|pixel| pixel == &image[..3])
}

impl Predictor {
    /// Reads the weights file of a trained encoder.
    ///
    /// # Errors
    /// If the file cannot be read or is not an encoder's, or this program was built without the backend.
    pub fn open(weights: &Path, config: &EncoderConfig) -> Result<Self, EncoderError> {
        let device = config.backend.device(crate::train::BACKEND)?;
        Self::new(crate::weights::load(weights, &device)?, config)
    }

    /// A predictor from an encoder in memory, such as one that was just trained.
    ///
    /// # Errors
    /// If its weights cannot be read.
    pub fn new(encoder: Encoder, config: &EncoderConfig) -> Result<Self, EncoderError> {
        Ok(Self {
            kernels: Kernels::of(&encoder, config.backend)?,
            encoder: Arc::new(Mutex::new(encoder)),
            corners: corners(config.crops),
        })
    }

    /// The encoder's outputs for images of [`IMAGE_BYTES`] bytes each, in the same order: the average over the crops.
    ///
    /// # Errors
    /// If an image has another size.
    pub fn predict(&self, images: &[&[u8]]) -> Result<Vec<Prediction>, EncoderError> {
        if let Some(wrong) = images.iter().find(|image| image.len() != IMAGE_BYTES) {
            return Err(EncoderError::Image(wrong.len()));
        }
        // A panic in another thread cannot leave the weights inconsistent, so a poisoned lock is usable.
        let encoder = self.encoder.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut of_crops = Vec::with_capacity(self.corners.len());
        for &corner in &self.corners {
            let crops = vec![
                Crop {
                    corner,
                    light: AS_RECORDED,
                };
                images.len()
            ];
            let crops = Crops { images, crops: &crops };
            of_crops.push(Outputs::read(estimate(&encoder, self.kernels.as_ref(), crops)));
        }
        Ok((0..images.len()).map(|image| combine(&of_crops, image)).collect())
    }
}

/// The outputs for one crop of every image.
struct Outputs {
    poses: Vec<Isometry3<f64>>,
    embeddings: Vec<f32>,
}

impl Outputs {
    fn read(estimates: Estimates) -> Self {
        let numbers = |tensor: Tensor<2>| -> Vec<f32> { tensor.into_data().iter::<f32>().collect() };
        let translations = numbers(estimates.poses.translation);
        let columns = estimates.poses.columns.map(numbers);
        let poses = (0..translations.len() / 3).map(|i| {
            let vector = |values: &[f32]| Vector3::from_fn(|k, _| f64::from(values[3 * i + k]));
            let [a, b, c] = [0, 1, 2].map(|k| vector(&columns[k]));
            let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[a, b, c]));
            let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
            Isometry3::from_parts(vector(&translations).into(), rotation)
        });
        Self {
            poses: poses.collect(),
            embeddings: numbers(estimates.embedding),
        }
    }
}

/// Averages the poses of an image's crops.
fn combine(of_crops: &[Outputs], image: usize) -> Prediction {
    let count = of_crops.len() as f64;
    let mut translation = Vector3::zeros();
    let mut rotation = Vector4::zeros();
    let first = of_crops[0].poses[image];
    for outputs in of_crops {
        let pose = outputs.poses[image];
        translation += pose.translation.vector / count;
        // A quaternion and its negative are the same rotation.
        let own = pose.rotation.coords;
        rotation += if own.dot(&first.rotation.coords) < 0.0 {
            -own
        } else {
            own
        };
    }
    let apart = |outputs: &Outputs| (outputs.poses[image].translation.vector - translation).norm();
    let middle = &of_crops[0];
    let part = |values: &[f32]| {
        let length = values.len() / middle.poses.len();
        values[image * length..(image + 1) * length].to_vec()
    };
    Prediction {
        pose: Isometry3::from_parts(
            translation.into(),
            UnitQuaternion::new_normalize(Quaternion::from_vector(rotation)),
        ),
        embedding: part(&middle.embeddings),
        disagreement: (of_crops.len() > 1).then(|| of_crops.iter().map(apart).sum::<f64>() / count),
    }
}

//! The networks that estimate poses, and what they have in common.

use std::sync::Arc;

use burn::module::{Module, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Isometry3, Vector3};

use crate::config::{Backend, Network};
use crate::images::{Crop, INPUTS, crop_and_normalise, crop_into};
use crate::keypoints::{self, KeypointNetwork};
use crate::loss::Poses;
use crate::resnet::{Named, ResNet};
use crate::trunk::{PER_KEYPOINT, Tapes, Trunk};
use crate::{CROP, EncoderError, IMAGE_BYTES};

/// Metres per unit of a network's translation output. With this scale, the outputs have the magnitude that the initial weights
/// give, and an optimiser step changes the estimate by millimetres.
pub const SCALE: f64 = 0.1;

/// A network.
#[derive(Module, Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one network in a program")]
pub enum Encoder {
    /// ResNet-18 (preset `paper`).
    ResNet(ResNet),
    /// The keypoint network (preset `re4`).
    Keypoints(KeypointNetwork),
}

/// Images with their crops: what a network is applied to.
#[derive(Clone, Copy)]
pub(crate) struct Crops<'a> {
    /// Images of [`IMAGE_BYTES`] bytes each.
    pub(crate) images: &'a [&'a [u8]],
    /// A crop of each.
    pub(crate) crops: &'a [Crop],
}

/// The outputs of a network for a batch.
pub(crate) struct Estimates {
    /// `[batch, 256]`, or the positions of the keypoints.
    pub(crate) embedding: Tensor<2>,
    /// Poses in the world frame.
    pub(crate) poses: Poses,
    /// Standard deviations of the keypoints' maps, in units of half an image side.
    pub(crate) spread: Option<Vec<f32>>,
}

impl Encoder {
    /// A network with burn's initial weights; `width` is the number of channels after the first convolution.
    pub fn new(network: Network, width: usize, device: &Device) -> Self {
        match network {
            Network::Resnet18 => Self::ResNet(ResNet::new(width, device)),
            Network::Keypoints => Self::Keypoints(KeypointNetwork::new(width, device)),
        }
    }

    /// Which network it is.
    pub fn network(&self) -> Network {
        match self {
            Self::ResNet(_) => Network::Resnet18,
            Self::Keypoints(_) => Network::Keypoints,
        }
    }

    /// Number of channels after the first convolution.
    pub fn width(&self) -> usize {
        match self {
            Self::ResNet(network) => network.width(),
            Self::Keypoints(network) => network.width(),
        }
    }

    /// The layers whose biases are together the initial estimate.
    fn last_layers(&mut self) -> Vec<&mut Linear> {
        match self {
            Self::ResNet(network) => vec![network.last_layer()],
            Self::Keypoints(network) => network.last_layers().into(),
        }
    }

    /// Sets the bias of the output to the mean of these poses, so that the initial estimates are distributed around it.
    #[must_use]
    pub fn centred_on(mut self, poses: &[Isometry3<f64>]) -> Self {
        let count = poses.len().max(1) as f64;
        let mean =
            |part: &dyn Fn(&Isometry3<f64>) -> Vector3<f64>| poses.iter().map(part).sum::<Vector3<f64>>() / count;
        let column =
            |k: usize| move |pose: &Isometry3<f64>| pose.rotation.to_rotation_matrix().matrix().column(k).into_owned();
        let parts = [
            mean(&|pose| pose.translation.vector) / SCALE,
            mean(&column(0)),
            mean(&column(1)),
        ];
        let values: Vec<f32> = parts
            .iter()
            .flat_map(|part| [part.x, part.y, part.z])
            .map(|x| x as f32)
            .collect();
        let mut rest = values.as_slice();
        for layer in self.last_layers() {
            layer.bias = layer.bias.take().map(|bias: Param<Tensor<1>>| {
                bias.map(|tensor| {
                    let (own, after) = rest.split_at(tensor.dims()[0]);
                    rest = after;
                    let bias = Tensor::from_data(TensorData::new(own.to_vec(), [own.len()]), &tensor.device());
                    if tensor.is_require_grad() {
                        bias.require_grad()
                    } else {
                        bias
                    }
                })
            });
        }
        self
    }

    /// The device of the weights.
    pub fn device(&self) -> Device {
        match self {
            Self::ResNet(network) => network.head_device(),
            Self::Keypoints(network) => network.device(),
        }
    }

    /// Applies the network with burn's layers.
    pub(crate) fn estimate(&self, crops: Crops<'_>) -> Estimates {
        let device = self.device();
        let images = normalised(crops, &device);
        match self {
            Self::ResNet(network) => {
                let (embedding, raw) = network.forward(images);
                Estimates {
                    embedding,
                    poses: Poses::from_raw(&raw, SCALE),
                    spread: None,
                }
            }
            Self::Keypoints(network) => {
                let offsets: Vec<f32> = crops.crops.iter().flat_map(|crop| keypoints::offset(crop.corner)).collect();
                let offsets = Tensor::from_data(TensorData::new(offsets, [crops.crops.len(), 2]), &device);
                let found = network.keypoints(images, &offsets);
                Estimates {
                    poses: Poses::from_raw(&network.head(&found.positions), SCALE),
                    embedding: found.positions,
                    spread: Some(found.spread.into_data().iter::<f32>().collect()),
                }
            }
        }
    }

    /// The keypoint network, if it is one.
    pub(crate) fn keypoints(&self) -> Option<&KeypointNetwork> {
        match self {
            Self::ResNet(_) => None,
            Self::Keypoints(network) => Some(network),
        }
    }

    /// Every tensor with its name.
    pub(crate) fn slots(&mut self) -> Vec<Named<'_>> {
        match self {
            Self::ResNet(network) => network.slots(),
            Self::Keypoints(network) => network.slots(),
        }
    }
}

/// Normalised crops `[batch, 3, 76, 76]`.
fn normalised(crops: Crops<'_>, device: &Device) -> Tensor<4> {
    let mut inputs = vec![0.0; crops.images.len() * INPUTS];
    let images = crops.images.iter().zip(crops.crops);
    for ((image, crop), values) in images.zip(inputs.chunks_exact_mut(INPUTS)) {
        crop_and_normalise(image, *crop, values);
    }
    Tensor::from_data(TensorData::new(inputs, [crops.images.len(), 3, CROP, CROP]), device)
}

/// The kernels that compute a keypoint network's convolutions on the CPU.
#[derive(Clone)]
pub(crate) struct Kernels {
    trunk: Arc<Trunk>,
}

/// The keypoints that [`Kernels::forward`] found.
pub(crate) struct Found {
    /// x and y of every keypoint, as in [`keypoints::Keypoints`].
    pub(crate) positions: Vec<f32>,
    /// Standard deviation of every map.
    pub(crate) spread: Vec<f32>,
}

impl Kernels {
    /// The kernels for a network on this backend; `None` if burn's layers compute it.
    ///
    /// # Errors
    /// If the weights cannot be read.
    pub(crate) fn of(encoder: &Encoder, backend: Backend) -> Result<Option<Self>, EncoderError> {
        let network = encoder.keypoints().filter(|_| backend == Backend::Flex);
        network.map(Self::new).transpose()
    }

    fn new(network: &KeypointNetwork) -> Result<Self, EncoderError> {
        let shape = keypoints::shape(network.width());
        let positions = keypoints::positions(&shape);
        Ok(Self {
            trunk: Arc::new(Trunk::new(shape, positions, network.trunk_weights()?)),
        })
    }

    /// The keypoints of crops. The tapes keep what the gradient needs.
    pub(crate) fn forward(&self, crops: Crops<'_>, tapes: &mut Tapes) -> Found {
        let fill = |image: usize, into: &mut [f32], layout| {
            debug_assert_eq!(crops.images[image].len(), IMAGE_BYTES);
            crop_into(crops.images[image], crops.crops[image], into, layout);
        };
        let found = self.trunk.forward(tapes, crops.images.len(), fill);
        let mut positions = Vec::with_capacity(found.len() / PER_KEYPOINT * 2);
        let mut spread = Vec::with_capacity(found.len() / PER_KEYPOINT);
        let per_image = found.len() / crops.images.len().max(1);
        for (crop, numbers) in crops.crops.iter().zip(found.chunks_exact(per_image.max(1))) {
            let [x, y] = keypoints::offset(crop.corner);
            for keypoint in numbers.chunks_exact(PER_KEYPOINT) {
                positions.extend([keypoint[0] + x, keypoint[1] + y]);
                spread.push(keypoint[2]);
            }
        }
        Found { positions, spread }
    }

    /// The trunk.
    pub(crate) fn trunk(&self) -> &Trunk {
        &self.trunk
    }
}

/// Applies a network, with the kernels if there are any.
pub(crate) fn estimate(encoder: &Encoder, kernels: Option<&Kernels>, crops: Crops<'_>) -> Estimates {
    let (Some(kernels), Some(network)) = (kernels, encoder.keypoints()) else {
        return encoder.estimate(crops);
    };
    let found = kernels.forward(crops, &mut Tapes::default());
    let dims = [crops.images.len(), found.positions.len() / crops.images.len().max(1)];
    let positions = Tensor::from_data(TensorData::new(found.positions, dims), &encoder.device());
    Estimates {
        poses: Poses::from_raw(&network.head(&positions), SCALE),
        embedding: positions,
        spread: Some(found.spread),
    }
}

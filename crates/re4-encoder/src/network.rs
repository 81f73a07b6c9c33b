//! The networks that estimate poses, and what they have in common.

use std::sync::Arc;

use burn::module::{Module, ModuleMapper, Param};
use burn::nn::Linear;
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Isometry3, Vector3};

use crate::config::Network;
use crate::images::{Crop, INPUTS, crop_and_normalise, crop_into};
use crate::keypoints::{self, KeypointNetwork};
use crate::loss::Poses;
use crate::resnet::{Named, ResNet};
use crate::trunk::{PER_KEYPOINT, Tapes, Trunk};
use crate::{CROP, EncoderError, IMAGE_BYTES};
use re4_train::Backend;

/// Metres per unit of a network's translation output. With this scale, the outputs have the magnitude that the initial weights
/// give, and an optimiser step changes the estimate by millimetres.
pub const SCALE: f64 = 0.1;

/// A network.
#[derive(Module, Debug)]
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

    /// The network with new initial weights of the rotation's head, if it has one of its own.
    pub(crate) fn with_new_rotation(self, initializer: &mut impl ModuleMapper) -> Self {
        match self {
            Self::ResNet(network) => Self::ResNet(network),
            Self::Keypoints(network) => Self::Keypoints(network.with_new_rotation(initializer)),
        }
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
                }
            }
            Self::Keypoints(network) => {
                let offsets: Vec<f32> = crops
                    .crops
                    .iter()
                    .flat_map(|crop| keypoints::offset(crop.corner))
                    .collect();
                let offsets = Tensor::from_data(TensorData::new(offsets, [crops.crops.len(), 2]), &device);
                let positions = network.keypoints(images, &offsets);
                Estimates {
                    poses: Poses::from_raw(&network.head(&positions), SCALE),
                    embedding: positions,
                }
            }
        }
    }

    /// The ResNet-18, if it is one.
    pub fn resnet(&self) -> Option<&ResNet> {
        match self {
            Self::ResNet(network) => Some(network),
            Self::Keypoints(_) => None,
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

    /// The keypoints of crops, x and y of each in turn, as [`KeypointNetwork::keypoints`] returns them. The tapes keep what the
    /// gradient needs.
    pub(crate) fn forward(&self, crops: Crops<'_>, tapes: &mut Tapes) -> Vec<f32> {
        let fill = |image: usize, into: &mut [f32], layout| {
            debug_assert_eq!(crops.images[image].len(), IMAGE_BYTES);
            crop_into(crops.images[image], crops.crops[image], into, layout);
        };
        let mut positions = self.trunk.forward(tapes, crops.images.len(), fill);
        let per_image = positions.len() / crops.images.len().max(1);
        for (crop, own) in crops.crops.iter().zip(positions.chunks_exact_mut(per_image.max(1))) {
            let offset = keypoints::offset(crop.corner);
            for keypoint in own.chunks_exact_mut(PER_KEYPOINT) {
                for (number, offset) in keypoint.iter_mut().zip(offset) {
                    *number += offset;
                }
            }
        }
        positions
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
    let positions = kernels.forward(crops, &mut Tapes::default());
    let dims = [crops.images.len(), positions.len() / crops.images.len().max(1)];
    let positions = Tensor::from_data(TensorData::new(positions, dims), &encoder.device());
    Estimates {
        poses: Poses::from_raw(&network.head(&positions), SCALE),
        embedding: positions,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::optim::GradientsParams;

    use crate::IMAGE_BYTES;

    /// Sets all weights to different values of the usual magnitude.
    struct Fill(u32);

    impl Fill {
        fn next(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (self.0 >> 8) as f32 / (1 << 24) as f32 - 0.5
        }
    }

    impl ModuleMapper for Fill {
        fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
            param.map(|tensor| {
                let dims = tensor.dims();
                let centre = if D == 1 { 0.7 } else { 0.0 };
                let values: Vec<f32> = (0..dims.iter().product()).map(|_| centre + 0.6 * self.next()).collect();
                let filled = Tensor::from_data(TensorData::new(values, dims), &tensor.device());
                if tensor.is_require_grad() {
                    filled.require_grad()
                } else {
                    filled
                }
            })
        }
    }

    fn network() -> Encoder {
        let device = Device::flex().autodiff();
        Encoder::new(Network::Keypoints, 32, &device).map(&mut Fill(7))
    }

    fn images() -> (Vec<Vec<u8>>, Vec<Crop>) {
        let mut values = Fill(3);
        let image = |_| {
            (0..IMAGE_BYTES)
                .map(|_| ((values.next() + 0.5) * 255.0) as u8)
                .collect()
        };
        let crops = [[0, 0], [8, 3], [4, 4], [1, 8], [7, 0]].map(|corner| Crop {
            corner,
            light: [1.1, -0.05],
        });
        ((0..5).map(image).collect(), crops.to_vec())
    }

    fn numbers<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
        tensor.clone().into_data().iter::<f32>().collect()
    }

    fn close(fast: &[f32], slow: &[f32], tolerance: f32, what: &str) {
        assert_eq!(fast.len(), slow.len(), "{what}");
        let scale = slow.iter().fold(1e-6_f32, |largest, x| largest.max(x.abs()));
        for (i, (fast, slow)) in fast.iter().zip(slow).enumerate() {
            assert!(
                (fast - slow).abs() <= tolerance * scale,
                "{what}, number {i}: {fast} and {slow}"
            );
        }
    }

    #[test]
    fn the_kernels_compute_what_burn_computes() {
        let encoder = network();
        let (images, crops) = images();
        let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
        let crops = Crops {
            images: &images,
            crops: &crops,
        };
        let slow = encoder.estimate(crops);
        let kernels = Kernels::of(&encoder, Backend::Flex).unwrap().unwrap();
        let fast = estimate(&encoder, Some(&kernels), crops);
        close(&numbers(&fast.embedding), &numbers(&slow.embedding), 1e-5, "keypoints");
        close(
            &numbers(&fast.poses.translation),
            &numbers(&slow.poses.translation),
            1e-5,
            "translation",
        );
        assert!(Kernels::of(&encoder, Backend::Torch).unwrap().is_none());
    }

    #[test]
    fn the_gradients_of_the_kernels_are_those_of_burn() {
        let encoder = network();
        let own = encoder.keypoints().unwrap();
        let (images, crops) = images();
        let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
        let crops = Crops {
            images: &images,
            crops: &crops,
        };
        // Any function of the keypoints whose gradient differs from one to the other.
        let loss = |positions: Tensor<2>| {
            let [batch, length] = positions.dims();
            let factors: Vec<f32> = (0..batch * length).map(|i| (i % 7) as f32 - 3.0).collect();
            let factors = Tensor::from_data(TensorData::new(factors, [batch, length]), &positions.device());
            (positions.clone() * factors + positions.powf_scalar(2.0)).sum()
        };
        let slow = GradientsParams::from_grads(loss(encoder.estimate(crops).embedding).backward(), &encoder);

        let kernels = Kernels::of(&encoder, Backend::Flex).unwrap().unwrap();
        let mut tapes = Tapes::default();
        let found = kernels.forward(crops, &mut tapes);
        let dims = [images.len(), found.len() / images.len()];
        let positions = Tensor::<2>::from_data(TensorData::new(found, dims), &encoder.device()).require_grad();
        let gradients = loss(positions.clone()).backward();
        let of_positions = numbers(&positions.grad(&gradients).unwrap());
        let of_trunk = kernels.trunk().backward(&tapes, &of_positions);
        let mut fast = GradientsParams::from_grads(gradients, &encoder);
        own.register(&of_trunk, &mut fast);
        for (name, slot) in encoder.clone().slots() {
            if name.contains("conv") || name.contains("norm") {
                let (fast, slow) = match slot {
                    crate::resnet::Slot::Kernel(param) => (fast.get::<4>(param.id), slow.get::<4>(param.id)),
                    crate::resnet::Slot::Vector(param) => {
                        let of = |gradients: &GradientsParams| gradients.get::<1>(param.id).map(Tensor::unsqueeze::<4>);
                        (of(&fast), of(&slow))
                    }
                    _ => continue,
                };
                close(&numbers(&fast.unwrap()), &numbers(&slow.unwrap()), 2e-4, &name);
            }
        }
    }
}

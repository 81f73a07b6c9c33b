//! The keypoint network: convolutions that keep the resolution, a spatial softmax that gives the position of one keypoint per
//! map, and a small head that maps the keypoints to a pose.
//!
//! Keypoints are in the coordinates of the whole image: the offset of the crop is added. A random crop is therefore only an
//! augmentation, and does not hide where the object is.

use burn::module::{Module, ModuleMapper};
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{GroupNorm, GroupNormConfig, Initializer, Linear, LinearConfig, PaddingConfig2d};
use burn::tensor::activation::{relu, softmax};
use burn::tensor::{Device, Tensor, TensorData};

use crate::conv::{CHANNELS, Conv};
use crate::loss::Poses;
use crate::resnet::{Named, Slot};
use crate::trunk::{EPSILON, GROUP_CHANNELS, Shape, Weights};
use crate::{CROP, EncoderError, SIDE};

/// Length of the hidden layer for the translation. With many, the network learns by heart where each demonstrator grasped; the
/// projection of a camera is nearly linear, and a few are enough for its curvature.
const TRANSLATION_HIDDEN: usize = 8;

/// Length of the hidden layer for the rotation, which is not nearly linear in the keypoints.
const ROTATION_HIDDEN: usize = 64;

/// Number of keypoints per channel of the convolutions.
const MAPS_PER_CHANNEL: usize = 2;

/// Factor of the initial weights of the convolution that gives the maps, so that the maps have peaks from the beginning. The
/// keypoints of flat maps hardly move with the object, and the head learns to amplify what little they move.
const MAP_GAIN: f64 = 4.0;

/// The factor of the initial weights of a convolution with these numbers of channels.
pub(crate) fn initial_gain(outputs: usize, inputs: usize) -> f64 {
    if outputs == MAPS_PER_CHANNEL * inputs {
        MAP_GAIN
    } else {
        1.0
    }
}

/// Kernel, stride and dilation of the convolutions. The last gives the maps.
const CONVOLUTIONS: [[usize; 3]; 4] = [[5, 2, 1], [3, 1, 1], [3, 1, 2], [3, 1, 1]];

/// The keypoint network.
#[derive(Module, Debug)]
pub struct KeypointNetwork {
    convs: Vec<Conv2d>,
    norms: Vec<GroupNorm>,
    translation: Head,
    rotation: Head,
}

/// A linear layer and one hidden layer in parallel.
#[derive(Module, Debug)]
struct Head {
    hidden: Linear,
    output: Linear,
    skip: Linear,
}

impl Head {
    fn new(inputs: usize, hidden: usize, outputs: usize, device: &Device) -> Self {
        let linear = |inputs, outputs, bias| {
            LinearConfig::new(inputs, outputs)
                .with_bias(bias)
                .with_initializer(Initializer::Zeros)
                .init(device)
        };
        Self {
            hidden: linear(inputs, hidden, true),
            output: linear(hidden, outputs, true),
            skip: linear(inputs, outputs, false),
        }
    }

    fn forward(&self, inputs: &Tensor<2>) -> Tensor<2> {
        let hidden = relu(self.hidden.forward(inputs.clone()));
        self.output.forward(hidden) + self.skip.forward(inputs.clone())
    }
}

/// Whether this number of channels is supported.
pub(crate) fn is_valid_width(width: usize) -> bool {
    width > 0 && width.is_multiple_of(CHANNELS)
}

/// Shape of the convolutions for crops of [`CROP`] pixels.
pub(crate) fn shape(width: usize) -> Shape {
    let mut side = CROP;
    let mut inputs = 3;
    let convs = CONVOLUTIONS
        .iter()
        .enumerate()
        .map(|(layer, &[kernel, stride, dilation])| {
            let last = layer + 1 == CONVOLUTIONS.len();
            let conv = Conv {
                kernel,
                stride,
                dilation,
                inputs,
                outputs: if last { MAPS_PER_CHANNEL * width } else { width },
                side,
            };
            (side, inputs) = (conv.out_side(), conv.outputs);
            conv
        });
    Shape { convs: convs.collect() }
}

/// Pixels of the whole image per unit of a keypoint's position.
const UNIT: f32 = SIDE as f32 / 2.0;

/// Position of a pixel of a crop that begins at this row or column, in units of half an image side from the image's centre.
fn position(pixel: f32, offset: u8) -> f32 {
    (pixel + f32::from(offset)) / UNIT - 1.0
}

/// Positions of the maps' columns, which are also those of their rows, for a crop without offset.
pub(crate) fn positions(shape: &Shape) -> Vec<f32> {
    let stride: usize = shape.convs.iter().map(|conv| conv.stride).product();
    let side = shape.convs.last().map_or(0, Conv::out_side);
    (0..side).map(|i| position((i * stride) as f32, 0)).collect()
}

/// What a crop's offset adds to the x and y of its keypoints.
pub(crate) fn offset([top, left]: [u8; 2]) -> [f32; 2] {
    [left, top].map(|pixels| f32::from(pixels) / UNIT)
}

impl KeypointNetwork {
    /// A network with burn's initial weights. `width` is the number of channels, a multiple of 16.
    pub(crate) fn new(width: usize, device: &Device) -> Self {
        let shape = shape(width);
        let conv = |conv: &Conv| {
            let padding = conv.padding();
            Conv2dConfig::new([conv.inputs, conv.outputs], [conv.kernel; 2])
                .with_stride([conv.stride; 2])
                .with_dilation([conv.dilation; 2])
                .with_padding(PaddingConfig2d::Explicit(padding, padding, padding, padding))
                .with_bias(false)
                .init(device)
        };
        let norm = |conv: &Conv| {
            GroupNormConfig::new(conv.outputs / GROUP_CHANNELS, conv.outputs)
                .with_epsilon(f64::from(EPSILON))
                .init(device)
        };
        let coordinates = 2 * shape.keypoints();
        Self {
            convs: shape.convs.iter().map(conv).collect(),
            norms: shape.convs[..shape.convs.len() - 1].iter().map(norm).collect(),
            translation: Head::new(coordinates, TRANSLATION_HIDDEN, 3, device),
            rotation: Head::new(coordinates, ROTATION_HIDDEN, 6, device),
        }
    }

    /// Number of channels.
    pub(crate) fn width(&self) -> usize {
        self.convs[0].weight.lazy_shape()[0]
    }

    /// The network with new initial weights of the rotation's head.
    pub(crate) fn with_new_rotation(mut self, initializer: &mut impl ModuleMapper) -> Self {
        let head = Head::new(2 * shape(self.width()).keypoints(), ROTATION_HIDDEN, 6, &self.device());
        self.rotation = head.map(initializer);
        self
    }

    /// The device of the weights.
    pub(crate) fn device(&self) -> Device {
        self.rotation.output.weight.val().device()
    }

    /// The layers whose biases are together the initial estimate.
    pub(crate) fn last_layers(&mut self) -> [&mut Linear; 2] {
        [&mut self.translation.output, &mut self.rotation.output]
    }

    /// Keypoints of normalised crops `[batch, 3, height, width]`, with `offsets` `[batch, 2]` of [`offset`]: their positions
    /// `[batch, 2 keypoints]` in units of half an image side from its centre, x and y of each keypoint in turn.
    pub(crate) fn keypoints(&self, images: Tensor<4>, offsets: &Tensor<2>) -> Tensor<2> {
        let mut x = images;
        for (conv, norm) in self.convs.iter().zip(&self.norms) {
            x = relu(norm.forward(conv.forward(x)));
        }
        if let Some(maps) = self.convs.last() {
            x = maps.forward(x);
        }
        let [batch, maps, height, width] = x.dims();
        let weights = softmax(x.reshape([batch * maps, height * width]), 1);
        let device = weights.device();
        let positions = positions(&shape(self.width()));
        let grid = |of: &dyn Fn(usize) -> f32| {
            let values: Vec<f32> = (0..height * width).map(of).collect();
            Tensor::<2>::from_data(TensorData::new(values, [1, height * width]), &device)
        };
        let (xs, ys) = (grid(&|i| positions[i % width]), grid(&|i| positions[i / width]));
        let mean = |grid: &Tensor<2>| (weights.clone() * grid.clone()).sum_dim(1);
        let (x, y) = (mean(&xs), mean(&ys));
        let positions = Tensor::cat(vec![x, y], 1).reshape([batch, maps, 2]) + offsets.clone().reshape([batch, 1, 2]);
        positions.reshape([batch, 2 * maps])
    }

    /// Nine numbers per pose, as [`crate::loss::Poses::from_raw`] expects them, from the positions of the keypoints.
    pub(crate) fn head(&self, positions: &Tensor<2>) -> Tensor<2> {
        Tensor::cat(
            vec![self.translation.forward(positions), self.rotation.forward(positions)],
            1,
        )
    }

    /// Poses with the estimated rotations and without a translation, from the positions of the keypoints. Nothing but the
    /// rotation's head has a gradient, so that an optimiser with weight decay changes nothing else.
    pub(crate) fn rotations(&self, positions: &Tensor<2>) -> Poses {
        let rotation = self.rotation.forward(positions);
        let [count, _] = rotation.dims();
        let translation = Tensor::zeros([count, 3], &rotation.device());
        Poses::from_raw(&Tensor::cat(vec![translation, rotation], 1), 1.0)
    }

    /// The weights of the convolutions and their normalisation, for [`crate::trunk::Trunk`].
    ///
    /// # Errors
    /// If they cannot be read from their device.
    pub(crate) fn trunk_weights(&self) -> Result<Weights, EncoderError> {
        let shape = shape(self.width());
        let read = |data: TensorData| {
            data.try_into_vec::<f32>()
                .map_err(|error| EncoderError::Device(format!("{error:?}")))
        };
        let mut weights = Weights {
            kernels: Vec::new(),
            scales: Vec::new(),
            shifts: Vec::new(),
        };
        for (conv, own) in self.convs.iter().zip(&shape.convs) {
            weights.kernels.push(own.to_own(&read(conv.weight.val().into_data())?));
        }
        for norm in &self.norms {
            for (part, list) in [(&norm.gamma, &mut weights.scales), (&norm.beta, &mut weights.shifts)] {
                let part = part
                    .as_ref()
                    .ok_or_else(|| EncoderError::Device("no scales".to_owned()))?;
                list.push(read(part.val().into_data())?);
            }
        }
        Ok(weights)
    }

    /// Adds the gradients of the trunk's weights to those of the head.
    pub(crate) fn register(&self, gradients: &Weights, into: &mut burn::optim::GradientsParams) {
        let shape = shape(self.width());
        let convs = self.convs.iter().zip(&shape.convs).zip(&gradients.kernels);
        for ((conv, own), gradient) in convs {
            let dims = [own.outputs, own.inputs, own.kernel, own.kernel];
            let data = TensorData::new(own.to_burn(gradient), dims);
            let device = conv.weight.val().device().inner();
            into.register(conv.weight.id, Tensor::<4>::from_data(data, &device));
        }
        let norms = self.norms.iter().zip(gradients.scales.iter().zip(&gradients.shifts));
        for (norm, (scale, shift)) in norms {
            for (part, gradient) in [(&norm.gamma, scale), (&norm.beta, shift)] {
                if let Some(part) = part {
                    let data = TensorData::new(gradient.clone(), [gradient.len()]);
                    let device = part.val().device().inner();
                    into.register(part.id, Tensor::<1>::from_data(data, &device));
                }
            }
        }
    }

    /// Every tensor with its name.
    pub(crate) fn slots(&mut self) -> Vec<Named<'_>> {
        let mut slots = Vec::new();
        for (layer, conv) in self.convs.iter_mut().enumerate() {
            slots.push((format!("keypoints.conv{layer}.weight"), Slot::Kernel(&mut conv.weight)));
        }
        for (layer, norm) in self.norms.iter_mut().enumerate() {
            for (name, part) in [("weight", &mut norm.gamma), ("bias", &mut norm.beta)] {
                slots.extend(
                    part.as_mut()
                        .map(|part| (format!("keypoints.norm{layer}.{name}"), Slot::Vector(part))),
                );
            }
        }
        for (part, head) in [("translation", &mut self.translation), ("rotation", &mut self.rotation)] {
            let layers = [
                ("hidden", &mut head.hidden),
                ("output", &mut head.output),
                ("skip", &mut head.skip),
            ];
            for (name, linear) in layers {
                let name = format!("keypoints.{part}.{name}");
                slots.push((format!("{name}.weight"), Slot::Matrix(&mut linear.weight)));
                let bias = linear.bias.as_mut();
                slots.extend(bias.map(|bias| (format!("{name}.bias"), Slot::Vector(bias))));
            }
        }
        slots
    }
}

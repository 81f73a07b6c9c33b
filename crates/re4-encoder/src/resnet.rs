//! The network: ResNet-18 in torchvision's layout, with an embedding and a pose head.

use burn::module::{Module, Param, RunningState};
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::pool::{MaxPool2d, MaxPool2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, Initializer, Linear, LinearConfig, PaddingConfig2d};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

/// Length of the embedding.
pub const EMBEDDING: usize = 256;

fn conv(channels: [usize; 2], kernel: usize, stride: usize, device: &Device) -> Conv2d {
    let padding = kernel / 2;
    Conv2dConfig::new(channels, [kernel, kernel])
        .with_stride([stride, stride])
        .with_padding(PaddingConfig2d::Explicit(padding, padding, padding, padding))
        .with_bias(false)
        .with_initializer(Initializer::KaimingNormal {
            gain: std::f64::consts::SQRT_2,
            fan_out_only: true,
        })
        .init(device)
}

fn norm(channels: usize, device: &Device) -> BatchNorm {
    BatchNormConfig::new(channels).init(device)
}

/// A linear layer with zero weights: training then samples them with its own generator. burn would sample biases too.
fn linear([inputs, outputs]: [usize; 2], device: &Device) -> Linear {
    LinearConfig::new(inputs, outputs)
        .with_initializer(Initializer::Zeros)
        .init(device)
}

#[derive(Module, Debug)]
struct Downsample {
    conv: Conv2d,
    bn: BatchNorm,
}

#[derive(Module, Debug)]
struct Block {
    conv1: Conv2d,
    bn1: BatchNorm,
    conv2: Conv2d,
    bn2: BatchNorm,
    downsample: Option<Downsample>,
}

impl Block {
    fn new(inside: usize, out: usize, stride: usize, device: &Device) -> Self {
        Self {
            conv1: conv([inside, out], 3, stride, device),
            bn1: norm(out, device),
            conv2: conv([out, out], 3, 1, device),
            bn2: norm(out, device),
            downsample: (stride != 1 || inside != out).then(|| Downsample {
                conv: conv([inside, out], 1, stride, device),
                bn: norm(out, device),
            }),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = relu(self.bn1.forward(self.conv1.forward(x.clone())));
        let y = self.bn2.forward(self.conv2.forward(y));
        let x = match &self.downsample {
            Some(down) => down.bn.forward(down.conv.forward(x)),
            None => x,
        };
        relu(x + y)
    }
}

/// A reference to a tensor of the network.
pub(crate) enum Slot<'a> {
    /// Weight of a convolution, `[out, in, height, width]`.
    Kernel(&'a mut Param<Tensor<4>>),
    /// Weight of a linear layer, `[in, out]`: burn's layout, which is the transpose of `PyTorch`'s.
    Matrix(&'a mut Param<Tensor<2>>),
    /// A bias or a scale.
    Vector(&'a mut Param<Tensor<1>>),
    /// A running statistic of batch normalisation.
    Running(&'a mut RunningState<Tensor<1>>),
}

pub(crate) type Named<'a> = (String, Slot<'a>);

fn conv_slot<'a>(name: &str, conv: &'a mut Conv2d) -> Named<'a> {
    (format!("{name}.weight"), Slot::Kernel(&mut conv.weight))
}

fn norm_slots<'a>(name: &str, norm: &'a mut BatchNorm) -> [Named<'a>; 4] {
    [
        (format!("{name}.weight"), Slot::Vector(&mut norm.gamma)),
        (format!("{name}.bias"), Slot::Vector(&mut norm.beta)),
        (format!("{name}.running_mean"), Slot::Running(&mut norm.running_mean)),
        (format!("{name}.running_var"), Slot::Running(&mut norm.running_var)),
    ]
}

fn linear_slots<'a>(name: &'a str, linear: &'a mut Linear) -> impl Iterator<Item = Named<'a>> {
    let bias = linear.bias.as_mut();
    std::iter::once((format!("{name}.weight"), Slot::Matrix(&mut linear.weight)))
        .chain(bias.map(|bias| (format!("{name}.bias"), Slot::Vector(bias))))
}

/// The network of the preset `paper`.
#[derive(Module, Debug)]
pub struct ResNet {
    conv1: Conv2d,
    bn1: BatchNorm,
    maxpool: MaxPool2d,
    layer1: Vec<Block>,
    layer2: Vec<Block>,
    layer3: Vec<Block>,
    layer4: Vec<Block>,
    embedding: Linear,
    head: Linear,
}

impl ResNet {
    /// A network with burn's initial weights; `width` is the number of channels after the first convolution.
    pub fn new(width: usize, device: &Device) -> Self {
        let stage = |inside: usize, out: usize, stride: usize| {
            vec![Block::new(inside, out, stride, device), Block::new(out, out, 1, device)]
        };
        Self {
            conv1: conv([3, width], 7, 2, device),
            bn1: norm(width, device),
            maxpool: MaxPool2dConfig::new([3, 3])
                .with_strides([2, 2])
                .with_padding(PaddingConfig2d::Explicit(1, 1, 1, 1))
                .init(),
            layer1: stage(width, width, 1),
            layer2: stage(width, 2 * width, 2),
            layer3: stage(2 * width, 4 * width, 2),
            layer4: stage(4 * width, 8 * width, 2),
            embedding: linear([8 * width, EMBEDDING], device),
            head: linear([EMBEDDING, 9], device),
        }
    }

    /// Number of channels after the first convolution.
    pub fn width(&self) -> usize {
        self.conv1.weight.lazy_shape()[0]
    }

    /// Maps normalised images `[batch, 3, height, width]` to the features after the average pool, `[batch, 8 width]`.
    pub fn features(&self, images: Tensor<4>) -> Tensor<2> {
        let mut x = self.maxpool.forward(relu(self.bn1.forward(self.conv1.forward(images))));
        for block in [&self.layer1, &self.layer2, &self.layer3, &self.layer4]
            .into_iter()
            .flatten()
        {
            x = block.forward(x);
        }
        let [batch, channels, _, _] = x.dims();
        x.mean_dim(3).mean_dim(2).reshape([batch, channels])
    }

    /// Maps normalised images `[batch, 3, height, width]` to embeddings `[batch, 256]` and head outputs `[batch, 9]`.
    pub fn forward(&self, images: Tensor<4>) -> (Tensor<2>, Tensor<2>) {
        let embedding = self.embedding.forward(self.features(images));
        let raw = self.head.forward(embedding.clone());
        (embedding, raw)
    }

    /// The device of the weights.
    pub(crate) fn head_device(&self) -> Device {
        self.head.weight.val().device()
    }

    /// The layer whose bias is the initial estimate.
    pub(crate) fn last_layer(&mut self) -> &mut Linear {
        &mut self.head
    }

    /// Every tensor with its name in torchvision's `resnet18`; `embedding` and `head` are this crate's own.
    pub(crate) fn slots(&mut self) -> Vec<Named<'_>> {
        let mut slots = vec![conv_slot("conv1", &mut self.conv1)];
        slots.extend(norm_slots("bn1", &mut self.bn1));
        let stages = [&mut self.layer1, &mut self.layer2, &mut self.layer3, &mut self.layer4];
        for (stage, blocks) in (1..).zip(stages) {
            for (index, block) in blocks.iter_mut().enumerate() {
                let name = |part: &str| format!("layer{stage}.{index}.{part}");
                slots.push(conv_slot(&name("conv1"), &mut block.conv1));
                slots.extend(norm_slots(&name("bn1"), &mut block.bn1));
                slots.push(conv_slot(&name("conv2"), &mut block.conv2));
                slots.extend(norm_slots(&name("bn2"), &mut block.bn2));
                if let Some(down) = &mut block.downsample {
                    slots.push(conv_slot(&name("downsample.0"), &mut down.conv));
                    slots.extend(norm_slots(&name("downsample.1"), &mut down.bn));
                }
            }
        }
        slots.extend(linear_slots("embedding", &mut self.embedding));
        slots.extend(linear_slots("head", &mut self.head));
        slots
    }
}

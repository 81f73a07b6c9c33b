//! The networks: the conditional 1-D U-Net of Diffusion Policy, and a residual MLP with the same interface.
//!
//! Both map a chunk, a time and a condition (the flattened observation history) to a chunk of the same shape.

use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};
use rand_pcg::Pcg64;
use re4_train::uniform;

use crate::NetworkSize;
use crate::layers::{Conv, Dense, Down, Initial, Named, Norm, Parameters, Slot, Up, mish, sinusoids};

/// Shape of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Size of the network.
    pub size: NetworkSize,
    /// Numbers per action.
    pub channels: usize,
    /// Actions per chunk.
    pub length: usize,
    /// Numbers of the condition.
    pub condition: usize,
}

/// Channels of the levels of the U-Net.
const fn levels(size: NetworkSize) -> [usize; 3] {
    match size {
        NetworkSize::Paper => [256, 512, 1024],
        NetworkSize::Small | NetworkSize::Mlp => [64, 128, 256],
    }
}

/// Size of the time's embedding.
const fn time_size(size: NetworkSize) -> usize {
    match size {
        NetworkSize::Paper => 256,
        NetworkSize::Small | NetworkSize::Mlp => 128,
    }
}

/// Width of the MLP.
const WIDTH: usize = 512;

/// Residual blocks of the MLP.
const BLOCKS: usize = 4;

/// A network.
#[derive(Module, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a program has few networks, and their weights are on the heap"
)]
pub enum Network {
    /// The U-Net.
    UNet(UNet),
    /// The MLP.
    Mlp(Mlp),
}

impl Network {
    /// A network with zero weights.
    pub fn new(shape: Shape, device: &Device) -> Self {
        match shape.size {
            NetworkSize::Paper | NetworkSize::Small => Self::UNet(UNet::new(shape, device)),
            NetworkSize::Mlp => Self::Mlp(Mlp::new(shape, device)),
        }
    }

    /// A network with initial weights that are sampled with a seed, with `PyTorch`'s default distributions.
    pub fn sampled(shape: Shape, seed: u64, device: &Device) -> Self {
        let mut network = Self::new(shape, device);
        // Another stream than that of the batches, so that the two sequences are independent for the same seed.
        let mut rng = Pcg64::new(u128::from(seed), 0x9e37_79b9_7f4a_7c15_f39c_c060_5ced_c834);
        for Named { initial, slot, .. } in network.all() {
            let mut fill = |count: usize| -> Vec<f32> {
                match initial {
                    Initial::Constant(value) => vec![value; count],
                    Initial::Uniform(inputs) => {
                        let bound = (1.0 / inputs as f64).sqrt();
                        (0..count)
                            .map(|_| ((2.0 * uniform(&mut rng) - 1.0) * bound) as f32)
                            .collect()
                    }
                }
            };
            match slot {
                Slot::Matrix { param, .. } => {
                    let dims = param.val().dims();
                    let data = TensorData::new(fill(dims.iter().product()), dims);
                    *param = param.clone().map(|old| like(&old, Tensor::from_data(data, device)));
                }
                Slot::Vector(param) => {
                    let dims = param.val().dims();
                    let data = TensorData::new(fill(dims[0]), dims);
                    *param = param.clone().map(|old| like(&old, Tensor::from_data(data, device)));
                }
            }
        }
        network
    }

    /// All parameters, in a fixed order.
    pub fn all(&mut self) -> Vec<Named<'_>> {
        let mut all = Vec::new();
        match self {
            Self::UNet(network) => network.parameters("", &mut all),
            Self::Mlp(network) => network.parameters("", &mut all),
        }
        all
    }

    /// Applies the network to chunks `[batch, length, channels]` with their times and conditions `[batch, condition]`.
    pub fn forward(&self, chunks: Tensor<3>, times: &[f32], condition: Tensor<2>) -> Tensor<3> {
        match self {
            Self::UNet(network) => network.forward(chunks, times, condition),
            Self::Mlp(network) => network.forward(chunks, times, condition),
        }
    }
}

/// The new values of a parameter, which is trained if the old one is.
fn like<const D: usize>(old: &Tensor<D>, new: Tensor<D>) -> Tensor<D> {
    if old.is_require_grad() { new.require_grad() } else { new }
}

/// The embedding of a time.
#[derive(Module, Debug)]
struct TimeEmbedding {
    first: Dense,
    second: Dense,
    size: usize,
}

impl TimeEmbedding {
    fn new(size: usize, device: &Device) -> Self {
        Self {
            first: Dense::new(size, 4 * size, device),
            second: Dense::new(4 * size, size, device),
            size,
        }
    }

    /// The condition of the blocks: the time's embedding, then the observations.
    fn condition(&self, times: &[f32], condition: Tensor<2>) -> Tensor<2> {
        let features = sinusoids(times, self.size, &condition.device());
        let embedded = self.second.forward(mish(self.first.forward(features)));
        Tensor::cat(vec![embedded, condition], 1)
    }
}

impl Parameters for TimeEmbedding {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        self.first.parameters(&format!("{prefix}.1"), into);
        self.second.parameters(&format!("{prefix}.3"), into);
    }
}

/// Convolution, normalisation and Mish.
#[derive(Module, Debug)]
struct ConvBlock {
    conv: Conv,
    norm: Norm,
}

impl ConvBlock {
    fn new(inputs: usize, outputs: usize, length: usize, device: &Device) -> Self {
        Self {
            conv: Conv::new(inputs, outputs, length, device),
            norm: Norm::new(outputs, device),
        }
    }

    fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        mish(self.norm.forward(self.conv.forward(x)))
    }
}

impl Parameters for ConvBlock {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        self.conv.parameters(&format!("{prefix}.block.0"), into);
        self.norm.parameters(&format!("{prefix}.block.1"), into);
    }
}

/// Two convolution blocks with a residual connection. The condition scales and shifts the result of the first.
#[derive(Module, Debug)]
struct ResidualBlock {
    first: ConvBlock,
    second: ConvBlock,
    film: Dense,
    skip: Option<Dense>,
    outputs: usize,
}

impl ResidualBlock {
    fn new(inputs: usize, outputs: usize, condition: usize, length: usize, device: &Device) -> Self {
        Self {
            first: ConvBlock::new(inputs, outputs, length, device),
            second: ConvBlock::new(outputs, outputs, length, device),
            film: Dense::new(condition, 2 * outputs, device),
            skip: (inputs != outputs).then(|| Dense::pointwise(inputs, outputs, device)),
            outputs,
        }
    }

    /// `condition` is the condition after Mish.
    fn forward(&self, x: Tensor<3>, condition: &Tensor<2>) -> Tensor<3> {
        let film: Tensor<3> = self.film.forward(condition.clone()).unsqueeze_dim(1);
        let scale = film.clone().narrow(2, 0, self.outputs);
        let shift = film.narrow(2, self.outputs, self.outputs);
        let hidden = self.first.forward(x.clone()) * scale + shift;
        let hidden = self.second.forward(hidden);
        hidden
            + match &self.skip {
                Some(skip) => skip.every_step(x),
                None => x,
            }
    }
}

impl Parameters for ResidualBlock {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        self.first.parameters(&format!("{prefix}.blocks.0"), into);
        self.second.parameters(&format!("{prefix}.blocks.1"), into);
        self.film.parameters(&format!("{prefix}.cond_encoder.1"), into);
        if let Some(skip) = &mut self.skip {
            skip.parameters(&format!("{prefix}.residual_conv"), into);
        }
    }
}

/// Diffusion Policy's conditional 1-D U-Net, with its names of parameters.
#[derive(Module, Debug)]
pub struct UNet {
    time: TimeEmbedding,
    down: Vec<ResidualBlock>,
    downsamplers: Vec<Down>,
    middle: Vec<ResidualBlock>,
    up: Vec<ResidualBlock>,
    upsamplers: Vec<Up>,
    last: ConvBlock,
    output: Dense,
}

impl UNet {
    fn new(shape: Shape, device: &Device) -> Self {
        let levels = levels(shape.size);
        let time = time_size(shape.size);
        let condition = time + shape.condition;
        let block = |inputs, outputs, length| ResidualBlock::new(inputs, outputs, condition, length, device);
        // Chunks of one or two actions are not shortened.
        let shortens = shape.length >= 4;
        let length = |level: usize| if shortens { shape.length >> level } else { shape.length };
        let mut down = Vec::new();
        let mut downsamplers = Vec::new();
        let mut inputs = shape.channels;
        for (level, &outputs) in levels.iter().enumerate() {
            down.push(block(inputs, outputs, length(level)));
            down.push(block(outputs, outputs, length(level)));
            if level + 1 < levels.len() {
                downsamplers.push(Down::new(outputs, length(level), !shortens, device));
            }
            inputs = outputs;
        }
        let deepest = levels[2];
        let mut up = Vec::new();
        let mut upsamplers = Vec::new();
        for level in [2, 1] {
            up.push(block(2 * levels[level], levels[level - 1], length(level)));
            up.push(block(levels[level - 1], levels[level - 1], length(level)));
            upsamplers.push(Up::new(levels[level - 1], length(level), !shortens, device));
        }
        Self {
            time: TimeEmbedding::new(time, device),
            down,
            downsamplers,
            middle: (0..2).map(|_| block(deepest, deepest, length(2))).collect(),
            up,
            upsamplers,
            last: ConvBlock::new(levels[0], levels[0], shape.length, device),
            output: Dense::pointwise(levels[0], shape.channels, device),
        }
    }

    fn forward(&self, chunks: Tensor<3>, times: &[f32], condition: Tensor<2>) -> Tensor<3> {
        // Every block applies Mish to the condition first; it is the same for all.
        let condition = mish(self.time.condition(times, condition));
        let mut x = chunks;
        let mut levels = Vec::new();
        for (level, blocks) in self.down.chunks(2).enumerate() {
            for block in blocks {
                x = block.forward(x, &condition);
            }
            levels.push(x.clone());
            if let Some(down) = self.downsamplers.get(level) {
                x = down.forward(x);
            }
        }
        for block in &self.middle {
            x = block.forward(x, &condition);
        }
        // The output of the first level is not used, as in the original.
        for (blocks, up) in self.up.chunks(2).zip(&self.upsamplers) {
            if let Some(level) = levels.pop() {
                x = Tensor::cat(vec![x, level], 2);
            }
            for block in blocks {
                x = block.forward(x, &condition);
            }
            x = up.forward(x);
        }
        self.output.every_step(self.last.forward(x))
    }
}

impl Parameters for UNet {
    fn parameters<'a>(&'a mut self, _: &str, into: &mut Vec<Named<'a>>) {
        self.time.parameters("diffusion_step_encoder", into);
        let mut downsamplers = self.downsamplers.iter_mut();
        for (level, blocks) in self.down.chunks_mut(2).enumerate() {
            for (number, block) in blocks.iter_mut().enumerate() {
                block.parameters(&format!("down_modules.{level}.{number}"), into);
            }
            if let Some(down) = downsamplers.next() {
                down.parameters(&format!("down_modules.{level}.2.conv"), into);
            }
        }
        for (number, block) in self.middle.iter_mut().enumerate() {
            block.parameters(&format!("mid_modules.{number}"), into);
        }
        let mut upsamplers = self.upsamplers.iter_mut();
        for (level, blocks) in self.up.chunks_mut(2).enumerate() {
            for (number, block) in blocks.iter_mut().enumerate() {
                block.parameters(&format!("up_modules.{level}.{number}"), into);
            }
            if let Some(up) = upsamplers.next() {
                up.parameters(&format!("up_modules.{level}.2.conv"), into);
            }
        }
        self.last.parameters("final_conv.0", into);
        self.output.parameters("final_conv.1", into);
    }
}

/// A residual block of the MLP: two linear layers; between them, the condition scales and shifts, and `ReLU` is applied.
#[derive(Module, Debug)]
struct MlpBlock {
    film: Dense,
    first: Dense,
    second: Dense,
}

impl MlpBlock {
    fn forward(&self, x: Tensor<2>, condition: &Tensor<2>) -> Tensor<2> {
        let film = self.film.forward(condition.clone());
        let scale = film.clone().narrow(1, 0, WIDTH) + 1.0;
        let shift = film.narrow(1, WIDTH, WIDTH);
        let hidden = relu(self.first.forward(x.clone()) * scale + shift);
        x + self.second.forward(hidden)
    }
}

/// A residual MLP over the whole chunk. It has neither normalisation nor Mish, which take as long as its matrix products on a CPU.
#[derive(Module, Debug)]
pub struct Mlp {
    time: TimeEmbedding,
    input: Dense,
    blocks: Vec<MlpBlock>,
    output: Dense,
}

impl Mlp {
    fn new(shape: Shape, device: &Device) -> Self {
        let time = time_size(shape.size);
        let condition = time + shape.condition;
        let numbers = shape.length * shape.channels;
        let block = || MlpBlock {
            film: Dense::new(condition, 2 * WIDTH, device),
            first: Dense::new(WIDTH, WIDTH, device),
            second: Dense::new(WIDTH, WIDTH, device),
        };
        Self {
            time: TimeEmbedding::new(time, device),
            input: Dense::new(numbers + shape.condition, WIDTH, device),
            blocks: (0..BLOCKS).map(|_| block()).collect(),
            output: Dense::new(WIDTH, numbers, device),
        }
    }

    fn forward(&self, chunks: Tensor<3>, times: &[f32], condition: Tensor<2>) -> Tensor<3> {
        let [batch, length, channels] = chunks.dims();
        let flat = chunks.reshape([batch, length * channels]);
        let input = Tensor::cat(vec![flat, condition.clone()], 1);
        let condition = mish(self.time.condition(times, condition));
        let mut x = self.input.forward(input);
        for block in &self.blocks {
            x = block.forward(x, &condition);
        }
        self.output.forward(relu(x)).reshape([batch, length, channels])
    }
}

impl Parameters for Mlp {
    fn parameters<'a>(&'a mut self, _: &str, into: &mut Vec<Named<'a>>) {
        self.time.parameters("time", into);
        self.input.parameters("input", into);
        for (number, block) in self.blocks.iter_mut().enumerate() {
            block.film.parameters(&format!("blocks.{number}.film"), into);
            block.first.parameters(&format!("blocks.{number}.first"), into);
            block.second.parameters(&format!("blocks.{number}.second"), into);
        }
        self.output.parameters("output", into);
    }
}

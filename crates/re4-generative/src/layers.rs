//! Layers. A convolution is a matrix product over copied windows, which is faster than burn's convolution for chunks, and whose
//! result for a chunk does not depend on the other chunks of a batch.

use burn::module::{Module, Param};
use burn::nn::{Initializer, Linear, LinearConfig};
use burn::tensor::{Device, Tensor, TensorData};

/// Side of the convolutions' kernel.
pub const KERNEL: usize = 5;

/// Groups of the normalisation.
pub const GROUPS: usize = 8;

/// Added to variances, as in `PyTorch`.
const EPSILON: f64 = 1e-5;

/// How initial values are sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Initial {
    /// Uniform, bounded by one over the square root of this number of inputs, as in `PyTorch`.
    Uniform(usize),
    /// One value.
    Constant(f32),
}

/// A parameter of a network.
pub enum Slot<'a> {
    /// A matrix.
    Matrix {
        /// The values.
        param: &'a mut Param<Tensor<2>>,
        /// What its rows and columns are.
        layout: Layout,
    },
    /// A vector.
    Vector(&'a mut Param<Tensor<1>>),
}

/// What the rows and columns of a matrix are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// A linear layer: `[inputs, outputs]`.
    Linear,
    /// A convolution with this number of taps: `[taps * inputs, outputs]`.
    Conv(usize),
    /// A transposed convolution with this number of taps: `[inputs, taps * outputs]`.
    Transposed(usize),
}

/// A parameter with its name and its initial values.
pub struct Named<'a> {
    /// Name in weights files.
    pub name: String,
    /// Initial values.
    pub initial: Initial,
    /// The values.
    pub slot: Slot<'a>,
}

/// Modules that list their parameters, in a fixed order.
pub trait Parameters {
    /// Appends the parameters. Their names begin with the prefix.
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>);
}

fn zeros(inputs: usize, outputs: usize, device: &Device) -> Linear {
    // Initial values are sampled later, with a seeded generator.
    LinearConfig::new(inputs, outputs)
        .with_initializer(Initializer::Zeros)
        .init(device)
}

fn push<'a>(linear: &'a mut Linear, (layout, fan_in): (Layout, usize), prefix: &str, into: &mut Vec<Named<'a>>) {
    into.push(Named {
        name: format!("{prefix}.weight"),
        initial: Initial::Uniform(fan_in),
        slot: Slot::Matrix {
            param: &mut linear.weight,
            layout,
        },
    });
    if let Some(bias) = &mut linear.bias {
        into.push(Named {
            name: format!("{prefix}.bias"),
            initial: Initial::Uniform(fan_in),
            slot: Slot::Vector(bias),
        });
    }
}

/// Applies a linear layer to all steps of all chunks, as one matrix product.
fn every_step(linear: &Linear, x: Tensor<3>) -> Tensor<3> {
    let [batch, time, channels] = x.dims();
    let flat = linear.forward(x.reshape([batch * time, channels]));
    let outputs = flat.dims()[1];
    flat.reshape([batch, time, outputs])
}

/// A linear layer.
#[derive(Module, Debug)]
pub struct Dense {
    linear: Linear,
    inputs: usize,
    /// Whether weights files store it as a convolution with one tap.
    pointwise: bool,
}

impl Dense {
    /// A layer with zero weights.
    pub fn new(inputs: usize, outputs: usize, device: &Device) -> Self {
        Self {
            linear: zeros(inputs, outputs, device),
            inputs,
            pointwise: false,
        }
    }

    /// A convolution with one tap and zero weights.
    pub fn pointwise(inputs: usize, outputs: usize, device: &Device) -> Self {
        Self {
            pointwise: true,
            ..Self::new(inputs, outputs, device)
        }
    }

    /// Applies the layer to `[batch, inputs]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        self.linear.forward(x)
    }

    /// Applies the layer to every step of `[batch, time, inputs]`.
    pub fn every_step(&self, x: Tensor<3>) -> Tensor<3> {
        every_step(&self.linear, x)
    }
}

impl Parameters for Dense {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        let layout = if self.pointwise {
            Layout::Conv(1)
        } else {
            Layout::Linear
        };
        push(&mut self.linear, (layout, self.inputs), prefix, into);
    }
}

/// A convolution over time that keeps the length: kernel [`KERNEL`] with zero padding.
///
/// For chunks of length 1 or 2 only the middle taps see data. The others are left out, but the initial values are those of the
/// complete kernel.
#[derive(Module, Debug)]
pub struct Conv {
    linear: Linear,
    taps: usize,
    inputs: usize,
}

impl Conv {
    /// A convolution with zero weights for chunks of this length.
    pub fn new(inputs: usize, outputs: usize, length: usize, device: &Device) -> Self {
        let taps = KERNEL.min(2 * length - 1);
        Self {
            linear: zeros(taps * inputs, outputs, device),
            taps,
            inputs,
        }
    }

    /// Applies the convolution to `[batch, time, inputs]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        if self.taps == 1 {
            return every_step(&self.linear, x);
        }
        let [batch, time, channels] = x.dims();
        let padding = Tensor::zeros([batch, self.taps / 2, channels], &x.device());
        let padded = Tensor::cat(vec![padding.clone(), x, padding], 1);
        let windows = (0..self.taps).map(|tap| padded.clone().narrow(1, tap, time)).collect();
        every_step(&self.linear, Tensor::cat(windows, 2))
    }
}

impl Parameters for Conv {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        let fan_in = KERNEL * self.inputs;
        push(&mut self.linear, (Layout::Conv(self.taps), fan_in), prefix, into);
    }
}

/// Shifts a chunk by one step, to later (`by` = 1) or to earlier; the first or last step becomes zero.
fn shifted(x: Tensor<3>, later: bool) -> Tensor<3> {
    let [batch, time, channels] = x.dims();
    let zero = Tensor::zeros([batch, 1, channels], &x.device());
    if later {
        Tensor::cat(vec![zero, x.narrow(1, 0, time - 1)], 1)
    } else {
        Tensor::cat(vec![x.narrow(1, 1, time - 1), zero], 1)
    }
}

/// A convolution that halves the length: kernel 3, stride 2, padding 1. If it keeps the length, it is a
/// linear layer over all numbers of the chunk, as in Streaming Flow Policy.
#[derive(Module, Debug)]
pub struct Down {
    linear: Linear,
    flat: bool,
    inputs: usize,
}

impl Down {
    /// A layer with zero weights for chunks of this length. `flat`: whether it keeps the length.
    pub fn new(channels: usize, length: usize, flat: bool, device: &Device) -> Self {
        let (inputs, outputs) = if flat {
            (length * channels, length * channels)
        } else {
            (3 * channels, channels)
        };
        Self {
            linear: zeros(inputs, outputs, device),
            flat,
            inputs,
        }
    }

    /// Applies the layer to `[batch, time, channels]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, time, channels] = x.dims();
        if self.flat {
            let flat = self.linear.forward(x.reshape([batch, time * channels]));
            return flat.reshape([batch, time, channels]);
        }
        let pairs = x.reshape([batch, time / 2, 2 * channels]);
        let before = shifted(pairs.clone().narrow(2, channels, channels), true);
        every_step(&self.linear, Tensor::cat(vec![before, pairs], 2))
    }
}

impl Parameters for Down {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        let layout = if self.flat { Layout::Linear } else { Layout::Conv(3) };
        push(&mut self.linear, (layout, self.inputs), prefix, into);
    }
}

/// A transposed convolution that doubles the length: kernel 4, stride 2, padding 1. If it keeps the length, as [`Down`].
#[derive(Module, Debug)]
pub struct Up {
    weight: Linear,
    bias: Param<Tensor<1>>,
    flat: bool,
    inputs: usize,
    channels: usize,
}

/// Taps of [`Up`].
const UP_TAPS: usize = 4;

impl Up {
    /// A layer with zero weights for chunks of this length. `flat`: whether it keeps the length.
    pub fn new(channels: usize, length: usize, flat: bool, device: &Device) -> Self {
        let outputs = if flat { length * channels } else { UP_TAPS * channels };
        let inputs = if flat { length * channels } else { channels };
        Self {
            weight: LinearConfig::new(inputs, outputs)
                .with_bias(false)
                .with_initializer(Initializer::Zeros)
                .init(device),
            bias: Initializer::Zeros.init([if flat { outputs } else { channels }], device),
            flat,
            inputs,
            channels,
        }
    }

    /// Applies the layer to `[batch, time, channels]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, time, channels] = x.dims();
        if self.flat {
            let flat = self.weight.forward(x.reshape([batch, time * channels]));
            return (flat + self.bias.val().unsqueeze()).reshape([batch, time, channels]);
        }
        // The input at t contributes to the outputs 2t - 1 to 2t + 2, one per tap.
        let taps = every_step(&self.weight, x);
        let tap = |number: usize| taps.clone().narrow(2, number * channels, channels);
        let even = tap(1) + shifted(tap(3), true);
        let odd = tap(2) + shifted(tap(0), false);
        let pairs = Tensor::cat(vec![even, odd], 2).reshape([batch, 2 * time, channels]);
        pairs + self.bias.val().unsqueeze()
    }
}

impl Parameters for Up {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        // PyTorch's fan-in of a transposed convolution counts the outputs of all taps.
        let fan_in = if self.flat {
            self.inputs
        } else {
            UP_TAPS * self.channels
        };
        into.push(Named {
            name: format!("{prefix}.weight"),
            initial: Initial::Uniform(fan_in),
            slot: Slot::Matrix {
                param: &mut self.weight.weight,
                layout: if self.flat {
                    Layout::Linear
                } else {
                    Layout::Transposed(UP_TAPS)
                },
            },
        });
        into.push(Named {
            name: format!("{prefix}.bias"),
            initial: Initial::Uniform(fan_in),
            slot: Slot::Vector(&mut self.bias),
        });
    }
}

/// Group normalisation over time and the channels of a group, with [`GROUPS`] groups.
#[derive(Module, Debug)]
pub struct Norm {
    scale: Param<Tensor<1>>,
    shift: Param<Tensor<1>>,
}

impl Norm {
    /// A normalisation with scale 1 and shift 0.
    pub fn new(channels: usize, device: &Device) -> Self {
        Self {
            scale: Initializer::Ones.init([channels], device),
            shift: Initializer::Zeros.init([channels], device),
        }
    }

    /// Normalises `[batch, time, channels]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [batch, time, channels] = x.dims();
        let grouped = x.reshape([batch, time, GROUPS, channels / GROUPS]);
        let mean = grouped.clone().mean_dim(3).mean_dim(1);
        let centred = grouped - mean;
        let variance = centred.clone().square().mean_dim(3).mean_dim(1);
        let normalised = (centred / (variance + EPSILON).sqrt()).reshape([batch, time, channels]);
        normalised * self.scale.val().unsqueeze() + self.shift.val().unsqueeze()
    }
}

impl Parameters for Norm {
    fn parameters<'a>(&'a mut self, prefix: &str, into: &mut Vec<Named<'a>>) {
        for (name, value, param) in [("weight", 1.0, &mut self.scale), ("bias", 0.0, &mut self.shift)] {
            into.push(Named {
                name: format!("{prefix}.{name}"),
                initial: Initial::Constant(value),
                slot: Slot::Vector(param),
            });
        }
    }
}

/// The Mish activation, `x tanh(ln(1 + e^x))`, in a form with one exponential.
pub fn mish<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    // tanh(ln(1 + e)) = n / (n + 2) with n = e (e + 2). For x above 20 it is 1 in single precision; the limit keeps e^2 finite.
    let e = x.clone().clamp_max(20.0).exp();
    let n = e.clone() * (e + 2.0);
    x * (n.clone() / (n + 2.0))
}

/// Sinusoidal features of a time: sines, then cosines, of geometrically spaced frequencies from 1 to 1/10000.
pub fn sinusoids(times: &[f32], size: usize, device: &Device) -> Tensor<2> {
    let half = size / 2;
    let rate = 10_000_f64.ln() / (half as f64 - 1.0);
    let mut values = Vec::with_capacity(times.len() * size);
    for time in times {
        let angle = |number: usize| f64::from(*time) * (-rate * number as f64).exp();
        values.extend((0..half).map(|number| angle(number).sin() as f32));
        values.extend((0..half).map(|number| angle(number).cos() as f32));
    }
    Tensor::from_data(TensorData::new(values, [times.len(), 2 * half]), device)
}

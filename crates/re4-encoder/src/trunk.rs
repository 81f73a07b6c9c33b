//! The convolutional part of the keypoint network on the CPU, with its gradient: from an image to the positions of keypoints.
//!
//! It computes the same as [`crate::keypoints`] does with burn's layers, image by image and in parallel. Group normalisation
//! needs no other image, so an image stays in the processor's cache from its pixels to its keypoints. Gradients are summed over
//! images in a fixed order, so the bytes do not depend on the number of threads.
#![allow(
    clippy::inline_always,
    reason = "the loops must be inlined into the function that is compiled for the processor's vectors"
)]
#![allow(
    clippy::needless_range_loop,
    reason = "loops over the lanes of several arrays, which the compiler turns into vectors"
)]

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::conv::{CHANNELS, Conv, Layout, add_weight_gradient, convolve};

/// Images whose gradients are summed by one thread.
const IMAGES_PER_SUM: usize = 4;

/// Added to variances, as burn's and `PyTorch`'s group normalisation do.
pub(crate) const EPSILON: f32 = 1e-5;

/// Channels of a group of the normalisation.
pub(crate) const GROUP_CHANNELS: usize = 4;

/// Numbers per keypoint: x and y.
pub(crate) const PER_KEYPOINT: usize = 2;

/// Shape of the trunk: convolutions with normalisation and `ReLU`, and a last one whose outputs are the keypoints' maps.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shape {
    pub(crate) convs: Vec<Conv>,
}

impl Shape {
    /// Number of keypoints.
    pub(crate) fn keypoints(&self) -> usize {
        self.convs.last().map_or(0, |conv| conv.outputs)
    }
}

/// Weights in the layout of [`Conv::to_own`].
#[derive(Debug, Clone)]
pub(crate) struct Weights {
    /// Of every convolution.
    pub(crate) kernels: Vec<Vec<f32>>,
    /// Scales of the normalisation after every convolution but the last.
    pub(crate) scales: Vec<Vec<f32>>,
    /// Shifts of the same.
    pub(crate) shifts: Vec<Vec<f32>>,
}

impl Weights {
    fn zeros(shape: &Shape) -> Self {
        let (_, normalised) = shape.convs.split_last().unzip();
        let channels = || -> Vec<Vec<f32>> {
            let convs: &[Conv] = normalised.unwrap_or_default();
            convs.iter().map(|conv| vec![0.0; conv.outputs]).collect()
        };
        Self {
            kernels: shape.convs.iter().map(|conv| vec![0.0; conv.weights()]).collect(),
            scales: channels(),
            shifts: channels(),
        }
    }

    fn add(&mut self, other: &Self) {
        let own = [&mut self.kernels, &mut self.scales, &mut self.shifts];
        for (own, other) in own.into_iter().zip([&other.kernels, &other.scales, &other.shifts]) {
            for (own, other) in own.iter_mut().flatten().zip(other.iter().flatten()) {
                *own += other;
            }
        }
    }
}

/// What the gradient of an image needs from its forward pass.
struct Tape {
    /// Padded input of every convolution.
    inputs: Vec<Vec<f32>>,
    /// Outputs of every convolution, before the normalisation. The last are the probabilities of the maps.
    outputs: Vec<Vec<f32>>,
    /// Mean and reciprocal of the standard deviation of every group, by normalised convolution.
    statistics: Vec<Vec<[f32; 2]>>,
    /// x and y of every keypoint.
    keypoints: Vec<f32>,
}

/// A trunk with its weights.
pub(crate) struct Trunk {
    arch: Arch,
    shape: Shape,
    /// Positions of the columns and rows of the maps, without the crop's offset.
    positions: Vec<f32>,
    weights: Weights,
    flipped: Vec<Vec<f32>>,
}

/// Memory of the forward passes of a batch, for reuse.
#[derive(Default)]
pub(crate) struct Tapes(Vec<Tape>);

impl Trunk {
    /// A trunk of this shape; `positions` are the coordinates of the maps' columns, which are also those of their rows.
    pub(crate) fn new(shape: Shape, positions: Vec<f32>, weights: Weights) -> Self {
        let convs = shape.convs.iter().zip(&weights.kernels).skip(1);
        Self {
            arch: Arch::new(),
            flipped: convs.map(|(conv, kernel)| conv.flipped(kernel)).collect(),
            shape,
            positions,
            weights,
        }
    }

    /// The keypoints of `count` images, [`PER_KEYPOINT`] numbers each. `fill` writes the pixels of an image, of which it gets the
    /// number, to the padded input.
    pub(crate) fn forward(
        &self,
        tapes: &mut Tapes,
        count: usize,
        fill: impl Fn(usize, &mut [f32], Layout) + Sync,
    ) -> Vec<f32> {
        while tapes.0.len() < count {
            tapes.0.push(Tape::new(&self.shape));
        }
        let tapes = &mut tapes.0[..count];
        tapes.par_iter_mut().enumerate().for_each(|(image, tape)| {
            fill(image, &mut tape.inputs[0], self.shape.convs[0].input());
            self.arch.dispatch(Forward {
                shape: &self.shape,
                weights: &self.weights,
                positions: &self.positions,
                tape,
            });
        });
        tapes.iter().flat_map(|tape| tape.keypoints.iter().copied()).collect()
    }

    /// The gradient of the weights, given that of the keypoints' x and y, two numbers each, after [`Self::forward`].
    pub(crate) fn backward(&self, tapes: &Tapes, gradients: &[f32]) -> Weights {
        let per_image = PER_KEYPOINT * self.shape.keypoints();
        let count = gradients.len() / per_image;
        let (arch, shape, positions) = (self.arch, &self.shape, self.positions.as_slice());
        let sums: Vec<Weights> = tapes.0[..count]
            .par_chunks(IMAGES_PER_SUM)
            .zip(gradients.par_chunks(IMAGES_PER_SUM * per_image))
            .map(|(tapes, gradients)| {
                let mut scratch = Scratch::new(shape);
                let mut sum = Weights::zeros(shape);
                for (tape, gradient) in tapes.iter().zip(gradients.chunks_exact(per_image)) {
                    arch.dispatch(Backward {
                        shape,
                        weights: &self.weights,
                        flipped: &self.flipped,
                        positions,
                        tape,
                        gradient,
                        scratch: &mut scratch,
                        sum: &mut sum,
                    });
                }
                sum
            })
            .collect();
        let mut all = Weights::zeros(shape);
        for sum in &sums {
            all.add(sum);
        }
        all
    }
}

impl Tape {
    fn new(shape: &Shape) -> Self {
        let outputs = |conv: &Conv| vec![0.0; conv.out_pixels() * conv.outputs];
        let groups = |conv: &Conv| vec![[0.0; 2]; conv.outputs / GROUP_CHANNELS];
        Self {
            inputs: shape.convs.iter().map(|conv| vec![0.0; conv.input().len()]).collect(),
            outputs: shape.convs.iter().map(outputs).collect(),
            statistics: shape.convs[..shape.convs.len() - 1].iter().map(groups).collect(),
            keypoints: vec![0.0; PER_KEYPOINT * shape.keypoints()],
        }
    }
}

struct Forward<'a> {
    shape: &'a Shape,
    weights: &'a Weights,
    positions: &'a [f32],
    tape: &'a mut Tape,
}

impl WithSimd for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            shape,
            weights,
            positions,
            tape,
        } = self;
        for (layer, conv) in shape.convs.iter().enumerate() {
            let output = &mut tape.outputs[layer];
            convolve(
                simd,
                conv,
                &conv.runs(),
                &weights.kernels[layer],
                &tape.inputs[layer],
                output,
            );
            if let Some(next) = shape.convs.get(layer + 1) {
                let affine = [&weights.scales[layer], &weights.shifts[layer]].map(Vec::as_slice);
                normalise(
                    output,
                    affine,
                    &mut tape.statistics[layer],
                    &mut tape.inputs[layer + 1],
                    next.input(),
                );
            } else {
                soften(output, conv.outputs);
                locate(output, conv.outputs, positions, &mut tape.keypoints);
            }
        }
    }
}

/// The vector of channels `block` of a pixel.
#[inline(always)]
fn lanes(pixel: &[f32], block: usize) -> &[f32; CHANNELS] {
    &pixel.as_chunks().0[block]
}

/// Sums over the pixels of an image for each channel of a block: of the values that `value` returns.
#[inline(always)]
fn sums<const N: usize>(pixels: impl Iterator<Item = [[f32; CHANNELS]; N]>) -> [[f32; CHANNELS]; N] {
    let mut sums = [[0.0; CHANNELS]; N];
    for values in pixels {
        for n in 0..N {
            for lane in 0..CHANNELS {
                sums[n][lane] += values[n][lane];
            }
        }
    }
    sums
}

/// Group normalisation and `ReLU`, written to the padded input of the next convolution.
#[inline(always)]
fn normalise(raw: &[f32], [scales, shifts]: [&[f32]; 2], statistics: &mut [[f32; 2]], out: &mut [f32], layout: Layout) {
    let channels = layout.channels;
    let count = (layout.side * layout.side * GROUP_CHANNELS) as f32;
    for block in 0..channels / CHANNELS {
        let pixels = || raw.chunks_exact(channels).map(|pixel| *lanes(pixel, block));
        let [sum] = sums(pixels().map(|values| [values]));
        let (mut means, mut rates) = ([0.0; CHANNELS], [0.0; CHANNELS]);
        for group in 0..CHANNELS / GROUP_CHANNELS {
            let range = group * GROUP_CHANNELS..(group + 1) * GROUP_CHANNELS;
            means[range.clone()].fill(sum[range].iter().sum::<f32>() / count);
        }
        let [squares] = sums(pixels().map(|values| {
            let mut squares = [0.0; CHANNELS];
            for lane in 0..CHANNELS {
                squares[lane] = (values[lane] - means[lane]) * (values[lane] - means[lane]);
            }
            [squares]
        }));
        for group in 0..CHANNELS / GROUP_CHANNELS {
            let range = group * GROUP_CHANNELS..(group + 1) * GROUP_CHANNELS;
            let variance = squares[range.clone()].iter().sum::<f32>() / count;
            let rate = 1.0 / (variance + EPSILON).sqrt();
            statistics[block * (CHANNELS / GROUP_CHANNELS) + group] = [means[range.start], rate];
            rates[range].fill(rate);
        }
        let (mut factors, mut offsets) = ([0.0; CHANNELS], [0.0; CHANNELS]);
        for lane in 0..CHANNELS {
            factors[lane] = rates[lane] * scales[block * CHANNELS + lane];
            offsets[lane] = shifts[block * CHANNELS + lane] - means[lane] * factors[lane];
        }
        for y in 0..layout.side {
            let line = &mut out[layout.line(y)];
            let raw = &raw[y * layout.side * channels..][..layout.side * channels];
            for (out, raw) in line.chunks_exact_mut(channels).zip(raw.chunks_exact(channels)) {
                let (out, raw) = (&mut out.as_chunks_mut::<CHANNELS>().0[block], lanes(raw, block));
                for lane in 0..CHANNELS {
                    out[lane] = (raw[lane] * factors[lane] + offsets[lane]).max(0.0);
                }
            }
        }
    }
}

/// The exponential function for numbers up to 0, with a relative error below 2e-7; 0 below -87. Unlike that of the system's
/// library, it is the same everywhere and is computed for a whole vector.
#[inline(always)]
fn exponential(x: f32) -> f32 {
    let x = x.max(-87.0);
    // x = n ln 2 + r, where |r| is at most half of ln 2. Adding and subtracting 1.5 * 2^23 rounds to an integer.
    let shifted = x * std::f32::consts::LOG2_E + 12_582_912.0;
    let n = shifted - 12_582_912.0;
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let polynomial = [
        1.987_569_1e-4,
        1.398_199_9e-3,
        8.333_452e-3,
        4.166_579_6e-2,
        1.666_666_5e-1,
        0.5,
    ];
    let mut sum = polynomial[0];
    for factor in &polynomial[1..] {
        sum = sum * r + factor;
    }
    let fraction = sum * r * r + r + 1.0;
    f32::from_bits(fraction.to_bits().wrapping_add(((n as i32) << 23) as u32))
}

/// Replaces the maps by their softmax over the pixels.
#[inline(always)]
fn soften(maps: &mut [f32], channels: usize) {
    for block in 0..channels / CHANNELS {
        let mut highest = [f32::NEG_INFINITY; CHANNELS];
        for pixel in maps.chunks_exact(channels) {
            let values = lanes(pixel, block);
            for lane in 0..CHANNELS {
                highest[lane] = highest[lane].max(values[lane]);
            }
        }
        let mut sum = [0.0; CHANNELS];
        for pixel in maps.chunks_exact_mut(channels) {
            let values = &mut pixel.as_chunks_mut::<CHANNELS>().0[block];
            for lane in 0..CHANNELS {
                values[lane] = exponential(values[lane] - highest[lane]);
                sum[lane] += values[lane];
            }
        }
        for lane in &mut sum {
            *lane = 1.0 / *lane;
        }
        for pixel in maps.chunks_exact_mut(channels) {
            let values = &mut pixel.as_chunks_mut::<CHANNELS>().0[block];
            for lane in 0..CHANNELS {
                values[lane] *= sum[lane];
            }
        }
    }
}

/// The mean position of every map.
#[inline(always)]
fn locate(maps: &[f32], channels: usize, positions: &[f32], keypoints: &mut [f32]) {
    let side = positions.len();
    for block in 0..channels / CHANNELS {
        let [xs, ys] = sums(maps.chunks_exact(channels).enumerate().map(|(number, pixel)| {
            let (x, y) = (positions[number % side], positions[number / side]);
            let values = lanes(pixel, block);
            let mut weighted = [[0.0; CHANNELS]; 2];
            for lane in 0..CHANNELS {
                weighted[0][lane] = values[lane] * x;
                weighted[1][lane] = values[lane] * y;
            }
            weighted
        }));
        let own = &mut keypoints[PER_KEYPOINT * CHANNELS * block..];
        for (lane, keypoint) in own.chunks_exact_mut(PER_KEYPOINT).take(CHANNELS).enumerate() {
            keypoint.copy_from_slice(&[xs[lane], ys[lane]]);
        }
    }
}

/// Memory of a backward pass.
struct Scratch {
    /// Gradient of the output of every convolution, padded as the input of [`Conv::reversed`] is.
    gradients: Vec<Vec<f32>>,
    /// Gradient of the input of every convolution but the first, without padding.
    inputs: Vec<Vec<f32>>,
}

/// Layout of the gradient of a convolution's output. That of the first is only used for its weights and needs no padding.
fn gradient_layout(layer: usize, conv: &Conv) -> Layout {
    Layout {
        side: conv.out_side(),
        padding: if layer == 0 { 0 } else { conv.padding() },
        channels: conv.outputs,
    }
}

impl Scratch {
    fn new(shape: &Shape) -> Self {
        let layouts = shape.convs.iter().enumerate();
        Self {
            gradients: layouts
                .map(|(layer, conv)| vec![0.0; gradient_layout(layer, conv).len()])
                .collect(),
            inputs: shape.convs[1..]
                .iter()
                .map(|conv| vec![0.0; conv.side * conv.side * conv.inputs])
                .collect(),
        }
    }
}

struct Backward<'a> {
    shape: &'a Shape,
    weights: &'a Weights,
    flipped: &'a [Vec<f32>],
    positions: &'a [f32],
    tape: &'a Tape,
    gradient: &'a [f32],
    scratch: &'a mut Scratch,
    sum: &'a mut Weights,
}

impl WithSimd for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            shape,
            weights,
            flipped,
            positions,
            tape,
            gradient,
            scratch,
            sum,
        } = self;
        for (layer, conv) in shape.convs.iter().enumerate().rev() {
            let layout = gradient_layout(layer, conv);
            let own = &mut scratch.gradients[layer];
            if layer + 1 == shape.convs.len() {
                scatter(&tape.outputs[layer], positions, &tape.keypoints, gradient, own, layout);
            } else {
                let next = &shape.convs[layer + 1];
                denormalise(
                    &Normalised {
                        raw: &tape.outputs[layer],
                        active: &tape.inputs[layer + 1],
                        active_layout: next.input(),
                        statistics: &tape.statistics[layer],
                        scales: &weights.scales[layer],
                    },
                    &scratch.inputs[layer],
                    [&mut sum.scales[layer], &mut sum.shifts[layer]],
                    own,
                    layout,
                );
            }
            let input = &tape.inputs[layer];
            add_weight_gradient(simd, conv, &conv.runs(), input, (own, layout), &mut sum.kernels[layer]);
            if layer > 0 {
                let reversed = conv.reversed();
                let into = &mut scratch.inputs[layer - 1];
                convolve(simd, &reversed, &reversed.runs(), &flipped[layer - 1], own, into);
            }
        }
    }
}

/// The gradient of the maps before their softmax, given that of the keypoints.
#[inline(always)]
fn scatter(maps: &[f32], positions: &[f32], keypoints: &[f32], gradient: &[f32], into: &mut [f32], layout: Layout) {
    let (channels, side) = (layout.channels, layout.side);
    for block in 0..channels / CHANNELS {
        let mut means = [[0.0; CHANNELS]; 2];
        let mut factors = [[0.0; CHANNELS]; 2];
        for lane in 0..CHANNELS {
            let keypoint = block * CHANNELS + lane;
            for axis in 0..2 {
                means[axis][lane] = keypoints[PER_KEYPOINT * keypoint + axis];
                factors[axis][lane] = gradient[PER_KEYPOINT * keypoint + axis];
            }
        }
        for y in 0..side {
            let line = &mut into[layout.line(y)];
            let maps = &maps[y * side * channels..][..side * channels];
            let pixels = line.chunks_exact_mut(channels).zip(maps.chunks_exact(channels));
            for (x, (into, map)) in pixels.enumerate() {
                let (into, map) = (&mut into.as_chunks_mut::<CHANNELS>().0[block], lanes(map, block));
                for lane in 0..CHANNELS {
                    into[lane] = map[lane]
                        * ((positions[x] - means[0][lane]) * factors[0][lane]
                            + (positions[y] - means[1][lane]) * factors[1][lane]);
                }
            }
        }
    }
}

/// A normalised layer, as its forward pass left it.
struct Normalised<'a> {
    raw: &'a [f32],
    active: &'a [f32],
    active_layout: Layout,
    statistics: &'a [[f32; 2]],
    scales: &'a [f32],
}

/// The gradient of a convolution's output, given that after normalisation and `ReLU`. Adds the gradients of scales and shifts.
#[inline(always)]
fn denormalise(
    layer: &Normalised<'_>,
    after: &[f32],
    [scales, shifts]: [&mut [f32]; 2],
    into: &mut [f32],
    layout: Layout,
) {
    let (channels, side) = (layout.channels, layout.side);
    let count = (side * side * GROUP_CHANNELS) as f32;
    let line = |y: usize| y * side * channels..(y + 1) * side * channels;
    for block in 0..channels / CHANNELS {
        let (mut means, mut rates, mut own) = ([0.0; CHANNELS], [0.0; CHANNELS], [0.0; CHANNELS]);
        for lane in 0..CHANNELS {
            let group = (block * CHANNELS + lane) / GROUP_CHANNELS;
            [means[lane], rates[lane]] = layer.statistics[group];
            own[lane] = layer.scales[block * CHANNELS + lane];
        }
        let mut totals = [[0.0_f32; CHANNELS]; 2];
        for y in 0..side {
            let active = layer.active[layer.active_layout.line(y)].chunks_exact(channels);
            let pixels = after[line(y)]
                .chunks_exact(channels)
                .zip(layer.raw[line(y)].chunks_exact(channels));
            for ((after, raw), active) in pixels.zip(active) {
                let (after, raw, active) = (lanes(after, block), lanes(raw, block), lanes(active, block));
                for lane in 0..CHANNELS {
                    let gradient = if active[lane] > 0.0 { after[lane] } else { 0.0 };
                    totals[0][lane] += gradient;
                    totals[1][lane] += gradient * ((raw[lane] - means[lane]) * rates[lane]);
                }
            }
        }
        let mut averages = [[0.0_f32; CHANNELS]; 2];
        for group in 0..CHANNELS / GROUP_CHANNELS {
            let range = group * GROUP_CHANNELS..(group + 1) * GROUP_CHANNELS;
            for (average, total) in averages.iter_mut().zip(&totals) {
                let sum: f32 = range.clone().map(|lane| own[lane] * total[lane]).sum();
                average[range.clone()].fill(sum / count);
            }
        }
        for lane in 0..CHANNELS {
            shifts[block * CHANNELS + lane] += totals[0][lane];
            scales[block * CHANNELS + lane] += totals[1][lane];
        }
        for y in 0..side {
            let active = layer.active[layer.active_layout.line(y)].chunks_exact(channels);
            let pixels = after[line(y)]
                .chunks_exact(channels)
                .zip(layer.raw[line(y)].chunks_exact(channels));
            let into = into[layout.line(y)].chunks_exact_mut(channels);
            for (((after, raw), active), into) in pixels.zip(active).zip(into) {
                let (after, raw, active) = (lanes(after, block), lanes(raw, block), lanes(active, block));
                let into = &mut into.as_chunks_mut::<CHANNELS>().0[block];
                for lane in 0..CHANNELS {
                    let gradient = if active[lane] > 0.0 { after[lane] } else { 0.0 };
                    let centred = (raw[lane] - means[lane]) * rates[lane];
                    into[lane] = rates[lane] * (own[lane] * gradient - averages[0][lane] - centred * averages[1][lane]);
                }
            }
        }
    }
}

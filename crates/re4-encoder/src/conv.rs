//! Convolutions of one image on the CPU: the hot loops of the keypoint network's training.
//!
//! Images are stored with the channels innermost. Every output is a chain of fused multiply-adds in a fixed order, so results do
//! not depend on the width of the processor's vectors. `tests/keypoints.rs` compares the results with burn's convolutions.
//!
//! burn's pure-Rust backend computes a convolution by copying windows to a matrix (im2col), and the gradient of its weights by a
//! convolution whose kernel is as large as the image. Both move far more memory than they compute with the few channels of this
//! network. Here, one image with all its activations stays in the processor's cache.
#![allow(
    clippy::inline_always,
    reason = "the loops must be inlined into the function that is compiled for the processor's vectors"
)]
#![allow(
    clippy::needless_range_loop,
    reason = "loops over the lanes of several arrays, which the compiler turns into vectors"
)]

use std::array::from_fn;

use pulp::Simd;

/// A square convolution without bias. Its padding keeps the side of the image, divided by the stride.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Conv {
    /// Side of the kernel, odd.
    pub(crate) kernel: usize,
    /// Step of the window, in pixels.
    pub(crate) stride: usize,
    /// Distance between the pixels of a window.
    pub(crate) dilation: usize,
    /// Channels of the input.
    pub(crate) inputs: usize,
    /// Channels of the output, a multiple of [`CHANNELS`].
    pub(crate) outputs: usize,
    /// Side of the input, in pixels.
    pub(crate) side: usize,
}

/// Channels of outputs are a multiple of this number: that of the widest vectors.
pub(crate) const CHANNELS: usize = 16;

/// A contiguous part of a window: the offset of its first number from the window's, and its length.
type Run = (usize, usize);

impl Conv {
    /// Pixels of padding at each side of the input.
    pub(crate) const fn padding(&self) -> usize {
        self.dilation * (self.kernel - 1) / 2
    }

    /// Side of the output, in pixels.
    pub(crate) const fn out_side(&self) -> usize {
        (self.side - 1) / self.stride + 1
    }

    /// Number of output pixels.
    pub(crate) const fn out_pixels(&self) -> usize {
        self.out_side() * self.out_side()
    }

    /// Layout of the input.
    pub(crate) const fn input(&self) -> Layout {
        Layout {
            side: self.side,
            padding: self.padding(),
            channels: self.inputs,
        }
    }

    /// Number of weights.
    pub(crate) const fn weights(&self) -> usize {
        self.kernel * self.kernel * self.inputs * self.outputs
    }

    /// The convolution of the output's gradient that gives the input's gradient, with [`Conv::flipped`] weights. Only for stride 1.
    pub(crate) const fn reversed(&self) -> Self {
        Self {
            inputs: self.outputs,
            outputs: self.inputs,
            ..*self
        }
    }

    /// Weights from burn's layout `[outputs, inputs, kernel, kernel]` to this module's, `[kernel, kernel, inputs, outputs]`.
    pub(crate) fn to_own(self, burn: &[f32]) -> Vec<f32> {
        let (taps, mut own) = (self.kernel * self.kernel, vec![0.0; self.weights()]);
        for (index, value) in burn.iter().enumerate() {
            let (tap, channel) = (index % taps, index / taps);
            let (input, output) = (channel % self.inputs, channel / self.inputs);
            own[(tap * self.inputs + input) * self.outputs + output] = *value;
        }
        own
    }

    /// The reverse of [`Conv::to_own`].
    pub(crate) fn to_burn(self, own: &[f32]) -> Vec<f32> {
        let (taps, mut burn) = (self.kernel * self.kernel, vec![0.0; self.weights()]);
        for (index, value) in burn.iter_mut().enumerate() {
            let (tap, channel) = (index % taps, index / taps);
            let (input, output) = (channel % self.inputs, channel / self.inputs);
            *value = own[(tap * self.inputs + input) * self.outputs + output];
        }
        burn
    }

    /// The weights of [`Conv::reversed`].
    pub(crate) fn flipped(self, own: &[f32]) -> Vec<f32> {
        let (taps, mut flipped) = (self.kernel * self.kernel, vec![0.0; self.weights()]);
        for (index, value) in own.iter().enumerate() {
            let (output, rest) = (index % self.outputs, index / self.outputs);
            let (input, tap) = (rest % self.inputs, rest / self.inputs);
            flipped[((taps - 1 - tap) * self.outputs + output) * self.inputs + input] = *value;
        }
        flipped
    }

    /// The contiguous parts of a window, in the order of the weights. Without dilation, a row of a window is contiguous.
    pub(crate) fn runs(&self) -> Vec<Run> {
        let row = self.input().row();
        let mut runs = Vec::with_capacity(self.kernel * self.kernel);
        for ky in 0..self.kernel {
            let start = ky * self.dilation * row;
            if self.dilation == 1 {
                runs.push((start, self.kernel * self.inputs));
            } else {
                runs.extend((0..self.kernel).map(|kx| (start + kx * self.dilation * self.inputs, self.inputs)));
            }
        }
        runs
    }
}

/// Layout of an image in memory: rows of pixels, with zeros around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Layout {
    /// Side without padding, in pixels.
    pub(crate) side: usize,
    /// Pixels of padding at each side.
    pub(crate) padding: usize,
    /// Numbers per pixel.
    pub(crate) channels: usize,
}

impl Layout {
    /// Numbers per row, with padding.
    pub(crate) const fn row(&self) -> usize {
        (self.side + 2 * self.padding) * self.channels
    }

    /// Numbers of the image, with padding.
    pub(crate) const fn len(&self) -> usize {
        (self.side + 2 * self.padding) * self.row()
    }

    /// The range of row `y`, without padding.
    pub(crate) const fn line(&self, y: usize) -> std::ops::Range<usize> {
        let start = (y + self.padding) * self.row() + self.padding * self.channels;
        start..start + self.side * self.channels
    }
}

/// Convolves a padded image. Writes the output without padding.
#[inline(always)]
pub(crate) fn convolve<S: Simd>(simd: S, conv: &Conv, runs: &[Run], weights: &[f32], input: &[f32], out: &mut [f32]) {
    // Pixels that are computed together: few enough for the registers, and a row has few pixels left over.
    match conv.out_side() {
        37..=39 => rows::<S, 13>(simd, conv, runs, weights, input, out),
        10.. => rows::<S, 10>(simd, conv, runs, weights, input, out),
        _ => rows::<S, 1>(simd, conv, runs, weights, input, out),
    }
}

#[inline(always)]
fn rows<S: Simd, const P: usize>(simd: S, conv: &Conv, runs: &[Run], weights: &[f32], input: &[f32], out: &mut [f32]) {
    let (side, step) = (conv.out_side(), conv.stride * conv.inputs);
    let row = conv.input().row();
    let blocks = conv.outputs / S::F32_LANES;
    let weights = S::as_simd_f32s(weights).0;
    let out = S::as_mut_simd_f32s(out).0;
    for (y, line) in out.chunks_exact_mut(side * blocks).enumerate() {
        let base = y * conv.stride * row;
        for x in (0..side).step_by(P) {
            // The last group of a row overlaps the one before it; what is computed twice is the same.
            let start = x.min(side - P);
            for block in 0..blocks {
                let mut sums = [simd.splat_f32s(0.0); P];
                let mut first = block;
                for &(offset, length) in runs {
                    let from = base + start * step + offset;
                    let windows: [&[f32]; P] = from_fn(|j| &input[from + j * step..][..length]);
                    let own = &weights[first..][..=(length - 1) * blocks];
                    first += length * blocks;
                    for i in 0..length {
                        let weight = own[i * blocks];
                        for j in 0..P {
                            sums[j] = simd.mul_add_f32s(simd.splat_f32s(windows[j][i]), weight, sums[j]);
                        }
                    }
                }
                for (j, sum) in sums.iter().enumerate() {
                    line[(start + j) * blocks + block] = *sum;
                }
            }
        }
    }
}

/// Adds the gradient of the weights. `gradient` is that of the output, in the given layout.
#[inline(always)]
pub(crate) fn add_weight_gradient<S: Simd>(
    simd: S,
    conv: &Conv,
    runs: &[Run],
    input: &[f32],
    (gradient, layout): (&[f32], Layout),
    into: &mut [f32],
) {
    let blocks = conv.outputs / S::F32_LANES;
    let gradient = S::as_simd_f32s(gradient).0;
    let into = S::as_mut_simd_f32s(into).0;
    let mut first = 0;
    for &(offset, length) in runs {
        let mut at = 0;
        while at < length {
            let of = (&mut into[first + at * blocks..], offset + at);
            // As many weights at a time as there are registers.
            at += match length - at {
                16.. => weights::<S, 16>(simd, conv, input, (gradient, layout), of),
                15 => weights::<S, 15>(simd, conv, input, (gradient, layout), of),
                _ => weights::<S, 1>(simd, conv, input, (gradient, layout), of),
            };
        }
        first += length * blocks;
    }
}

#[inline(always)]
fn weights<S: Simd, const Q: usize>(
    simd: S,
    conv: &Conv,
    input: &[f32],
    (gradient, layout): (&[S::f32s], Layout),
    (into, offset): (&mut [S::f32s], usize),
) -> usize {
    let (side, step) = (conv.out_side(), conv.stride * conv.inputs);
    let row = conv.input().row();
    let blocks = conv.outputs / S::F32_LANES;
    for block in 0..blocks {
        let mut sums = [simd.splat_f32s(0.0); Q];
        for y in 0..side {
            let line = layout.line(y);
            let gradients = &gradient[line.start / S::F32_LANES..line.end / S::F32_LANES];
            let inputs = &input[y * conv.stride * row + offset..][..(side - 1) * step + Q];
            for x in 0..side {
                let own = gradients[x * blocks + block];
                let window = &inputs[x * step..][..Q];
                for q in 0..Q {
                    sums[q] = simd.mul_add_f32s(simd.splat_f32s(window[q]), own, sums[q]);
                }
            }
        }
        for (q, sum) in sums.iter().enumerate() {
            let into = &mut into[q * blocks + block];
            *into = simd.add_f32s(*into, *sum);
        }
    }
    Q
}

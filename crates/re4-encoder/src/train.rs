//! Training.

use std::path::Path;
use std::time::Instant;

use burn::module::{Module as _, ModuleMapper, Param};
use burn::optim::{AdamWConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Isometry3;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use serde::{Deserialize, Serialize};

use crate::batches::{Sample, Sampler};
use crate::checkpoint::Checkpoints;
use crate::config::EncoderConfig;
use crate::images::{INPUTS, ImageFile, Loaded, MIDDLE, batches, load};
use crate::loss::{GROUP, Losses, Poses, losses};
use crate::resnet::Encoder;
use crate::{CROP, EncoderError};

/// Images at once where nothing is trained.
const CHUNK: usize = 64;

/// Most images whose loss is told of demonstrations that were held out.
const HELD_OUT: usize = 512;

/// What a training is made of.
pub struct Task<'a> {
    /// Settings.
    pub config: &'a EncoderConfig,
    /// Batches.
    pub sampler: &'a Sampler,
    /// Images of all demonstrations.
    pub images: &'a ImageFile,
    /// Frames of demonstrations that are held out, with the targets that they would have; nothing is chosen by them.
    pub held_out: &'a [Sample],
    /// Weights to start from, in torchvision's names.
    pub weights: Option<&'a Path>,
}

/// How far a training is.
#[derive(Debug, Clone, Copy)]
pub struct Progress {
    /// Epoch, from 1.
    pub epoch: u32,
    /// Steps done in all.
    pub steps: u64,
    /// Images a second, since the start of this process.
    pub rate: f64,
    /// Mean losses of the epoch up to here: sum, absolute, relative, cross.
    pub losses: [f64; 4],
}

/// A finished epoch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Epoch {
    /// Number, from 1.
    pub epoch: u32,
    /// Steps until its end.
    pub steps: u32,
    /// Learning rate of its last step.
    pub learning_rate: f64,
    /// Means of its steps.
    pub losses: [f64; 4],
    /// L_abs of frames that were held out.
    pub held_out: Option<f64>,
}

/// What came of it.
pub struct Trained {
    /// Weights.
    pub encoder: Encoder,
    /// One an epoch.
    pub epochs: Vec<Epoch>,
    /// Epochs that were there already, from a checkpoint.
    pub resumed: u32,
    /// Images a second of this process; `None` where nothing was left to train.
    pub rate: Option<f64>,
}

/// Steps of an epoch: as many as draw as many images as there are, or as the settings say.
pub fn steps_of(config: &EncoderConfig, sampler: &Sampler) -> u32 {
    config
        .steps
        .unwrap_or_else(|| (sampler.images() / config.batch).max(1) as u32)
}

/// Trains, from the last whole checkpoint on where there is one. `going` is told after every step and ends the training, whose
/// checkpoints stay, by its error.
///
/// # Errors
/// When the weights to start from cannot be used, a loss is not finite, the disk is full, or by `going`.
pub fn train<E: From<EncoderError>>(
    task: &Task,
    checkpoints: &Checkpoints,
    mut going: impl FnMut(&Progress) -> Result<(), E>,
) -> Result<Trained, E> {
    let config = task.config;
    let device = config.backend.device()?.autodiff();
    let mut encoder = start(task, &device)?;
    let mut optimizer = AdamWConfig::new()
        .with_weight_decay(config.weight_decay as f32)
        .with_epsilon(1e-8)
        .init();
    let mut epochs: Vec<Epoch> = Vec::new();
    if let Some(last) = checkpoints.last()? {
        (encoder, optimizer, epochs) = last.restore(encoder, optimizer)?;
    }
    let resumed = epochs.len() as u32;
    let steps = steps_of(config, task.sampler);
    let clock = Instant::now();
    let mut drawn = 0_u64;
    for epoch in resumed..config.epochs {
        let mut sums = [0.0; 4];
        let mut rate_of_step = config.learning_rate;
        encoder = std::thread::scope(|scope| -> Result<Encoder, E> {
            let mut encoder = encoder;
            let receiver = batches(scope, task.images, task.sampler, epoch, steps);
            for step in 0..steps {
                let Ok(loaded) = receiver.recv() else {
                    return Err(EncoderError::Loader.into());
                };
                let loaded = loaded?;
                rate_of_step = learning_rate(config, u64::from(epoch) * u64::from(steps) + u64::from(step), steps);
                let values;
                (encoder, values) = advance(encoder, &mut optimizer, &loaded, config, rate_of_step);
                if values.iter().any(|value| !value.is_finite()) {
                    return Err(EncoderError::NotFinite {
                        epoch: epoch + 1,
                        step: step + 1,
                        kept: checkpoints.describe(epoch),
                    }
                    .into());
                }
                drawn += loaded.batch.samples.len() as u64;
                for (sum, value) in sums.iter_mut().zip(values) {
                    *sum += value;
                }
                going(&Progress {
                    epoch: epoch + 1,
                    steps: u64::from(epoch) * u64::from(steps) + u64::from(step) + 1,
                    rate: drawn as f64 / clock.elapsed().as_secs_f64(),
                    losses: sums.map(|sum| sum / f64::from(step + 1)),
                })?;
            }
            Ok(encoder)
        })?;
        epochs.push(Epoch {
            epoch: epoch + 1,
            steps: (epoch + 1) * steps,
            learning_rate: rate_of_step,
            losses: sums.map(|sum| sum / f64::from(steps)),
            held_out: held_out(&encoder, task)?,
        });
        checkpoints.keep(&encoder, &optimizer, &epochs)?;
    }
    Ok(Trained {
        encoder: encoder.valid(),
        rate: (drawn > 0).then(|| drawn as f64 / clock.elapsed().as_secs_f64()),
        epochs,
        resumed,
    })
}

fn learning_rate(config: &EncoderConfig, step: u64, steps: u32) -> f64 {
    if !config.cosine {
        return config.learning_rate;
    }
    let all = f64::from(config.epochs) * f64::from(steps);
    let share = step as f64 / all;
    // The first twentieth leads up from nothing, so that the first steps, whose gradients say little, move little.
    let up = (share * 20.0).min(1.0).max(1.0 / all);
    config.learning_rate * up * 0.5 * (1.0 + (std::f64::consts::PI * share).cos())
}

/// The encoder before its first step.
fn start(task: &Task, device: &Device) -> Result<Encoder, EncoderError> {
    let encoder = Encoder::new(task.config.width, device);
    let mut rng = Rng {
        rng: Pcg64::new(u128::from(task.config.seed), 0x5851_f42d_4c95_7f2d_1405_7b7e_f767_814f),
    };
    let encoder = encoder.map(&mut rng).aimed(&task.sampler.anchors());
    match task.weights {
        Some(path) => crate::weights::load_torchvision(encoder, path),
        None => Ok(encoder),
    }
}

/// Draws weights: burn's own draw depends on what else the process draws.
struct Rng {
    rng: Pcg64,
}

impl Rng {
    /// Even in [0, 1).
    fn even(&mut self) -> f64 {
        (self.rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let (radius, turn) = ((1.0 - self.even()).ln(), self.even());
        (-2.0 * radius).sqrt() * (std::f64::consts::TAU * turn).cos()
    }
}

impl ModuleMapper for Rng {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|tensor| {
            let dims = tensor.dims();
            let count: usize = dims.iter().product();
            let values: Vec<f32> = match dims.as_slice() {
                // Convolutions as in torchvision: He's normal distribution by outputs.
                [out, _, height, width] => {
                    let deviation = (2.0 / (out * height * width) as f64).sqrt();
                    (0..count).map(|_| (self.normal() * deviation) as f32).collect()
                }
                // Linear layers as in PyTorch: even, up to the root of the inputs.
                [inputs, _] => {
                    let bound = (1.0 / *inputs as f64).sqrt();
                    (0..count).map(|_| ((2.0 * self.even() - 1.0) * bound) as f32).collect()
                }
                // Scales and offsets are 1 and 0 as they are.
                _ => return tensor,
            };
            let device = tensor.device();
            let drawn = Tensor::from_data(TensorData::new(values, dims), &device);
            if tensor.is_require_grad() {
                drawn.require_grad()
            } else {
                drawn
            }
        })
    }
}

fn inputs(values: Vec<f32>, device: &Device) -> Tensor<4> {
    let count = values.len() / INPUTS;
    Tensor::from_data(TensorData::new(values, [count, 3, CROP, CROP]), device)
}

/// One step of the optimiser; the losses before it.
fn advance(
    encoder: Encoder,
    optimizer: &mut ModuleOptimizer,
    loaded: &Loaded,
    config: &EncoderConfig,
    learning_rate: f64,
) -> (Encoder, [f64; 4]) {
    let device = encoder.device();
    let (_, estimates) = encoder.poses(inputs(loaded.inputs.clone(), &device));
    let targets: Vec<Isometry3<f64>> = loaded.batch.samples.iter().map(|sample| sample.target).collect();
    let targets = Poses::from_known(&targets, &device);
    let near: Vec<f32> = loaded
        .batch
        .near
        .iter()
        .map(|near| f32::from(u8::from(*near)))
        .collect();
    let groups = loaded.batch.samples.len() / GROUP;
    let near = Tensor::from_data(TensorData::new(near, [groups, 1]), &device);
    let Losses {
        sum,
        absolute,
        relative,
        cross,
    } = losses(&estimates, &targets, &near, &config.losses);
    let values = [&sum, &absolute, &relative, &cross].map(|loss| f64::from(loss.clone().into_scalar::<f32>()));
    if !values.iter().all(|value| value.is_finite()) {
        return (encoder, values);
    }
    let gradients = GradientsParams::from_grads(sum.backward(), &encoder);
    (optimizer.step(learning_rate, encoder, gradients), values)
}

/// L_abs of frames of demonstrations that were held out, cropped in the middle.
fn held_out(encoder: &Encoder, task: &Task) -> Result<Option<f64>, EncoderError> {
    if task.held_out.is_empty() {
        return Ok(None);
    }
    let encoder = encoder.valid();
    let device = encoder.device();
    let step = task.held_out.len().div_ceil(HELD_OUT);
    let samples: Vec<Sample> = task
        .held_out
        .iter()
        .step_by(step)
        .map(|sample| Sample {
            crop: MIDDLE,
            ..*sample
        })
        .collect();
    let mut sum = 0.0;
    for chunk in samples.chunks(CHUNK) {
        let (_, estimates) = encoder.poses(inputs(load(task.images, chunk)?, &device));
        let targets: Vec<Isometry3<f64>> = chunk.iter().map(|sample| sample.target).collect();
        let losses = estimates.metric(&Poses::from_known(&targets, &device), task.config.losses.translation);
        sum += f64::from(losses.sum().into_scalar::<f32>());
    }
    Ok(Some(sum / samples.len() as f64))
}

//! Training of the encoder.

use std::path::Path;

use burn::module::{Module as _, ModuleMapper, Param};
use burn::optim::{AdamWConfig, GradientsParams, ModuleOptimizer};
use burn::store::ModuleRecord;
use burn::tensor::{Bytes, Device, Tensor, TensorData};
use nalgebra::Isometry3;
use rand_pcg::Pcg64;
use re4_train::{Checkpoints, Epoch, Learner, Plan, Progress, Schedule, TrainError, WarmUp, fit, normal, uniform};

use crate::batches::{Sample, Sampler};
use crate::config::{EncoderConfig, Network};
use crate::images::{Crop, ImageFile, Loaded, load};
use crate::keypoints;
use crate::loss::{Alternatives, Losses, Poses, Setting, losses};
use crate::network::{Crops, Encoder, Kernels, SCALE, estimate};
use crate::orientation;
use crate::trunk::Tapes;
use crate::{EncoderError, IMAGE_BYTES};

/// Number of images per forward pass when the held-out loss is computed.
const HELD_OUT_BATCH: usize = 64;

/// Maximum number of images for the held-out loss.
const MAXIMUM_HELD_OUT: usize = 512;

/// The inputs of a training.
pub struct Task<'a> {
    /// Settings.
    pub config: &'a EncoderConfig,
    /// Samples the batches.
    pub sampler: &'a Sampler,
    /// Images of all demonstrations.
    pub images: &'a ImageFile,
    /// Frames of the held-out demonstrations with their targets. Their loss is only reported: it selects no checkpoint or setting.
    pub held_out: &'a [Sample],
    /// Initial weights with torchvision's names; random if `None`.
    pub weights: Option<&'a Path>,
    /// Rotations after which the object looks the same, about the gripper's axis of approach.
    pub symmetry: Alternatives,
}

/// The result of a training.
pub struct Trained {
    /// The trained network.
    pub encoder: Encoder,
    /// One entry per epoch. [`parts`] names its losses.
    pub epochs: Vec<Epoch>,
    /// Number of epochs that were restored from a checkpoint.
    pub resumed: u32,
    /// Images per second in this process; `None` if all epochs were restored.
    pub rate: Option<f64>,
}

/// Number of steps per epoch: that of the settings, or the number of training images divided by the batch size.
pub fn steps_of(config: &EncoderConfig, sampler: &Sampler) -> u32 {
    config
        .steps
        .unwrap_or_else(|| (sampler.images() / config.batch).max(1) as u32)
}

/// Trains an encoder, from the last valid checkpoint if there is one. `on_step` is called after every step; its error stops the
/// training, and the checkpoints are kept.
///
/// # Errors
/// If the initial weights cannot be used, a loss is not finite, or the disk is full; or the error that `on_step` returns.
pub fn train<E: From<EncoderError>>(
    task: &Task,
    checkpoints: &Checkpoints,
    mut on_step: impl FnMut(&Progress) -> Result<(), E>,
) -> Result<Trained, E> {
    let config = task.config;
    let device = config.backend.device(BACKEND).map_err(EncoderError::from)?.autodiff();
    let mut learner = Encoding {
        task,
        encoder: start(task, &device)?,
        optimizer: AdamWConfig::new()
            .with_weight_decay(config.weight_decay as f32)
            // PyTorch's default, because the paper gives none; burn's default is larger.
            .with_epsilon(1e-8)
            .init(),
        tapes: Tapes::default(),
    };
    let plan = Plan {
        epochs: config.epochs,
        steps: steps_of(config, task.sampler),
        schedule: if config.cosine {
            cosine(config.learning_rate)
        } else {
            Schedule::Constant(config.learning_rate)
        },
        setting: "pose.encoder.learning_rate",
    };
    let load = |epoch, step| {
        let batch = task.sampler.batch(epoch, step);
        load(task.images, &batch.samples).map(|images| Loaded { batch, images })
    };
    let fitted = fit(&mut learner, &plan, &load, checkpoints, |progress| {
        on_step(progress).map_err(Stopped::Caller)
    });
    let fitted = fitted.map_err(|stopped| match stopped {
        Stopped::Caller(error) => error,
        Stopped::Encoder(error) => error.into(),
    })?;
    Ok(Trained {
        encoder: orientation::settle(learner.encoder, task)?.valid(),
        epochs: fitted.epochs,
        resumed: fitted.resumed,
        rate: fitted.rate.map(|rate| rate * config.batch as f64),
    })
}

/// Why the training loop stopped.
enum Stopped<E> {
    Caller(E),
    Encoder(EncoderError),
}

impl<E> From<EncoderError> for Stopped<E> {
    fn from(error: EncoderError) -> Self {
        Self::Encoder(error)
    }
}

impl<E> From<TrainError> for Stopped<E> {
    fn from(error: TrainError) -> Self {
        Self::Encoder(error.into())
    }
}

/// The setting that names the backend.
pub const BACKEND: &str = "pose.encoder.backend";

/// The losses of an epoch or of a step: their sum, L_abs, L_rel and L_cross.
pub fn parts(losses: &[f64]) -> [f64; 4] {
    std::array::from_fn(|part| losses.get(part).copied().unwrap_or(f64::NAN))
}

/// Half a cosine period after a warm-up over the first twentieth, because the gradients of the first steps are unreliable.
pub(crate) fn cosine(highest: f64) -> Schedule {
    Schedule::Cosine {
        highest,
        warm_up: WarmUp::Part(20),
    }
}

/// The encoder before the first step.
fn start(task: &Task, device: &Device) -> Result<Encoder, EncoderError> {
    let encoder = Encoder::new(task.config.network, task.config.width, device);
    // Another stream than that of the batches, so that the two sequences are independent for the same seed.
    let rng = Pcg64::new(u128::from(task.config.seed), 0x5851_f42d_4c95_7f2d_1405_7b7e_f767_814f);
    let mut initializer = WeightInitializer::new(rng, task.config.network);
    let encoder = encoder.map(&mut initializer).centred_on(&task.sampler.anchors());
    match task.weights {
        Some(path) => crate::weights::load_torchvision(encoder, path),
        None => Ok(encoder),
    }
}

/// Samples initial weights with its own generator. burn's initializers use global state, so they depend on other computations
/// of the process.
pub(crate) struct WeightInitializer {
    rng: Pcg64,
    network: Network,
}

impl WeightInitializer {
    pub(crate) fn new(rng: Pcg64, network: Network) -> Self {
        Self { rng, network }
    }
}

impl ModuleMapper for WeightInitializer {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|tensor| {
            let dims = tensor.dims();
            let count: usize = dims.iter().product();
            let values: Vec<f32> = match dims.as_slice() {
                // Convolutions as in torchvision: He initialisation, normal, with the fan-out. The keypoint network's have few
                // inputs in the first layer, so its fan-in is used.
                [out, inside, height, width] => {
                    let (fan, gain) = match self.network {
                        Network::Resnet18 => (out, 1.0),
                        Network::Keypoints => (inside, keypoints::initial_gain(*out, *inside)),
                    };
                    let deviation = gain * (2.0 / (fan * height * width) as f64).sqrt();
                    (0..count).map(|_| (normal(&mut self.rng) * deviation) as f32).collect()
                }
                // Linear layers as in PyTorch: uniform, bounded by one over the square root of the number of inputs.
                [inputs, _] => {
                    let bound = (1.0 / *inputs as f64).sqrt();
                    (0..count)
                        .map(|_| ((2.0 * uniform(&mut self.rng) - 1.0) * bound) as f32)
                        .collect()
                }
                // Scales and biases keep burn's values, 1 and 0.
                _ => return tensor,
            };
            let device = tensor.device();
            let sampled = Tensor::from_data(TensorData::new(values, dims), &device);
            if tensor.is_require_grad() {
                sampled.require_grad()
            } else {
                sampled
            }
        })
    }
}

/// The crops of samples.
fn crops(samples: &[Sample]) -> Vec<Crop> {
    let crop = |sample: &Sample| Crop {
        corner: sample.crop,
        light: sample.light,
    };
    samples.iter().map(crop).collect()
}

/// The targets of samples.
fn targets(samples: &[Sample], device: &Device) -> Poses {
    let targets: Vec<Isometry3<f64>> = samples.iter().map(|sample| sample.target).collect();
    Poses::from_known(&targets, device)
}

/// The losses' values, or the numbers that are not finite.
fn values(losses: &Losses) -> [f64; 4] {
    let all = [&losses.sum, &losses.absolute, &losses.relative, &losses.cross];
    all.map(|loss| f64::from(loss.clone().into_scalar::<f32>()))
}

/// A network in training.
struct Encoding<'a> {
    task: &'a Task<'a>,
    encoder: Encoder,
    optimizer: ModuleOptimizer,
    tapes: Tapes,
}

impl Encoding<'_> {
    /// One step of the optimiser; returns the losses before the step. If a loss is not finite, the weights stay unchanged.
    fn step(&mut self, loaded: &Loaded, learning_rate: f64) -> Result<[f64; 4], EncoderError> {
        let config = self.task.config;
        let device = self.encoder.device();
        let samples = &loaded.batch.samples;
        let images: Vec<&[u8]> = loaded.images.chunks_exact(IMAGE_BYTES).collect();
        let crops = crops(samples);
        let crops = Crops {
            images: &images,
            crops: &crops,
        };
        let near = loaded.batch.near.iter().map(|near| f32::from(u8::from(*near)));
        let near: Vec<f32> = near.collect();
        let groups = near.len();
        let near = Tensor::from_data(TensorData::new(near, [groups, 1]), &device);
        let setting = Setting {
            config: &config.losses,
            symmetry: self.task.symmetry,
            held: config.held_images,
        };
        let targets = targets(samples, &device);
        let kernels = Kernels::of(&self.encoder, config.backend)?;
        let (values, gradients) = if let (Some(kernels), Some(network)) = (&kernels, self.encoder.keypoints()) {
            let found = kernels.forward(crops, &mut self.tapes);
            let dims = [samples.len(), found.len() / samples.len()];
            let positions = Tensor::<2>::from_data(TensorData::new(found, dims), &device).require_grad();
            let poses = Poses::from_raw(&network.head(&positions), SCALE);
            let losses = losses(&poses, &targets, &near, setting);
            let values = values(&losses);
            let gradients = losses.sum.backward();
            let of_positions = positions.grad(&gradients);
            let of_positions: Vec<f32> = of_positions
                .into_iter()
                .flat_map(|gradient| gradient.into_data().iter::<f32>().collect::<Vec<_>>())
                .collect();
            let of_trunk = kernels.trunk().backward(&self.tapes, &of_positions);
            let mut gradients = GradientsParams::from_grads(gradients, &self.encoder);
            network.register(&of_trunk, &mut gradients);
            (values, gradients)
        } else {
            let poses = self.encoder.estimate(crops).poses;
            let losses = losses(&poses, &targets, &near, setting);
            let values = values(&losses);
            (
                values,
                GradientsParams::from_grads(losses.sum.backward(), &self.encoder),
            )
        };
        if values.iter().all(|value| value.is_finite()) {
            self.encoder = self.optimizer.step(learning_rate, self.encoder.clone(), gradients);
        }
        Ok(values)
    }
}

impl Learner for Encoding<'_> {
    type Batch = Loaded;
    type Error = EncoderError;

    fn advance(&mut self, loaded: &Loaded, learning_rate: f64) -> Result<Vec<f64>, EncoderError> {
        self.step(loaded, learning_rate).map(Vec::from)
    }

    fn held_out(&self) -> Result<Option<f64>, EncoderError> {
        held_out(&self.encoder, self.task)
    }

    fn save(&self) -> Result<Vec<Vec<u8>>, String> {
        // The inference copy of the module has the statistics of batch normalisation after the last step.
        let encoder = self.encoder.valid().into_record().into_bytes();
        let encoder = encoder.map_err(|error| error.to_string())?.to_vec();
        let optimizer = self.optimizer.into_bytes().map_err(|error| error.to_string())?.to_vec();
        Ok(vec![encoder, optimizer])
    }

    fn restore(&mut self, parts: Vec<Vec<u8>>) -> Result<(), String> {
        let [encoder, optimizer]: [Vec<u8>; 2] = parts.try_into().map_err(|_| "it has other parts".to_owned())?;
        let record = ModuleRecord::from_bytes(Bytes::from_bytes_vec(encoder)).map_err(|error| error.to_string())?;
        let restored = self.encoder.clone().try_load_record(record);
        self.encoder = restored.map_err(|error| error.to_string())?;
        let restored = self.optimizer.clone().from_bytes(Bytes::from_bytes_vec(optimizer));
        self.optimizer = restored.map_err(|error| error.to_string())?;
        Ok(())
    }
}

/// L_abs over frames of the held-out demonstrations, with centre crops.
fn held_out(encoder: &Encoder, task: &Task) -> Result<Option<f64>, EncoderError> {
    if task.held_out.is_empty() {
        return Ok(None);
    }
    let encoder = encoder.valid();
    let device = encoder.device();
    let kernels = Kernels::of(&encoder, task.config.backend)?;
    let step = task.held_out.len().div_ceil(MAXIMUM_HELD_OUT);
    let samples: Vec<Sample> = task.held_out.iter().step_by(step).copied().collect();
    let mut sum = 0.0;
    for chunk in samples.chunks(HELD_OUT_BATCH) {
        let images = load(task.images, chunk)?;
        let images: Vec<&[u8]> = images.chunks_exact(IMAGE_BYTES).collect();
        let crops = crops(chunk);
        let estimates = estimate(
            &encoder,
            kernels.as_ref(),
            Crops {
                images: &images,
                crops: &crops,
            },
        );
        let losses = estimates
            .poses
            .metric(&targets(chunk, &device), &task.config.losses, task.symmetry.of_label());
        sum += f64::from(losses.sum().into_scalar::<f32>());
    }
    Ok(Some(sum / samples.len() as f64))
}

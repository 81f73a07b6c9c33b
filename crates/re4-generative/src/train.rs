//! Training of a network on the windows of demonstrations.

use std::sync::{Mutex, PoisonError};

use burn::module::Module as _;
use burn::optim::{AdamWConfig, GradientsParams, ModuleOptimizer};
use burn::store::ModuleRecord;
use burn::tensor::{Bytes, Device, Tensor, TensorData};
use rand_pcg::Pcg64;
use re4_train::{Checkpoints, Fitted, Learner, Plan, Progress, Schedule, WarmUp, below, fit, normal, uniform};

use crate::config::{FlowConfig, Method};
use crate::diffusion::{LEVELS, NoiseSchedule};
use crate::flow;
use crate::layers::Slot;
use crate::network::{Network, Shape};
use crate::windows::Windows;
use crate::{GenerativeConfig, GenerativeError};

/// The setting that names the backend.
pub const BACKEND: &str = "policy.training.backend";

/// Number of checkpoints of a training, and of points of its curve, unless it is short.
const EPOCHS: u32 = 50;

/// Minimum number of steps between two checkpoints, which have four times the size of the weights.
const MINIMUM_STEPS: u32 = 100;

/// Highest decay of the moving average of the weights.
const MAXIMUM_DECAY: f64 = 0.9999;

/// Maximum number of windows for the held-out loss.
const MAXIMUM_HELD_OUT: usize = 1024;

/// The inputs of a training.
pub struct Task<'a> {
    /// Settings.
    pub config: &'a GenerativeConfig,
    /// What is learned.
    pub method: Method,
    /// Windows to train on.
    pub windows: &'a Windows,
    /// Windows of held-out demonstrations, if there are any.
    pub held_out: Option<&'a Windows>,
    /// Shape of the network.
    pub shape: Shape,
}

impl Method {
    /// Shape of the network for actions of this many numbers and observations of this many.
    pub fn shape(self, config: &GenerativeConfig, channels: usize, observation: usize) -> Shape {
        Shape {
            size: config.network,
            channels,
            length: match self {
                Self::Diffusion => config.horizon,
                Self::Flow(FlowConfig { stochastic, .. }) => 1 + usize::from(stochastic),
            },
            condition: config.history * observation,
        }
    }
}

/// Number of steps per epoch.
fn steps_per_epoch(config: &GenerativeConfig) -> u32 {
    config.steps.div_ceil(EPOCHS).max(MINIMUM_STEPS.min(config.steps))
}

/// Number of steps of a training, which is at least that of the settings.
pub fn steps_of(config: &GenerativeConfig) -> u32 {
    config.steps.div_ceil(steps_per_epoch(config)) * steps_per_epoch(config)
}

/// A trained network: the moving average of its weights.
pub struct Trained {
    /// The network.
    pub network: Network,
    /// The curve.
    pub fitted: Fitted,
}

/// Trains a network, from the last valid checkpoint if there is one. `on_step` is called after every step; its error stops the
/// training, and the checkpoints are kept.
///
/// # Errors
/// If a loss is not finite or a checkpoint cannot be written or read; or the error that `on_step` returns.
pub fn train<E: From<GenerativeError>>(
    task: &Task<'_>,
    checkpoints: &Checkpoints,
    mut on_step: impl FnMut(&Progress) -> Result<(), E>,
) -> Result<Trained, E> {
    let config = task.config;
    let device = config.backend.device(BACKEND).map_err(GenerativeError::from)?;
    let network = Network::sampled(task.shape, config.seed, &device.clone().autodiff());
    let mut learner = Generating {
        average: network.valid(),
        network,
        optimizer: AdamWConfig::new()
            .with_beta_1(config.beta as f32)
            .with_beta_2(0.999)
            .with_epsilon(1e-8)
            .with_weight_decay(config.weight_decay as f32)
            .init(),
        task,
        steps: 0,
        device,
    };
    let steps = steps_per_epoch(config);
    let plan = Plan {
        epochs: config.steps.div_ceil(steps),
        steps,
        schedule: Schedule::Cosine {
            highest: config.learning_rate,
            warm_up: WarmUp::Steps(config.warm_up),
        },
        setting: "policy.training.learning_rate",
    };
    let batches = Batches::new(task);
    let load = |epoch, step| Ok(batches.batch(u64::from(epoch) * u64::from(steps) + u64::from(step)));
    let fitted = fit(&mut learner, &plan, &load, checkpoints, |progress| {
        on_step(progress).map_err(Stopped::Caller)
    });
    let fitted = fitted.map_err(|stopped| match stopped {
        Stopped::Caller(error) => error,
        Stopped::Own(error) => error.into(),
    })?;
    Ok(Trained {
        network: learner.average,
        fitted,
    })
}

/// Why the training loop stopped.
enum Stopped<E> {
    Caller(E),
    Own(GenerativeError),
}

impl<E> From<GenerativeError> for Stopped<E> {
    fn from(error: GenerativeError) -> Self {
        Self::Own(error)
    }
}

impl<E> From<re4_train::TrainError> for Stopped<E> {
    fn from(error: re4_train::TrainError) -> Self {
        Self::Own(error.into())
    }
}

/// What a step is computed from.
pub struct Batch {
    /// Observation histories.
    histories: Vec<f32>,
    /// Inputs of the network.
    inputs: Vec<f32>,
    /// Times of the inputs.
    times: Vec<f32>,
    /// Outputs that the network should give.
    targets: Vec<f32>,
}

/// Samples batches. Every window occurs once per pass over the data, in an order that depends only on the seed and the pass.
struct Batches<'a> {
    task: &'a Task<'a>,
    schedule: NoiseSchedule,
    /// The last pass and its order. Batches are requested in order, so it is computed once per pass.
    order: Mutex<(u64, Vec<u32>)>,
}

impl<'a> Batches<'a> {
    fn new(task: &'a Task<'a>) -> Self {
        Self {
            task,
            schedule: NoiseSchedule::default(),
            order: Mutex::new((u64::MAX, Vec::new())),
        }
    }

    /// The window of an example.
    fn window(&self, example: u64) -> usize {
        let count = self.task.windows.count() as u64;
        let (pass, at) = (example / count, (example % count) as usize);
        let mut order = self.order.lock().unwrap_or_else(PoisonError::into_inner);
        if order.0 != pass {
            let mut all: Vec<u32> = (0..count as u32).collect();
            let mut rng = Pcg64::new(u128::from(self.task.config.seed), (1 << 64) | u128::from(pass));
            for last in (1..all.len()).rev() {
                all.swap(last, below(&mut rng, last + 1));
            }
            *order = (pass, all);
        }
        order.1[at] as usize
    }

    fn batch(&self, step: u64) -> Batch {
        let size = self.task.config.batch as u64;
        let mut rng = Pcg64::new(u128::from(self.task.config.seed), (2 << 64) | u128::from(step));
        let windows = (step * size..(step + 1) * size).map(|example| self.window(example));
        batch_of(self.task, &self.schedule, self.task.windows, windows, &mut rng)
    }
}

/// The examples of windows, with noise from the generator.
fn batch_of(
    task: &Task<'_>,
    schedule: &NoiseSchedule,
    from: &Windows,
    windows: impl Iterator<Item = usize>,
    rng: &mut Pcg64,
) -> Batch {
    let mut batch = Batch {
        histories: Vec::new(),
        inputs: Vec::new(),
        times: Vec::new(),
        targets: Vec::new(),
    };
    let mut chunk = Vec::new();
    for window in windows {
        from.push_history(window, &mut batch.histories);
        chunk.clear();
        from.push_chunk(window, &mut chunk);
        match task.method {
            Method::Diffusion => {
                let level = below(rng, LEVELS);
                batch.times.push(level as f32);
                for clean in &chunk {
                    let noise = normal(rng) as f32;
                    batch.inputs.push(schedule.noisy(*clean, noise, level));
                    batch.targets.push(noise);
                }
            }
            Method::Flow(config) => {
                let time = uniform(rng);
                batch.times.push(time as f32);
                let example = flow::example(&config, &chunk, task.shape.channels, time, || normal(rng));
                batch.inputs.extend(example.input);
                batch.targets.extend(example.target);
            }
        }
    }
    batch
}

/// A network in training.
struct Generating<'a> {
    task: &'a Task<'a>,
    network: Network,
    /// The moving average of the weights.
    average: Network,
    optimizer: ModuleOptimizer,
    steps: u64,
    device: Device,
}

/// The mean squared error of a network on a batch.
fn loss(network: &Network, batch: &Batch, shape: Shape, device: &Device) -> Tensor<1> {
    let count = batch.times.len();
    let chunks = [count, shape.length, shape.channels];
    let inputs = Tensor::from_data(TensorData::new(batch.inputs.clone(), chunks), device);
    let targets = Tensor::from_data(TensorData::new(batch.targets.clone(), chunks), device);
    let condition = TensorData::new(batch.histories.clone(), [count, shape.condition]);
    let outputs = network.forward(inputs, &batch.times, Tensor::from_data(condition, device));
    (outputs - targets).square().mean()
}

/// The decay of the moving average after a step, from 0.
fn decay(step: u64, power: f64) -> f64 {
    let steps = step.saturating_sub(1);
    if steps == 0 {
        return 0.0;
    }
    (1.0 - (1.0 + steps as f64).powf(-power)).min(MAXIMUM_DECAY)
}

impl Learner for Generating<'_> {
    type Batch = Batch;
    type Error = GenerativeError;

    fn advance(&mut self, batch: &Batch, learning_rate: f64) -> Result<Vec<f64>, GenerativeError> {
        let device = self.device.clone().autodiff();
        let loss = loss(&self.network, batch, self.task.shape, &device);
        let value = f64::from(loss.clone().into_scalar::<f32>());
        let gradients = GradientsParams::from_grads(loss.backward(), &self.network);
        if value.is_finite() {
            self.network = self.optimizer.step(learning_rate, self.network.clone(), gradients);
            let decay = decay(self.steps, self.task.config.average);
            self.steps += 1;
            average(&mut self.average, &self.network, decay);
        }
        Ok(vec![value])
    }

    fn held_out(&self) -> Result<Option<f64>, GenerativeError> {
        let Some(windows) = self.task.held_out else {
            return Ok(None);
        };
        // The same windows and noise after every epoch.
        let mut rng = Pcg64::new(u128::from(self.task.config.seed), 3 << 64);
        let stride = windows.count().div_ceil(MAXIMUM_HELD_OUT);
        let chosen = (0..windows.count()).step_by(stride);
        let batch = batch_of(self.task, &NoiseSchedule::default(), windows, chosen, &mut rng);
        let loss = loss(&self.average, &batch, self.task.shape, &self.device);
        Ok(Some(f64::from(loss.into_scalar::<f32>())))
    }

    fn save(&self) -> Result<Vec<Vec<u8>>, String> {
        let text = |error: &dyn std::fmt::Display| error.to_string();
        let bytes = |network: Network| network.into_record().into_bytes().map_err(|error| text(&error));
        let optimizer = self.optimizer.into_bytes().map_err(|error| text(&error))?;
        Ok(vec![
            self.steps.to_le_bytes().to_vec(),
            bytes(self.network.valid())?.to_vec(),
            bytes(self.average.clone())?.to_vec(),
            optimizer.to_vec(),
        ])
    }

    fn restore(&mut self, parts: Vec<Vec<u8>>) -> Result<(), String> {
        let [steps, network, average, optimizer]: [Vec<u8>; 4] =
            parts.try_into().map_err(|_| "it has other parts".to_owned())?;
        let steps: [u8; 8] = steps.try_into().map_err(|_| "it has no number of steps".to_owned())?;
        self.steps = u64::from_le_bytes(steps);
        let load = |into: &Network, bytes: Vec<u8>| -> Result<Network, String> {
            let record = ModuleRecord::from_bytes(Bytes::from_bytes_vec(bytes)).map_err(|error| error.to_string())?;
            into.clone().try_load_record(record).map_err(|error| error.to_string())
        };
        self.network = load(&self.network, network)?;
        self.average = load(&self.average, average)?;
        let restored = self.optimizer.clone().from_bytes(Bytes::from_bytes_vec(optimizer));
        self.optimizer = restored.map_err(|error| error.to_string())?;
        Ok(())
    }
}

/// Moves the average towards the weights of a network.
fn average(average: &mut Network, network: &Network, decay: f64) {
    let mut network = network.valid();
    for (own, new) in average.all().into_iter().zip(network.all()) {
        match (own.slot, new.slot) {
            (Slot::Matrix { param: own, .. }, Slot::Matrix { param: new, .. }) => {
                let mixed = own.val() * decay + new.val() * (1.0 - decay);
                *own = own.clone().map(|_| mixed);
            }
            (Slot::Vector(own), Slot::Vector(new)) => {
                let mixed = own.val() * decay + new.val() * (1.0 - decay);
                *own = own.clone().map(|_| mixed);
            }
            // Both networks have the same shape, so their parameters are of the same kinds.
            _ => {}
        }
    }
}

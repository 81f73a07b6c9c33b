//! Generation of chunks with a trained network.

use burn::tensor::{Device, Tensor, TensorData};
use rand_pcg::Pcg64;
use re4_train::normal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::GenerativeError;
use crate::diffusion::{LEVELS, NoiseSchedule};
use crate::network::{Network, Shape};

/// How chunks are generated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Sampler {
    /// Diffusion: 100 random steps.
    Ddpm,
    /// Diffusion: deterministic steps from a random start.
    Ddim {
        /// Number of steps, a divisor of 100.
        steps: usize,
    },
    /// Flow: Euler steps from the last action.
    Flow {
        /// Steps per action.
        steps: usize,
        /// Number of actions to generate.
        actions: usize,
        /// Number of actions of the chunks in the training.
        horizon: usize,
    },
}

/// What a chunk is generated from.
#[derive(Debug, Clone)]
pub struct Request {
    /// The normalised observation history, the oldest observation first.
    pub history: Vec<f32>,
    /// The normalised last action, from which a flow starts.
    pub last: Vec<f32>,
    /// The random generator of this chunk. Chunks do not share one, so that a chunk does not depend on others of its batch.
    pub rng: Pcg64,
}

/// A trained network with its device.
#[derive(Debug)]
pub struct Generator {
    network: Network,
    shape: Shape,
    device: Device,
    schedule: NoiseSchedule,
}

impl Generator {
    /// A generator with a trained network.
    pub fn new(network: Network, shape: Shape, device: Device) -> Self {
        Self {
            network,
            shape,
            device,
            schedule: NoiseSchedule::default(),
        }
    }

    /// Generates a chunk for every request, in the order of the requests: normalised actions, of which the first is the one
    /// before the present frame for diffusion, and the one at the present frame for a flow.
    ///
    /// A chunk does not depend on the other requests.
    ///
    /// # Errors
    /// If the values cannot be read from the device.
    pub fn generate(&self, requests: &[Request], sampler: Sampler) -> Result<Vec<Vec<f32>>, GenerativeError> {
        let mut generators: Vec<Pcg64> = requests.iter().map(|request| request.rng.clone()).collect();
        self.generate_with(requests, sampler, |into, count| {
            for rng in &mut generators {
                into.extend((0..count).map(|_| normal(rng) as f32));
            }
        })
    }

    /// The same with other noise: `noise` appends this many numbers for every request.
    ///
    /// # Errors
    /// As for [`Generator::generate`].
    pub fn generate_with(
        &self,
        requests: &[Request],
        sampler: Sampler,
        mut noise: impl FnMut(&mut Vec<f32>, usize),
    ) -> Result<Vec<Vec<f32>>, GenerativeError> {
        let count = requests.len();
        let histories = requests.iter().flat_map(|request| request.history.iter().copied());
        let data = TensorData::new(histories.collect::<Vec<f32>>(), [count, self.shape.condition]);
        let condition: Tensor<2> = Tensor::from_data(data, &self.device);
        let numbers = self.shape.length * self.shape.channels;
        let mut sample = |into: &mut Vec<f32>, count: usize| {
            into.clear();
            noise(into, count);
        };
        let mut values = Vec::new();
        match sampler {
            Sampler::Ddpm => {
                sample(&mut values, numbers);
                let mut fresh = Vec::new();
                for level in (0..LEVELS).rev() {
                    let noise = self.apply(&values, level as f32, &condition)?;
                    if level > 0 {
                        sample(&mut fresh, numbers);
                    }
                    for ((value, noise), fresh) in values.iter_mut().zip(noise).zip(&fresh) {
                        *value = self.schedule.ddpm(*value, noise, level, *fresh);
                    }
                }
            }
            Sampler::Ddim { steps } => {
                sample(&mut values, numbers);
                for level in NoiseSchedule::ddim_levels(steps) {
                    let noise = self.apply(&values, level as f32, &condition)?;
                    let to = level.checked_sub(LEVELS / steps);
                    for (value, noise) in values.iter_mut().zip(noise) {
                        *value = self.schedule.ddim(*value, noise, level, to);
                    }
                }
            }
            Sampler::Flow {
                steps,
                actions,
                horizon,
            } => return self.integrate(requests, &condition, sample, (steps, actions, horizon)),
        }
        Ok(values.chunks_exact(numbers).map(<[f32]>::to_vec).collect())
    }

    /// Integrates the flow from the last actions.
    fn integrate(
        &self,
        requests: &[Request],
        condition: &Tensor<2>,
        mut sample: impl FnMut(&mut Vec<f32>, usize),
        (steps, actions, horizon): (usize, usize, usize),
    ) -> Result<Vec<Vec<f32>>, GenerativeError> {
        let channels = self.shape.channels;
        let numbers = self.shape.length * channels;
        let mut latent = Vec::new();
        sample(&mut latent, numbers - channels);
        let mut values = Vec::with_capacity(requests.len() * numbers);
        for (at, request) in requests.iter().enumerate() {
            values.extend(&request.last);
            values.extend(&latent[at * (numbers - channels)..(at + 1) * (numbers - channels)]);
        }
        let mut chunks = vec![Vec::with_capacity(actions * channels); requests.len()];
        let step = 1.0 / ((horizon - 1) * steps) as f32;
        for action in 0..actions {
            for part in 0..steps {
                let time = (action * steps + part) as f32 * step;
                let velocity = self.apply(&values, time, condition)?;
                for (value, velocity) in values.iter_mut().zip(velocity) {
                    *value += step * velocity;
                }
            }
            for (chunk, values) in chunks.iter_mut().zip(values.chunks_exact(numbers)) {
                chunk.extend(&values[..channels]);
            }
        }
        Ok(chunks)
    }

    /// Applies the network to all chunks, at the same time.
    fn apply(&self, values: &[f32], time: f32, condition: &Tensor<2>) -> Result<Vec<f32>, GenerativeError> {
        let [count, _] = condition.dims();
        let data = TensorData::new(values.to_vec(), [count, self.shape.length, self.shape.channels]);
        let output = self.network.forward(
            Tensor::from_data(data, &self.device),
            &vec![time; count],
            condition.clone(),
        );
        let data = output.into_data();
        data.try_into_vec::<f32>()
            .map_err(|error| GenerativeError::Device(format!("{error:?}")))
    }
}

//! Settings of generative policies and their training.

use re4_train::Backend;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the network learns.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase", tag = "kind", deny_unknown_fields)]
pub enum Method {
    /// The noise in a noisy chunk (Diffusion Policy).
    Diffusion,
    /// The velocity of the action along a chunk (Streaming Flow Policy).
    Flow(FlowConfig),
}

/// Settings of the flow's training targets. Actions are normalised to [-1, 1], and the time of a chunk to [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FlowConfig {
    /// Standard deviation of the tube around the demonstrated actions at the beginning of a chunk.
    pub deviation: f64,
    /// Rate `k` at which the flow returns to the demonstrated actions: the target velocity has the additional term
    /// `-k (a - xi(t))`, and the tube narrows with `exp(-k t)`. 0 turns this stabilisation off.
    pub stabilization: f64,
    /// Whether the flow has a latent variable, with which it can represent several modes.
    pub stochastic: bool,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self {
            deviation: 0.1,
            stabilization: 10.0,
            stochastic: false,
        }
    }
}

/// The network, by its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum NetworkSize {
    /// Diffusion Policy's conditional 1-D U-Net with 256, 512 and 1024 channels: about 65 million parameters.
    Paper,
    /// The same U-Net with 64, 128 and 256 channels: about 5 million parameters.
    Small,
    /// A residual MLP over the whole chunk: about 3 million parameters, and the fastest on a CPU.
    Mlp,
}

/// A generative policy and its training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GenerativeConfig {
    /// The network.
    pub network: NetworkSize,
    /// Number of observations that the network receives: the current one and those before it.
    pub history: usize,
    /// Number of actions in a chunk. A multiple of 4.
    pub horizon: usize,
    /// Number of steps of the optimiser.
    pub steps: u32,
    /// Chunks per step.
    pub batch: usize,
    /// Highest learning rate of AdamW. It warms up linearly and decays to zero along half a cosine period.
    pub learning_rate: f64,
    /// Number of steps of the warm-up.
    pub warm_up: u32,
    /// Weight decay of AdamW.
    pub weight_decay: f64,
    /// Decay of the first moment of AdamW.
    pub beta: f64,
    /// Power of the schedule of the moving average of the weights: after step `s`, the decay is `1 - (1 + s)^-power`, at most
    /// 0.9999. The policy uses the average after the last step.
    pub average: f64,
    /// Fraction of the demonstrations that are not trained on. Their loss is reported; it selects nothing.
    pub held_out: f64,
    /// The backend. Backends other than `flex` require a program built with them.
    pub backend: Backend,
    /// Seed of initial weights, batches and noise.
    pub seed: u64,
}

impl GenerativeConfig {
    /// Settings of Diffusion Policy (its paper and code), except for the number of steps and the size of the network, which are
    /// those of a training of minutes on a CPU.
    pub fn diffusion() -> Self {
        Self {
            network: NetworkSize::Mlp,
            history: 2,
            horizon: 16,
            steps: 60_000,
            batch: 256,
            // Ten times that of Diffusion Policy, whose network is larger: the loss after 2,500 steps is 0.037 instead of 0.045 with 3e-4.
            learning_rate: 1e-3,
            warm_up: 500,
            weight_decay: 1e-6,
            beta: 0.95,
            average: 0.75,
            held_out: 0.0,
            backend: Backend::Flex,
            seed: 0,
        }
    }

    /// Settings of Streaming Flow Policy, with the same exceptions.
    pub fn flow() -> Self {
        Self {
            beta: 0.9,
            steps: 30_000,
            ..Self::diffusion()
        }
    }
}

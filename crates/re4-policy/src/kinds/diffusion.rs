//! Diffusion Policy (Chi et al. 2023): chunks of actions are generated from noise, conditioned on the last observations.

use std::sync::Arc;

use re4_artifact::Stage;
use re4_generative::diffusion::LEVELS;
use re4_generative::{GenerativeConfig, Method, Sampler};
use re4_rollout::{Opened, Plane, Space};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::generative::{self, Execution, PlaneCodec, SpaceCodec, Training};
use super::{Inputs, OpenError, SettingError, Settings};

/// The sampler that generates chunks. Both use the same weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum DiffusionSampler {
    /// 100 random steps (Ho et al. 2020).
    Ddpm,
    /// A few deterministic steps (Song et al. 2020).
    Ddim,
}

/// Settings of Diffusion Policy for Push-T.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaneDiffusion {
    /// The sampler: `ddpm` or `ddim`.
    pub sampler: DiffusionSampler,
    /// Number of steps of `ddim`, a divisor of 100.
    #[schemars(extend("only_with" = { "policy.sampler": "ddim" }))]
    pub sampler_steps: u32,
    /// Number of actions of a chunk that are executed before the next one is generated.
    pub actions: u32,
    /// The observation: `keypoints` or `pose`.
    pub observation: PlaneCodec,
    /// The network and its training.
    pub training: GenerativeConfig,
}

impl Default for PlaneDiffusion {
    fn default() -> Self {
        Self {
            sampler: DiffusionSampler::Ddim,
            sampler_steps: 10,
            actions: 8,
            observation: PlaneCodec::Keypoints,
            training: GenerativeConfig::diffusion(),
        }
    }
}

/// Settings of Diffusion Policy for the robosuite tasks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpaceDiffusion {
    /// The sampler: `ddpm` or `ddim`.
    pub sampler: DiffusionSampler,
    /// Number of steps of `ddim`, a divisor of 100.
    #[schemars(extend("only_with" = { "policy.sampler": "ddim" }))]
    pub sampler_steps: u32,
    /// Number of actions of a chunk that are executed before the next one is generated.
    pub actions: u32,
    /// The network and its training.
    pub training: GenerativeConfig,
}

impl Default for SpaceDiffusion {
    fn default() -> Self {
        Self {
            sampler: DiffusionSampler::Ddim,
            sampler_steps: 10,
            actions: 8,
            training: GenerativeConfig::diffusion(),
        }
    }
}

fn check(sampler_steps: u32, actions: u32, training: &GenerativeConfig) -> Result<(), SettingError> {
    SettingError::unless(
        sampler_steps >= 1 && (LEVELS as u32).is_multiple_of(sampler_steps),
        "sampler_steps",
        sampler_steps,
        "give a divisor of 100",
    )?;
    generative::check(training, actions)
}

fn execution(sampler: DiffusionSampler, sampler_steps: u32, actions: u32) -> Execution {
    Execution {
        sampler: match sampler {
            DiffusionSampler::Ddpm => Sampler::Ddpm,
            DiffusionSampler::Ddim => Sampler::Ddim {
                steps: sampler_steps as usize,
            },
        },
        actions: actions as usize,
    }
}

impl Settings<Plane> for PlaneDiffusion {
    fn inputs(&self) -> &'static [Stage] {
        &[Stage::Index, Stage::Train]
    }

    fn training(&self) -> Option<Training<'_, Plane>> {
        Some(Training {
            config: &self.training,
            method: Method::Diffusion,
            codec: Arc::new(self.observation),
        })
    }

    fn check(&self, _: bool) -> Result<(), SettingError> {
        check(self.sampler_steps, self.actions, &self.training)
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Plane>>, OpenError> {
        let training = Settings::<Plane>::training(self).ok_or(OpenError::Missing { stage: "train" })?;
        generative::open(
            &training,
            execution(self.sampler, self.sampler_steps, self.actions),
            inputs,
        )
    }
}

impl Settings<Space> for SpaceDiffusion {
    fn inputs(&self) -> &'static [Stage] {
        &[Stage::Index, Stage::Train]
    }

    fn training(&self) -> Option<Training<'_, Space>> {
        Some(Training {
            config: &self.training,
            method: Method::Diffusion,
            codec: Arc::new(SpaceCodec),
        })
    }

    fn check(&self, _: bool) -> Result<(), SettingError> {
        check(self.sampler_steps, self.actions, &self.training)
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        let training = Settings::<Space>::training(self).ok_or(OpenError::Missing { stage: "train" })?;
        generative::open(
            &training,
            execution(self.sampler, self.sampler_steps, self.actions),
            inputs,
        )
    }
}

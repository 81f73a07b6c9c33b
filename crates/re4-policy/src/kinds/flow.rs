//! Streaming Flow Policy: actions are integrated along a learned velocity field that starts at the last action.

use std::sync::Arc;

use re4_artifact::Stage;
use re4_generative::config::FlowConfig;
use re4_generative::{GenerativeConfig, Method, Sampler};
use re4_rollout::{Opened, Plane, Space};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::generative::{self, Execution, PlaneCodec, SpaceCodec, Training};
use super::{Inputs, OpenError, SettingError, Settings};

/// Settings of Streaming Flow Policy for Push-T.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaneFlow {
    /// Number of Euler steps per action.
    pub steps: u32,
    /// Number of actions that are generated and executed before the next observation is used.
    pub actions: u32,
    /// The observation: `keypoints` or `pose`.
    pub observation: PlaneCodec,
    /// What the network learns.
    pub flow: FlowConfig,
    /// The network and its training.
    pub training: GenerativeConfig,
}

impl Default for PlaneFlow {
    fn default() -> Self {
        Self {
            steps: 1,
            actions: 8,
            observation: PlaneCodec::Keypoints,
            flow: FlowConfig::default(),
            training: GenerativeConfig::flow(),
        }
    }
}

/// Settings of Streaming Flow Policy for the robosuite tasks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpaceFlow {
    /// Number of Euler steps per action.
    pub steps: u32,
    /// Number of actions that are generated and executed before the next observation is used.
    pub actions: u32,
    /// What the network learns.
    pub flow: FlowConfig,
    /// The network and its training.
    pub training: GenerativeConfig,
}

impl Default for SpaceFlow {
    fn default() -> Self {
        Self {
            steps: 1,
            actions: 8,
            flow: FlowConfig::default(),
            training: GenerativeConfig::flow(),
        }
    }
}

fn check(steps: u32, actions: u32, flow: &FlowConfig, training: &GenerativeConfig) -> Result<(), SettingError> {
    SettingError::unless(
        (1..=1000).contains(&steps),
        "steps",
        steps,
        "give a number from 1 to 1000",
    )?;
    for (setting, value) in [
        ("flow.deviation", flow.deviation),
        ("flow.stabilization", flow.stabilization),
    ] {
        let valid = value.is_finite() && value >= 0.0;
        SettingError::unless(valid, setting, value, "give a finite number that is not negative")?;
    }
    generative::check(training, actions)
}

fn execution(steps: u32, actions: u32, horizon: usize) -> Execution {
    let actions = actions as usize;
    Execution {
        sampler: Sampler::Flow {
            steps: steps as usize,
            actions,
            horizon,
        },
        actions,
    }
}

impl Settings<Plane> for PlaneFlow {
    fn inputs(&self) -> &'static [Stage] {
        &[Stage::Index, Stage::Train]
    }

    fn training(&self) -> Option<Training<'_, Plane>> {
        Some(Training {
            config: &self.training,
            method: Method::Flow(self.flow),
            codec: Arc::new(self.observation),
        })
    }

    fn check(&self, _: bool) -> Result<(), SettingError> {
        check(self.steps, self.actions, &self.flow, &self.training)
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Plane>>, OpenError> {
        let training = Settings::<Plane>::training(self).ok_or(OpenError::Missing { stage: "train" })?;
        generative::open(
            &training,
            execution(self.steps, self.actions, self.training.horizon),
            inputs,
        )
    }
}

impl Settings<Space> for SpaceFlow {
    fn inputs(&self) -> &'static [Stage] {
        &[Stage::Index, Stage::Train]
    }

    fn training(&self) -> Option<Training<'_, Space>> {
        Some(Training {
            config: &self.training,
            method: Method::Flow(self.flow),
            codec: Arc::new(SpaceCodec),
        })
    }

    fn check(&self, _: bool) -> Result<(), SettingError> {
        check(self.steps, self.actions, &self.flow, &self.training)
    }

    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<Space>>, OpenError> {
        let training = Settings::<Space>::training(self).ok_or(OpenError::Missing { stage: "train" })?;
        generative::open(
            &training,
            execution(self.steps, self.actions, self.training.horizon),
            inputs,
        )
    }
}

//! Tables `[rollout]` of the pipeline file.

use re4_geometry::spatial::Symmetry;
use re4_policy::spatial::{
    PoseFilterConfig, SPATIAL_PRESETS, SpatialPolicyConfig, SpatialRecoveryConfig, SpatialReframeConfig,
    SpatialReplanConfig, SpatialReplayConfig, SpatialRetrieveConfig,
};
use re4_policy::{PRESETS, PolicyConfig, ReframeConfig, ReplanConfig, ReplayConfig, RetrieveConfig};
use re4_sim::robosuite::{Fidelity, RobosuiteTask};
use re4_sim::{ResetOrder, SeedScheme};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Variant;
use super::seeds::Seeds;

/// `index` to `rollouts`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RolloutSection {
    /// Preset that the policy starts from: `paper`, `re4` or `re2`. The tables below change single settings of it.
    #[schemars(extend("enum" = PRESETS))]
    pub policy: String,
    /// Seeds of the scenes: a half-open range `"500..600"`, several of them joined by commas, or a list of numbers. Left out
    /// where the pipeline has a table `[scenes]`, and nowhere else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seeds: Option<Seeds>,
    /// Whose seeds: which generator makes the scene of a seed.
    #[serde(default = "diffusion_policy")]
    pub seed_scheme: SeedScheme,
    /// In which order a reset to the scene of a seed sets the block's position and angle. The block of a scene from
    /// `[scenes]` always arrives at the pose that the scene says.
    #[serde(default)]
    pub reset: ResetOrder,
    /// Control steps an episode lasts at most.
    #[serde(default = "paper_steps")]
    pub max_steps: u32,
    /// Retrieve.
    pub retrieve: RetrieveConfig,
    /// Reframe.
    pub reframe: ReframeConfig,
    /// Replan.
    pub replan: ReplanConfig,
    /// Replay.
    pub replay: ReplayConfig,
}

impl RolloutSection {
    /// The policy with all its settings.
    pub fn policy_config(&self) -> PolicyConfig {
        PolicyConfig {
            retrieve: self.retrieve.clone(),
            reframe: self.reframe,
            replan: self.replan.clone(),
            replay: self.replay.clone(),
        }
    }
}

/// `index` to `rollouts` of robosuite's tasks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialRolloutSection {
    /// Preset that the policy starts from: `paper`, `re4` or `re2`. The tables below change single settings of it.
    #[schemars(extend("enum" = SPATIAL_PRESETS))]
    pub policy: String,
    /// Seeds of the scenes: a half-open range `"500..600"`, several of them joined by commas, or a list of numbers. The scene of
    /// a seed is the one that robosuite draws for it.
    pub seeds: Seeds,
    /// Control steps an episode lasts at most.
    #[serde(default = "robomimic_steps")]
    pub max_steps: u32,
    /// Turns after which the object looks the same, in its own frame. By default, with `re4` that of the task's object: four
    /// quarters of a turn for the cube, any turn for the can, none for the nut; with the other presets none. With
    /// `variant = "image"` none either: the frame that the encoder estimates is that of the gripper as it would hold the object,
    /// whose axes are not the object's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<Symmetry>,
    /// Errors that the object poses which the policy is told are given on purpose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<NoiseSection>,
    /// How closely robosuite is followed: `robosuite`, to the bit, or `fast`.
    #[serde(default)]
    pub fidelity: Fidelity,
    /// Retrieve.
    pub retrieve: SpatialRetrieveConfig,
    /// Reframe.
    pub reframe: SpatialReframeConfig,
    /// Replan: the bridge to the start of a chunk.
    pub replan: SpatialReplanConfig,
    /// Replay.
    pub replay: SpatialReplayConfig,
    /// What is done about failure.
    pub recovery: SpatialRecoveryConfig,
    /// How observed object poses are averaged; every one is taken as it is where the preset has no such table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter: Option<PoseFilterConfig>,
}

/// Errors of the object poses that a policy is told: normal, independent at every control step, drawn by the scene's seed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseSection {
    /// Standard deviation along each axis of the world, in metres, 1 at most.
    #[serde(default)]
    pub translation: f64,
    /// Standard deviation of each component of a rotation vector, in rad, 3.14 at most.
    #[serde(default)]
    pub rotation: f64,
}

impl SpatialRolloutSection {
    /// The policy with all its settings.
    pub fn policy_config(&self) -> SpatialPolicyConfig {
        SpatialPolicyConfig {
            retrieve: self.retrieve.clone(),
            reframe: self.reframe.clone(),
            replan: self.replan.clone(),
            replay: self.replay.clone(),
            recovery: self.recovery.clone(),
            filter: self.filter.clone(),
        }
    }

    /// Symmetry of the task's object that the policy uses.
    pub fn symmetry(&self, task: RobosuiteTask, variant: Option<Variant>) -> Symmetry {
        let usual = if self.policy == "re4" && variant != Some(Variant::Image) {
            task.symmetry
        } else {
            Symmetry::None
        };
        self.symmetry.unwrap_or(usual)
    }
}

fn diffusion_policy() -> SeedScheme {
    SeedScheme::DiffusionPolicy
}

fn paper_steps() -> u32 {
    200
}

fn robomimic_steps() -> u32 {
    400
}

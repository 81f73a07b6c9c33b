//! Tables `[policy]` and `[rollout]` of the pipeline file.

use re4_artifact::Stage;
use re4_geometry::spatial::Symmetry;
use re4_policy::kinds::{Kinds as _, PlanePolicy, SettingError, SpacePolicy};
use re4_sim::robosuite::{Fidelity, RobosuiteTask};
use re4_sim::{ResetOrder, SeedScheme};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Variant;
use super::seeds::Seeds;

/// The policy that is rolled out, with its settings.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Policy {
    /// Of Push-T.
    Plane(PlanePolicy),
    /// Of a robosuite task.
    Space(SpacePolicy),
}

impl Policy {
    /// The name of its kind.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Plane(policy) => policy.kind(),
            Self::Space(policy) => policy.kind(),
        }
    }

    /// Stages whose artifacts it opens.
    pub(crate) fn inputs(&self) -> &'static [Stage] {
        match self {
            Self::Plane(policy) => policy.settings().inputs(),
            Self::Space(policy) => policy.settings().inputs(),
        }
    }

    /// Refuses settings that make no sense.
    pub(super) fn check(&self, images: bool) -> Result<(), SettingError> {
        match self {
            Self::Plane(policy) => policy.settings().check(images),
            Self::Space(policy) => policy.settings().check(images),
        }
    }
}

/// `index` to `rollouts`: where they start, how long they last, and what is observed in them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RolloutSection {
    /// Seeds of the scenes: a half-open range `"500..600"`, several of them joined by commas, or a list of numbers. Left out
    /// where the pipeline has a table `[scenes]`, and nowhere else. The scene of a seed of a robosuite task is the one that
    /// robosuite draws for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seeds: Option<Seeds>,
    /// Control steps an episode lasts at most: 200 by default, with robosuite's tasks 400.
    #[serde(default = "paper_steps")]
    pub max_steps: u32,
    /// Push-T: whose seeds, that is which generator makes the scene of a seed.
    #[serde(default = "diffusion_policy")]
    #[schemars(extend("domain" = "plane"))]
    #[schemars(extend("only_with" = { "scenes": null }))]
    pub seed_scheme: SeedScheme,
    /// Push-T: in which order a reset to the scene of a seed sets the block's position and angle. The block of a scene from
    /// `[scenes]` always arrives at the pose that the scene says.
    #[serde(default)]
    #[schemars(extend("domain" = "plane"))]
    #[schemars(extend("only_with" = { "scenes": null }))]
    pub reset: ResetOrder,
    /// robosuite tasks: turns after which the object looks the same, in its own frame. By default, with `re4` that of the task's
    /// object: four quarters of a turn for the cube, any turn for the can, none for the nut; with other policies none. With
    /// `variant = "image"` none either: the frame that the encoder estimates is that of the gripper as it would hold the object,
    /// whose axes are not the object's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("domain" = "space"))]
    pub symmetry: Option<Symmetry>,
    /// robosuite tasks: errors that the object poses which the policy is told are given on purpose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("domain" = "space"))]
    pub noise: Option<NoiseSection>,
    /// robosuite tasks: how closely robosuite is followed: `robosuite`, to the bit, or `fast`.
    #[serde(default)]
    #[schemars(extend("domain" = "space"))]
    pub fidelity: Fidelity,
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

impl RolloutSection {
    /// Symmetry of a robosuite task's object that a policy uses.
    pub(crate) fn symmetry(&self, task: RobosuiteTask, variant: Option<Variant>, policy: &SpacePolicy) -> Symmetry {
        let usual = if matches!(policy, SpacePolicy::Re4(_)) && variant != Some(Variant::Image) {
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

/// Control steps that an episode of robosuite's tasks lasts at most: the horizon of robomimic's benchmark.
pub(super) const ROBOMIMIC_STEPS: u32 = 400;

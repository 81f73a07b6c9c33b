//! The tables `[policy]` and `[rollout]` of the pipeline file.

use re4_artifact::Stage;
use re4_geometry::spatial::Symmetry;
use re4_policy::kinds::{Kinds as _, PlanePolicy, SettingError, SpacePolicy};
use re4_rollout::{Conditions, Disturbance};
use re4_sim::robosuite::{Fidelity, RobosuiteTask};
use re4_sim::{ResetOrder, SeedScheme};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Variant;
use super::goal::Goal;
use super::seeds::Seeds;

/// The policy that is rolled out, with its settings.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Policy {
    /// A policy for Push-T.
    Plane(PlanePolicy),
    /// A policy for a robosuite task.
    Space(SpacePolicy),
}

impl Policy {
    /// The name of the policy's kind, as in `policy.kind`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Plane(policy) => policy.kind(),
            Self::Space(policy) => policy.kind(),
        }
    }

    /// Stages whose artifacts the policy opens.
    pub(crate) fn inputs(&self) -> &'static [Stage] {
        match self {
            Self::Plane(policy) => policy.settings().inputs(),
            Self::Space(policy) => policy.settings().inputs(),
        }
    }

    /// Checks the settings for values that are out of range or contradict each other. `images`: whether the policy observes
    /// images.
    pub(super) fn check(&self, images: bool) -> Result<(), SettingError> {
        match self {
            Self::Plane(policy) => policy.settings().check(images),
            Self::Space(policy) => policy.settings().check(images),
        }
    }
}

/// How the policy is rolled out: where rollouts start, how long they last, and what is observed in them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RolloutSection {
    /// Seeds of the scenes: a half-open range `"500..600"`, several ranges joined by commas, or a list of numbers. Required
    /// unless the pipeline has a table `[scenes]`; the two exclude each other. For robosuite tasks, the scene of a seed is the
    /// one that robosuite samples with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seeds: Option<Seeds>,
    /// Maximum length of an episode in control steps. Default: 200 for Push-T, 400 for robosuite tasks.
    #[serde(default = "paper_steps")]
    pub max_steps: u32,
    /// Push-T: the random number generator that samples the scene of a seed.
    #[serde(default = "diffusion_policy")]
    #[schemars(extend("domain" = "plane"))]
    #[schemars(extend("only_with" = { "scenes": null }))]
    pub seed_scheme: SeedScheme,
    /// Push-T: the order in which a reset to the scene of a seed sets the block's position and angle. Has no effect on scenes
    /// from `[scenes]`, whose block always gets exactly the pose of the scene.
    #[serde(default)]
    #[schemars(extend("domain" = "plane"))]
    #[schemars(extend("only_with" = { "scenes": null }))]
    pub reset: ResetOrder,
    /// robosuite tasks: rotations that leave the object's appearance unchanged, in the object's frame. Default with `re4`: the
    /// symmetry of the task's object, which is multiples of 90 degrees about the vertical axis for the cube, any rotation about
    /// its axis for the can, and none for the nut. Default with other policies: none. Default with `variant = "image"`: none,
    /// because the encoder estimates the pose at which a gripper would hold the object, and the axes of the object's symmetry
    /// are not known in this frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("domain" = "space"))]
    pub symmetry: Option<Symmetry>,
    /// Random errors that are added to the object poses that the policy observes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<NoiseSection>,
    /// Push-T: the goal pose of the block. `"random"`: by the seed, at any angle and anywhere at a distance of at least 30 px from
    /// the walls, but not where the block covers more than half of it at the start. `[x, y, theta]`: at this pose, in px and rad.
    /// Default: the task's goal, `[256, 256, 0.785]`. Coverage, `IoU`, success and images are those of the episode's goal. Policies
    /// observe and act in a frame that moves with the goal, in which the goal is where it is in the demonstrations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("domain" = "plane"))]
    pub goal: Option<Goal>,
    /// A sudden change of the scene in every episode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub disturbance: Option<Disturbance>,
    /// Age of the observations that the policy acts on, in control steps: 0 to 10. In the first steps of an episode, the policy
    /// acts on the observation after the reset.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub latency: u32,
    /// robosuite tasks: how closely the simulation follows robosuite: `robosuite` (bit-exact) or `fast`.
    #[serde(default)]
    #[schemars(extend("domain" = "space"))]
    pub fidelity: Fidelity,
}

/// Random errors of the object poses that a policy observes: normally distributed, independent at every control step, seeded by
/// the scene's seed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseSection {
    /// Standard deviation along each axis of the world frame: in px for Push-T, at most 100; in metres for robosuite tasks, at
    /// most 1.
    #[serde(default)]
    pub translation: f64,
    /// Standard deviation of the angle (Push-T) or of each component of the rotation vector (robosuite tasks), in rad, at most
    /// 3.14.
    #[serde(default)]
    pub rotation: f64,
}

impl NoiseSection {
    /// Whether there are errors.
    pub(crate) fn is_noisy(&self) -> bool {
        self.translation != 0.0 || self.rotation != 0.0
    }
}

impl RolloutSection {
    /// Whether rollouts have the table `worlds`.
    pub(crate) fn has_worlds(&self) -> bool {
        self.goal.is_some() || self.disturbance.is_some()
    }

    /// The conditions of all episodes.
    pub(crate) fn conditions(&self) -> Conditions {
        Conditions {
            latency: self.latency,
            disturbance: self.disturbance,
        }
    }

    /// The object symmetry that the policy uses: the setting, or the default of the task, variant and policy.
    pub(crate) fn symmetry(&self, task: RobosuiteTask, variant: Option<Variant>, policy: &SpacePolicy) -> Symmetry {
        let usual = if matches!(policy, SpacePolicy::Re4(_)) && variant != Some(Variant::Image) {
            task.symmetry
        } else {
            Symmetry::None
        };
        self.symmetry.unwrap_or(usual)
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(number: &u32) -> bool {
    *number == 0
}

fn diffusion_policy() -> SeedScheme {
    SeedScheme::DiffusionPolicy
}

fn paper_steps() -> u32 {
    200
}

/// Default `max_steps` of robosuite tasks: the horizon of robomimic's benchmark.
pub(super) const ROBOMIMIC_STEPS: u32 = 400;

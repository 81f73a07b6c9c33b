//! The interface of the simulators that rollouts use.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::SimError;

/// A simulator of one task: it is reset to a scene and then stepped with actions.
///
/// The same calls in the same order give bit-identical results, on any thread and next to any number of other simulators.
pub trait Simulator: Send {
    /// The initial state that a reset requests.
    type Scene;
    /// Options of a reset.
    type Reset;
    /// The part of the state that a policy observes.
    type Observation;
    /// The command of a policy for one control step.
    type Action;
    /// The result of one control step.
    type Step;

    /// Starts an episode from `scene`.
    ///
    /// # Errors
    /// If the scene is invalid; the simulator then keeps its state.
    fn reset(&mut self, scene: &Self::Scene, how: Self::Reset) -> Result<Self::Observation, SimError>;

    /// Runs one control step.
    ///
    /// # Errors
    /// If the action is invalid, in which case the simulator keeps its state; or if the physics diverges, after which
    /// the simulator must be reset.
    fn step(&mut self, action: &Self::Action) -> Result<Self::Step, SimError>;
}

/// The result of one control step of Push-T.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Step<O> {
    /// The state after the step.
    pub observation: O,
    /// Area of the goal that the block covers, as a fraction of the goal's area, in `[0, 1]`.
    pub coverage: f64,
    /// Intersection over union of the block and the goal, in `[0, 1]`.
    pub iou: f64,
    /// `clip(coverage / 0.95, 0, 1)`, the reward of gym-pusht and `diffusion_policy`.
    pub score: f64,
    /// Whether the coverage is strictly above 0.95.
    pub success: bool,
    /// Contact points of all physics steps, divided by the number of physics steps in a control step, rounded up. This is
    /// the `n_contacts` column of the Push-T demonstrations.
    ///
    /// (gym-pusht's `info["n_contacts"]` divides by 1000 instead of 10 and is therefore 0 or 1.)
    pub contacts: u32,
}

/// The order in which a reset sets the block's position and angle.
///
/// The order matters because setting the angle rotates the block about its centre of gravity, which is not its origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, JsonSchema)]
pub enum ResetOrder {
    /// Position, then angle. This is the order of gym-pusht, of Diffusion Policy's benchmark (`legacy_test: True`) and of the human
    /// demonstrations. The block's position becomes `requested + c - R(theta) c`, where `c` is its centre of gravity.
    #[default]
    #[serde(rename = "legacy")]
    Legacy,
    /// Angle, then position. The block's pose becomes the requested pose.
    #[serde(rename = "pose")]
    PoseIsPose,
}

//! The interface that rollouts drive.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::SimError;

/// A simulator of one task: reset it to a scene, then step it with actions.
///
/// The same calls in the same order give the same bits, on any thread and beside any number of other simulators.
pub trait Simulator: Send {
    /// A state that can be asked for in a reset.
    type Scene;
    /// What else a reset depends on.
    type Reset;
    /// What a policy sees of the state.
    type Observation;
    /// What a policy commands.
    type Action;
    /// What one control step leads to.
    type Step;

    /// Starts an episode from `scene`.
    ///
    /// # Errors
    /// When the scene is not one the simulator can take; the simulator then stays as it was.
    fn reset(&mut self, scene: &Self::Scene, how: Self::Reset) -> Result<Self::Observation, SimError>;

    /// Runs one control step.
    ///
    /// # Errors
    /// When the action is not one the simulator can take, which leaves the simulator as it was; or when the physics came to
    /// a state it cannot go on from, after which only a reset helps.
    fn step(&mut self, action: &Self::Action) -> Result<Self::Step, SimError>;
}

/// What one control step of Push-T led to.
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
    /// Contact points of all physics steps, divided by the number of physics steps in a control step, rounded up: the
    /// `n_contacts` column of the Push-T demonstrations.
    ///
    /// (gym-pusht's `info["n_contacts"]` divides by 1000 in place of 10 and is therefore 0 or 1.)
    pub contacts: u32,
}

/// In which order a reset sets the block's position and angle.
///
/// It matters because setting the angle turns the block about its centre of gravity, which is not its origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, JsonSchema)]
pub enum ResetOrder {
    /// Position, then angle: gym-pusht always, `diffusion_policy` in its benchmark (`legacy_test: True`), and the human
    /// demonstrations. The block arrives at `requested + c - R(theta) c` with `c` its centre of gravity.
    #[default]
    #[serde(rename = "legacy")]
    Legacy,
    /// Angle, then position: the block arrives at the requested pose.
    #[serde(rename = "pose")]
    PoseIsPose,
}

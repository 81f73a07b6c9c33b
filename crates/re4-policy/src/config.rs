//! Settings of the planar policy in a pipeline file, and its presets.

use re4_index::AngleMetric;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kinds::SettingError;

/// Minimum of lengths and speeds in px. Shorter steps would split a path across the workspace into more waypoints than an episode
/// has control steps.
const MINIMUM_LENGTH: f64 = 0.01;

/// Settings of a planar policy that performs Retrieve, Reframe, Replan and Replay. Reframe and Replan can be disabled separately.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// Retrieve: selects the demonstration to follow and the frame to start from.
    pub retrieve: RetrieveConfig,
    /// Reframe: transforms the chunk to the observed object pose.
    pub reframe: ReframeConfig,
    /// Replan: moves the end effector to the start of the chunk.
    pub replan: ReplanConfig,
    /// Replay: executes the chunk.
    pub replay: ReplayConfig,
}

/// How Retrieve selects a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Selector {
    /// The paper's two-stage lookup: the nearest state in every demonstration, then the nearest object pose among these states.
    TwoStage,
    /// The chunk whose recorded object motion, applied to the observed object pose, ends closest to the goal pose.
    Outcome,
}

/// Settings of Retrieve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RetrieveConfig {
    /// Rule that selects the frame.
    pub selector: Selector,
    /// `two_stage`: how block angles are compared.
    #[schemars(extend("only_with" = { "policy.retrieve.selector": "two_stage" }))]
    pub angle: AngleMetric,
    /// `two_stage`: tolerance on `d_o` in normalised units. Stage 1 considers only frames whose `d_o` exceeds the minimum `d_o`
    /// of their demonstration by at most this value.
    #[schemars(extend("only_with" = { "policy.retrieve.selector": "two_stage" }))]
    pub epsilon: f64,
    /// `outcome`: number of chunks, nearest in outcome, whose cost is computed.
    #[schemars(extend("only_with" = { "policy.retrieve.selector": "outcome" }))]
    pub candidates: usize,
    /// `outcome`: cost of one control step, in pixels of expected misalignment.
    #[schemars(extend("only_with" = { "policy.retrieve.selector": "outcome" }))]
    pub step_cost: f64,
    /// `outcome`: expected increase of the misalignment per pixel that the object is pushed.
    #[schemars(extend("only_with" = { "policy.retrieve.selector": "outcome" }))]
    pub motion_cost: f64,
}

/// Settings of Reframe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReframeConfig {
    /// Whether Reframe is enabled. If not, the demonstration is replayed where it was recorded.
    pub enabled: bool,
}

/// The planner of the path from the end effector to the start of the chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Planner {
    /// Rapidly-exploring random tree, as in the paper.
    Rrt,
    /// Shortest path over the visibility graph of the inflated block.
    Visibility,
}

/// Settings of Replan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReplanConfig {
    /// Whether Replan is enabled. If not, the chunk is replayed from the current end-effector position.
    pub enabled: bool,
    /// The planner.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub planner: Planner,
    /// Minimum distance from the pusher's centre to the block, in pixels.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub keepout: f64,
    /// `rrt`: length of one extension of the tree, in pixels.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true, "policy.replan.planner": "rrt" }))]
    pub step: f64,
    /// `rrt`: maximum number of extensions.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true, "policy.replan.planner": "rrt" }))]
    pub iterations: u32,
    /// `rrt`: fraction of the samples that are the goal itself.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true, "policy.replan.planner": "rrt" }))]
    pub goal_bias: f64,
    /// Maximum distance between the waypoints that are executed, one per control step, in pixels. The vertices of the plan are
    /// always waypoints.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub spacing: f64,
}

/// How the chunk is converted to commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tracking {
    /// The recorded actions, transformed by Reframe, are the commands.
    Actions,
    /// The recorded path of the end effector, transformed by Reframe, is followed at the given speed. The commands compensate for
    /// the lag of the controller.
    Path,
}

/// Settings of Replay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReplayConfig {
    /// How the chunk is converted to commands.
    pub tracking: Tracking,
    /// Number of commands executed before the next Retrieve (n in the paper).
    pub horizon: usize,
    /// `actions`: only every `stride`-th recorded action is executed.
    #[schemars(extend("only_with" = { "policy.replay.tracking": "actions" }))]
    pub stride: usize,
    /// `path`: maximum travel of the pusher per control step, in pixels.
    #[schemars(extend("only_with" = { "policy.replay.tracking": "path" }))]
    pub speed: f64,
    /// Maximum deviation of the object from the recorded motion before the chunk is abandoned, as a root mean square over the
    /// object's points, in pixels. If absent, a chunk is never abandoned.
    pub divergence: Option<f64>,
}

impl PolicyConfig {
    /// The method and constants of the paper. Values that the paper does not give are our own choices.
    /// docs/concepts/method.md lists them.
    pub fn paper() -> Self {
        Self {
            retrieve: RetrieveConfig {
                selector: Selector::TwoStage,
                angle: AngleMetric::Raw,
                epsilon: 0.1,
                candidates: 64,
                step_cost: 0.0,
                motion_cost: 0.0,
            },
            reframe: ReframeConfig { enabled: true },
            replan: ReplanConfig {
                enabled: true,
                planner: Planner::Rrt,
                keepout: 15.0,
                step: 15.0,
                iterations: 1000,
                goal_bias: 0.1,
                // The spacing exceeds the workspace, so only the vertices of the polyline are waypoints. A free straight segment
                // is then executed directly, as in the paper.
                spacing: 1024.0,
            },
            replay: ReplayConfig {
                tracking: Tracking::Actions,
                // Chosen together with `epsilon` on the seeds 200000 to 200999.
                horizon: 24,
                stride: 1,
                speed: 20.0,
                divergence: None,
            },
        }
    }

    /// Retrieve and Replay only.
    pub fn re2() -> Self {
        let mut config = Self::paper();
        config.reframe.enabled = false;
        config.replan.enabled = false;
        config
    }

    /// The best settings found, tuned on the seeds 200000 to 204999. docs/concepts/method.md lists every departure from the paper
    /// with its effect on the score.
    pub fn re4() -> Self {
        let mut config = Self::paper();
        config.retrieve.selector = Selector::Outcome;
        config.retrieve.angle = AngleMetric::Periodic;
        config.retrieve.candidates = 256;
        config.retrieve.step_cost = 0.8;
        config.retrieve.motion_cost = 0.05;
        config.replan.planner = Planner::Visibility;
        config.replan.keepout = 18.0;
        config.replan.spacing = 60.0;
        config.replay.tracking = Tracking::Path;
        config.replay.horizon = 200;
        config.replay.speed = 20.0;
        config.replay.divergence = Some(8.0);
        config
    }

    /// Checks all numbers.
    ///
    /// # Errors
    /// The first number with which the policy could not work, such as a spacing of 0 between waypoints.
    pub fn check(&self) -> Result<(), SettingError> {
        let (retrieve, replan, replay) = (&self.retrieve, &self.replan, &self.replay);
        let count = |setting, value: u64| SettingError::unless(value >= 1, setting, value, "give 1 or more");
        let number = |setting, value: f64| SettingError::unless(value >= 0.0, setting, value, "give 0 or more");
        let length = |setting, value: f64| {
            SettingError::unless(
                value >= MINIMUM_LENGTH,
                setting,
                format!("{value} px"),
                "give 0.01 or more",
            )
        };
        count("retrieve.candidates", retrieve.candidates as u64)?;
        count("replan.iterations", u64::from(replan.iterations))?;
        count("replay.horizon", replay.horizon as u64)?;
        count("replay.stride", replay.stride as u64)?;
        number("retrieve.epsilon", retrieve.epsilon)?;
        number("retrieve.step_cost", retrieve.step_cost)?;
        number("retrieve.motion_cost", retrieve.motion_cost)?;
        number("replan.keepout", replan.keepout)?;
        number("replay.divergence", replay.divergence.unwrap_or(0.0))?;
        length("replan.step", replan.step)?;
        length("replan.spacing", replan.spacing)?;
        length("replay.speed", replay.speed)?;
        let is_fraction = (0.0..=1.0).contains(&replan.goal_bias);
        SettingError::unless(
            is_fraction,
            "replan.goal_bias",
            replan.goal_bias,
            "give a fraction from 0 to 1",
        )
    }
}

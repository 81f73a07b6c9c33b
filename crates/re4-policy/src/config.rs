//! What a policy is made of, as a pipeline file writes it, and the presets.

use re4_index::AngleMetric;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kinds::SettingError;

/// Shorter steps would cut a way across the window into more waypoints than any episode has steps.
const SHORTEST: f64 = 0.01;

/// A policy of the Retrieve-Reframe-Replan-Replay family. Every step can be switched off alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// Which demonstration to follow, and from where.
    pub retrieve: RetrieveConfig,
    /// Whether the chunk is carried into the frame of the object.
    pub reframe: ReframeConfig,
    /// How the end effector gets to the start of the chunk.
    pub replan: ReplanConfig,
    /// How the chunk is executed.
    pub replay: ReplayConfig,
}

/// How Retrieve ranks the demonstrations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Selector {
    /// The paper's two-stage lookup: nearest state in each demonstration, then nearest object pose among these.
    TwoStage,
    /// The chunk whose recorded motion of the object, applied to the object here, leads closest to the goal pose.
    Outcome,
}

/// Retrieve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RetrieveConfig {
    /// How demonstrations are ranked.
    pub selector: Selector,
    /// `two_stage`: how block angles are compared.
    pub angle: AngleMetric,
    /// `two_stage`: tolerance on `d_o` within a demonstration, in normalised units; candidates farther than this beyond
    /// the demonstration's minimum `d_o` are not admitted to stage 1.
    pub epsilon: f64,
    /// `outcome`: how many chunks, nearest in outcome, are compared in full.
    pub candidates: usize,
    /// `outcome`: price of one control step, in pixels of expected misalignment.
    pub step_cost: f64,
    /// `outcome`: expected growth of the misalignment for a pixel that the object is pushed.
    pub motion_cost: f64,
}

/// Reframe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReframeConfig {
    /// Off: the demonstration is replayed where it was recorded.
    pub enabled: bool,
}

/// Which planner connects the end effector with the start of the chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Planner {
    /// Rapidly-exploring random tree, as in the paper.
    Rrt,
    /// Shortest path over the visibility graph of the inflated block.
    Visibility,
}

/// Replan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReplanConfig {
    /// Off: the chunk is replayed from wherever the end effector is.
    pub enabled: bool,
    /// Which planner.
    pub planner: Planner,
    /// Distance in pixels that the pusher's centre keeps from the block.
    pub keepout: f64,
    /// `rrt`: length in pixels of one extension of the tree.
    pub step: f64,
    /// `rrt`: how many extensions are tried.
    pub iterations: u32,
    /// `rrt`: fraction of the samples that are the goal itself.
    pub goal_bias: f64,
    /// Maximum distance in pixels between waypoints that are executed, one a control step; the vertices of the plan
    /// are always among them.
    pub spacing: f64,
}

/// How the chunk is turned into commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Tracking {
    /// The recorded actions, carried along, are the commands.
    Actions,
    /// The recorded path of the end effector is followed, at the speed given, by commands that account for the
    /// controller's lag.
    Path,
}

/// Replay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReplayConfig {
    /// How the chunk is turned into commands.
    pub tracking: Tracking,
    /// Commands executed before the next Retrieve, the paper's n.
    pub horizon: usize,
    /// `actions`: every how manieth recorded action is executed.
    pub stride: usize,
    /// `path`: maximum travel of the pusher in a control step, in pixels.
    pub speed: f64,
    /// How far the object may stray from the recorded motion, root mean square over its points in pixels, before the
    /// chunk is given up; never when absent.
    pub divergence: Option<f64>,
}

impl PolicyConfig {
    /// The paper's method and constants; where the paper gives none, the choice is ours and documented.
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
                // Wider than the workspace: the vertices of the polyline are the waypoints, so that a free straight
                // segment is executed directly, as the paper says.
                spacing: 1024.0,
            },
            replay: ReplayConfig {
                tracking: Tracking::Actions,
                horizon: 24,
                stride: 1,
                speed: 20.0,
                divergence: None,
            },
        }
    }

    /// Retrieve and Replay alone.
    pub fn re2() -> Self {
        let mut config = Self::paper();
        config.reframe.enabled = false;
        config.replan.enabled = false;
        config
    }

    /// The best found.
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

    /// Looks every number over.
    ///
    /// # Errors
    /// The first under which a policy could not do its work, such as waypoints with no distance between them.
    pub fn check(&self) -> Result<(), SettingError> {
        let (retrieve, replan, replay) = (&self.retrieve, &self.replan, &self.replay);
        let count = |setting, value: u64| SettingError::unless(value >= 1, setting, value, "give 1 or more");
        let number = |setting, value: f64| SettingError::unless(value >= 0.0, setting, value, "give 0 or more");
        let length = |setting, value: f64| {
            SettingError::unless(value >= SHORTEST, setting, format!("{value} px"), "give 0.01 or more")
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
        let share = (0.0..=1.0).contains(&replan.goal_bias);
        SettingError::unless(
            share,
            "replan.goal_bias",
            replan.goal_bias,
            "it is a fraction, from 0 to 1",
        )
    }
}

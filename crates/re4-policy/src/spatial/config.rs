//! Settings of the policy in SE(3) in a pipeline file, and its presets.

use re4_geometry::spatial::Symmetry;
use re4_index::{SpatialMetric, Stage2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kinds::SettingError;

/// Settings of a policy in SE(3) that performs Retrieve, Reframe, Replan and Replay. Reframe and Replan can be disabled
/// separately.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialPolicyConfig {
    /// Retrieve: selects the demonstration to follow and the frame to start from.
    pub retrieve: SpatialRetrieveConfig,
    /// Reframe: transforms the chunk to the observed object pose.
    pub reframe: SpatialReframeConfig,
    /// Replan: moves the end effector to the start of the chunk.
    pub replan: SpatialReplanConfig,
    /// Replay: executes the chunk.
    pub replay: SpatialReplayConfig,
    /// Detection of failures and recovery from them.
    pub recovery: SpatialRecoveryConfig,
    /// Averaging of observed object poses. If absent, every observation is used directly.
    pub filter: Option<PoseFilterConfig>,
}

/// Settings of Retrieve. The scales and weights define the distances between states. The distance between two poses is
/// `distance / translation_scale + angle / rotation_scale`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialRetrieveConfig {
    /// Translation that contributes a distance of 1, in metres.
    pub translation_scale: f64,
    /// Rotation that contributes a distance of 1, in rad.
    pub rotation_scale: f64,
    /// Weight of the object pose in `d_q`.
    pub object_weight: f64,
    /// Weight of the end-effector pose in the object frame in `d_q`.
    pub eef_weight: f64,
    /// Distance that ranks the demonstrations in stage 2: `object`, as in the paper, or `state`.
    pub stage2: Stage2,
    /// Whether frames after the last release of a demonstration can be retrieved.
    pub tail: bool,
    /// Amount by which `d_q` of the current demonstration's next frame may exceed that of the retrieved frame for the policy to
    /// continue with the current demonstration. If absent, the policy always switches to the retrieved frame.
    pub commit_margin: Option<f64>,
}

impl SpatialRetrieveConfig {
    /// Returns the metric for an object with a symmetry.
    pub fn metric(&self, symmetry: Symmetry) -> SpatialMetric {
        SpatialMetric {
            translation_scale: self.translation_scale,
            rotation_scale: self.rotation_scale,
            object_weight: self.object_weight,
            eef_weight: self.eef_weight,
            symmetry,
        }
    }
}

/// How a chunk is replayed while the object is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TransferReplay {
    /// The recorded goals are used unchanged, so the end effector follows the demonstration (paper, Algorithm 2).
    Verbatim,
    /// Every goal is corrected by the difference between the grasps, so the object follows the demonstration.
    GraspCorrected,
}

/// When the motion from the demonstration's object pose to the observed one is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Measuring {
    /// At the decision, before the bridge (paper, Algorithm 2).
    Decision,
    /// At every control step until the gripper changes the mode.
    Continuous,
}

/// Settings of Reframe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialReframeConfig {
    /// Whether Reframe is enabled. If not, the demonstration is replayed where it was recorded.
    pub enabled: bool,
    /// How a chunk is replayed while the object is held.
    #[schemars(extend("only_with" = { "policy.reframe.enabled": true }))]
    pub transfer: TransferReplay,
    /// When the motion between the two object poses is measured.
    #[schemars(extend("only_with" = { "policy.reframe.enabled": true }))]
    pub measure: Measuring,
    /// Object pose to use while the gripper holds the object. Applies only to poses from images.
    #[serde(default, skip_serializing_if = "WhileHeld::is_default")]
    pub held: WhileHeld,
    /// Number of control steps after which the policy looks at the object again if the estimate is doubtful and the gripper is open.
    /// If absent, the policy looks only at decisions. Applies only to poses from images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub look_again: Option<u32>,
}

/// The object pose that a policy with poses from images uses while the gripper holds the object.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WhileHeld {
    /// The pose estimated from the image.
    #[default]
    Seen,
    /// The pose estimated before the grasp, moved with the gripper since then, as the transfer mode implies. It does not require that
    /// the object is visible.
    Carried,
}

impl WhileHeld {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks by reference")]
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Settings of Replan: a closed-loop bridge to the start of the chunk. At every control step, the set-point is the start itself
/// or a point on the straight path to it that is at most the lead away from the end effector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialReplanConfig {
    /// Whether Replan is enabled. If not, the chunk is replayed from the current end-effector pose.
    pub enabled: bool,
    /// Maximum distance from the end effector to the set-point, in metres.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub lead_translation: f64,
    /// Maximum angle from the end effector to the set-point, in rad.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub lead_rotation: f64,
    /// Distance to the start at which the bridge has arrived, in metres.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub tolerance_translation: f64,
    /// Angle to the start at which the bridge has arrived, in rad.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub tolerance_rotation: f64,
    /// Maximum number of control steps of the bridge. The chunk is then replayed even if the bridge has not arrived.
    #[schemars(extend("only_with" = { "policy.replan.enabled": true }))]
    pub max_steps: u32,
}

/// Settings of Replay. The replay continues across changes of the recorded mode and stops at the end of the demonstration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialReplayConfig {
    /// Number of actions executed before the next Retrieve (n in the paper).
    pub horizon: u32,
    /// Whether a chunk that reaches the last release of the demonstration continues to the end of the demonstration.
    pub finish: bool,
    /// Extension of a chunk during which the gripper closes or opens. If absent, chunks are not extended.
    pub settle: Option<SettleConfig>,
    /// Replay at the robot's pace where nothing is touched. If absent, every frame takes one control step, as recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retime: Option<RetimeConfig>,
}

/// Replay at the robot's pace instead of the demonstrator's. The set-point moves along the recorded path of the end effector, at most
/// the lead of Replan ahead of the end effector along this path. Parts in which something is touched are replayed as recorded, action
/// by action: around every change of the gripper command, and where the object moves although it is not held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RetimeConfig {
    /// Distance from the pose at a change of the gripper command within which the demonstration is replayed as recorded, in metres,
    /// with rotations converted at 0.1 m per rad.
    pub margin: f64,
}

impl Default for RetimeConfig {
    /// The margin is the lead of Replan: from there on, a set-point at full lead would lie at the grasp or beyond it.
    fn default() -> Self {
        Self { margin: 0.05 }
    }
}

/// Extension of a chunk that would end while the fingers still move: the replay continues until the fingers are still, for at
/// most 40 actions after the gripper command changed.
///
/// Between the command to close and the grasp, the mode is already transfer but the object is not yet held. A decision at that
/// time would move the fingers to the grasp of the demonstration without moving the object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SettleConfig {
    /// Minimum number of actions after a change of the gripper command.
    pub steps: u32,
    /// Change of the distance between the fingers above which they count as moving, in metres per control step.
    pub finger_speed: f64,
}

/// When the policy checks for a lost grasp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GraspCheck {
    /// At every retrieval, and at the end of a bridge.
    Retrieval,
    /// At every control step.
    Step,
}

/// What the policy does when a demonstration ends without success.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EndOfDemo {
    /// Retrieve from the current state.
    Retrieve,
    /// After a release, the arm returns to the home pose and the policy then retrieves. If the object is held, the policy
    /// retrieves from the current state. If bans are enabled, the demonstration is banned.
    GoHome,
}

/// Bans of demonstrations in an episode. A lost grasp bans the demonstration that was followed when the object was grasped
/// and the one that was followed when the grasp was lost. A demonstration that is retrieved repeatedly without progress is
/// also banned. Banned demonstrations rank after all others. When all demonstrations are banned, all bans are lifted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BanConfig {
    /// A demonstration is banned when it has been retrieved this many times near the same frame in one mode.
    pub repeats: u32,
    /// Maximum distance between frames that count as the same, in frames. It is limited to less than the horizon.
    pub window: u32,
}

/// Settings of failure detection and recovery.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialRecoveryConfig {
    /// Distance between the fingers, in metres, below which the grasp is lost in transfer mode. The end effector then returns to
    /// the initial pose of the episode with the gripper open (paper, section on Robomimic). If absent, lost grasps are not
    /// detected.
    ///
    /// Closing fingers are farther apart than when they hold the object, so the check needs no delay after the command to close.
    /// The value must be less than the width of the object where it is grasped.
    pub lost_grasp: Option<f64>,
    /// When the policy checks for a lost grasp.
    pub check: GraspCheck,
    /// Maximum number of control steps of the return to the home pose.
    pub home_steps: u32,
    /// What the policy does when a demonstration ends without success.
    pub end_of_demo: EndOfDemo,
    /// Bans of demonstrations. If absent, demonstrations are not banned.
    pub ban: Option<BanConfig>,
}

/// Averaging of observed object poses in the frame in which the object is fixed: the world in transit, the gripper in transfer.
///
/// The median difference between successive observations estimates the error of a single observation. An observation that is
/// farther from the average than `gate` standard deviations shows that the object moved, and the average restarts from it.
/// Observations without errors are therefore used unchanged, however the object moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseFilterConfig {
    /// Maximum number of averaged observations: a new observation has a weight of at least the inverse of this number. 1 disables
    /// averaging.
    pub samples: u32,
    /// Distance from the average above which the object is assumed to have moved, in standard deviations of an error along one
    /// axis.
    pub gate: f64,
}

impl SpatialPolicyConfig {
    /// The method and constants of the paper. Values that the paper does not give (scales, weights, tolerances, leads, limits of
    /// steps) are our own choices.
    ///
    /// Without bans, the preset can retrieve the same demonstration repeatedly without progress. Such an episode ends when its
    /// step budget is used up.
    pub fn paper() -> Self {
        Self {
            retrieve: SpatialRetrieveConfig {
                // `SpatialMetric` explains the scales.
                translation_scale: 0.1,
                rotation_scale: 1.0,
                object_weight: 1.0,
                eef_weight: 1.0,
                stage2: Stage2::Object,
                tail: true,
                commit_margin: None,
            },
            reframe: SpatialReframeConfig {
                enabled: true,
                transfer: TransferReplay::Verbatim,
                measure: Measuring::Decision,
                held: WhileHeld::Seen,
                look_again: None,
            },
            replan: SpatialReplanConfig {
                enabled: true,
                lead_translation: 0.05,
                lead_rotation: 0.5,
                tolerance_translation: 0.01,
                tolerance_rotation: 5f64.to_radians(),
                max_steps: 40,
            },
            replay: SpatialReplayConfig {
                horizon: 16,
                finish: false,
                settle: None,
                retime: None,
            },
            recovery: SpatialRecoveryConfig {
                lost_grasp: Some(0.01),
                check: GraspCheck::Retrieval,
                home_steps: 60,
                end_of_demo: EndOfDemo::Retrieve,
                ban: None,
            },
            filter: None,
        }
    }

    /// Retrieve and Replay only. After a lost grasp, the arm still returns to the home pose; otherwise no episode could
    /// continue after a missed grasp.
    pub fn re2() -> Self {
        let mut config = Self::paper();
        config.reframe.enabled = false;
        config.replan.enabled = false;
        config
    }

    /// The settings of `paper` with additions: grasp correction, continuous measurement, bans, commitment to a demonstration,
    /// averaged poses, and no decision while the fingers move. docs/results/robosuite.md compares the presets.
    pub fn re4() -> Self {
        let mut config = Self::paper();
        config.retrieve.tail = false;
        config.retrieve.commit_margin = Some(0.5);
        config.reframe.transfer = TransferReplay::GraspCorrected;
        config.reframe.measure = Measuring::Continuous;
        config.replay.finish = true;
        config.replay.settle = Some(SettleConfig {
            steps: 10,
            finger_speed: 5e-4,
        });
        config.recovery.check = GraspCheck::Step;
        config.recovery.end_of_demo = EndOfDemo::GoHome;
        config.recovery.ban = Some(BanConfig { repeats: 4, window: 3 });
        config.filter = Some(PoseFilterConfig { samples: 20, gate: 4.0 });
        config
    }

    /// Checks all settings. `images` is true if the object pose is estimated from images.
    ///
    /// # Errors
    /// The first invalid setting.
    pub fn check(&self, images: bool) -> Result<(), SettingError> {
        let (retrieve, replan, replay) = (&self.retrieve, &self.replan, &self.replay);
        let (recovery, filter, ban) = (&self.recovery, self.filter.as_ref(), self.recovery.ban.as_ref());
        let positive = |setting, value: f64| {
            let valid = value.is_finite() && value > 0.0;
            SettingError::unless(valid, setting, value, "give a finite number above 0")
        };
        let not_negative = |setting, value: f64| {
            let valid = value.is_finite() && value >= 0.0;
            SettingError::unless(valid, setting, value, "give a finite number, 0 or more")
        };
        let count = |setting, value: u32| SettingError::unless(value >= 1, setting, value, "give 1 or more");
        positive("retrieve.translation_scale", retrieve.translation_scale)?;
        positive("retrieve.rotation_scale", retrieve.rotation_scale)?;
        not_negative("retrieve.object_weight", retrieve.object_weight)?;
        not_negative("retrieve.eef_weight", retrieve.eef_weight)?;
        not_negative("retrieve.commit_margin", retrieve.commit_margin.unwrap_or(0.0))?;
        positive("replan.lead_translation", replan.lead_translation)?;
        positive("replan.lead_rotation", replan.lead_rotation)?;
        positive("replan.tolerance_translation", replan.tolerance_translation)?;
        positive("replan.tolerance_rotation", replan.tolerance_rotation)?;
        count("replay.horizon", replay.horizon)?;
        let finger_speed = replay.settle.as_ref().map_or(0.0, |settle| settle.finger_speed);
        not_negative("replay.settle.finger_speed", finger_speed)?;
        let retime = replay.retime.as_ref();
        not_negative("replay.retime.margin", retime.map_or(0.0, |retime| retime.margin))?;
        SettingError::unless(
            retime.is_none() || replan.enabled,
            "replay.retime",
            "given, but replan.enabled is false, and its lead sets the pace",
            "leave it out",
        )?;
        not_negative("recovery.lost_grasp", recovery.lost_grasp.unwrap_or(0.0))?;
        count("recovery.home_steps", recovery.home_steps)?;
        let repeats = ban.map_or(2, |ban| ban.repeats);
        SettingError::unless(repeats >= 2, "recovery.ban.repeats", repeats, "give 2 or more")?;
        count("filter.samples", filter.map_or(1, |f| f.samples))?;
        positive("filter.gate", filter.map_or(1.0, |f| f.gate))?;
        count("reframe.look_again", self.reframe.look_again.unwrap_or(1))?;
        SettingError::unless(
            images || self.reframe.look_again.is_none(),
            "reframe.look_again",
            "a setting that is only available with variant = \"image\"",
            "leave it out",
        )?;
        SettingError::unless(
            images || self.reframe.held == WhileHeld::Seen,
            "reframe.held",
            "\"carried\", which is only available with variant = \"image\"",
            "leave it out",
        )
    }
}

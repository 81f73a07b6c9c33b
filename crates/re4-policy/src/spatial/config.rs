//! What a policy in space is made of, as a pipeline file writes it, and the presets.

use re4_geometry::spatial::Symmetry;
use re4_index::{SpatialMetric, Stage2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kinds::SettingError;

/// A policy of the Retrieve-Reframe-Replan-Replay family in SE(3). Every step can be switched off alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialPolicyConfig {
    /// Which demonstration to follow, and from where.
    pub retrieve: SpatialRetrieveConfig,
    /// How the chunk is carried into the frame of the object.
    pub reframe: SpatialReframeConfig,
    /// How the end effector gets to the start of the chunk.
    pub replan: SpatialReplanConfig,
    /// How much of the chunk is executed.
    pub replay: SpatialReplayConfig,
    /// What is done about failure.
    pub recovery: SpatialRecoveryConfig,
    /// How observed object poses are averaged; every one is taken as it is when absent.
    pub filter: Option<PoseFilterConfig>,
}

/// Retrieve. Scales and weights are those of the distances between states: poses are
/// `distance / translation_scale + angle / rotation_scale` apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialRetrieveConfig {
    /// Translation, in metres, that counts as 1.
    pub translation_scale: f64,
    /// Rotation, in rad, that counts as 1.
    pub rotation_scale: f64,
    /// Weight of the object's pose in `d_q`.
    pub object_weight: f64,
    /// Weight of the end effector's pose, as seen from the object, in `d_q`.
    pub eef_weight: f64,
    /// Which distance ranks the demonstrations in stage 2: `object` as in the paper, or `state`.
    pub stage2: Stage2,
    /// Whether frames after a demonstration's last release can be retrieved.
    pub tail: bool,
    /// By how much `d_q` of the demonstration's next frame may exceed that of the retrieved one for the demonstration to be
    /// followed further; it is left for any better one when absent.
    pub commit_margin: Option<f64>,
}

impl SpatialRetrieveConfig {
    /// The metric for an object.
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
    /// The recorded goals, unchanged: the end effector follows the demonstration (paper, Algorithm 2).
    Verbatim,
    /// Each goal corrected by the difference of the grasps: the object follows the demonstration.
    GraspCorrected,
}

/// When the motion from the demonstration's object to the one here is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Measuring {
    /// At the decision, before the bridge (paper, Algorithm 2).
    Decision,
    /// At every step until the gripper changes the mode.
    Continuous,
}

/// Reframe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialReframeConfig {
    /// Off: the demonstration is replayed where it was recorded.
    pub enabled: bool,
    /// How a chunk is replayed while the object is held.
    pub transfer: TransferReplay,
    /// When the motion between the two objects is measured.
    pub measure: Measuring,
    /// Where the object is said to be while it is held, with poses from images.
    #[serde(default, skip_serializing_if = "WhileHeld::is_default")]
    pub held: WhileHeld,
}

/// Where an object is said to be while the gripper holds it, for a policy that looks at images.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WhileHeld {
    /// Where the image shows it.
    #[default]
    Seen,
    /// Where it was seen before the grasp, moving with the gripper since, as a mode of transfer says: what the hand hides need
    /// not be seen.
    Carried,
}

impl WhileHeld {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks by reference")]
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Replan: a closed-loop bridge to the start of the chunk. Every step, the set-point is the start itself or a point a lead
/// ahead on the straight way there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialReplanConfig {
    /// Off: the chunk is replayed from wherever the end effector is.
    pub enabled: bool,
    /// Maximum distance in metres from the end effector to the set-point.
    pub lead_translation: f64,
    /// Maximum angle in rad from the end effector to the set-point.
    pub lead_rotation: f64,
    /// Distance in metres at which the bridge has arrived.
    pub tolerance_translation: f64,
    /// Angle in rad at which the bridge has arrived.
    pub tolerance_rotation: f64,
    /// Control steps after which the chunk is replayed, arrived or not.
    pub max_steps: u32,
}

/// Replay. It runs on where the recorded mode changes, and stops at the demonstration's end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialReplayConfig {
    /// Actions executed before the next Retrieve, the paper's n.
    pub horizon: u32,
    /// Whether a chunk that reaches the demonstration's last release goes on to the demonstration's end.
    pub finish: bool,
    /// How far a chunk in which the gripper closes or opens runs on; to its end and no further when absent.
    pub settle: Option<SettleConfig>,
}

/// A chunk that ends while the fingers still move runs on until they are still, for 40 actions at the most: between the
/// command to close and the grasp, the object is in transfer but not yet held, and moving it to where the demonstration has it
/// would move the fingers alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SettleConfig {
    /// Minimum number of actions after the gripper's command changed.
    pub steps: u32,
    /// Change of the distance between the fingers, in metres a control step, from which on they move.
    pub finger_speed: f64,
}

/// When fingers that hold nothing are noticed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GraspCheck {
    /// At every retrieval, and at the end of a bridge.
    Retrieval,
    /// At every control step.
    Step,
}

/// What follows on the end of a demonstration without success.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EndOfDemo {
    /// Retrieve, from where things are.
    Retrieve,
    /// After a release, the way home, then Retrieve; with the object held, Retrieve. Where demonstrations are banned, this one
    /// is.
    GoHome,
}

/// When a demonstration is not followed again in an episode: after a grasp that it made, or during which it was followed, was
/// lost; or when it leads nowhere. Banned demonstrations rank after all others; where all are banned, all bans are lifted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BanConfig {
    /// How many times a demonstration may be retrieved about the same frame in one mode; at the last of them it is banned.
    pub repeats: u32,
    /// Frames that count as the same frame are at most so far apart, and closer than the horizon.
    pub window: u32,
}

/// Failure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpatialRecoveryConfig {
    /// Distance in metres between the fingers below which, in transfer, the grasp is lost: the end effector goes back to where
    /// the episode began, the gripper open (paper, section on Robomimic). Never looked at when absent.
    ///
    /// Fingers that are still closing are farther apart than what they will hold, so no time to close is needed; the value
    /// must be below the object's width where it is grasped.
    pub lost_grasp: Option<f64>,
    /// When that is looked at.
    pub check: GraspCheck,
    /// Maximum number of control steps on the way home.
    pub home_steps: u32,
    /// What follows on the end of a demonstration without success.
    pub end_of_demo: EndOfDemo,
    /// When a demonstration is not followed again; never when absent.
    pub ban: Option<BanConfig>,
}

/// Averaging of observed object poses: in transit in the world, in transfer in the gripper, where the object rests.
///
/// How much successive observations differ there (their median) tells the errors of single ones. An observation farther from
/// the average than `gate` standard deviations says that the object moved: the average starts anew from it. So observations
/// without errors are taken as they are, whatever moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PoseFilterConfig {
    /// Observations after which older ones are forgotten; 1 averages nothing.
    pub samples: u32,
    /// Distance, in standard deviations of an error along one axis, beyond which the object has moved.
    pub gate: f64,
}

impl SpatialPolicyConfig {
    /// The paper's method and constants; where the paper gives none (scales, weights, tolerances, leads, caps), the choice is
    /// ours. It has no cure for a demonstration that leads nowhere: such an episode ends with its step budget.
    pub fn paper() -> Self {
        Self {
            retrieve: SpatialRetrieveConfig {
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

    /// Retrieve and Replay alone. A lost grasp still ends in the way home, without which every miss would end the episode.
    pub fn re2() -> Self {
        let mut config = Self::paper();
        config.reframe.enabled = false;
        config.replan.enabled = false;
        config
    }

    /// Grasp correction, bans, commitment to a demonstration, averaged poses, and no decision while the fingers move.
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

    /// Looks every number over. `images` says whether the object's pose is estimated from images.
    ///
    /// # Errors
    /// The first that makes no sense.
    pub fn check(&self, images: bool) -> Result<(), SettingError> {
        let (retrieve, replan, replay) = (&self.retrieve, &self.replan, &self.replay);
        let (recovery, filter, ban) = (&self.recovery, self.filter.as_ref(), self.recovery.ban.as_ref());
        let positive = |setting, value: f64| {
            let sound = value.is_finite() && value > 0.0;
            SettingError::unless(sound, setting, value, "give a finite number above 0")
        };
        let not_negative = |setting, value: f64| {
            let sound = value.is_finite() && value >= 0.0;
            SettingError::unless(sound, setting, value, "give a finite number, 0 or more")
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
        not_negative("recovery.lost_grasp", recovery.lost_grasp.unwrap_or(0.0))?;
        count("recovery.home_steps", recovery.home_steps)?;
        let repeats = ban.map_or(2, |ban| ban.repeats);
        SettingError::unless(repeats >= 2, "recovery.ban.repeats", repeats, "give 2 or more")?;
        count("filter.samples", filter.map_or(1, |f| f.samples))?;
        positive("filter.gate", filter.map_or(1.0, |f| f.gate))?;
        SettingError::unless(
            images || self.reframe.held == WhileHeld::Seen,
            "reframe.held",
            "\"carried\", which belongs to variant = \"image\"",
            "leave it out",
        )
    }
}

//! Configuration of the segmentation.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::SegmentError;

/// The rule that assigns modes to frames, and the thresholds of motion.
///
/// Lengths are in the units of the demonstrations (pixels for Push-T, metres for robosuite tasks) per control step, angles are in
/// radians per control step. The defaults are those for Push-T.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentConfig {
    /// The rule that assigns modes to frames.
    pub rule: Rule,
    /// `rigid_motion`: a step is rigid if the end effector translates by less than this in the object's frame. The paper's
    /// epsilon. Greater than 0.
    #[schemars(extend("only_with" = { "segment.rule": "rigid_motion" }))]
    pub translation_epsilon: f64,
    /// `rigid_motion`: a step is rigid if the end effector rotates by less than this in the object's frame. Has no effect if
    /// the end effector is a point. Greater than 0.
    #[schemars(extend("only_with" = { "segment.rule": "rigid_motion" }))]
    pub rotation_epsilon: f64,
    /// An object moves if its origin translates by more than this in a step, or if it rotates by more than `minimum_rotation`.
    /// 0 or greater.
    pub minimum_motion: f64,
    /// An object moves if it rotates by more than this in a step, or if its origin translates by more than `minimum_motion`. With
    /// `rigid_motion`, an object that does not move is never in transfer. 0 or greater.
    #[serde(alias = "minimum_turn")]
    pub minimum_rotation: f64,
    /// `rigid_motion`: the point of the object whose distance is compared with that of the end effector.
    #[schemars(extend("only_with" = { "segment.rule": "rigid_motion" }))]
    pub object_distance: ObjectDistance,
    /// robosuite tasks: settings of the gripper. Default: the default of each setting.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gripper: Option<GripperConfig>,
    /// Task `arm`: what the dataset does not prove about its gripper.
    #[serde(skip_serializing_if = "OpeningConfig::is_default")]
    pub opening: OpeningConfig,
}

/// What a dataset of the task `arm` does not prove about its gripper.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OpeningConfig {
    /// Whether the recorded opening decreases or increases when the gripper closes; without a recorded opening, the command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub closes: Option<Closes>,
    /// The recorded opening of the gripper when it is fully shut. A gripper that settles there holds nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shut: Option<f64>,
}

impl OpeningConfig {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// How the opening of a gripper changes when it closes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Closes {
    /// It decreases: a distance between fingers, a width, a percentage of the full opening.
    Decreasing,
    /// It increases: the angle of a finger's drive, a fraction of the full closing.
    Increasing,
}

impl Closes {
    /// The name in the pipeline file.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Decreasing => "decreasing",
            Self::Increasing => "increasing",
        }
    }

    /// 1 if larger values are more open, else -1.
    pub(crate) fn sign(self) -> f64 {
        match self {
            Self::Decreasing => 1.0,
            Self::Increasing => -1.0,
        }
    }
}

/// Settings of the gripper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GripperConfig {
    /// `gripper_command`: the action whose gripper command determines the mode of a frame.
    pub command: Command,
    /// Distance between the fingers, in m, below which they hold no object. The default is the paper's value for a failed grasp.
    pub closed: f64,
    /// Change of the distance between the fingers, in m per control step, below which they have stopped.
    pub still: f64,
    /// The frame that is the grasp frame g(d), whose end-effector pose is the anchor.
    #[serde(skip_serializing_if = "AnchorAt::is_default")]
    pub anchor: AnchorAt,
}

/// The frame of a demonstration that is its grasp frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AnchorAt {
    /// The first transfer frame, as in the paper.
    #[default]
    FirstTransfer,
    /// The first frame that is transfer by the rule `evidence`. A missed grasp does not become the anchor, and the fingers have
    /// reached the object. If no frame holds the object, the first transfer frame.
    FirstHold,
}

impl AnchorAt {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

impl Default for GripperConfig {
    fn default() -> Self {
        Self {
            command: Command::Last,
            closed: 0.01,
            still: 0.0005,
            anchor: AnchorAt::default(),
        }
    }
}

/// The action whose gripper command determines the mode of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// The action before the frame, which led to it, as in the paper ("when the last action's gripper state is set"). The first
    /// frame is transit.
    #[default]
    Last,
    /// The action taken at the frame.
    Current,
}

/// The rule that assigns modes to frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Every frame is transit. This is the paper's rule for Push-T, where the object is pushed and never grasped.
    #[default]
    AlwaysTransit,
    /// The paper's general definition (section "Manipulation Modes"): a frame is transfer if object and end effector move by the
    /// same distance, with their relative pose fixed.
    RigidMotion,
    /// The paper's rule for robomimic's tasks: a frame is transfer if the gripper is commanded to close, and transit otherwise.
    GripperCommand,
    /// A frame is transfer while something stops the closed fingers: from the frame at which they have settled on it after a
    /// command to close, until they let it go or shut. Needs no object pose.
    Grasp,
    /// As `grasp`, but only while the recorded object stays where it was in the gripper.
    Evidence,
    /// Task `arm`: as `grasp`, for any gripper. What closes it and how far it opens is proven from the dataset, or set in
    /// `segment.opening`.
    Gripper,
}

impl Rule {
    /// Whether the rule reads the gripper, which Push-T does not have.
    pub fn needs_gripper(self) -> bool {
        matches!(
            self,
            Self::GripperCommand | Self::Grasp | Self::Evidence | Self::Gripper
        )
    }

    /// Whether the rule reads recorded object poses.
    pub fn reads_object(self) -> bool {
        matches!(self, Self::RigidMotion | Self::Evidence)
    }

    /// The name in the pipeline file.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::AlwaysTransit => "always_transit",
            Self::RigidMotion => "rigid_motion",
            Self::GripperCommand => "gripper_command",
            Self::Grasp => "grasp",
            Self::Evidence => "evidence",
            Self::Gripper => "gripper",
        }
    }
}

/// The point of the object whose distance |o, o'| is used in the condition | |x, x'| - |o, o'| | < epsilon.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectDistance {
    /// The point of the object at the end effector. An object that is rotated then counts as carried, and the choice of the
    /// object's origin does not matter. Equal distances then follow from a fixed relative pose.
    #[default]
    AtEef,
    /// The object's origin, as in the paper's formula. An object that rotates about a point far from its origin then counts as
    /// transit.
    AtOrigin,
}

impl Default for SegmentConfig {
    fn default() -> Self {
        Self {
            rule: Rule::AlwaysTransit,
            translation_epsilon: 0.5,
            rotation_epsilon: 0.01,
            minimum_motion: 0.1,
            // This angle moves a point of the block 60 px from its centre by about `minimum_motion`.
            minimum_rotation: 0.002,
            object_distance: ObjectDistance::AtEef,
            gripper: None,
            opening: OpeningConfig::default(),
        }
    }
}

impl SegmentConfig {
    /// Returns the defaults for demonstrations in SE(3), in metres. The rule is [`Rule::GripperCommand`].
    pub fn spatial() -> Self {
        Self {
            rule: Rule::GripperCommand,
            // Between these two: an object in the fingers slips by about 0.1 mm per step, a moving gripper moves by about 10 mm.
            translation_epsilon: 0.001,
            rotation_epsilon: 0.02,
            minimum_motion: 0.0005,
            minimum_rotation: 0.005,
            object_distance: ObjectDistance::AtEef,
            gripper: Some(GripperConfig::default()),
            opening: OpeningConfig::default(),
        }
    }

    /// Returns the defaults for demonstrations of an arm without an object. The rule is [`Rule::Gripper`].
    pub fn arm() -> Self {
        Self {
            rule: Rule::Gripper,
            gripper: None,
            ..Self::spatial()
        }
    }

    /// Checks the ranges of all thresholds.
    ///
    /// # Errors
    /// [`SegmentError::Config`] names the first threshold that is out of range.
    pub fn check(&self) -> Result<(), SegmentError> {
        for (field, value) in [
            ("translation_epsilon", self.translation_epsilon),
            ("rotation_epsilon", self.rotation_epsilon),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(SegmentError::Config {
                    field,
                    value,
                    range: "greater than 0",
                });
            }
        }
        let gripper = self.gripper.clone().unwrap_or_default();
        for (field, value) in [
            ("minimum_motion", self.minimum_motion),
            ("minimum_rotation", self.minimum_rotation),
            ("gripper.closed", gripper.closed),
            ("gripper.still", gripper.still),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SegmentError::Config {
                    field,
                    value,
                    range: "of at least 0",
                });
            }
        }
        Ok(())
    }
}

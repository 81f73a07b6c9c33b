//! Configuration of the stage.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::error::SegmentError;

/// How modes are told apart, and from how much motion on an object counts as moving.
///
/// Lengths are in the units of the demonstrations (pixels for Push-T, metres for robosuite), angles in radians. Both are
/// per step. The defaults are Push-T's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentConfig {
    /// The rule that gives the modes.
    pub rule: Rule,
    /// `rigid_motion`: a step is rigid when the end effector moves less than this as seen from the object. The paper's
    /// epsilon. Greater than 0.
    #[schemars(extend("only_with" = { "segment.rule": "rigid_motion" }))]
    pub translation_epsilon: f64,
    /// `rigid_motion`: a step is rigid when the end effector turns less than this as seen from the object. Without effect
    /// where the end effector is a point. Greater than 0.
    #[schemars(extend("only_with" = { "segment.rule": "rigid_motion" }))]
    pub rotation_epsilon: f64,
    /// The object moves when its origin moves further than this in a step ...
    pub minimum_motion: f64,
    /// ... or when it turns further than this in a step. An object that does not move is never in transfer.
    #[serde(alias = "minimum_turn")]
    pub minimum_rotation: f64,
    /// `rigid_motion`: where the object's distance is measured that is compared with the end effector's.
    #[schemars(extend("only_with" = { "segment.rule": "rigid_motion" }))]
    pub object_distance: ObjectDistance,
    /// What is read from the gripper; robosuite's tasks only, which get the defaults where it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gripper: Option<GripperConfig>,
}

/// What is read from the gripper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GripperConfig {
    /// `gripper_command`: the action whose command gives the mode of a frame.
    pub command: Command,
    /// Fingers nearer to each other than this, in m, hold nothing. The paper's figure for a failed grasp.
    pub closed: f64,
    /// Fingers whose distance changes by less than this, in m per step, have stopped.
    pub still: f64,
}

impl Default for GripperConfig {
    fn default() -> Self {
        Self {
            command: Command::Last,
            closed: 0.01,
            still: 0.0005,
        }
    }
}

/// The action whose gripper command gives the mode of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Command {
    /// The one before the frame, which led to it: the paper's words ("when the last action's gripper state is set"). The first
    /// frame is transit.
    #[default]
    Last,
    /// The one taken at the frame.
    Current,
}

/// The rule that gives the modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// Every frame is transit: the paper's words for Push-T, where the object is pushed and never grasped.
    #[default]
    AlwaysTransit,
    /// The paper's general definition (section "Manipulation Modes"): transfer where object and end effector move by the
    /// same distance, with their relative pose fixed.
    RigidMotion,
    /// The paper's words for robomimic's tasks: transfer where the gripper's command closes, transit elsewhere.
    GripperCommand,
}

/// Where the distance |o, o'| that the object moves is measured, in | |x, x'| - |o, o'| | < epsilon.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectDistance {
    /// At the point of the object where the end effector is, so that an object that is turned counts as carried, and the
    /// choice of the object's origin does not matter. Equal distances then follow from a fixed relative pose.
    #[default]
    AtEef,
    /// At the object's origin, the paper's formula to the letter: an object that turns about a point far from its origin
    /// counts as transit.
    AtOrigin,
}

impl Default for SegmentConfig {
    fn default() -> Self {
        Self {
            rule: Rule::AlwaysTransit,
            translation_epsilon: 0.5,
            rotation_epsilon: 0.01,
            minimum_motion: 0.1,
            // What moves a point of the block, 60 px from its centre, by about the distance above.
            minimum_rotation: 0.002,
            object_distance: ObjectDistance::AtEef,
            gripper: None,
        }
    }
}

impl SegmentConfig {
    /// Defaults for demonstrations in space, in metres: the rule by the gripper's command.
    pub fn spatial() -> Self {
        Self {
            rule: Rule::GripperCommand,
            // An object in the fingers slips by a tenth of a millimetre a step; a hand that is under way moves by a hundred.
            translation_epsilon: 0.001,
            rotation_epsilon: 0.02,
            minimum_motion: 0.0005,
            minimum_rotation: 0.005,
            object_distance: ObjectDistance::AtEef,
            gripper: Some(GripperConfig::default()),
        }
    }

    /// Checks the ranges of all thresholds.
    ///
    /// # Errors
    /// [`SegmentError::Config`] naming the first that is out of range.
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
                    range: "0 or greater",
                });
            }
        }
        Ok(())
    }
}

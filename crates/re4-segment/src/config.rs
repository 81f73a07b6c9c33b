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
    pub translation_epsilon: f64,
    /// `rigid_motion`: a step is rigid when the end effector turns less than this as seen from the object. Without effect
    /// where the end effector is a point. Greater than 0.
    pub rotation_epsilon: f64,
    /// The object moves when its origin moves further than this in a step ...
    pub minimum_motion: f64,
    /// ... or when it turns further than this in a step. An object that does not move is never in transfer.
    pub minimum_turn: f64,
    /// `rigid_motion`: where the object's distance is measured that is compared with the end effector's.
    pub object_distance: ObjectDistance,
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
            minimum_turn: 0.002,
            object_distance: ObjectDistance::AtEef,
        }
    }
}

impl SegmentConfig {
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
        for (field, value) in [
            ("minimum_motion", self.minimum_motion),
            ("minimum_turn", self.minimum_turn),
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

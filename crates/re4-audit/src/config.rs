//! Thresholds from the pipeline file.

use re4_fault::Remedy;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::list::CHECKS;

/// Thresholds of the audit, by the code of their check. They replace the thresholds that are derived from the data or built in.
/// Each has the unit of its check.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AuditConfig {
    /// Threshold of the check `command_fingers_disagree`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command_fingers_disagree: Option<f64>,
    /// Threshold of the check `contact_without_motion`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_without_motion: Option<f64>,
    /// Threshold of the check `discontinuity_eef`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub discontinuity_eef: Option<f64>,
    /// Threshold of the check `discontinuity_object`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub discontinuity_object: Option<f64>,
    /// Threshold of the check `discontinuity_rotation`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(alias = "discontinuity_turn")]
    pub discontinuity_rotation: Option<f64>,
    /// Threshold of the check `dropped`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dropped: Option<f64>,
    /// Threshold of the check `early_release`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub early_release: Option<f64>,
    /// Threshold of the check `ends_before_success`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ends_before_success: Option<f64>,
    /// Threshold of the check `flicker`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flicker: Option<f64>,
    /// Threshold of the check `frozen`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frozen: Option<f64>,
    /// Threshold of the check `idle`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub idle: Option<f64>,
    /// Threshold of the check `lost_grasp`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost_grasp: Option<f64>,
    /// Threshold of the check `missed_grasp`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missed_grasp: Option<f64>,
    /// Threshold of the check `motion_without_contact`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion_without_contact: Option<f64>,
    /// Threshold of the check `non_rigid_rotation`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub non_rigid_rotation: Option<f64>,
    /// Threshold of the check `non_rigid_transfer`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub non_rigid_transfer: Option<f64>,
    /// Threshold of the check `outlier_length`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outlier_length: Option<f64>,
    /// Threshold of the check `pushed_in_transit`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pushed_in_transit: Option<f64>,
    /// Threshold of the check `regrasp`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub regrasp: Option<f64>,
    /// Threshold of the check `saturated`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturated: Option<f64>,
    /// Threshold of the check `actions_opposed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actions_opposed: Option<f64>,
    /// Threshold of the check `actions_scaled`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actions_scaled: Option<f64>,
    /// Threshold of the check `actions_shifted`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actions_shifted: Option<f64>,
    /// Threshold of the check `actions_unrelated`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub actions_unrelated: Option<f64>,
    /// Threshold of the check `frozen_eef`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frozen_eef: Option<f64>,
    /// Threshold of the check `frozen_object`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frozen_object: Option<f64>,
    /// Threshold of the check `gripper_reversed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gripper_reversed: Option<f64>,
    /// Threshold of the check `near_duplicate`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub near_duplicate: Option<f64>,
    /// Threshold of the check `released_moving`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub released_moving: Option<f64>,
    /// Threshold of the check `released_high`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub released_high: Option<f64>,
    /// Threshold of the check `reversed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reversed: Option<f64>,
    /// Threshold of the check `saturated_together`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturated_together: Option<f64>,
    /// Threshold of the check `success_lost`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub success_lost: Option<f64>,
    /// Threshold of the check `swapped_object`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub swapped_object: Option<f64>,
    /// Threshold of the check `frozen_signal`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frozen_signal: Option<f64>,
    /// Threshold of the check `timestamps`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub timestamps: Option<f64>,
    /// Threshold of the check `time_gap`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_gap: Option<f64>,
}

impl AuditConfig {
    /// Returns the threshold that the pipeline file sets for a check, if any.
    pub fn threshold(&self, code: &str) -> Option<f64> {
        match code {
            "command_fingers_disagree" => self.command_fingers_disagree,
            "contact_without_motion" => self.contact_without_motion,
            "discontinuity_eef" => self.discontinuity_eef,
            "discontinuity_object" => self.discontinuity_object,
            "discontinuity_rotation" => self.discontinuity_rotation,
            "dropped" => self.dropped,
            "early_release" => self.early_release,
            "ends_before_success" => self.ends_before_success,
            "flicker" => self.flicker,
            "frozen" => self.frozen,
            "idle" => self.idle,
            "lost_grasp" => self.lost_grasp,
            "missed_grasp" => self.missed_grasp,
            "motion_without_contact" => self.motion_without_contact,
            "non_rigid_rotation" => self.non_rigid_rotation,
            "non_rigid_transfer" => self.non_rigid_transfer,
            "outlier_length" => self.outlier_length,
            "pushed_in_transit" => self.pushed_in_transit,
            "regrasp" => self.regrasp,
            "saturated" => self.saturated,
            "actions_opposed" => self.actions_opposed,
            "actions_scaled" => self.actions_scaled,
            "actions_shifted" => self.actions_shifted,
            "actions_unrelated" => self.actions_unrelated,
            "frozen_eef" => self.frozen_eef,
            "frozen_object" => self.frozen_object,
            "gripper_reversed" => self.gripper_reversed,
            "near_duplicate" => self.near_duplicate,
            "released_moving" => self.released_moving,
            "released_high" => self.released_high,
            "reversed" => self.reversed,
            "saturated_together" => self.saturated_together,
            "success_lost" => self.success_lost,
            "swapped_object" => self.swapped_object,
            "frozen_signal" => self.frozen_signal,
            "timestamps" => self.timestamps,
            "time_gap" => self.time_gap,
            _ => None,
        }
    }

    /// Checks the ranges of all thresholds.
    ///
    /// # Errors
    /// [`AuditError`] names the first threshold that is not a finite number of at least 0.
    pub fn check(&self) -> Result<(), AuditError> {
        for check in CHECKS {
            if let Some(value) = self.threshold(check.code)
                && !(value.is_finite() && value >= 0.0)
            {
                return Err(AuditError {
                    code: check.code,
                    value,
                });
            }
        }
        Ok(())
    }
}

/// Error for a threshold that is out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Remedy)]
#[error("cannot audit: audit.{code} is {value}")]
#[remedy("set it to a finite number of at least 0, or leave it out")]
pub struct AuditError {
    code: &'static str,
    value: f64,
}

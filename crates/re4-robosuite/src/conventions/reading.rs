//! Conversion of recorded actions to the actions that robosuite's own files contain.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ActionKind, Controls, Settings, Unproven};
use crate::actions::{self, Action, Osc};

/// Unit of the first six columns of delta actions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionScale {
    /// The controller's unit: its maximum command (1) means `output_max`.
    #[default]
    Controller,
    /// Metres and radians per step.
    Metres,
    /// Another unit, which the settings `action_gain` and `action_offset` convert to the controller's unit.
    Numbers,
}

/// Frame of absolute actions, and of the delta actions of robosuite 1.5.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionFrame {
    /// The world frame.
    #[default]
    World,
    /// The frame of the robot's base (body `robot0_base` of the model).
    Base,
}

/// Direction in which a delta action rotates the end effector.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionRotation {
    /// By its rotation vector, as in robosuite 1.2 and later.
    #[default]
    Forward,
    /// By the negated rotation vector, as recordings of robosuite 1.0 show.
    Reversed,
}

/// Range of gripper commands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GripperRange {
    /// From -1 to 1. Only the sign matters, and 0 stops the fingers.
    #[default]
    MinusOneOne,
    /// From 0 to 1. Commands of 0 and 1 move the fingers in opposite directions.
    ZeroOne,
}

/// Pose that the controller holds before the first step. Its orientation remains the goal until a rotation is commanded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum InitialGoal {
    /// The pose of the robot after a reset without noise: robosuite's collector and robomimic reset the robot and then load the
    /// recorded state.
    ResetPose,
    /// The pose in the first frame.
    #[default]
    FirstPose,
}

/// Conversion of recorded actions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActionReading {
    /// Unit of delta actions.
    pub scale: ActionScale,
    /// Factors from recorded deltas to controller commands (translation, then rotation).
    pub gain: [f64; 6],
    /// Offsets that are added after that, in controller commands.
    pub offset: [f64; 6],
    /// Direction in which deltas rotate.
    pub rotation: ActionRotation,
    /// Frame of absolute actions.
    pub frame: ActionFrame,
    /// Pose of that frame in the world frame: position in metres and quaternion (x, y, z, w).
    pub base: [f64; 7],
    /// Range of gripper commands.
    pub gripper: GripperRange,
}

impl Default for ActionReading {
    /// The conversion for actions as robosuite writes them: the identity.
    fn default() -> Self {
        Self {
            scale: ActionScale::Controller,
            gain: [1.0; 6],
            offset: [0.0; 6],
            rotation: ActionRotation::Forward,
            frame: ActionFrame::World,
            base: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            gripper: GripperRange::MinusOneOne,
        }
    }
}

impl ActionReading {
    /// The conversion that the settings ask for.
    ///
    /// # Errors
    /// If settings exclude each other, or one of them needs a controller or base that the file does not give.
    pub(super) fn of(
        settings: &Settings,
        controls: Option<&Controls>,
        base: Option<&Isometry3<f64>>,
    ) -> Result<Self, Unproven> {
        let refuse = |why: &str| Err(Unproven::Settings(why.to_owned()));
        let mut reading = Self {
            rotation: settings.action_rotation.unwrap_or_default(),
            gripper: settings.gripper_range.unwrap_or_default(),
            ..Self::default()
        };
        let numbers = settings.action_gain.is_some() || settings.action_offset.is_some();
        let of_deltas = settings.states_scale() || settings.action_rotation == Some(ActionRotation::Reversed);
        if of_deltas && settings.action_kind == Some(ActionKind::Absolute) {
            return refuse(
                "action_scale, action_gain, action_offset and action_rotation apply to deltas only, but action_kind is \"absolute\"; remove one of them",
            );
        }
        let of_goals = settings.action_frame == Some(ActionFrame::Base);
        if of_goals && (of_deltas || settings.action_kind == Some(ActionKind::Delta)) {
            return refuse(
                "action_frame applies to absolute actions only, but other settings apply to deltas; remove one of them",
            );
        }
        let all = settings.action_gain.iter().chain(&settings.action_offset).flatten();
        if all.into_iter().any(|value| !value.is_finite())
            || settings.action_gain.is_some_and(|gain| gain.contains(&0.0))
        {
            return refuse(
                "action_gain or action_offset has a number that is not finite, or a gain is 0; give finite numbers and gains other than 0",
            );
        }
        match (settings.action_scale, numbers) {
            (Some(ActionScale::Controller | ActionScale::Metres), true) => {
                return refuse(
                    "action_gain or action_offset is set, but action_scale names another scale; remove one of them, or set action_scale = \"numbers\"",
                );
            }
            (Some(ActionScale::Numbers), false) => {
                return refuse(
                    "action_scale = \"numbers\" needs action_gain or action_offset; set them to six numbers each",
                );
            }
            (Some(ActionScale::Metres), false) => match controls {
                Some(controls) => reading = reading.metres(&controls.osc),
                None => {
                    return refuse(
                        "action_scale = \"metres\" needs the controller's output_max, which env_args does not declare; add it to env_args",
                    );
                }
            },
            (_, true) => {
                reading.scale = ActionScale::Numbers;
                reading.gain = settings.action_gain.unwrap_or(reading.gain);
                reading.offset = settings.action_offset.unwrap_or(reading.offset);
            }
            (Some(ActionScale::Controller) | None, false) => {}
        }
        if of_goals {
            match base {
                Some(base) => reading = reading.in_base(base),
                None => {
                    return refuse(
                        "action_frame = \"base\" needs the pose of the body robot0_base from the attribute model_file, which is missing; restore it",
                    );
                }
            }
        }
        Ok(reading)
    }

    /// This conversion for deltas in metres and radians per step.
    #[must_use]
    pub fn metres(self, osc: &Osc) -> Self {
        let (gain, offset) = osc.commands_of_motion();
        Self {
            scale: ActionScale::Metres,
            gain,
            offset,
            ..self
        }
    }

    /// This conversion for goals in the frame of a base, whose pose in the world frame is given.
    #[must_use]
    pub fn in_base(self, base: &Isometry3<f64>) -> Self {
        let [x, y, z]: [f64; 3] = base.translation.vector.into();
        let [qx, qy, qz, qw]: [f64; 4] = base.rotation.coords.into();
        Self {
            frame: ActionFrame::Base,
            base: [x, y, z, qx, qy, qz, qw],
            ..self
        }
    }

    /// Whether the conversion leaves all actions unchanged.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        let neutral = Self {
            scale: self.scale,
            base: self.base,
            ..Self::default()
        };
        *self == neutral
    }

    /// Converts a recorded action to the one that robosuite's own files would contain: controller commands or a goal in the
    /// world frame, and a gripper command of which only the sign matters.
    #[must_use]
    pub fn read(&self, recorded: &Action) -> Action {
        let mut action = *recorded;
        if self.gain != [1.0; 6] || self.offset != [0.0; 6] {
            for (axis, value) in action[..6].iter_mut().enumerate() {
                *value = *value * self.gain[axis] + self.offset[axis];
            }
        }
        if self.rotation == ActionRotation::Reversed {
            // Subtraction instead of negation keeps zeros positive. The bits of a zero command do not change.
            action[3..6].iter_mut().for_each(|value| *value = 0.0 - *value);
        }
        if self.frame == ActionFrame::Base {
            let [x, y, z, qx, qy, qz, qw] = self.base;
            let world_from_base = UnitQuaternion::new_normalize(Quaternion::new(qw, qx, qy, qz));
            let base = Isometry3::from_parts(Translation3::new(x, y, z), world_from_base);
            let position = base.rotation * actions::position(recorded) + Vector3::new(x, y, z);
            action[..3].copy_from_slice(position.as_slice());
            // If the base is not rotated, the rotation vector stays as it was recorded. Converting it would wrap vectors longer
            // than pi.
            if world_from_base.angle() > 1e-9 {
                let rotation = (world_from_base * actions::rotation(recorded)).scaled_axis();
                action[3..6].copy_from_slice(rotation.as_slice());
            }
        }
        if self.gripper == GripperRange::ZeroOne {
            action[6] = 2.0 * action[6] - 1.0;
        }
        action
    }
}

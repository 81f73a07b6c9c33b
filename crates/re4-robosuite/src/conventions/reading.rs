//! How recorded actions become those of robosuite's own files.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ActionKind, Controls, Settings, Unproven};
use crate::actions::{self, Action, Osc};

/// Unit of the first six columns of delta actions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionScale {
    /// The controller's own: its maximum command (1) means `output_max`.
    #[default]
    Controller,
    /// Metres and radians a step.
    Metres,
    /// Another one, which the settings `action_gain` and `action_offset` take to the controller's.
    Numbers,
}

/// Frame that absolute actions are given in.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionFrame {
    /// The world.
    #[default]
    World,
    /// The robot's base (body `robot0_base` of the model).
    Base,
}

/// Which way a delta action turns the hand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionRotation {
    /// By its rotation vector: robosuite since 1.2.
    #[default]
    Forward,
    /// By the opposite of its rotation vector: robosuite 1.0, as its recordings show.
    Reversed,
}

/// What gripper commands go from and to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GripperRange {
    /// -1 and 1; the sign decides, and 0 holds the fingers where they are.
    #[default]
    MinusOneOne,
    /// 0 and 1; 0 is the opposite of 1.
    ZeroOne,
}

/// The pose that the controller holds before the first step. Without a rotation command its orientation stays the goal.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum InitialGoal {
    /// That of the robot's reset, without noise: robosuite's collector and robomimic load each scene into a robot that was
    /// just reset.
    ResetPose,
    /// That of the first frame.
    #[default]
    FirstPose,
}

/// How recorded actions are read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ActionReading {
    /// Unit of delta actions.
    pub scale: ActionScale,
    /// Factor from a recorded delta to the controller's command.
    pub gain: [f64; 6],
    /// What is added after that, in commands.
    pub offset: [f64; 6],
    /// Which way deltas turn.
    pub rotation: ActionRotation,
    /// Frame of absolute actions.
    pub frame: ActionFrame,
    /// Position and quaternion (x, y, z, w) of that frame in the world.
    pub base: [f64; 7],
    /// Range of the gripper's command.
    pub gripper: GripperRange,
}

impl Default for ActionReading {
    /// Actions as robosuite writes them.
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
    /// How the settings say that actions are to be read.
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
                "action_scale, action_gain, action_offset and action_rotation are about deltas, and action_kind is \"absolute\"; remove one of them",
            );
        }
        let of_goals = settings.action_frame == Some(ActionFrame::Base);
        if of_goals && (of_deltas || settings.action_kind == Some(ActionKind::Delta)) {
            return refuse(
                "action_frame is about absolute actions, and other settings are about deltas; remove one of them",
            );
        }
        let all = settings.action_gain.iter().chain(&settings.action_offset).flatten();
        if all.into_iter().any(|value| !value.is_finite())
            || settings.action_gain.is_some_and(|gain| gain.contains(&0.0))
        {
            return refuse("action_gain and action_offset hold six finite numbers, and gains are not 0; correct them");
        }
        match (settings.action_scale, numbers) {
            (Some(ActionScale::Controller | ActionScale::Metres), true) => {
                return refuse(
                    "action_gain and action_offset say how actions are scaled, and action_scale names another scale; remove one of them, or set action_scale = \"numbers\"",
                );
            }
            (Some(ActionScale::Numbers), false) => {
                return refuse(
                    "action_scale = \"numbers\" needs action_gain or action_offset, six numbers each; give them",
                );
            }
            (Some(ActionScale::Metres), false) => match controls {
                Some(controls) => reading = reading.metres(&controls.osc),
                None => {
                    return refuse(
                        "action_scale = \"metres\" needs the controller's output_max, which env_args does not declare; restore it",
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
                        "action_frame = \"base\" needs the pose of the robot's base, body robot0_base of the attribute model_file, which is not there; restore it",
                    );
                }
            }
        }
        Ok(reading)
    }

    /// Deltas in metres and radians a step.
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

    /// Goals in the frame of this base.
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

    /// Whether actions stay as they are.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        let neutral = Self {
            scale: self.scale,
            base: self.base,
            ..Self::default()
        };
        *self == neutral
    }

    /// A recorded action as robosuite's own: commands of the controller or goals in the world, and a gripper command whose
    /// sign decides.
    #[must_use]
    pub fn read(&self, recorded: &Action) -> Action {
        let mut action = *recorded;
        if self.gain != [1.0; 6] || self.offset != [0.0; 6] {
            for (axis, value) in action[..6].iter_mut().enumerate() {
                *value = *value * self.gain[axis] + self.offset[axis];
            }
        }
        if self.rotation == ActionRotation::Reversed {
            // Not negated: what is zero stays a positive zero.
            action[3..6].iter_mut().for_each(|value| *value = 0.0 - *value);
        }
        if self.frame == ActionFrame::Base {
            let [x, y, z, qx, qy, qz, qw] = self.base;
            let turn = UnitQuaternion::new_normalize(Quaternion::new(qw, qx, qy, qz));
            let base = Isometry3::from_parts(Translation3::new(x, y, z), turn);
            let position = base.rotation * actions::position(recorded) + Vector3::new(x, y, z);
            action[..3].copy_from_slice(position.as_slice());
            // A base that is not turned leaves the rotation vector as it was recorded, beyond half a turn, too.
            if turn.angle() > 1e-9 {
                let rotation = (turn * actions::rotation(recorded)).scaled_axis();
                action[3..6].copy_from_slice(rotation.as_slice());
            }
        }
        if self.gripper == GripperRange::ZeroOne {
            action[6] = 2.0 * action[6] - 1.0;
        }
        action
    }
}

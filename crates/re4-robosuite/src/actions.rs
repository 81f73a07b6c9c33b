//! Conversion between delta actions and absolute goals of robosuite's operational-space controller (`OSC_POSE`).
//!
//! A delta action consists of a translation `t` and a rotation vector `r` in world axes, each within [-1, 1], and the gripper
//! command. Its goal is `p_goal = p_site + t * output_max[..3]`, `R_goal = exp(r * output_max[3..]) R_site`. An absolute action
//! is the goal itself: position (metres) and rotation vector (radians) of the grip site in the world frame, and the gripper
//! command.
//!
//! A delta with zero rotation leaves the goal orientation unchanged: it remains the orientation of the last goal, not the
//! current orientation of the site. Therefore the conversion needs all steps of a demonstration in order, from the first one.
//! Source: robosuite 1.4.1, `controllers/osc.py` (`set_goal`). The orientation of the grip site follows from the recorded one
//! with [`hand_from_site`](crate::hand_from_site).

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::env_args::EnvArgs;

/// An action: translation or position (3), rotation vector (3), gripper command (1).
pub type Action = [f64; 7];

/// Maximum angle (radians) between two goals that count as the same orientation.
const SAME_ORIENTATION: f64 = 1e-9;

/// Reasons why actions cannot be converted.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ActionError {
    /// The scales of the controller are not declared.
    #[error(
        "env_args declares no {0} of the controller, so the size of its steps is unknown: only OSC_POSE actions with declared scales can be converted"
    )]
    NoScale(&'static str),
    /// The controller is not `OSC_POSE`.
    #[error("env_args declares the controller {0}, but only OSC_POSE actions can be converted")]
    Kind(String),
    /// The minimum of a scale is not below its maximum, or one of them is not finite.
    #[error("the range of the controller's axis {axis} is {min} to {max}, which is not a valid range")]
    Range {
        /// Index of the axis, 0 to 5.
        axis: usize,
        /// Its minimum value.
        min: f64,
        /// Its maximum value.
        max: f64,
    },
    /// The numbers of actions and poses differ.
    #[error("there are {actions} actions but {poses} poses of the grip site")]
    Lengths {
        /// Number of actions.
        actions: usize,
        /// Number of poses.
        poses: usize,
    },
    /// A number is NaN or infinite.
    #[error("actions[{frame}, {column}] is {value}, not a finite number")]
    NotFinite {
        /// Row.
        frame: usize,
        /// Column.
        column: usize,
        /// The number.
        value: f64,
    },
}

/// The scales of an `OSC_POSE` controller: the motions that its minimum and maximum commands mean.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Osc {
    /// Minimum command of each axis.
    input_min: [f64; 6],
    /// Maximum command of each axis.
    input_max: [f64; 6],
    /// Motion (metres or radians per step) per unit of command.
    gain: [f64; 6],
    /// Command in the middle of its range.
    input_middle: [f64; 6],
    /// Motion (metres or radians per step) for the command in the middle of its range.
    output_middle: [f64; 6],
}

impl Osc {
    /// A controller whose commands in [-1, 1] mean up to `position` metres and `rotation` radians per step on each axis.
    ///
    /// # Errors
    /// If a scale is not a finite number above zero.
    pub fn symmetric(position: f64, rotation: f64) -> Result<Self, ActionError> {
        let max = [position, position, position, rotation, rotation, rotation];
        Self::new([-1.0; 6], [1.0; 6], max.map(|value| -value), max)
    }

    /// The controller that a file declares.
    ///
    /// Rotated bases are not supported: the robots in robosuite's single-arm tasks are not rotated.
    ///
    /// # Errors
    /// If the controller is not `OSC_POSE` or declares no scales.
    pub fn from_env(env: &EnvArgs) -> Result<Self, ActionError> {
        let controller = env
            .controller
            .as_ref()
            .ok_or(ActionError::NoScale("controller_configs"))?;
        if let Some(kind) = controller.kind.as_ref().filter(|kind| *kind != "OSC_POSE") {
            return Err(ActionError::Kind(kind.clone()));
        }
        let output_max = controller.output_max.ok_or(ActionError::NoScale("output_max"))?;
        let output_min = controller.output_min.unwrap_or(output_max.map(|value| -value));
        Self::new(controller.input_min, controller.input_max, output_min, output_max)
    }

    fn new(
        input_min: [f64; 6],
        input_max: [f64; 6],
        output_min: [f64; 6],
        output_max: [f64; 6],
    ) -> Result<Self, ActionError> {
        for (min, max) in [(&input_min, &input_max), (&output_min, &output_max)] {
            for (axis, (&min, &max)) in min.iter().zip(max).enumerate() {
                if !(min.is_finite() && max.is_finite() && min < max) {
                    return Err(ActionError::Range { axis, min, max });
                }
            }
        }
        let by_axis = |value: &dyn Fn(usize) -> f64| std::array::from_fn(value);
        Ok(Self {
            input_min,
            input_max,
            gain: by_axis(&|i| (output_max[i] - output_min[i]) / (input_max[i] - input_min[i])),
            input_middle: by_axis(&|i| f64::midpoint(input_max[i], input_min[i])),
            output_middle: by_axis(&|i| f64::midpoint(output_max[i], output_min[i])),
        })
    }

    /// The motion that a command asks for: metres (0..3) and radians (3..6) per step. Commands outside the controller's range
    /// are clipped, as in robosuite.
    #[must_use]
    pub fn motion(&self, action: &Action) -> [f64; 6] {
        std::array::from_fn(|i| {
            let command = action[i].clamp(self.input_min[i], self.input_max[i]);
            (command - self.input_middle[i]) * self.gain[i] + self.output_middle[i]
        })
    }

    /// Converts a delta action in the axes of a base to one in world axes. `base` is the orientation of the base in the world frame.
    /// The command is clipped in the axes of the base first, as the controller does, so that in world axes it can be longer than the
    /// maximum of one axis. Returns `None` unless the scales are the same on all axes of translation and on all axes of rotation,
    /// without an offset.
    #[must_use]
    pub fn in_world_axes(&self, action: &Action, base: &UnitQuaternion<f64>) -> Option<Action> {
        let same = |numbers: &[f64; 6]| numbers[..3] == [numbers[0]; 3] && numbers[3..] == [numbers[3]; 3];
        if !same(&self.gain) || self.input_middle != [0.0; 6] || self.output_middle != [0.0; 6] {
            return None;
        }
        let clipped: [f64; 6] = std::array::from_fn(|i| action[i].clamp(self.input_min[i], self.input_max[i]));
        let [x, y, z, rx, ry, rz] = clipped;
        Some(join(
            base * Vector3::new(x, y, z),
            base * Vector3::new(rx, ry, rz),
            action[6],
        ))
    }

    /// The motion per unit of command on each axis: metres (0..3) and radians (3..6) per step.
    #[must_use]
    pub fn unit(&self) -> [f64; 6] {
        self.gain
    }

    /// The gain and the offset of each axis that convert a motion (metres and radians per step) to its command:
    /// `command = gain * motion + offset`.
    #[must_use]
    pub fn commands_of_motion(&self) -> ([f64; 6], [f64; 6]) {
        let gain = self.gain.map(|gain| 1.0 / gain);
        let offset = std::array::from_fn(|i| self.input_middle[i] - self.output_middle[i] / self.gain[i]);
        (gain, offset)
    }

    /// The command that asks for a motion, without clipping.
    fn command(&self, motion: [f64; 6]) -> [f64; 6] {
        std::array::from_fn(|i| (motion[i] - self.output_middle[i]) / self.gain[i] + self.input_middle[i])
    }

    /// Converts the delta actions of a demonstration to absolute actions. The actions must be in order from the first step.
    ///
    /// `site[t]` is the grip site's pose in the world frame at the observation of action `t`. `initial` is the pose that the
    /// controller holds before the first step, or `None` for `site[0]`. In demonstrations that start from a recorded state, the
    /// controller holds a stale pose in the first step: the pose of the robot before that state was loaded.
    ///
    /// # Errors
    /// If the lengths differ or an action is not finite.
    pub fn to_absolute(
        &self,
        delta: &[Action],
        site: &[Isometry3<f64>],
        initial: Option<&Isometry3<f64>>,
    ) -> Result<Vec<Action>, ActionError> {
        check(delta, site)?;
        let mut held = initial
            .or(site.first())
            .map_or_else(UnitQuaternion::identity, |pose| pose.rotation);
        let steps = delta.iter().zip(site).enumerate();
        Ok(steps
            .map(|(t, (action, site))| {
                let site = if t == 0 { initial.unwrap_or(site) } else { site };
                let motion = self.motion(action);
                let [x, y, z, rx, ry, rz] = motion;
                if [rx, ry, rz] != [0.0; 3] {
                    held = UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz)) * site.rotation;
                }
                let position = site.translation.vector + Vector3::new(x, y, z);
                join(position, held.scaled_axis(), action[6])
            })
            .collect())
    }

    /// Converts the absolute actions of a demonstration to delta actions: the inverse of [`Osc::to_absolute`]. The actions must be
    /// in order from the first step.
    ///
    /// An unchanged goal orientation becomes a delta without rotation. Commands are not clipped, so they can be outside the
    /// controller's range. Such goals have no exact delta.
    ///
    /// # Errors
    /// If the lengths differ or an action is not finite.
    pub fn to_delta(
        &self,
        absolute: &[Action],
        site: &[Isometry3<f64>],
        initial: Option<&Isometry3<f64>>,
    ) -> Result<Vec<Action>, ActionError> {
        check(absolute, site)?;
        let mut held = initial
            .or(site.first())
            .map_or_else(UnitQuaternion::identity, |pose| pose.rotation);
        let steps = absolute.iter().zip(site).enumerate();
        Ok(steps
            .map(|(t, (action, site))| {
                let site = if t == 0 { initial.unwrap_or(site) } else { site };
                let goal = rotation(action);
                let mut rotation = Vector3::zeros();
                if goal.angle_to(&held) > SAME_ORIENTATION {
                    rotation = (goal * site.rotation.inverse()).scaled_axis();
                    if rotation == Vector3::zeros() {
                        // A delta of exactly zero would keep the orientation of the last goal.
                        rotation.x = SAME_ORIENTATION;
                    }
                }
                held = goal;
                let shift = position(action) - site.translation.vector;
                let command = self.command([shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z]);
                join(
                    Vector3::new(command[0], command[1], command[2]),
                    Vector3::new(command[3], command[4], command[5]),
                    action[6],
                )
            })
            .collect())
    }
}

/// Checks that there is one pose per action and all numbers are finite.
fn check(actions: &[Action], site: &[Isometry3<f64>]) -> Result<(), ActionError> {
    if actions.len() != site.len() {
        return Err(ActionError::Lengths {
            actions: actions.len(),
            poses: site.len(),
        });
    }
    for (frame, action) in actions.iter().enumerate() {
        if let Some(column) = action.iter().position(|value| !value.is_finite()) {
            let value = action[column];
            return Err(ActionError::NotFinite { frame, column, value });
        }
    }
    Ok(())
}

fn join(first: Vector3<f64>, second: Vector3<f64>, gripper: f64) -> Action {
    [first.x, first.y, first.z, second.x, second.y, second.z, gripper]
}

/// Goal position (metres) of an absolute action.
#[must_use]
pub fn position(absolute: &Action) -> Vector3<f64> {
    Vector3::new(absolute[0], absolute[1], absolute[2])
}

/// Goal orientation of an absolute action.
#[must_use]
pub fn rotation(absolute: &Action) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(absolute[3], absolute[4], absolute[5]))
}

/// Distance (metres) and angle (radians) between two absolute actions. It compares orientations, because rotation vectors with
/// opposite signs mean nearly the same orientation if their angles are near 180 degrees.
#[must_use]
pub fn distance(a: &Action, b: &Action) -> (f64, f64) {
    ((position(a) - position(b)).norm(), rotation(a).angle_to(&rotation(b)))
}

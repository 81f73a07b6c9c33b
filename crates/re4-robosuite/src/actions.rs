//! Actions of robosuite's operational-space controller (`OSC_POSE`): deltas to absolute goals and back.
//!
//! A delta action is a translation and a rotation vector in world axes, each within [-1, 1], and the gripper's command. It
//! makes the goal `p_goal = p_site + t * output_max[..3]`, `R_goal = exp(r * output_max[3..]) R_site`. An absolute action is
//! the goal itself: position in metres, rotation vector of the grip site's orientation, gripper's command, all in the world.
//!
//! A delta without any rotation leaves the goal's orientation where it was: not at the site's orientation, but at the last
//! goal. So conversion needs a demo in order, from its first step. Source: robosuite 1.4.1, `controllers/osc.py`
//! (`set_goal`); the rotation of the grip site is [`hand_to_site`](crate::hand_to_site) from the recorded one.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::env_args::EnvArgs;

/// An action: translation or position, rotation vector, gripper.
pub type Action = [f64; 7];

/// Goals closer than this (in radians) count as the same orientation.
const SAME_ORIENTATION: f64 = 1e-9;

/// Why actions cannot be converted.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ActionError {
    /// The controller's scales are not declared.
    #[error(
        "env_args declares no {0} of the controller, so the size of its steps is unknown: only OSC_POSE with its scales can be converted"
    )]
    NoScale(&'static str),
    /// The controller is of another kind.
    #[error("env_args declares the controller {0}, but only OSC_POSE actions can be converted")]
    Kind(String),
    /// The scales are not usable.
    #[error("the controller's axis {axis} goes from {min} to {max}, which is no range")]
    Range {
        /// Index of the axis, 0 to 5.
        axis: usize,
        /// Its minimum value.
        min: f64,
        /// Its maximum value.
        max: f64,
    },
    /// Actions and poses do not belong together.
    #[error("there are {actions} actions but {poses} poses of the grip site")]
    Lengths {
        /// Number of actions.
        actions: usize,
        /// Number of poses.
        poses: usize,
    },
    /// A number that is NaN or infinite.
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

/// The scales of an `OSC_POSE` controller: what its minimum and maximum commands mean.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Osc {
    input_min: [f64; 6],
    input_max: [f64; 6],
    gain: [f64; 6],
    input_middle: [f64; 6],
    output_middle: [f64; 6],
}

impl Osc {
    /// A controller whose commands in [-1, 1] mean at most `position` metres and `rotation` radians a step on each axis.
    ///
    /// # Errors
    /// When a scale is not a number above zero.
    pub fn symmetric(position: f64, rotation: f64) -> Result<Self, ActionError> {
        let max = [position, position, position, rotation, rotation, rotation];
        Self::new([-1.0; 6], [1.0; 6], max.map(|value| -value), max)
    }

    /// The controller that a file declares.
    ///
    /// The axes of a rotated base are not known here: robosuite's single-arm tasks have none.
    ///
    /// # Errors
    /// When it is no `OSC_POSE` or declares no scales.
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

    /// Metres (0..3) and radians (3..6) that a command asks for; commands beyond the controller's range are cut, as it does.
    #[must_use]
    pub fn motion(&self, action: &Action) -> [f64; 6] {
        std::array::from_fn(|i| {
            let command = action[i].clamp(self.input_min[i], self.input_max[i]);
            (command - self.input_middle[i]) * self.gain[i] + self.output_middle[i]
        })
    }

    /// Metres and radians a step that a command of 1 adds to one of 0, on each axis.
    #[must_use]
    pub fn unit(&self) -> [f64; 6] {
        self.gain
    }

    /// Gain and offset of each axis that take metres and radians a step to the commands that ask for them.
    #[must_use]
    pub fn commands_of_motion(&self) -> ([f64; 6], [f64; 6]) {
        let gain = self.gain.map(|gain| 1.0 / gain);
        let offset = std::array::from_fn(|i| self.input_middle[i] - self.output_middle[i] / self.gain[i]);
        (gain, offset)
    }

    /// The command that asks for a motion, not cut.
    fn command(&self, motion: [f64; 6]) -> [f64; 6] {
        std::array::from_fn(|i| (motion[i] - self.output_middle[i]) / self.gain[i] + self.input_middle[i])
    }

    /// Absolute actions of a demo's delta actions, in order from its first step.
    ///
    /// `site[t]` is the grip site's pose at the observation of action `t`. `initial` is the pose that the controller holds
    /// before the first step; none takes `site[0]`. Demos that were reset to a recorded state have a stale one at their first
    /// step: the robot's pose before that reset.
    ///
    /// # Errors
    /// When lengths differ or an action is not finite.
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

    /// Delta actions of a demo's absolute actions, in order from its first step: the inverse of [`Osc::to_absolute`].
    ///
    /// A goal orientation that stays as it was becomes a delta without rotation. Commands are not cut: one beyond the
    /// controller's range has no exact delta.
    ///
    /// # Errors
    /// When lengths differ or an action is not finite.
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
                let mut turn = Vector3::zeros();
                if goal.angle_to(&held) > SAME_ORIENTATION {
                    turn = (goal * site.rotation.inverse()).scaled_axis();
                    if turn == Vector3::zeros() {
                        // No rotation at all would mean to hold the last goal instead.
                        turn.x = SAME_ORIENTATION;
                    }
                }
                held = goal;
                let shift = position(action) - site.translation.vector;
                let command = self.command([shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]);
                join(
                    Vector3::new(command[0], command[1], command[2]),
                    Vector3::new(command[3], command[4], command[5]),
                    action[6],
                )
            })
            .collect())
    }
}

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

/// Position of an absolute action.
#[must_use]
pub fn position(absolute: &Action) -> Vector3<f64> {
    Vector3::new(absolute[0], absolute[1], absolute[2])
}

/// Orientation of an absolute action.
#[must_use]
pub fn rotation(absolute: &Action) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(absolute[3], absolute[4], absolute[5]))
}

/// Distance between two absolute actions: metres and radians. Rotation vectors near a half turn differ in sign and mean the
/// same orientation; this compares orientations.
#[must_use]
pub fn distance(a: &Action, b: &Action) -> (f64, f64) {
    ((position(a) - position(b)).norm(), rotation(a).angle_to(&rotation(b)))
}

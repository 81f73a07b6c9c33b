//! The conventions of a file as typed values, each with the evidence for it.
//!
//! For every convention, each hypothesis gets a residual that is computed from the numbers in the file. A hypothesis is
//! accepted if it fits ([`Evidence::threshold`]) and all others clearly do not ([`MARGIN`]). If the data does not decide, an
//! explicit setting is required. A setting that clearly contradicts the data is refused.
//!
//! Proven conventions are compared with what the file declares. If the proven object layout, quaternion order or gripper sign
//! differs from what the declared version of robosuite writes, the file is refused unless a setting names the proven value:
//! some other tool has rewritten the file, and a policy that runs in the declared environment would meet the other convention
//! there. If the proven kind of action differs from the declared one, there is only a warning, because converters to absolute
//! actions leave `control_delta` unchanged.

mod commands;
mod demo;
mod detect;
mod eef;
mod evidence;
mod frames;
mod goals;
mod gripper;
mod monitor;
mod opening;
mod reading;
mod residuals;
mod response;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use commands::Controls;
pub use demo::{DemoArrays, Rows, zero_rows};
pub use detect::{Detection, RefusedDemo};
pub use evidence::{Basis, Candidate, Evidence, MARGIN, Proof};
pub use frames::{BasedDeltas, delta_frame};
pub use monitor::{Contradiction, DemoResiduals, QUATERNION_TOLERANCE};
pub use re4_task::{ObjectLayout, RobosuiteTask};
pub use reading::{ActionFrame, ActionReading, ActionRotation, ActionScale, GripperRange, InitialGoal};
pub use response::Response;

use crate::hand_from_site;

/// The frame whose orientation `obs/robot0_eef_quat` stores. The two frames differ by [`hand_from_site`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EefOrientation {
    /// The hand body.
    HandBody,
    /// The grip site, which is the frame that the controller controls.
    GripSite,
}

/// Position of the scalar part in a stored quaternion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum QuaternionOrder {
    /// Scalar last, as in robosuite's observations.
    Xyzw,
    /// Scalar first, as in `MuJoCo`'s states.
    Wxyz,
}

/// Meaning of the first six columns of `actions`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionKind {
    /// Relative motions: commands in [-1, 1] that the controller scales.
    Delta,
    /// Goal poses in the world frame: position in metres and a rotation vector in radians.
    Absolute,
}

/// Effect of a positive gripper command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GripperSign {
    /// A positive command closes the fingers.
    PositiveCloses,
    /// A positive command opens the fingers.
    PositiveOpens,
}

/// Delay of the relative part of `obs/object`. It is not proven: if several values fit, `Current` is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RelativeLag {
    /// Both poses come from the same row.
    Current,
    /// The object pose comes from the previous row, as in live robosuite 1.5. The first row, which has no previous one,
    /// contains zeros.
    ObjectOneLate,
    /// Both poses come from the previous row.
    BothOneLate,
}

/// Conventions that the user sets explicitly. All others are detected from the data.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Order of the parts of `obs/object`.
    pub object_layout: Option<ObjectLayout>,
    /// Frame whose orientation `obs/robot0_eef_quat` stores.
    pub eef_orientation: Option<EefOrientation>,
    /// Component order of `obs/robot0_eef_quat`.
    pub eef_quaternion: Option<QuaternionOrder>,
    /// Component order of the quaternions in `obs/object`.
    pub object_quaternion: Option<QuaternionOrder>,
    /// Kind of the arm columns of `actions`: deltas or absolute goals.
    pub action_kind: Option<ActionKind>,
    /// Effect of a positive gripper command.
    pub gripper_sign: Option<GripperSign>,
    /// Accepts delta actions outside [-1, 1], which the controller clips. Files from robosuite's own collector contain such
    /// actions; robomimic does not allow them.
    pub allow_actions_beyond_range: bool,
    /// Unit of delta actions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_scale: Option<ActionScale>,
    /// Six factors (translation x, y, z, then rotation x, y, z) that convert recorded deltas to controller commands:
    /// `command = action_gain * recorded + action_offset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_gain: Option<[f64; 6]>,
    /// Six offsets, in controller commands, that are added to the recorded deltas after they are multiplied by `action_gain`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_offset: Option<[f64; 6]>,
    /// Direction in which delta actions rotate the end effector.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_rotation: Option<ActionRotation>,
    /// Frame of absolute actions, and of the delta actions of robosuite 1.5 if the robot's base is rotated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_frame: Option<ActionFrame>,
    /// Range of gripper commands.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gripper_range: Option<GripperRange>,
    /// Pose that the controller holds before the first step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_goal: Option<InitialGoal>,
}

impl Settings {
    /// Whether the unit of delta actions is set.
    fn states_scale(&self) -> bool {
        self.action_scale.is_some() || self.action_gain.is_some() || self.action_offset.is_some()
    }
}

/// The conventions of a file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Conventions {
    /// The task, or `None` for environments whose object vector is not known.
    pub task: Option<RobosuiteTask>,
    /// Order of the parts of `obs/object`, or `None` for other tasks and files without that dataset.
    pub object_layout: Option<ObjectLayout>,
    /// Delay of the relative part of `obs/object`.
    pub relative_lag: RelativeLag,
    /// Frame whose orientation `obs/robot0_eef_quat` stores.
    pub eef_orientation: EefOrientation,
    /// Component order of `obs/robot0_eef_quat`.
    pub eef_quaternion: QuaternionOrder,
    /// Component order of the quaternions in `obs/object`, or `None` for other tasks and files without that dataset.
    pub object_quaternion: Option<QuaternionOrder>,
    /// Kind of the arm columns of `actions`.
    pub action_kind: ActionKind,
    /// Effect of a positive gripper command.
    pub gripper_sign: GripperSign,
    /// Whether the conventions of the end effector are proven from the data. If they are not, the residuals are measured, but
    /// no demonstration is refused because of them.
    pub eef_proven: bool,
    /// Whether the conventions of the object vector are proven from the data, with the same effect.
    pub object_proven: bool,
    /// Value of the setting with the same name.
    pub allow_actions_beyond_range: bool,
    /// Conversion of recorded actions to controller commands or goals.
    pub actions: ActionReading,
    /// Pose that the controller holds before the first step.
    pub initial_goal: InitialGoal,
    /// The controller that the file declares, or `None` if the file declares no scales. Without it, actions are not compared
    /// with the end effector's motion.
    pub controls: Option<Controls>,
}

/// Reasons why the conventions of a file cannot be determined.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Unproven {
    /// The data fits no hypothesis or several, or there is too little data.
    #[error("the convention {convention} is not proven: {why} ({residuals}); if you know it, set {setting}")]
    Undecided {
        /// The convention.
        convention: &'static str,
        /// Why the data does not decide.
        why: String,
        /// The hypotheses and their residuals.
        residuals: String,
        /// The settings that would accept a hypothesis.
        setting: String,
    },
    /// The data proves a convention that differs from the declared one.
    #[error(
        "the data proves that the convention {convention} is {proven} ({residuals}), but {declared_by}, which writes {declared}: the file differs from its declaration; set {convention} = \"{proven}\" to accept the file as it is"
    )]
    Declared {
        /// The convention.
        convention: &'static str,
        /// The value that the data proves.
        proven: String,
        /// The value that follows from the declaration.
        declared: String,
        /// A clause that names the declaration.
        declared_by: String,
        /// The hypotheses and their residuals.
        residuals: String,
    },
    /// The data contradicts a setting.
    #[error(
        "the setting {setting} is contradicted by the data: {convention} is {proven} ({residuals}); remove the setting"
    )]
    Setting {
        /// The convention.
        convention: &'static str,
        /// The setting as given.
        setting: String,
        /// The value that the data supports.
        proven: String,
        /// The hypotheses and their residuals.
        residuals: String,
    },
    /// The actions do not follow the conventions.
    #[error("{what} ({evidence}); {fix}")]
    Actions {
        /// The convention.
        convention: &'static str,
        /// What was found.
        what: String,
        /// The test and its numbers.
        evidence: String,
        /// The remedy.
        fix: String,
    },
    /// Settings that exclude each other.
    #[error("{0}")]
    Settings(String),
    /// Demonstrations that contradict the others. Without them everything is proven.
    #[error("{}", listed(.0))]
    RefusedDemo(Vec<RefusedDemo>),
    /// A demonstration whose numbers cannot be used at all.
    #[error(transparent)]
    Demo(#[from] Contradiction),
}

/// All refused demonstrations with the reasons, in one line.
fn listed(odd: &[RefusedDemo]) -> String {
    let each: Vec<String> = odd.iter().map(|odd| format!("{}: {}", odd.demo, odd.why)).collect();
    each.join("; ")
}

/// The parts of a row of `obs/object`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectRow {
    /// Object pose in the world frame (metres), with the quaternion normalised.
    pub pose: Isometry3<f64>,
    /// Object position as stored.
    pub position: [f64; 3],
    /// Object quaternion as stored, in the file's order.
    pub quaternion: [f64; 4],
    /// Relative position as stored: in the world frame for Lift, in the hand body's frame for Can and Square.
    pub relative_position: [f64; 3],
    /// Relative quaternion as stored, in the file's order, or `None` for Lift.
    pub relative_quaternion: Option<[f64; 4]>,
}

impl QuaternionOrder {
    /// Converts a stored quaternion to a rotation. Returns `None` if its norm is zero or a component is not finite.
    #[must_use]
    pub fn rotation(self, stored: [f64; 4]) -> Option<UnitQuaternion<f64>> {
        let [a, b, c, d] = stored;
        let quaternion = match self {
            Self::Xyzw => Quaternion::new(d, a, b, c),
            Self::Wxyz => Quaternion::new(a, b, c, d),
        };
        let finite = quaternion.coords.iter().all(|value| value.is_finite());
        UnitQuaternion::try_new(quaternion, 1e-9).filter(|_| finite)
    }
}

impl EefOrientation {
    /// The orientation of the hand body, given a stored orientation of this frame.
    #[must_use]
    pub fn hand(self, stored: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        match self {
            Self::HandBody => stored,
            Self::GripSite => stored * hand_from_site().inverse(),
        }
    }

    /// The orientation of the grip site, given a stored orientation of this frame.
    #[must_use]
    pub fn site(self, stored: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        match self {
            Self::HandBody => stored * hand_from_site(),
            Self::GripSite => stored,
        }
    }
}

fn pose(position: [f64; 3], rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(Vector3::from(position)), rotation)
}

/// `N` consecutive numbers of a row, beginning at a column. Returns `None` if the row is too short.
fn part<const N: usize>(row: &[f64], start: usize) -> Option<[f64; N]> {
    row.get(start..start + N)?.try_into().ok()
}

impl Conventions {
    /// Splits a row of `obs/object` into its parts. Returns `None` if the layout is not known, the row has another width, or
    /// the norm of the quaternion is zero.
    #[must_use]
    pub fn decompose(&self, row: &[f64]) -> Option<ObjectRow> {
        let layout = self.object_layout.filter(|layout| layout.columns() == row.len())?;
        let position = part(row, layout.pose_start())?;
        let quaternion = part(row, layout.pose_start() + 3)?;
        Some(ObjectRow {
            pose: pose(position, self.object_quaternion?.rotation(quaternion)?),
            position,
            quaternion,
            relative_position: part(row, layout.relative_start())?,
            relative_quaternion: part(row, layout.relative_start() + 3),
        })
    }

    /// Pose in the world frame with the orientation of the hand body and the position of the grip site: the frame of the
    /// relative object poses. Returns `None` if the norm of the quaternion is zero.
    #[must_use]
    pub fn hand_pose(&self, eef_pos: [f64; 3], eef_quat: [f64; 4]) -> Option<Isometry3<f64>> {
        let stored = self.eef_quaternion.rotation(eef_quat)?;
        Some(pose(eef_pos, self.eef_orientation.hand(stored)))
    }

    /// Pose of the grip site in the world frame, which is the frame of the controller's goals. Returns `None` if the norm of
    /// the quaternion is zero.
    #[must_use]
    pub fn site_pose(&self, eef_pos: [f64; 3], eef_quat: [f64; 4]) -> Option<Isometry3<f64>> {
        let stored = self.eef_quaternion.rotation(eef_quat)?;
        Some(pose(eef_pos, self.eef_orientation.site(stored)))
    }
}

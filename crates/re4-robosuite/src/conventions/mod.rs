//! Conventions of a file as typed summary, each with the evidence for it.
//!
//! For every convention, each hypothesis gets a residual from the numbers of the file. One is accepted when it fits
//! ([`Evidence::threshold`]) and every other clearly does not ([`MARGIN`]). What the data cannot tell needs an explicit
//! setting, and a setting against clear evidence is refused.
//!
//! What is proven is compared with what the file declares. A proven object layout, quaternion order or gripper sign other
//! than robosuite of the declared version writes is refused unless a setting names it: such a file has been through other
//! hands, and whoever runs a policy in the declared environment would meet the other convention there. A proven kind of
//! action other than declared is a warning only: converters to absolute actions keep `control_delta` as it was.

mod commands;
mod demo;
mod detect;
mod eef;
mod evidence;
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
pub use detect::{Learned, Odd};
pub use evidence::{Basis, Candidate, Evidence, MARGIN, Proof};
pub use monitor::{Contradiction, DemoResiduals, QUATERNION_TOLERANCE};
pub use re4_task::{ObjectLayout, RobosuiteTask};
pub use reading::{ActionFrame, ActionReading, ActionRotation, ActionScale, GripperRange, InitialGoal};
pub use response::Response;

use crate::hand_to_site;

/// Whose orientation `obs/robot0_eef_quat` is. The two differ by [`hand_to_site`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EefOrientation {
    /// The hand body's.
    HandBody,
    /// The grip site's, which the controller steers.
    GripSite,
}

/// Where a quaternion's scalar part is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum QuaternionOrder {
    /// Last: robosuite's observations.
    Xyzw,
    /// First: `MuJoCo`'s states.
    Wxyz,
}

/// What the first six columns of `actions` are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActionKind {
    /// Motions within [-1, 1] of the controller's scales.
    Delta,
    /// Goals in the world: metres and a rotation vector.
    Absolute,
}

/// What a positive gripper command does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GripperSign {
    /// Fingers close.
    PositiveCloses,
    /// Fingers open.
    PositiveOpens,
}

/// How late the relative part of `obs/object` is. Not proven: where both fit, `Current` is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RelativeLag {
    /// Both poses are those of the same row.
    Current,
    /// The object's pose is that of the row before, as in live robosuite 1.5; zeros where there is none.
    ObjectOneLate,
    /// Both poses are those of the row before.
    BothOneLate,
}

/// Conventions that the user states instead of leaving them to the data.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Order of the parts of `obs/object`.
    pub object_layout: Option<ObjectLayout>,
    /// Whose orientation `obs/robot0_eef_quat` is.
    pub eef_orientation: Option<EefOrientation>,
    /// Order of `obs/robot0_eef_quat`.
    pub eef_quaternion: Option<QuaternionOrder>,
    /// Order of the quaternions in `obs/object`.
    pub object_quaternion: Option<QuaternionOrder>,
    /// What `actions` are.
    pub action_kind: Option<ActionKind>,
    /// What a positive gripper command does.
    pub gripper_sign: Option<GripperSign>,
    /// Accepts delta actions beyond [-1, 1]: the controller cuts them. Files of robosuite's own collector have them,
    /// robomimic's must not.
    pub allow_actions_beyond_range: bool,
    /// Unit of delta actions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_scale: Option<ActionScale>,
    /// Factors that take recorded deltas (translation, rotation) to the controller's commands, six of them; what
    /// `action_offset` says is added after that.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_gain: Option<[f64; 6]>,
    /// What is added to recorded deltas times `action_gain`, six numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_offset: Option<[f64; 6]>,
    /// Which way delta actions turn the hand.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_rotation: Option<ActionRotation>,
    /// Frame of absolute actions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action_frame: Option<ActionFrame>,
    /// What gripper commands go from and to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gripper_range: Option<GripperRange>,
    /// The pose that the controller holds before the first step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_goal: Option<InitialGoal>,
}

impl Settings {
    /// Whether they say of which unit delta actions are.
    fn states_scale(&self) -> bool {
        self.action_scale.is_some() || self.action_gain.is_some() || self.action_offset.is_some()
    }
}

/// The conventions of a file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Conventions {
    /// The task; none for environments whose object vector is not known.
    pub task: Option<RobosuiteTask>,
    /// Order of the parts of `obs/object`; none for other tasks and files without it.
    pub object_layout: Option<ObjectLayout>,
    /// How late the relative part of `obs/object` is.
    pub relative_lag: RelativeLag,
    /// Whose orientation `obs/robot0_eef_quat` is.
    pub eef_orientation: EefOrientation,
    /// Order of `obs/robot0_eef_quat`.
    pub eef_quaternion: QuaternionOrder,
    /// Order of the quaternions in `obs/object`; none for other tasks and files without it.
    pub object_quaternion: Option<QuaternionOrder>,
    /// What `actions` are.
    pub action_kind: ActionKind,
    /// What a positive gripper command does.
    pub gripper_sign: GripperSign,
    /// Whether the conventions of the end effector come from the data. Otherwise residuals against them are measured, but
    /// refuse nothing.
    pub eef_proven: bool,
    /// The same for the object vector.
    pub object_proven: bool,
    /// The setting of that name.
    pub allow_actions_beyond_range: bool,
    /// How recorded actions become commands or goals of the controller.
    pub actions: ActionReading,
    /// The pose that the controller holds before the first step.
    pub initial_goal: InitialGoal,
    /// The controller that the file declares; none where it declares no scales, and actions are not held against it.
    pub controls: Option<Controls>,
}

/// Why conventions cannot be told.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Unproven {
    /// The data fits none or several hypotheses, or is too little.
    #[error("the convention {convention} is not proven: {why} ({residuals}); if you know it, set {setting}")]
    Undecided {
        /// The convention.
        convention: &'static str,
        /// What is missing.
        why: String,
        /// The hypotheses and their residuals.
        residuals: String,
        /// The settings that would accept one.
        setting: String,
    },
    /// The data proves another convention than the file declares.
    #[error(
        "the convention {convention} is proven to be {proven} ({residuals}), but {declared_by}, which writes {declared}: the file is not what it declares; set {convention} = \"{proven}\" to accept it as it is"
    )]
    Declared {
        /// The convention.
        convention: &'static str,
        /// What the data proves.
        proven: String,
        /// What the declaration entails.
        declared: String,
        /// The declaration.
        declared_by: String,
        /// The hypotheses and their residuals.
        residuals: String,
    },
    /// A setting that the data contradicts.
    #[error(
        "the setting {setting} is contradicted by the data: {convention} is {proven} ({residuals}); remove the setting"
    )]
    Setting {
        /// The convention.
        convention: &'static str,
        /// The setting as given.
        setting: String,
        /// What the data says instead.
        proven: String,
        /// The hypotheses and their residuals.
        residuals: String,
    },
    /// Actions that are not what the conventions say.
    #[error("{what} ({evidence}); {fix}")]
    Actions {
        /// The convention.
        convention: &'static str,
        /// What was found.
        what: String,
        /// The test and its numbers.
        evidence: String,
        /// What to do.
        fix: String,
    },
    /// Settings that exclude each other.
    #[error("{0}")]
    Settings(String),
    /// Demos without which everything is proven.
    #[error("{}", named(.0))]
    Odd(Vec<Odd>),
    /// A demo whose numbers cannot be used at all.
    #[error(transparent)]
    Demo(#[from] Contradiction),
}

fn named(odd: &[Odd]) -> String {
    let each: Vec<String> = odd.iter().map(|odd| format!("{}: {}", odd.demo, odd.why)).collect();
    each.join("; ")
}

/// A row of `obs/object`, taken apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectRow {
    /// Object pose in the world, the quaternion normalised.
    pub pose: Isometry3<f64>,
    /// Object position as stored.
    pub position: [f64; 3],
    /// Object quaternion as stored, in the file's order.
    pub quaternion: [f64; 4],
    /// Relative position as stored: in the world for Lift, in the hand's frame for Can and Square.
    pub relative_position: [f64; 3],
    /// Relative quaternion as stored, in the file's order; none for Lift.
    pub relative_quaternion: Option<[f64; 4]>,
}

impl QuaternionOrder {
    /// A stored quaternion as a rotation; none where it has no direction or is not finite.
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
    /// The hand body's orientation, given this one.
    #[must_use]
    pub fn hand(self, stored: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        match self {
            Self::HandBody => stored,
            Self::GripSite => stored * hand_to_site().inverse(),
        }
    }

    /// The grip site's orientation, given this one.
    #[must_use]
    pub fn site(self, stored: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        match self {
            Self::HandBody => stored * hand_to_site(),
            Self::GripSite => stored,
        }
    }
}

fn pose(position: [f64; 3], rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(Vector3::from(position)), rotation)
}

/// `N` numbers of a row from a column on.
fn part<const N: usize>(row: &[f64], start: usize) -> Option<[f64; N]> {
    row.get(start..start + N)?.try_into().ok()
}

impl Conventions {
    /// Takes a row of `obs/object` apart; none where the layout is not known, the row has another width, or the quaternion
    /// has no direction.
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

    /// Pose of the hand body at the grip site's position, the frame of the relative object poses; none where the quaternion
    /// has no direction.
    #[must_use]
    pub fn hand_pose(&self, eef_pos: [f64; 3], eef_quat: [f64; 4]) -> Option<Isometry3<f64>> {
        let stored = self.eef_quaternion.rotation(eef_quat)?;
        Some(pose(eef_pos, self.eef_orientation.hand(stored)))
    }

    /// Pose of the grip site, the frame of the controller's goals; none where the quaternion has no direction.
    #[must_use]
    pub fn site_pose(&self, eef_pos: [f64; 3], eef_quat: [f64; 4]) -> Option<Isometry3<f64>> {
        let stored = self.eef_quaternion.rotation(eef_quat)?;
        Some(pose(eef_pos, self.eef_orientation.site(stored)))
    }
}

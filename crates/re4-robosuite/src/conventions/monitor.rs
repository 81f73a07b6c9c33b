//! Checking single demonstrations against the conventions of their file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::commands::{self, FURTHER, LESS, ROTATES_FURTHER, TRANSLATION_UNEXPLAINED};
use super::demo::ValidDemo;
use super::detect::{NOT_EXPLAINED, UNEXPLAINED};
use super::eef::EXACT;
use super::goals::{self, FRAME};
use super::gripper::{self, FINGER_TRAVEL};
use super::residuals::{self, Relation};
use super::response::TRANSLATION;
use super::{ActionKind, Conventions, DemoArrays, GripperRange, GripperSign, RelativeLag, part};
use crate::kinematics::KinematicsError;

/// Maximum difference of the norm of a stored quaternion from 1.
pub const QUATERNION_TOLERANCE: f64 = 1e-3;
/// Maximum amount by which rounding may take a command out of its range.
const COMMAND_TOLERANCE: f64 = 1e-6;

/// Maximum finger travel (metres) under commands of 0. Play causes less.
const MOVED_WHILE_HELD: f64 = 0.02;
/// Minimum number of rows with motion of the end effector for checking the scale of the actions.
const ROWS: usize = 20;
/// Minimum negative gain that shows that the end effector moves opposite to its commands.
const OPPOSITE: f64 = 0.3;
/// Maximum mean offset of the goals (metres). Friction and contacts cause less.
const OFFSET: f64 = 3.0 * FRAME;

/// What the residual of a quaternion's norm measures.
const NORM: &str = "the norm of a quaternion differs from 1";

/// A contradiction between a demonstration and the conventions of its file.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Contradiction {
    /// An array does not have one row per action.
    #[error("{demo}: {dataset} has {rows} rows, but there are {need} actions")]
    Length {
        /// The demo.
        demo: String,
        /// The dataset.
        dataset: &'static str,
        /// Its rows.
        rows: usize,
        /// Number of actions.
        need: usize,
    },
    /// An array does not have the number of columns that its task needs.
    #[error("{demo}: {dataset} has {columns} columns, but the task needs {need}")]
    Columns {
        /// The demo.
        demo: String,
        /// The dataset.
        dataset: &'static str,
        /// Its columns.
        columns: usize,
        /// Columns of the task.
        need: usize,
    },
    /// A number is NaN or infinite.
    #[error("{demo}: {dataset}[{frame}, {column}] is {value}, not a finite number")]
    NotFinite {
        /// The demo.
        demo: String,
        /// The dataset.
        dataset: &'static str,
        /// Row.
        frame: usize,
        /// Column.
        column: usize,
        /// The number.
        value: f64,
    },
    /// The poses cannot be computed from the states and the model.
    #[error("{demo}: cannot compute poses from states and model_file: {source}")]
    Kinematics {
        /// The demo.
        demo: String,
        /// The reason.
        source: KinematicsError,
    },
    /// The residual of a row exceeds the threshold.
    #[error("{demo}: {dataset}, row {frame}: {what} by {measured:.3}, more than {threshold}")]
    Residual {
        /// The demo.
        demo: String,
        /// The dataset and its columns, e.g. `obs/object[3:7]`.
        dataset: String,
        /// The row with the maximum residual.
        frame: usize,
        /// What the residual measures, as a clause.
        what: &'static str,
        /// The residual.
        measured: f64,
        /// The maximum allowed residual.
        threshold: f64,
    },
    /// Rows were allocated and never recorded.
    #[error(
        "{demo}: rows {first} to {last} contain only zeros, as in a recording that stopped before its arrays were full; remove these rows from all arrays"
    )]
    Zeros {
        /// The demo.
        demo: String,
        /// First row of zeros.
        first: usize,
        /// Last row of zeros.
        last: usize,
    },
    /// All rows of a dataset are the same although the actions change.
    #[error(
        "{demo}: all {rows} rows of {dataset} are the same although the actions change, as if it was never updated; record the demonstration again"
    )]
    Frozen {
        /// The demo.
        demo: String,
        /// The dataset.
        dataset: &'static str,
        /// Its rows.
        rows: usize,
    },
    /// The demonstration as a whole contradicts a convention.
    #[error("{demo}: {dataset}: {what}: {measured:.2}, more than {threshold}, over {frames} frames")]
    Whole {
        /// The demo.
        demo: String,
        /// The dataset.
        dataset: &'static str,
        /// What was measured, as a clause.
        what: &'static str,
        /// The measured value.
        measured: f64,
        /// The maximum allowed value.
        threshold: f64,
        /// Number of frames that provide evidence.
        frames: usize,
    },
}

impl Contradiction {
    /// The error for a block of rows that contain only zeros.
    pub fn zeros(demo: &str, rows: &std::ops::RangeInclusive<usize>) -> Self {
        Self::Zeros {
            demo: demo.to_owned(),
            first: *rows.start(),
            last: *rows.end(),
        }
    }

    /// Whether the arrays can be read all the same: they have the right shapes and finite numbers, but contradict what most of the
    /// other demonstrations prove.
    #[must_use]
    pub fn is_readable(&self) -> bool {
        match self {
            Self::Whole { .. } => true,
            Self::Residual { what, .. } => *what != NORM,
            _ => false,
        }
    }

    /// The name of the demonstration.
    #[must_use]
    pub fn demo(&self) -> &str {
        match self {
            Self::Length { demo, .. }
            | Self::Columns { demo, .. }
            | Self::NotFinite { demo, .. }
            | Self::Kinematics { demo, .. }
            | Self::Residual { demo, .. }
            | Self::Zeros { demo, .. }
            | Self::Frozen { demo, .. }
            | Self::Whole { demo, .. } => demo,
        }
    }
}

/// Maximum residuals of a demonstration over its rows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DemoResiduals {
    /// Number of rows.
    pub frames: usize,
    /// Difference of the norm of `obs/robot0_eef_quat` from 1.
    pub eef_quaternion_norm: f64,
    /// Difference of the norms of the quaternions in `obs/object` from 1, or `None` if their columns are not known.
    pub object_quaternion_norm: Option<f64>,
    /// Difference between the relative part of `obs/object` and the recorded poses (metres or radians).
    pub relative: Option<f64>,
    /// Difference between the end-effector pose and the one from states and model (metres or radians).
    pub eef_kinematics: Option<f64>,
    /// Difference between the object pose and the one from states and model (metres or radians).
    pub object_kinematics: Option<f64>,
    /// Difference between the finger joints and those from states and model (metres).
    pub gripper_kinematics: Option<f64>,
    /// Amount by which the largest delta action exceeds [-1, 1], or `None` for absolute actions.
    pub beyond_range: Option<f64>,
    /// Fraction of the finger travel that goes against the gripper command, or `None` if the fingers hardly move.
    pub fingers_against: Option<f64>,
    /// Fraction of the end effector's motion that the actions leave unexplained, or `None` if it hardly moves.
    pub motion_unexplained: Option<f64>,
}

/// The maximum value and its row.
fn maximum(values: impl Iterator<Item = (usize, f64)>) -> Option<(usize, f64)> {
    values.reduce(|best, next| if next.1.total_cmp(&best.1).is_gt() { next } else { best })
}

/// Returns a function that refuses the demonstration with this name as a whole.
fn refuse_whole(name: &str) -> impl Fn(&'static str, &'static str, f64, f64, usize) -> Result<(), Contradiction> {
    move |dataset, what, measured, threshold, frames| {
        Err(Contradiction::Whole {
            demo: name.to_owned(),
            dataset,
            what,
            measured,
            threshold,
            frames,
        })
    }
}

impl Conventions {
    /// Checks a demonstration against these conventions.
    ///
    /// # Errors
    /// Names the first dataset that contradicts the conventions, with its worst row.
    pub fn check(&self, demo: &DemoArrays<'_>) -> Result<DemoResiduals, Contradiction> {
        self.check_valid(&ValidDemo::new(demo, self.task, &self.actions)?)
    }

    /// Does the same for a demonstration whose actions are already converted.
    pub(super) fn check_valid(&self, valid: &ValidDemo<'_>) -> Result<DemoResiduals, Contradiction> {
        let demo = &valid.arrays;
        let frames = demo.actions.len();
        let within = |dataset: &str, what: &'static str, threshold: f64, worst: Option<(usize, f64)>| match worst {
            Some((frame, measured)) if measured.is_nan() || measured > threshold => Err(Contradiction::Residual {
                demo: demo.name.to_owned(),
                dataset: dataset.to_owned(),
                frame,
                what,
                measured,
                threshold,
            }),
            other => Ok(other.map(|(_, measured)| measured)),
        };
        let mut result = DemoResiduals {
            frames,
            ..DemoResiduals::default()
        };

        let norms = demo.eef_quat.iter().map(norm_error).enumerate();
        result.eef_quaternion_norm =
            within("obs/robot0_eef_quat", NORM, QUATERNION_TOLERANCE, maximum(norms))?.unwrap_or_default();
        for start in self.object_quaternions() {
            let Some(rows) = demo.object else { continue };
            let norms = (0..frames).filter_map(|t| Some((t, norm_error(&self.stored(rows.row(t), start, t)?))));
            let dataset = format!("obs/object[{start}:{}]", start + 4);
            let worst = within(&dataset, NORM, QUATERNION_TOLERANCE, maximum(norms))?;
            result.object_quaternion_norm = larger(result.object_quaternion_norm, worst);
        }
        if self.action_kind == ActionKind::Delta {
            let commands = valid.actions.iter().enumerate();
            let beyond = commands.map(|(t, action)| {
                let largest = action.iter().fold(0.0_f64, |largest, a| largest.max(a.abs()));
                (t, largest - 1.0)
            });
            let worst = maximum(beyond);
            result.beyond_range = worst.map(|(_, beyond)| beyond.max(0.0));
            if !self.allow_actions_beyond_range {
                let what = "a delta action exceeds [-1, 1] (allow_actions_beyond_range accepts it)";
                within("actions", what, COMMAND_TOLERANCE, worst)?;
            }
        }
        if self.actions.gripper == GripperRange::ZeroOne {
            let beyond = demo.actions.iter().map(|action| (action[6] - 0.5).abs() - 0.5);
            let what = "the gripper command exceeds its range in this file, [0, 1],";
            within("actions[:, 6]", what, COMMAND_TOLERANCE, maximum(beyond.enumerate()))?;
        }
        self.check_exact(valid, &mut result, &within)?;
        self.check_motion(valid, &mut result)?;
        self.check_commands(valid)?;
        Ok(result)
    }

    /// Checks the unit, direction and frame of the actions and the range of the gripper command over the whole demonstration.
    fn check_commands(&self, demo: &ValidDemo<'_>) -> Result<(), Contradiction> {
        let refuse = refuse_whole(demo.arrays.name);
        if self.actions.gripper == GripperRange::MinusOneOne {
            let (held, frames) = gripper::held_travel(demo);
            if held > MOVED_WHILE_HELD && frames >= 5 {
                let what = "the fingers move under gripper commands of 0, which should stop them, as in a demonstration with commands from 0 to 1 (travel in metres)";
                return refuse("actions[:, 6]", what, held, MOVED_WHILE_HELD, frames);
            }
        }
        let Some(controls) = &self.controls else { return Ok(()) };
        let steps = commands::steps(demo, self.eef_quaternion);
        if self.action_kind == ActionKind::Absolute {
            let sums = goals::goals(&controls.response, &steps, &demo.actions, demo.arrays.eef_pos);
            let offset = goals::goal_offset(&controls.response, &sums).norm();
            if offset > OFFSET && sums.frames() >= ROWS {
                let what = "absolute actions are offset from the end effector's motion, as in a demonstration with another frame (mean offset in metres)";
                return refuse("actions[:, 0:3]", what, offset, OFFSET, sums.frames());
            }
            return Ok(());
        }
        let sums = commands::deltas(controls, &steps, &demo.actions);
        let frames = sums.frames();
        if frames < ROWS {
            return Ok(());
        }
        let further = "the end effector moves further than its commands ask for, as in a demonstration with another scale (ratio of its motion to the controller's)";
        let less = "the end effector moves less far than its commands ask for, as in a demonstration with another scale (ratio of the controller's motion to its motion)";
        let opposite = "the end effector moves opposite to its commands (ratio of its motion to the controller's, without the sign)";
        let translation = sums
            .line(&TRANSLATION)
            .filter(|line| line.unexplained <= TRANSLATION_UNEXPLAINED);
        let rotation = commands::rotation_line(&sums);
        let limits = [
            ("actions[:, 0:3]", translation, FURTHER, LESS),
            // Within a single demonstration, the end effector may rotate as little as a sixth of the commanded angle.
            ("actions[:, 3:6]", rotation, ROTATES_FURTHER, 2.0 * LESS),
        ];
        for (dataset, line, maximum_gain, maximum_inverse) in limits {
            let Some(line) = line else { continue };
            if line.gain < -OPPOSITE {
                return refuse(dataset, opposite, -line.gain, OPPOSITE, frames);
            }
            if line.gain > maximum_gain {
                return refuse(dataset, further, line.gain, maximum_gain, frames);
            }
            if line.gain > 0.0 && line.gain < 1.0 / maximum_inverse {
                return refuse(dataset, less, 1.0 / line.gain, maximum_inverse, frames);
            }
        }
        Ok(())
    }

    /// The first column of each quaternion in `obs/object`.
    fn object_quaternions(&self) -> impl Iterator<Item = usize> {
        self.object_layout.into_iter().flat_map(|layout| {
            let relative = (layout.columns() == 14).then(|| layout.relative_start() + 3);
            [Some(layout.pose_start() + 3), relative].into_iter().flatten()
        })
    }

    /// A stored quaternion, or `None` for a relative one that robosuite 1.5 has not computed yet.
    fn stored(&self, row: &[f64], start: usize, frame: usize) -> Option<[f64; 4]> {
        let layout = self.object_layout?;
        let relative = layout.relative_start() + 3 == start;
        if relative && layout.pending(row, frame) {
            return None;
        }
        part(row, start)
    }

    /// Checks the relations that are exact up to rounding.
    fn check_exact(
        &self,
        demo: &ValidDemo<'_>,
        result: &mut DemoResiduals,
        within: &impl Fn(&str, &'static str, f64, Option<(usize, f64)>) -> Result<Option<f64>, Contradiction>,
    ) -> Result<(), Contradiction> {
        // Conventions that come from a setting only are measured, but do not refuse a demonstration.
        let exact = |proven: bool| if proven { EXACT } else { f64::INFINITY };
        let each = |residual: &dyn Fn(usize) -> Option<f64>| {
            maximum((0..demo.arrays.actions.len()).filter_map(|t| Some((t, residual(t)?))))
        };
        let worst = each(&|t| residuals::eef_kinematics(demo, t, self.eef_quaternion, self.eef_orientation));
        let what = "the pose differs from the one that states and model_file give";
        result.eef_kinematics = within(
            "obs/robot0_eef_pos and robot0_eef_quat",
            what,
            exact(self.eef_proven),
            worst,
        )?;
        let worst = each(&|t| {
            let known = demo.observed.get(t)?.gripper_qpos?;
            let stored = demo.arrays.gripper_qpos[t];
            Some((known[0] - stored[0]).abs().max((known[1] - stored[1]).abs()))
        });
        let what = "the finger joints differ from those in states";
        result.gripper_kinematics = within("obs/robot0_gripper_qpos", what, EXACT, worst)?;

        let (Some(layout), Some(object)) = (self.object_layout, self.object_quaternion) else {
            return Ok(());
        };
        let worst = each(&|t| residuals::object_kinematics(demo, t, layout, object));
        let columns = |start: usize, end: usize| format!("obs/object[{start}:{end}]");
        let start = layout.pose_start();
        let what = "the object pose differs from the one that states and model_file give";
        result.object_kinematics = within(&columns(start, start + 7), what, exact(self.object_proven), worst)?;
        let relation = |lag: RelativeLag| Relation {
            layout,
            object,
            eef: self.eef_quaternion,
            frame: self.eef_orientation,
            lag,
        };
        let (late, current) = (relation(self.relative_lag), relation(RelativeLag::Current));
        let worst = each(&|t| {
            let late = residuals::relative(demo, t, late)?;
            // A delayed relative part is current if robosuite observed the same state twice.
            let current = residuals::relative(demo, t, current)?;
            Some(late.min(current))
        });
        let start = layout.relative_start();
        let end = if layout.columns() == 14 { start + 7 } else { start + 3 };
        let what = "the relative part differs from the one that the object and end-effector poses give";
        result.relative = within(&columns(start, end), what, exact(self.object_proven), worst)?;
        Ok(())
    }

    /// Checks the gripper sign and the kind of the actions over the whole demonstration.
    fn check_motion(&self, demo: &ValidDemo<'_>, result: &mut DemoResiduals) -> Result<(), Contradiction> {
        let refuse = refuse_whole(demo.arrays.name);
        let mut fingers = residuals::finger_travel(demo);
        if self.gripper_sign == GripperSign::PositiveOpens {
            fingers = fingers.complement();
        }
        if fingers.total() >= FINGER_TRAVEL {
            let against = fingers.value();
            result.fingers_against = Some(against);
            if against > 0.5 {
                let what = "the fingers move against the gripper command (fraction of their travel)";
                return refuse("actions[:, 6]", what, against, 0.5, fingers.frames);
            }
        }
        let kinds = residuals::motion(demo);
        let other = match self.action_kind {
            ActionKind::Delta => ActionKind::Absolute,
            ActionKind::Absolute => ActionKind::Delta,
        };
        if kinds.frames() >= 20 {
            let own = kinds.unexplained(self.action_kind);
            result.motion_unexplained = Some(own);
            if own > NOT_EXPLAINED && kinds.unexplained(other) <= UNEXPLAINED {
                let what =
                    "the actions are of the other kind, delta or absolute (fraction of the motion left unexplained)";
                return refuse("actions[:, 0:6]", what, own, NOT_EXPLAINED, kinds.frames());
            }
        }
        Ok(())
    }
}

/// The larger of two optional values, or the only one.
fn larger(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.max(b)),
        (a, b) => a.or(b),
    }
}

/// Difference of a quaternion's norm from 1.
fn norm_error(quaternion: &[f64; 4]) -> f64 {
    (quaternion.iter().map(|value| value * value).sum::<f64>().sqrt() - 1.0).abs()
}

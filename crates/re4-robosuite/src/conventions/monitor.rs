//! Holding a file's conventions against one demo after the other.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::commands::{self, FURTHER, LESS, TRANSLATION_TOLD, TURNS_FURTHER};
use super::demo::Sound;
use super::detect::{NOT_EXPLAINED, UNEXPLAINED};
use super::eef::EXACT;
use super::goals::{self, FRAME};
use super::gripper::{self, FINGER_TRAVEL};
use super::residuals::{self, Relation};
use super::response::TRANSLATION;
use super::{ActionKind, Conventions, DemoArrays, GripperRange, GripperSign, RelativeLag, part};
use crate::kinematics::KinematicsError;

/// How far the norm of a stored quaternion may be from 1.
pub const QUATERNION_TOLERANCE: f64 = 1e-3;
/// How far a delta command may be beyond 1 by rounding.
const COMMAND_TOLERANCE: f64 = 1e-6;

/// Travel of the fingers (metres) under commands that hold them that play does not make.
const MOVED_WHILE_HELD: f64 = 0.02;
/// Rows in which the hand moves that tell of a demo's scale.
const ROWS: usize = 20;
/// A hand goes the other way than it is asked to by more than this many times what the controller does.
const OTHER_WAY: f64 = 0.3;
/// Mean distance of goals from where the hand goes (metres) that no friction or contact makes.
const OTHER_PLACE: f64 = 3.0 * FRAME;

/// A demo that does not follow the conventions of its file.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Contradiction {
    /// An array with another number of rows than there are actions.
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
    /// An array with another number of columns than its task has.
    #[error("{demo}: {dataset} has {columns} columns, but the task's has {need}")]
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
    /// A number that is NaN or infinite.
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
    /// States and model do not give poses.
    #[error("{demo}: no poses from states and model_file: {source}")]
    Kinematics {
        /// The demo.
        demo: String,
        /// Why.
        source: KinematicsError,
    },
    /// A number further from what it should be than the threshold.
    #[error("{demo}: {dataset}, row {frame}: {what} by {measured:.3}, more than {threshold}")]
    Residual {
        /// The demo.
        demo: String,
        /// The dataset and its columns, e.g. `obs/object[3:7]`.
        dataset: String,
        /// The row with the maximum residual.
        frame: usize,
        /// What is off.
        what: &'static str,
        /// How far.
        measured: f64,
        /// What is allowed.
        threshold: f64,
    },
    /// Rows that were allocated and never recorded.
    #[error(
        "{demo}: rows {first} to {last} are zeros, as in a recording that was cut off before its arrays were; cut the arrays to what was recorded"
    )]
    Zeros {
        /// The demo.
        demo: String,
        /// First row of zeros.
        first: usize,
        /// Last row of zeros.
        last: usize,
    },
    /// A dataset whose rows are all the same although the actions ask for motion.
    #[error(
        "{demo}: all {rows} rows of {dataset} are the same while the actions change, as if it was never updated; record it anew"
    )]
    Frozen {
        /// The demo.
        demo: String,
        /// The dataset.
        dataset: &'static str,
        /// Its rows.
        rows: usize,
    },
    /// A whole demo against a convention.
    #[error("{demo}: {dataset}: {what}: {measured:.2}, more than {threshold}, over {frames} frames")]
    Whole {
        /// The demo.
        demo: String,
        /// The dataset.
        dataset: &'static str,
        /// What is off.
        what: &'static str,
        /// The measured share.
        measured: f64,
        /// What is allowed.
        threshold: f64,
        /// Frames that tell something.
        frames: usize,
    },
}

impl Contradiction {
    /// These rows are zeros.
    pub fn zeros(demo: &str, rows: &std::ops::RangeInclusive<usize>) -> Self {
        Self::Zeros {
            demo: demo.to_owned(),
            first: *rows.start(),
            last: *rows.end(),
        }
    }

    /// The demo that it is about.
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

/// How well a demo follows the conventions: maximum residuals over its rows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DemoResiduals {
    /// Rows.
    pub frames: usize,
    /// Distance of the norm of `obs/robot0_eef_quat` from 1.
    pub eef_quaternion_norm: f64,
    /// Distance of the norms of the quaternions in `obs/object` from 1; none where they are not known.
    pub object_quaternion_norm: Option<f64>,
    /// Relative part of `obs/object` against the poses (metres or radians).
    pub relative: Option<f64>,
    /// End-effector pose against states and model (metres or radians).
    pub eef_kinematics: Option<f64>,
    /// Object pose against states and model (metres or radians).
    pub object_kinematics: Option<f64>,
    /// Finger joints against states and model (metres).
    pub gripper_kinematics: Option<f64>,
    /// How far the maximum delta action is beyond [-1, 1]; none for absolute actions.
    pub beyond_range: Option<f64>,
    /// Fraction of the finger travel against the gripper command; none where the fingers hardly move.
    pub fingers_against: Option<f64>,
    /// Fraction of the hand's motion that the actions leave unexplained; none where it hardly moves.
    pub motion_unexplained: Option<f64>,
}

/// The maximum value and its row.
fn maximum(values: impl Iterator<Item = (usize, f64)>) -> Option<(usize, f64)> {
    values.reduce(|best, next| if next.1.total_cmp(&best.1).is_gt() { next } else { best })
}

/// Refuses a demo of this name as a whole.
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
    /// Holds these conventions against a demo, row by row.
    ///
    /// # Errors
    /// The first dataset that is off, with the row where it is most off.
    pub fn check(&self, demo: &DemoArrays<'_>) -> Result<DemoResiduals, Contradiction> {
        self.check_sound(&Sound::new(demo, self.task, &self.actions)?)
    }

    /// The same for a demo that was read by these conventions.
    pub(super) fn check_sound(&self, sound: &Sound<'_>) -> Result<DemoResiduals, Contradiction> {
        let demo = &sound.arrays;
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
        let what = "the norm of a quaternion differs from 1";
        result.eef_quaternion_norm =
            within("obs/robot0_eef_quat", what, QUATERNION_TOLERANCE, maximum(norms))?.unwrap_or_default();
        for start in self.object_quaternions() {
            let Some(rows) = demo.object else { continue };
            let norms = (0..frames).filter_map(|t| Some((t, norm_error(&self.stored(rows.row(t), start, t)?))));
            let dataset = format!("obs/object[{start}:{}]", start + 4);
            let worst = within(&dataset, what, QUATERNION_TOLERANCE, maximum(norms))?;
            result.object_quaternion_norm = larger(result.object_quaternion_norm, worst);
        }
        if self.action_kind == ActionKind::Delta {
            let commands = sound.actions.iter().enumerate();
            let beyond =
                commands.map(|(t, action)| (t, action.iter().fold(0.0_f64, |most, a| most.max(a.abs())) - 1.0));
            let worst = maximum(beyond);
            result.beyond_range = worst.map(|(_, beyond)| beyond.max(0.0));
            if !self.allow_actions_beyond_range {
                let what = "a delta action leaves [-1, 1] (allow_actions_beyond_range accepts it)";
                within("actions", what, COMMAND_TOLERANCE, worst)?;
            }
        }
        if self.actions.gripper == GripperRange::ZeroOne {
            let beyond = demo.actions.iter().map(|action| (action[6] - 0.5).abs() - 0.5);
            let what = "the gripper command leaves [0, 1], its range in this file,";
            within("actions[:, 6]", what, COMMAND_TOLERANCE, maximum(beyond.enumerate()))?;
        }
        self.check_exact(sound, &mut result, &within)?;
        self.check_motion(sound, &mut result)?;
        self.check_commands(sound)?;
        Ok(result)
    }

    /// Unit, direction and frame of the actions, and the range of the gripper's command, over the whole demo.
    fn check_commands(&self, demo: &Sound<'_>) -> Result<(), Contradiction> {
        let refuse = refuse_whole(demo.arrays.name);
        if self.actions.gripper == GripperRange::MinusOneOne {
            let (held, frames) = gripper::held_travel(demo);
            if held > MOVED_WHILE_HELD && frames >= 5 {
                let what = "the fingers move under gripper commands of 0, which hold them, as in a demonstration with commands from 0 to 1; metres of their travel";
                return refuse("actions[:, 6]", what, held, MOVED_WHILE_HELD, frames);
            }
        }
        let Some(controls) = &self.controls else { return Ok(()) };
        let steps = commands::steps(demo, self.eef_quaternion);
        if self.action_kind == ActionKind::Absolute {
            let sums = goals::goals(&controls.response, &steps, &demo.actions, demo.arrays.eef_pos);
            let beside = goals::goal_offset(&controls.response, &sums).norm();
            if beside > OTHER_PLACE && sums.frames() >= ROWS {
                let what = "absolute actions lie beside where the hand goes, as in a demonstration of another frame; metres in the mean";
                return refuse("actions[:, 0:3]", what, beside, OTHER_PLACE, sums.frames());
            }
            return Ok(());
        }
        let sums = commands::deltas(controls, &steps, &demo.actions);
        let frames = sums.frames();
        if frames < ROWS {
            return Ok(());
        }
        let further = "the hand goes further than its commands ask for, as in a demonstration of another scale; times what the controller does";
        let less = "the hand goes less far than its commands ask for, as in a demonstration of another scale; what the controller does, in times of it";
        let other_way = "the hand goes the other way than its commands ask for; times what the controller does";
        let translation = sums
            .line(&TRANSLATION)
            .filter(|line| line.unexplained <= TRANSLATION_TOLD);
        let rotation = commands::rotation_line(&sums);
        let told = [
            ("actions[:, 0:3]", translation, FURTHER, LESS),
            // Few rotations are far from what they stand beside.
            ("actions[:, 3:6]", rotation, TURNS_FURTHER, 2.0 * LESS),
        ];
        for (dataset, line, most, minimum) in told {
            let Some(line) = line else { continue };
            if line.gain < -OTHER_WAY {
                return refuse(dataset, other_way, -line.gain, OTHER_WAY, frames);
            }
            if line.gain > most {
                return refuse(dataset, further, line.gain, most, frames);
            }
            if line.gain > 0.0 && line.gain < 1.0 / minimum {
                return refuse(dataset, less, 1.0 / line.gain, minimum, frames);
            }
        }
        Ok(())
    }

    /// First columns of the quaternions in `obs/object`.
    fn object_quaternions(&self) -> impl Iterator<Item = usize> {
        self.object_layout.into_iter().flat_map(|layout| {
            let relative = (layout.columns() == 14).then(|| layout.relative_start() + 3);
            [Some(layout.pose_start() + 3), relative].into_iter().flatten()
        })
    }

    /// A stored quaternion; none for a relative one that robosuite 1.5 has not yet computed.
    fn stored(&self, row: &[f64], start: usize, frame: usize) -> Option<[f64; 4]> {
        let layout = self.object_layout?;
        let relative = layout.relative_start() + 3 == start;
        if relative && layout.pending(row, frame) {
            return None;
        }
        part(row, start)
    }

    /// Relations that hold to rounding.
    fn check_exact(
        &self,
        demo: &Sound<'_>,
        result: &mut DemoResiduals,
        within: &impl Fn(&str, &'static str, f64, Option<(usize, f64)>) -> Result<Option<f64>, Contradiction>,
    ) -> Result<(), Contradiction> {
        // What only a setting says is measured, but refuses nothing.
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
            // A late part is current again after a second look at the same state.
            let current = residuals::relative(demo, t, current)?;
            Some(late.min(current))
        });
        let start = layout.relative_start();
        let end = if layout.columns() == 14 { start + 7 } else { start + 3 };
        let what = "the relative part differs from what object and end-effector pose give";
        result.relative = within(&columns(start, end), what, exact(self.object_proven), worst)?;
        Ok(())
    }

    /// Shares over the whole demo.
    fn check_motion(&self, demo: &Sound<'_>, result: &mut DemoResiduals) -> Result<(), Contradiction> {
        let refuse = refuse_whole(demo.arrays.name);
        let mut fingers = residuals::finger_travel(demo);
        if self.gripper_sign == GripperSign::PositiveOpens {
            fingers = fingers.complement();
        }
        if fingers.total() >= FINGER_TRAVEL {
            let against = fingers.value();
            result.fingers_against = Some(against);
            if against > 0.5 {
                let what = "the fingers move against the gripper command, as a fraction of their travel";
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
                    "the actions are of the other kind (delta or absolute): motion left unexplained, as a fraction";
                return refuse("actions[:, 0:6]", what, own, NOT_EXPLAINED, kinds.frames());
            }
        }
        Ok(())
    }
}

fn larger(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.max(b)),
        (a, b) => a.or(b),
    }
}

fn norm_error(quaternion: &[f64; 4]) -> f64 {
    (quaternion.iter().map(|value| value * value).sum::<f64>().sqrt() - 1.0).abs()
}

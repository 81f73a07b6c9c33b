//! The borrowed arrays of one demonstration.

use std::borrow::Cow;
use std::ops::RangeInclusive;

use super::{ActionReading, Contradiction, RobosuiteTask};
use crate::actions::Action;
use crate::kinematics::{Model, Observed};

/// A row-major table of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rows<'a> {
    values: &'a [f64],
    columns: usize,
}

impl<'a> Rows<'a> {
    /// A table with rows of `columns` numbers. Returns `None` if the numbers do not fill whole rows.
    #[must_use]
    pub fn new(values: &'a [f64], columns: usize) -> Option<Self> {
        (columns > 0 && values.len().is_multiple_of(columns)).then_some(Self { values, columns })
    }

    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.len() / self.columns
    }

    /// Whether there are no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The row with this index.
    #[must_use]
    pub fn row(&self, index: usize) -> &'a [f64] {
        &self.values[index * self.columns..(index + 1) * self.columns]
    }

    /// All rows.
    pub fn rows(&self) -> impl Iterator<Item = &'a [f64]> + use<'a> {
        self.values.chunks_exact(self.columns)
    }
}

/// The arrays of one demonstration, with one row per action.
#[derive(Debug, Clone, Copy)]
pub struct DemoArrays<'a> {
    /// Name for messages, e.g. `demo_12`.
    pub name: &'a str,
    /// `obs/robot0_eef_pos`, in metres in the world frame.
    pub eef_pos: &'a [[f64; 3]],
    /// `obs/robot0_eef_quat`.
    pub eef_quat: &'a [[f64; 4]],
    /// `obs/object`.
    pub object: Option<Rows<'a>>,
    /// `obs/robot0_gripper_qpos`, in metres.
    pub gripper_qpos: &'a [[f64; 2]],
    /// `actions`.
    pub actions: &'a [Action],
    /// `obs/robot0_eef_vel_ang`, in radians per second in the world frame.
    pub eef_vel_ang: Option<&'a [[f64; 3]]>,
    /// `states`, used only together with `model`.
    pub states: Option<Rows<'a>>,
    /// The model of the attribute `model_file`, used only together with `states`.
    pub model: Option<&'a Model>,
}

/// A demonstration whose arrays have the same length and finite numbers, with the poses that follow from its states.
#[derive(Clone)]
pub(super) struct ValidDemo<'a> {
    pub(super) arrays: DemoArrays<'a>,
    /// The converted actions: controller commands, or goals in the world frame.
    pub(super) actions: Cow<'a, [Action]>,
    /// Poses in each state. Empty without states or model.
    pub(super) observed: Vec<Observed>,
}

impl<'a> ValidDemo<'a> {
    pub(super) fn new(
        arrays: &DemoArrays<'a>,
        task: Option<RobosuiteTask>,
        reading: &ActionReading,
    ) -> Result<Self, Contradiction> {
        let need = arrays.actions.len();
        let length = |dataset: &'static str, rows: usize| {
            if rows == need {
                return Ok(());
            }
            Err(Contradiction::Length {
                demo: arrays.name.to_owned(),
                dataset,
                rows,
                need,
            })
        };
        length("obs/robot0_eef_pos", arrays.eef_pos.len())?;
        length("obs/robot0_eef_quat", arrays.eef_quat.len())?;
        length("obs/robot0_gripper_qpos", arrays.gripper_qpos.len())?;
        finite(arrays.name, "actions", arrays.actions)?;
        finite(arrays.name, "obs/robot0_eef_pos", arrays.eef_pos)?;
        finite(arrays.name, "obs/robot0_eef_quat", arrays.eef_quat)?;
        finite(arrays.name, "obs/robot0_gripper_qpos", arrays.gripper_qpos)?;
        if let Some(velocities) = arrays.eef_vel_ang {
            length("obs/robot0_eef_vel_ang", velocities.len())?;
            finite(arrays.name, "obs/robot0_eef_vel_ang", velocities)?;
        }
        if let Some(object) = arrays.object {
            length("obs/object", object.len())?;
            finite(arrays.name, "obs/object", object.rows())?;
            let columns = task.map(|task| task.object_columns());
            if let Some(need) = columns.filter(|need| *need != object.columns()) {
                return Err(Contradiction::Columns {
                    demo: arrays.name.to_owned(),
                    dataset: "obs/object",
                    columns: object.columns(),
                    need,
                });
            }
        }
        check_recorded(arrays)?;
        let mut observed = Vec::new();
        if let (Some(states), Some(model)) = (arrays.states, arrays.model) {
            length("states", states.len())?;
            finite(arrays.name, "states", states.rows())?;
            observed = model
                .observe(states.rows(), task.map(|task| task.object))
                .map_err(|source| Contradiction::Kinematics {
                    demo: arrays.name.to_owned(),
                    source,
                })?;
        }
        let actions = if reading.is_plain() {
            Cow::Borrowed(arrays.actions)
        } else {
            arrays.actions.iter().map(|action| reading.read(action)).collect()
        };
        Ok(Self {
            arrays: *arrays,
            actions,
            observed,
        })
    }
}

/// Finds the first block of rows in which the action and all numbers of `rows` are zero, as in arrays that were allocated in
/// advance and never filled. `rows` must be data that is never zero in a recording: states or quaternions.
pub fn zero_rows<R: AsRef<[f64]>>(actions: &[Action], rows: &[R]) -> Option<RangeInclusive<usize>> {
    let zero = |t: usize| {
        let all = |row: &[f64]| row.iter().all(|value| *value == 0.0);
        rows.get(t).is_some_and(|row| all(row.as_ref())) && actions.get(t).is_some_and(|action| all(action))
    };
    let first = (0..rows.len()).find(|t| zero(*t))?;
    let end = (first..rows.len()).find(|t| !zero(*t)).unwrap_or(rows.len());
    Some(first..=end - 1)
}

/// Minimum number of identical rows that count as a dataset that was never updated. In simulation the end effector is never
/// exactly at rest.
const FROZEN: usize = 20;

/// Refuses arrays that were never filled or updated.
fn check_recorded(arrays: &DemoArrays<'_>) -> Result<(), Contradiction> {
    if let Some(rows) = zero_rows(arrays.actions, arrays.eef_quat) {
        return Err(Contradiction::zeros(arrays.name, &rows));
    }
    let (Some(first), Some(action)) = (arrays.eef_pos.first(), arrays.actions.first()) else {
        return Ok(());
    };
    let rows = arrays.eef_pos.len();
    let frozen = rows >= FROZEN
        && arrays.eef_pos.iter().all(|position| position == first)
        && arrays.actions.iter().any(|other| other[..6] != action[..6]);
    if frozen {
        return Err(Contradiction::Frozen {
            demo: arrays.name.to_owned(),
            dataset: "obs/robot0_eef_pos",
            rows,
        });
    }
    Ok(())
}

/// Checks that all numbers of a dataset are finite.
fn finite<R: AsRef<[f64]>>(
    demo: &str,
    dataset: &'static str,
    rows: impl IntoIterator<Item = R>,
) -> Result<(), Contradiction> {
    for (frame, row) in rows.into_iter().enumerate() {
        let row = row.as_ref();
        if let Some(column) = row.iter().position(|value| !value.is_finite()) {
            return Err(Contradiction::NotFinite {
                demo: demo.to_owned(),
                dataset,
                frame,
                column,
                value: row[column],
            });
        }
    }
    Ok(())
}

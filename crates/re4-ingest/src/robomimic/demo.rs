//! One demonstration: its arrays as they are in the file, checked.

use std::sync::Arc;

use super::fault::Hdf5Fault;
use super::file::{Element, File, Located};

/// Rows of numbers, one after the other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Matrix {
    /// Numbers of a row.
    pub columns: usize,
    /// All numbers.
    pub values: Vec<f64>,
}

impl Matrix {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }
}

/// What a file holds of one demonstration, bit for bit (single precision widened), every dataset with one row a frame and
/// without NaN or infinity. Rows of `obs` are the observations before the action of the same row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Demo {
    /// Its group below `/data`, such as `demo_12`.
    pub name: String,
    /// Number of frames.
    pub frames: usize,
    /// `actions`: translation or position, rotation vector, gripper command.
    pub actions: Vec<[f64; 7]>,
    /// `obs/robot0_eef_pos`; empty in the raw layout.
    pub eef_position: Vec<[f64; 3]>,
    /// `obs/robot0_eef_quat`; empty in the raw layout.
    pub eef_quaternion: Vec<[f64; 4]>,
    /// `obs/robot0_gripper_qpos`; empty in the raw layout.
    pub fingers: Vec<[f64; 2]>,
    /// `obs/object`, where there is one.
    pub object: Option<Matrix>,
    /// `obs/robot0_eef_vel_ang`, where there is one and it was asked for.
    pub angular_velocity: Option<Vec<[f64; 3]>>,
    /// `states`, where there are any.
    pub states: Option<Matrix>,
    /// `rewards`, where there are any.
    pub rewards: Option<Vec<f64>>,
    /// `dones`, where there are any.
    pub dones: Option<Vec<bool>>,
    /// Absolute actions beside `actions`: `actions_abs`, or `action_dict/abs_pos` and `abs_rot_axis_angle`.
    pub other_goals: Option<Vec<[f64; 6]>>,
    /// The MJCF text of attribute `model_file`; none where there is none.
    pub model: Option<Arc<str>>,
    /// Datasets that hold single precision.
    pub single_precision: Vec<&'static str>,
}

/// The datasets of one demonstration, found and not yet read.
pub(crate) struct FoundDemo {
    pub(crate) name: String,
    pub(crate) frames: usize,
    pub(crate) model: Option<Arc<str>>,
    datasets: Vec<(Name, Located)>,
}

/// A dataset of a demonstration, and how many numbers its rows have (0 for a single one, `None` for any).
type Name = (&'static str, Option<usize>);

const ACTIONS: Name = ("actions", Some(7));
const STATES: Name = ("states", None);
const OTHERS: [Name; 3] = [STATES, ("rewards", Some(0)), ("dones", Some(0))];
const OBSERVATIONS: [Name; 3] = [
    ("obs/robot0_eef_pos", Some(3)),
    ("obs/robot0_eef_quat", Some(4)),
    ("obs/robot0_gripper_qpos", Some(2)),
];
const OBJECT: Name = ("obs/object", None);
const ANGULAR_VELOCITY: Name = ("obs/robot0_eef_vel_ang", Some(3));
const ACTIONS_ABS: Name = ("actions_abs", Some(7));
const ABS_POSITION: Name = ("action_dict/abs_pos", Some(3));
const ABS_ROTATION: Name = ("action_dict/abs_rot_axis_angle", Some(3));

/// What is wanted of a demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// All but observations; states have to be there.
    Raw,
    /// All, observations have to be there.
    Observed,
    /// The same, with the hand's angular velocities.
    ObservedWithVelocities,
    /// Actions alone.
    Actions,
}

impl FoundDemo {
    /// Finds the datasets and checks their shapes against each other and against the attribute `num_samples`.
    pub(crate) fn find(file: &File, name: &str, wanted: Wanted) -> Result<Self, Hdf5Fault> {
        let group = format!("data/{name}");
        let members = file.members(&group)?;
        if members.is_empty() {
            return Err(Hdf5Fault::EmptyDemo { demo: name.to_owned() });
        }
        let has = |members: &[String], name: &str| members.iter().any(|member| member == name);
        let mut names = vec![ACTIONS];
        if wanted != Wanted::Actions {
            names.extend(OTHERS.into_iter().filter(|(name, _)| has(&members, name)));
            if wanted == Wanted::Raw && !has(&members, STATES.0) {
                return Err(missing(&group, STATES.0));
            }
            if wanted != Wanted::Raw {
                if !has(&members, "obs") {
                    return Err(missing(&group, "obs"));
                }
                let observations = file.members(&format!("{group}/obs"))?;
                names.extend(OBSERVATIONS);
                let optional = [
                    (OBJECT, true),
                    (ANGULAR_VELOCITY, wanted == Wanted::ObservedWithVelocities),
                ];
                let there = |name: &Name| has(&observations, name.0.trim_start_matches("obs/"));
                names.extend(
                    optional
                        .iter()
                        .filter(|(name, wanted)| *wanted && there(name))
                        .map(|(name, _)| *name),
                );
                if let Some((missed, _)) = OBSERVATIONS.iter().find(|name| !there(name)) {
                    return Err(missing(&group, missed));
                }
            }
            if has(&members, ACTIONS_ABS.0) {
                names.push(ACTIONS_ABS);
            } else if has(&members, "action_dict") {
                let kinds = file.members(&format!("{group}/action_dict"))?;
                if has(&kinds, "abs_pos") && has(&kinds, "abs_rot_axis_angle") {
                    names.extend([ABS_POSITION, ABS_ROTATION]);
                }
            }
        }
        if !has(&members, ACTIONS.0) {
            return Err(missing(&group, ACTIONS.0));
        }
        let datasets = names
            .into_iter()
            .map(|name| Ok((name, file.locate(&format!("{group}/{}", name.0))?)))
            .collect::<Result<Vec<_>, Hdf5Fault>>()?;
        let frames = rows_of(&datasets)?;
        for (name, located) in &datasets {
            check_shape(*name, located)?;
        }
        if let Some(samples) = file.count(&group, "num_samples")?
            && usize::try_from(samples) != Ok(frames)
        {
            return Err(Hdf5Fault::Count {
                object: format!("/{group}"),
                attribute: "num_samples",
                found: samples,
                expected: frames,
                what: format!("rows in {group}/actions"),
            });
        }
        let model = if wanted == Wanted::Actions {
            None
        } else {
            file.text(&group, "model_file")?
        };
        Ok(Self {
            name: name.to_owned(),
            frames,
            model: model.map(Arc::from),
            datasets,
        })
    }

    /// Reads the datasets and checks their values.
    pub(crate) fn read(self, file: &File) -> Result<Demo, Hdf5Fault> {
        let mut demo = Demo {
            name: self.name,
            frames: self.frames,
            model: self.model,
            ..Demo::default()
        };
        let mut goals = [const { Vec::new() }; 2];
        for (name, located) in self.datasets {
            let values = file.read(&located)?;
            if located.element == Element::F32 {
                demo.single_precision.push(name.0);
            }
            let columns = located.shape.get(1).copied().unwrap_or(1);
            if name.0 == "dones" {
                demo.dones = Some(flags(&located, &values)?);
                continue;
            }
            finite(&located, &values, columns)?;
            match name {
                ACTIONS => demo.actions = rows(&values),
                ("obs/robot0_eef_pos", _) => demo.eef_position = rows(&values),
                ("obs/robot0_eef_quat", _) => demo.eef_quaternion = rows(&values),
                ("obs/robot0_gripper_qpos", _) => demo.fingers = rows(&values),
                OBJECT => demo.object = Some(Matrix { columns, values }),
                ANGULAR_VELOCITY => demo.angular_velocity = Some(rows(&values)),
                STATES => demo.states = Some(Matrix { columns, values }),
                ACTIONS_ABS => {
                    let six = |row: &[f64; 7]| [row[0], row[1], row[2], row[3], row[4], row[5]];
                    demo.other_goals = Some(rows::<7>(&values).iter().map(six).collect());
                }
                ABS_POSITION => goals[0] = rows::<3>(&values),
                ABS_ROTATION => goals[1] = rows::<3>(&values),
                _ => demo.rewards = Some(values),
            }
        }
        if demo.other_goals.is_none() && !goals[0].is_empty() {
            let join = |([x, y, z], [rx, ry, rz]): (&[f64; 3], &[f64; 3])| [*x, *y, *z, *rx, *ry, *rz];
            demo.other_goals = Some(goals[0].iter().zip(&goals[1]).map(join).collect());
        }
        Ok(demo)
    }
}

fn missing(group: &str, dataset: &str) -> Hdf5Fault {
    Hdf5Fault::Missing {
        object: format!("{group}/{dataset}"),
        mend: "restore it, or leave the demonstration out by a filter key or ingest.select",
    }
}

/// Rows that all datasets have.
fn rows_of(datasets: &[(Name, Located)]) -> Result<usize, Hdf5Fault> {
    let length = |located: &Located| located.shape.first().copied().unwrap_or(0);
    // What most of them have is what the others are measured by.
    let common = datasets
        .iter()
        .map(|(_, located)| length(located))
        .max_by_key(|&rows| datasets.iter().filter(|(_, other)| length(other) == rows).count())
        .unwrap_or(0);
    if let Some((_, odd)) = datasets.iter().find(|(_, located)| length(located) != common)
        && let Some((_, other)) = datasets.iter().find(|(_, located)| length(located) == common)
    {
        return Err(Hdf5Fault::Length {
            object: odd.name.clone(),
            found: length(odd),
            other: other.name.clone(),
            expected: common,
        });
    }
    match datasets.first() {
        Some((_, first)) if common == 0 => Err(Hdf5Fault::NoFrames {
            object: first.name.clone(),
        }),
        _ => Ok(common),
    }
}

fn check_shape((_, columns): Name, located: &Located) -> Result<(), Hdf5Fault> {
    let fits = match columns {
        Some(0) => matches!(located.shape[..], [_] | [_, 1]),
        Some(columns) => located.shape.len() == 2 && located.shape[1] == columns,
        None => located.shape.len() == 2 && located.shape[1] > 0,
    };
    if fits {
        return Ok(());
    }
    Err(Hdf5Fault::Shape {
        object: located.name.clone(),
        found: located.shape.clone(),
        expected: match columns {
            Some(0) => "(N,)".to_owned(),
            Some(columns) => format!("(N, {columns})"),
            None => "(N, numbers of a row)".to_owned(),
        },
        mend: if columns == ACTIONS.1 {
            "one arm with a two-finger gripper is read, whose actions are three numbers of position, three of rotation and the gripper's, so give such a file"
        } else {
            "restore it, or leave the demonstration out by a filter key or ingest.select"
        },
    })
}

fn rows<const WIDTH: usize>(values: &[f64]) -> Vec<[f64; WIDTH]> {
    values.as_chunks::<WIDTH>().0.to_vec()
}

fn finite(located: &Located, values: &[f64], columns: usize) -> Result<(), Hdf5Fault> {
    let Some(at) = values.iter().position(|value| !value.is_finite()) else {
        return Ok(());
    };
    Err(Hdf5Fault::NotFinite {
        object: located.name.clone(),
        row: at / columns.max(1),
        column: at % columns.max(1),
        value: values[at],
    })
}

fn flags(located: &Located, values: &[f64]) -> Result<Vec<bool>, Hdf5Fault> {
    let flag = |(row, &value): (usize, &f64)| match value {
        0.0 => Ok(false),
        1.0 => Ok(true),
        _ => Err(Hdf5Fault::NotAFlag {
            object: located.name.clone(),
            row,
            value,
        }),
    };
    values.iter().enumerate().map(flag).collect()
}

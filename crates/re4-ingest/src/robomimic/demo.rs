//! Reads one demonstration: its arrays as they are in the file, checked.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::fault::Hdf5Fault;
use super::file::{Element, File, Located};
use super::relatives::{DATAGEN, Datagen, FoundDatagen};
use crate::demos::Matrix;

/// The data of one demonstration, bit for bit (single precision is widened). Every dataset has one row per frame and
/// no NaN or infinity. Rows of `obs` are the observations before the action of the same row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Demo {
    /// Name of its group in `/data`, such as `demo_12`.
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
    /// `obs/object`, if it exists.
    pub object: Option<Matrix>,
    /// `obs/robot0_eef_vel_ang`, if it exists and was requested.
    pub angular_velocity: Option<Vec<[f64; 3]>>,
    /// `states`, if it exists.
    pub states: Option<Matrix>,
    /// `rewards`, if it exists.
    pub rewards: Option<Vec<f64>>,
    /// `dones`, if it exists.
    pub dones: Option<Vec<bool>>,
    /// Absolute actions in addition to `actions`: `actions_abs`, or `action_dict/abs_pos` and `abs_rot_axis_angle`.
    pub other_goals: Option<Vec<[f64; 6]>>,
    /// Columns 7 to 11 of `actions` of a robot with a mobile base: motion of the base (4) and mode (1).
    pub base_commands: Option<Vec<[f64; 5]>>,
    /// `obs/ee_pos` of a LIBERO file, if it exists.
    pub late_position: Option<Vec<[f64; 3]>>,
    /// `MimicGen`'s group `datagen_info`, if it exists.
    pub datagen: Option<Datagen>,
    /// The MJCF text of attribute `model_file`, if it exists.
    pub model: Option<Arc<str>>,
    /// Names of its datasets in single precision.
    pub single_precision: Vec<&'static str>,
    /// Descriptions of optional data that was skipped because of invalid values.
    pub skipped: Vec<String>,
}

/// The datasets of one demonstration, located but not read.
pub(crate) struct FoundDemo {
    pub(crate) name: String,
    pub(crate) frames: usize,
    pub(crate) model: Option<Arc<str>>,
    datasets: Vec<(Name, Located)>,
    datagen: Option<FoundDatagen>,
    skipped: Vec<String>,
}

/// Name of a dataset, and the number of columns (0 for a vector, `None` for any number).
pub(super) type Name = (&'static str, Option<usize>);

const ACTIONS: Name = ("actions", Some(7));
const STATES: Name = ("states", None);
const OTHERS: [Name; 3] = [STATES, ("rewards", Some(0)), ("dones", Some(0))];
/// Optional datasets; invalid values in them do not make a demonstration unusable.
const OPTIONAL: [&str; 2] = ["rewards", "dones"];
pub(super) const OBSERVATIONS: [Name; 3] = [
    ("obs/robot0_eef_pos", Some(3)),
    ("obs/robot0_eef_quat", Some(4)),
    ("obs/robot0_gripper_qpos", Some(2)),
];
const OBJECT: Name = ("obs/object", None);
const ANGULAR_VELOCITY: Name = ("obs/robot0_eef_vel_ang", Some(3));
const ACTIONS_ABS: Name = ("actions_abs", Some(7));
const LATE_POSITION: Name = ("obs/ee_pos", Some(3));
/// Columns of `actions` of a robot with a mobile base.
const WITH_BASE: usize = 12;
const ABS_POSITION: Name = ("action_dict/abs_pos", Some(3));
const ABS_ROTATION: Name = ("action_dict/abs_rot_axis_angle", Some(3));

/// Which data of a demonstration to read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// Everything except observations; states are required.
    Raw,
    /// The same, with the observed position of the end effector in a file of LIBERO.
    Late,
    /// Everything; observations are required.
    Observed,
    /// The same, with the angular velocities of the end effector.
    ObservedWithVelocities,
    /// Only actions.
    Actions,
}

impl FoundDemo {
    /// Locates the datasets, and checks their shapes against each other and against the attribute `num_samples`. All faults are
    /// reported at once.
    pub(crate) fn find(file: &File, name: &str, wanted: Wanted) -> Result<Self, Hdf5Fault> {
        let group = format!("data/{name}");
        let members = file.members(&group)?;
        if members.is_empty() {
            return Err(Hdf5Fault::EmptyDemo { demo: name.to_owned() });
        }
        let mut faults = Vec::new();
        let names = names_of(file, &group, &members, wanted, &mut faults)?;
        let (mut datasets, mut skipped) = (Vec::new(), Vec::new());
        for name in names {
            let found = file.locate(&format!("{group}/{}", name.0)).and_then(|located| {
                check_shape(name, &located)?;
                Ok(located)
            });
            match found {
                Ok(located) => datasets.push((name, located)),
                Err(fault) if file.is_fatal(&fault) => return Err(fault),
                // Each of these datasets is copied to one column, which stays null.
                Err(fault @ (Hdf5Fault::Dtype { .. } | Hdf5Fault::Shape { .. })) if OPTIONAL.contains(&name.0) => {
                    skipped.push(fault.what());
                }
                Err(fault) => faults.push(fault),
            }
        }
        let frames = rows_of(&datasets, &mut faults);
        let mut datagen = None;
        if wanted != Wanted::Actions && members.iter().any(|member| member == DATAGEN) {
            let found = FoundDatagen::find(file, &group, &mut faults)?;
            found.check_rows(&group, frames, &mut faults);
            datagen = Some(found);
        }
        let valid = faults.is_empty();
        match file.count(&group, "num_samples") {
            Ok(Some(samples)) if valid && usize::try_from(samples) != Ok(frames) => {
                let fault = Hdf5Fault::Count {
                    object: format!("/{group}"),
                    attribute: "num_samples",
                    found: samples,
                    expected: frames,
                    what: format!("rows in {group}/actions"),
                };
                file.note(&mut faults, fault)?;
            }
            Ok(_) => {}
            Err(fault) => file.note(&mut faults, fault)?,
        }
        let mut model = None;
        if wanted != Wanted::Actions {
            match file.text(&group, "model_file") {
                Ok(text) => model = text.map(Arc::from),
                Err(fault) => file.note(&mut faults, fault)?,
            }
        }
        match Hdf5Fault::all(faults) {
            Some(fault) => Err(fault),
            None => Ok(Self {
                name: name.to_owned(),
                frames,
                model,
                datasets,
                datagen,
                skipped,
            }),
        }
    }

    /// Reads the datasets and checks their values. All faults are reported at once.
    pub(crate) fn read(self, file: &File) -> Result<Demo, Hdf5Fault> {
        let mut demo = Demo {
            name: self.name,
            frames: self.frames,
            model: self.model,
            skipped: self.skipped,
            ..Demo::default()
        };
        let mut goals = [const { Vec::new() }; 2];
        let mut faults = Vec::new();
        for (name, located) in self.datasets {
            let values = match file.read(&located) {
                Ok(values) => values,
                Err(fault) => {
                    file.note(&mut faults, fault)?;
                    continue;
                }
            };
            if located.element == Element::F32 {
                demo.single_precision.push(name.0);
            }
            let columns = located.shape.get(1).copied().unwrap_or(1);
            if name.0 == "dones" {
                match flags(&located, &values) {
                    Ok(flags) => demo.dones = Some(flags),
                    Err(why) => demo.skipped.push(why),
                }
                continue;
            }
            if let Err(fault) = finite(&located, &values, columns) {
                if OPTIONAL.contains(&name.0) {
                    demo.skipped.push(fault.what());
                } else {
                    faults.push(fault);
                }
                continue;
            }
            match name {
                ACTIONS if columns == WITH_BASE => {
                    let all = rows::<WITH_BASE>(&values);
                    demo.actions = all
                        .iter()
                        .map(|row| std::array::from_fn(|column| row[column]))
                        .collect();
                    demo.base_commands = Some(all.iter().map(|row| std::array::from_fn(|at| row[at + 7])).collect());
                }
                ACTIONS => demo.actions = rows(&values),
                LATE_POSITION => demo.late_position = Some(rows(&values)),
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
        if let Some(found) = self.datagen {
            demo.datagen = Some(found.read(file, &mut faults)?);
        }
        if let Some(fault) = Hdf5Fault::all(faults) {
            return Err(fault);
        }
        if demo.other_goals.is_none() && !goals[0].is_empty() {
            let join = |([x, y, z], [rx, ry, rz]): (&[f64; 3], &[f64; 3])| [*x, *y, *z, *rx, *ry, *rz];
            demo.other_goals = Some(goals[0].iter().zip(&goals[1]).map(join).collect());
        }
        Ok(demo)
    }
}

/// The requested datasets that exist; required ones that are missing are added to the faults.
fn names_of(
    file: &File,
    group: &str,
    members: &[String],
    wanted: Wanted,
    faults: &mut Vec<Hdf5Fault>,
) -> Result<Vec<Name>, Hdf5Fault> {
    let has = |members: &[String], name: &str| members.iter().any(|member| member == name);
    let mut names = Vec::new();
    let mut lacks = Vec::new();
    let mut need = |names: &mut Vec<Name>, name: Name, there: bool| {
        if there {
            names.push(name);
        } else {
            lacks.push(format!("{group}/{}", name.0));
        }
    };
    need(&mut names, ACTIONS, has(members, ACTIONS.0));
    let others: &[Name] = if wanted == Wanted::Actions { &[] } else { &OTHERS };
    for &name in others {
        let there = has(members, name.0);
        if there || (name == STATES && matches!(wanted, Wanted::Raw | Wanted::Late)) {
            need(&mut names, name, there);
        }
    }
    if !matches!(wanted, Wanted::Raw | Wanted::Late | Wanted::Actions) {
        if has(members, "obs") {
            let observations = file.members(&format!("{group}/obs"))?;
            let there = |name: Name| has(&observations, name.0.trim_start_matches("obs/"));
            for name in OBSERVATIONS {
                need(&mut names, name, there(name));
            }
            let optional = [
                (OBJECT, true),
                (ANGULAR_VELOCITY, wanted == Wanted::ObservedWithVelocities),
            ];
            let optional = optional.iter().filter(|(name, wanted)| *wanted && there(*name));
            names.extend(optional.map(|(name, _)| *name));
        } else {
            need(&mut names, ("obs", None), false);
        }
    } else if wanted == Wanted::Late && has(members, "obs") {
        let observations = file.members(&format!("{group}/obs"))?;
        names.extend(has(&observations, "ee_pos").then_some(LATE_POSITION));
    }
    if !lacks.is_empty() {
        faults.push(Hdf5Fault::Missing {
            objects: lacks,
            fix: "restore what is missing, leave the demonstration out with a filter key or ingest.select, or audit the file without an object with task = \"arm\"",
        });
    }
    if wanted == Wanted::Actions {
        return Ok(names);
    }
    if has(members, ACTIONS_ABS.0) {
        names.push(ACTIONS_ABS);
    } else if has(members, "action_dict") {
        let kinds = file.members(&format!("{group}/action_dict"))?;
        if has(&kinds, "abs_pos") && has(&kinds, "abs_rot_axis_angle") {
            names.extend([ABS_POSITION, ABS_ROTATION]);
        }
    }
    Ok(names)
}

/// The common number of rows of the datasets; a different length is a fault.
fn rows_of(datasets: &[(Name, Located)], faults: &mut Vec<Hdf5Fault>) -> usize {
    let length = |located: &Located| located.shape.first().copied().unwrap_or(0);
    // The most common length is taken as correct, so that the fault names the dataset that differs.
    let common = datasets
        .iter()
        .map(|(_, located)| length(located))
        .max_by_key(|&rows| datasets.iter().filter(|(_, other)| length(other) == rows).count())
        .unwrap_or(0);
    if let Some((_, other)) = datasets.iter().find(|(_, located)| length(located) == common) {
        let lengths: BTreeSet<usize> = datasets.iter().map(|(_, located)| length(located)).collect();
        for odd in lengths.into_iter().filter(|&odd| odd != common) {
            let names = datasets.iter().filter(|(_, located)| length(located) == odd);
            faults.push(Hdf5Fault::Length {
                objects: names.map(|(_, located)| located.name.clone()).collect(),
                found: odd,
                other: other.name.clone(),
                expected: common,
            });
        }
        if common == 0 {
            faults.push(Hdf5Fault::NoFrames {
                object: other.name.clone(),
            });
        }
    }
    common
}

fn check_shape(name: Name, located: &Located) -> Result<(), Hdf5Fault> {
    let (_, columns) = name;
    let fits = match columns {
        // Whether the robot has a base is checked with its model.
        _ if name == ACTIONS && matches!(located.shape[..], [_, WITH_BASE]) => true,
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
        fix: if columns == ACTIONS.1 {
            "only one arm with a two-finger gripper is supported (three numbers of position, three of rotation and one of the gripper), so give such a file, or audit this one without an object with task = \"arm\""
        } else {
            "restore it, or leave the demonstration out with a filter key or ingest.select"
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

/// Converts numbers to booleans. The error describes a value that is neither 0 nor 1.
fn flags(located: &Located, values: &[f64]) -> Result<Vec<bool>, String> {
    let flag = |(row, &value): (usize, &f64)| match value {
        0.0 => Ok(false),
        1.0 => Ok(true),
        _ => Err(format!(
            "dataset {} has {value} in row {row}, which is neither 0 nor 1",
            located.name
        )),
    };
    values.iter().enumerate().map(flag).collect()
}

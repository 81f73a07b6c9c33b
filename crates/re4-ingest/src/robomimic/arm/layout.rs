//! Chooses the arrays of an arm from the names of the datasets, and names the elements of its vectors.

use re4_artifact::Label;

use super::super::fault::Hdf5Fault;
use super::super::file::File;
use super::config::ArmConfig;
use crate::demos::DemoName;
use crate::tables::{SignalRole, SignalRow, SignalVector};

/// Names of the datasets below `obs`, without the prefix of an arm. The first one that exists is read. The names are those of
/// robosuite and robomimic, then those of LIBERO and Isaac Lab.
const JOINTS: &[&str] = &["joint_pos", "joint_states"];
const EEF_POSITION: &[&str] = &["eef_pos", "ee_pos"];
const EEF_ORIENTATION: &[&str] = &["eef_quat", "eef_quat_site", "ee_ori", "ee_quat"];
const GRIPPER: &[&str] = &["gripper_qpos", "gripper_states", "gripper_pos"];

/// Beginnings of the names of one arm's datasets, in the order in which they are looked for. The last one is that of files with a
/// single arm that does not name it.
const ARMS: &[&str] = &[
    "robot0_",
    "robot1_",
    "robot0_right_",
    "robot0_left_",
    "right_",
    "left_",
    "",
];

/// The datasets of an arm, by their paths below a demonstration, with their numbers of columns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArmLayout {
    pub(super) joints: Option<Array>,
    pub(super) eef_position: Option<Array>,
    pub(super) eef_orientation: Option<Array>,
    pub(super) gripper: Option<Array>,
    pub(super) actions: Array,
    /// Elements of an action that are the arm's.
    pub(super) elements: std::ops::Range<usize>,
    /// Index of the gripper command in the arm's part of an action.
    pub(super) command: Option<usize>,
    pub(super) signals: Vec<SignalRow>,
}

/// A dataset.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Array {
    /// Its path below the demonstration, such as `obs/robot0_eef_pos`.
    pub(super) path: String,
    pub(super) columns: usize,
    /// Whether a setting names it.
    named: bool,
}

impl Array {
    /// Its name without the group.
    fn name(&self) -> &str {
        self.path.rsplit_once('/').map_or(&*self.path, |(_, name)| name)
    }

    fn basis(&self) -> Label {
        if self.named { "setting" } else { "name" }.into()
    }
}

impl ArmLayout {
    /// Chooses the arrays of the first demonstration that can be read; all others must have the same.
    pub(super) fn of(file: &File, demos: &[DemoName], config: &ArmConfig) -> Result<Self, Hdf5Fault> {
        let mut first = None;
        for demo in demos {
            match Self::of_demo(file, &demo.name, config) {
                Ok(layout) => return Ok(layout),
                Err(fault @ Hdf5Fault::NeedsLibrary) => return Err(fault),
                Err(fault) => {
                    first.get_or_insert(fault);
                }
            }
        }
        Err(first.unwrap_or(Hdf5Fault::NoData))
    }

    fn of_demo(file: &File, demo: &str, config: &ArmConfig) -> Result<Self, Hdf5Fault> {
        let group = format!("data/{demo}");
        let observations = file.members_or_none(&format!("{group}/obs"))?;
        let prefix = arm_of(&observations, config)?;
        let array = |path: String, named: bool| -> Result<Array, Hdf5Fault> {
            let located = file.locate(&format!("{group}/{path}"))?;
            let columns = match located.shape[..] {
                [_] => 1,
                [_, columns] if columns > 0 => columns,
                _ => {
                    return Err(Hdf5Fault::Shape {
                        object: located.name,
                        found: located.shape,
                        expected: "(N, numbers of a row)".to_owned(),
                        fix: "name another dataset in the table [ingest.arm]",
                    });
                }
            };
            Ok(Array { path, columns, named })
        };
        let find = |setting: &Option<String>, names: &[&str], key: &str| -> Result<Option<Array>, Hdf5Fault> {
            let there = |name: &str| observations.iter().any(|other| other == name);
            if let Some(name) = setting {
                if !there(name) {
                    return Err(Hdf5Fault::Other(format!(
                        "ingest.arm.{key} is {name:?}, but there is no dataset {group}/obs/{name}; give one of {}",
                        listed(&observations)
                    )));
                }
                return array(format!("obs/{name}"), true).map(Some);
            }
            let found = names
                .iter()
                .map(|name| format!("{prefix}{name}"))
                .find(|name| there(name));
            found.map(|name| array(format!("obs/{name}"), false)).transpose()
        };
        let actions = match &config.actions {
            Some(name) => array(name.clone(), true),
            None => array("actions".to_owned(), false),
        }?;
        let mut layout = Self {
            joints: find(&config.joints, JOINTS, "joints")?,
            eef_position: find(&config.eef_position, EEF_POSITION, "eef_position")?,
            eef_orientation: find(&config.eef_orientation, EEF_ORIENTATION, "eef_orientation")?,
            gripper: find(&config.gripper, GRIPPER, "gripper")?,
            elements: elements(&actions, prefix, &observations, config)?,
            actions,
            command: None,
            signals: Vec::new(),
        };
        layout.check(&observations, &group)?;
        let width = layout.elements.len();
        layout.command = match config.gripper_command {
            Some(at) if at >= width => {
                return Err(Hdf5Fault::Other(format!(
                    "ingest.arm.gripper_command is {at}, but an action has {width} elements; give 0 to {}",
                    width - 1
                )));
            }
            Some(at) => Some(at),
            None => layout.has_command().then(|| width - 1),
        };
        layout.signals = layout.state_signals();
        layout.signals.extend(layout.action_signals(config));
        Ok(layout)
    }

    /// Checks that there is an arm, and that its arrays have a known form.
    fn check(&self, observations: &[String], group: &str) -> Result<(), Hdf5Fault> {
        if self.joints.is_none() && self.eef_position.is_none() {
            return Err(Hdf5Fault::Other(format!(
                "{group}/obs has neither joint positions nor a position of the end effector under a known name; name its datasets in the table [ingest.arm] (joints, eef_position, eef_orientation, gripper); it has {}",
                listed(observations)
            )));
        }
        let wrong = |array: &Array, expected: &str| Hdf5Fault::Shape {
            object: format!("{group}/{}", array.path),
            found: vec![array.columns],
            expected: expected.to_owned(),
            fix: "name another dataset in the table [ingest.arm]",
        };
        match (&self.eef_position, &self.eef_orientation) {
            (Some(array), _) if array.columns != 3 => Err(wrong(array, "rows of three numbers")),
            (_, Some(array)) if !matches!(array.columns, 3 | 4) => Err(wrong(
                array,
                "rows of a quaternion (x, y, z, w) or of a rotation vector",
            )),
            _ => Ok(()),
        }
    }

    /// The commands of the arm, by the number of elements of an action: those of the end effector or of the joints, without the
    /// gripper.
    fn commands(&self) -> Option<Commands> {
        let joints = self.joints.as_ref().map(|array| array.columns);
        let width = self.elements.len();
        match width {
            7 | 4 if self.eef_position.is_some() => Some(Commands::Eef),
            6 | 3 if self.eef_position.is_some() && joints != Some(width) => Some(Commands::Eef),
            _ if joints == Some(width) || joints.is_some_and(|joints| joints + 1 == width) => Some(Commands::Joints),
            _ => None,
        }
    }

    /// Whether the last element of an action is a gripper command: it is one more than the arm's own.
    fn has_command(&self) -> bool {
        let joints = self.joints.as_ref().map(|array| array.columns);
        match self.commands() {
            Some(Commands::Eef) => matches!(self.elements.len(), 4 | 7),
            Some(Commands::Joints) => joints != Some(self.elements.len()),
            None => self.elements.len() > 1,
        }
    }

    /// The arrays of the state vector, with the role and the unit of their elements, in order.
    pub(super) fn state(&self) -> impl Iterator<Item = (&Array, SignalRole, Option<Label>)> {
        let unit = |columns: usize| (columns == 3).then(|| "rad".into());
        [
            (&self.joints, SignalRole::Joint, None),
            (&self.eef_position, SignalRole::EefPosition, Some("m".into())),
            (
                &self.eef_orientation,
                SignalRole::EefOrientation,
                self.eef_orientation.as_ref().and_then(|array| unit(array.columns)),
            ),
            (&self.gripper, SignalRole::Gripper, None),
        ]
        .into_iter()
        .filter_map(|(array, role, unit)| Some((array.as_ref()?, role, unit)))
    }

    fn state_signals(&self) -> Vec<SignalRow> {
        let elements = self.state().flat_map(|(array, role, unit)| {
            (0..array.columns)
                .map(move |element| (format!("{}_{element}", array.name()), role, unit.clone(), array.basis()))
        });
        (0..)
            .zip(elements)
            .map(|(index, (name, role, unit, basis))| SignalRow {
                vector: SignalVector::State,
                index,
                name,
                role,
                unit,
                basis,
            })
            .collect()
    }

    fn action_signals(&self, config: &ArmConfig) -> Vec<SignalRow> {
        let commands = self.commands();
        let role = |element: usize| match commands {
            _ if self.command == Some(element) => SignalRole::Gripper,
            Some(Commands::Eef) if element < 3 => SignalRole::EefPosition,
            Some(Commands::Eef) if element < 6 => SignalRole::EefOrientation,
            Some(Commands::Joints) => SignalRole::Joint,
            _ => SignalRole::Other,
        };
        let basis = |element: usize| match config.gripper_command {
            Some(at) if at == element => "setting",
            _ => "count",
        };
        (0..)
            .zip(self.elements.clone().enumerate())
            .map(|(index, (own, element))| SignalRow {
                vector: SignalVector::Action,
                index,
                name: format!("{}_{element}", self.actions.name()),
                role: role(own),
                unit: None,
                basis: basis(own).into(),
            })
            .collect()
    }
}

/// What an action commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Commands {
    Eef,
    Joints,
}

/// The names of arms that begin the names of their datasets.
pub(super) fn arms() -> impl Iterator<Item = &'static str> {
    ARMS.iter()
        .map(|prefix| prefix.trim_end_matches('_'))
        .filter(|arm| !arm.is_empty())
}

/// Beginning of the names of the arm's datasets. Two arms are refused, unless a setting chooses one.
fn arm_of<'a>(observations: &[String], config: &'a ArmConfig) -> Result<&'a str, Hdf5Fault> {
    let has = |prefix: &str| {
        let names = JOINTS.iter().chain(EEF_POSITION);
        names
            .map(|name| format!("{prefix}{name}"))
            .any(|name| observations.contains(&name))
    };
    let there = ARMS.iter().copied().filter(|prefix| !prefix.is_empty() && has(prefix));
    let there: Vec<&'static str> = there.collect();
    let name = |prefix: &&str| format!("{:?}", prefix.trim_end_matches('_'));
    let names = || there.iter().map(name).collect::<Vec<_>>().join(", ");
    match (&config.arm, &there[..]) {
        (Some(arm), _) => ARMS
            .iter()
            .find(|prefix| prefix.trim_end_matches('_') == arm && has(prefix))
            .copied()
            .ok_or_else(|| {
                Hdf5Fault::Other(format!(
                    "ingest.arm.arm is {arm:?}, but no datasets of the observations begin with {arm}_; give one of {}",
                    names()
                ))
            }),
        (None, [_, _, ..]) => Err(Hdf5Fault::Other(format!(
            "it has several arms ({}); set ingest.arm.arm to one of them, and ingest.arm.action_elements to its part of an action, such as [0, 7]",
            names()
        ))),
        (None, [one]) => Ok(one),
        (None, []) => Ok(""),
    }
}

/// The elements of an action that are the arm's.
fn elements(
    actions: &Array,
    prefix: &str,
    observations: &[String],
    config: &ArmConfig,
) -> Result<std::ops::Range<usize>, Hdf5Fault> {
    match config.action_elements {
        Some([first, end]) if end <= actions.columns => Ok(first..end),
        Some([first, end]) => Err(Hdf5Fault::Other(format!(
            "ingest.arm.action_elements is [{first}, {end}], but an action has {} elements; give an end of at most {}",
            actions.columns, actions.columns
        ))),
        None => {
            let other = |name: &&&str| !name.is_empty() && **name != prefix;
            let several = ARMS.iter().filter(other).any(|other| {
                let names = JOINTS.iter().chain(EEF_POSITION);
                names
                    .map(|name| format!("{other}{name}"))
                    .any(|name| observations.contains(&name))
            });
            if several {
                return Err(Hdf5Fault::Other(format!(
                    "it has several arms, and ingest.arm.arm chooses one, but which of the {} elements of an action are its own is not known; set ingest.arm.action_elements, such as [0, {}]",
                    actions.columns,
                    actions.columns / 2
                )));
            }
            Ok(0..actions.columns)
        }
    }
}

/// Names for a message, at most twelve.
fn listed(names: &[String]) -> String {
    match names {
        [] => "no datasets".to_owned(),
        names if names.len() > 12 => format!("{} and {} others", names[..12].join(", "), names.len() - 12),
        names => names.join(", "),
    }
}

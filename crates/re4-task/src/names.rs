//! Tasks by name.

use std::borrow::Cow;
use std::fmt;
use std::ops::Deref;
use std::sync::LazyLock;

use re4_geometry::spatial::Symmetry;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

use crate::records::{ARM, PUSHT, RECORDS, ROBOSUITE};
use crate::{Camera, TaskSpec};

/// A robosuite task that has a record.
#[derive(Clone, Copy)]
pub struct RobosuiteTask(&'static TaskSpec);

impl RobosuiteTask {
    /// Returns all tasks with a record.
    pub fn all() -> impl Iterator<Item = Self> {
        RECORDS.iter().map(Self)
    }

    /// Returns the task with this name in pipeline files.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().find(|task| task.name == name)
    }

    /// Returns the task of an environment, given by robosuite's name or by `MimicGen`'s name (`Square_D0`, `Square_D1`, ...).
    /// `MimicGen`'s environments have the same scene, object vector and success rule as robosuite's, but other distributions of
    /// initial poses.
    #[must_use]
    pub fn of_environment(name: &str) -> Option<Self> {
        let mimicgen = Self::distribution(name).and_then(|_| name.rsplit_once('_'));
        Self::all().find(|task| match mimicgen {
            Some((scene, _)) => scene == task.environment || Some(scene) == task.mimicgen,
            None => name == task.environment,
        })
    }

    /// Returns the number of `MimicGen`'s initial distribution in an environment name: 1 for `Square_D1`. Number 0 is robosuite's
    /// own distribution. `None` if the name is not one of `MimicGen`'s.
    #[must_use]
    pub fn distribution(environment: &str) -> Option<u32> {
        let (_, ending) = environment.rsplit_once('_')?;
        let digits = ending.strip_prefix('D')?;
        let plain = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
        digits.parse().ok().filter(|_| plain)
    }

    /// Returns a part of an error message: the environments of the tasks with a record, and a remedy with the names of these
    /// tasks.
    #[must_use]
    pub fn known() -> String {
        let environments: Vec<_> = RECORDS.iter().map(|task| task.environment.to_owned()).collect();
        let names: Vec<_> = RECORDS.iter().map(|task| format!("{:?}", task.name)).collect();
        format!(
            "of robosuite's environments only {} can be simulated; set task to {}",
            enumerated(&environments, "and"),
            enumerated(&names, "or")
        )
    }
}

/// Formats a list as "a, b and c".
fn enumerated(words: &[String], last: &str) -> String {
    match words {
        [first @ .., end] if !first.is_empty() => format!("{} {last} {end}", first.join(", ")),
        _ => words.concat(),
    }
}

impl Deref for RobosuiteTask {
    type Target = TaskSpec;

    fn deref(&self) -> &'static TaskSpec {
        self.0
    }
}

impl PartialEq for RobosuiteTask {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for RobosuiteTask {}

impl fmt::Debug for RobosuiteTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl Serialize for RobosuiteTask {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name)
    }
}

impl<'de> Deserialize<'de> for RobosuiteTask {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        static NAMES: LazyLock<Vec<&'static str>> = LazyLock::new(|| RECORDS.iter().map(|task| task.name).collect());
        let name = String::deserialize(deserializer)?;
        Self::named(&name).ok_or_else(|| D::Error::unknown_variant(&name, &NAMES))
    }
}

/// The properties that every task has, with or without a record.
pub(crate) struct Summary {
    pub(crate) name: &'static str,
    pub(crate) environment: &'static str,
    pub(crate) about: &'static str,
    pub(crate) cameras: &'static [Camera],
    pub(crate) control_rate: usize,
}

/// The task of a pipeline file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Push-T, the only planar task.
    PushT,
    /// A robosuite task that has a record.
    Known(RobosuiteTask),
    /// Any other robosuite environment with one arm and a two-finger gripper. It is not simulated.
    Robosuite,
    /// Any arm with a gripper, without an object. It is not simulated.
    Arm,
}

/// What the demonstrations of a task consist of; each has its own tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Domain {
    /// A point and an object in a plane: Push-T.
    Plane,
    /// A gripper and an object in SE(3): robosuite's tasks.
    Space,
    /// An arm with a gripper, without an object.
    Arm,
}

impl Task {
    /// Returns all tasks, in the order in which they are listed.
    pub fn all() -> impl Iterator<Item = Self> {
        let known = RobosuiteTask::all().map(Self::Known);
        std::iter::once(Self::PushT)
            .chain(known)
            .chain([Self::Robosuite, Self::Arm])
    }

    fn summary(self) -> Summary {
        match self {
            Self::PushT => PUSHT,
            Self::Known(RobosuiteTask(task)) => Summary {
                name: task.name,
                environment: task.environment,
                about: task.about,
                cameras: task.cameras,
                control_rate: task.control_rate,
            },
            Self::Robosuite => ROBOSUITE,
            Self::Arm => ARM,
        }
    }

    /// What the demonstrations consist of.
    #[must_use]
    pub fn domain(self) -> Domain {
        match self {
            Self::PushT => Domain::Plane,
            Self::Known(_) | Self::Robosuite => Domain::Space,
            Self::Arm => Domain::Arm,
        }
    }

    /// Name in pipeline files and artifacts.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.summary().name
    }

    /// Name of the environment in texts for users.
    #[must_use]
    pub fn environment(self) -> &'static str {
        self.summary().environment
    }

    /// Cameras whose images can be rendered.
    #[must_use]
    pub fn cameras(self) -> &'static [Camera] {
        self.summary().cameras
    }

    /// Number of control steps per second (Hz).
    #[must_use]
    pub fn control_rate(self) -> usize {
        self.summary().control_rate
    }

    /// Whether the task is planar.
    #[must_use]
    pub fn is_planar(self) -> bool {
        self.domain() == Domain::Plane
    }

    /// Returns the robosuite task if it has a record and can therefore be simulated.
    #[must_use]
    pub fn robosuite(self) -> Option<RobosuiteTask> {
        match self {
            Self::Known(task) => Some(task),
            Self::PushT | Self::Robosuite | Self::Arm => None,
        }
    }

    /// Rotations after which the manipulated object looks the same, in its own frame. None for a task without a record.
    #[must_use]
    pub fn symmetry(self) -> Symmetry {
        self.robosuite().map_or(Symmetry::None, |task| task.symmetry)
    }
}

impl Serialize for Task {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for Task {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        static NAMES: LazyLock<Vec<&'static str>> = LazyLock::new(|| Task::all().map(Task::name).collect());
        let name = String::deserialize(deserializer)?;
        Self::all()
            .find(|task| task.name() == name)
            .ok_or_else(|| D::Error::unknown_variant(&name, &NAMES))
    }
}

impl JsonSchema for Task {
    fn schema_name() -> Cow<'static, str> {
        "TaskName".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let variant = |task: Task| {
            let Summary { name, about, .. } = task.summary();
            json_schema!({ "description": about, "type": "string", "const": name })
        };
        let variants: Vec<Schema> = Self::all().map(variant).collect();
        json_schema!({ "description": "Tasks that this version supports.", "oneOf": variants })
    }
}

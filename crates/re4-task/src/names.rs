//! Tasks by name.

use std::borrow::Cow;
use std::fmt;
use std::ops::Deref;
use std::sync::LazyLock;

use re4_geometry::spatial::Symmetry;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

use crate::records::{PUSHT, RECORDS, ROBOSUITE};
use crate::{Camera, TaskSpec};

/// A robosuite task that has a record.
#[derive(Clone, Copy)]
pub struct RobosuiteTask(&'static TaskSpec);

impl RobosuiteTask {
    /// All of them.
    pub fn all() -> impl Iterator<Item = Self> {
        RECORDS.iter().map(Self)
    }

    /// The task that a pipeline file calls by this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().find(|task| task.name == name)
    }

    /// The task of an environment's name: robosuite's, or `MimicGen`'s for the same scene, object vector and success rule with
    /// one of its initial distributions (`Square_D0`, `Square_D1`, ...).
    #[must_use]
    pub fn of_environment(name: &str) -> Option<Self> {
        let mimicgen = Self::distribution(name).and_then(|_| name.rsplit_once('_'));
        Self::all().find(|task| match mimicgen {
            Some((scene, _)) => scene == task.environment || Some(scene) == task.mimicgen,
            None => name == task.environment,
        })
    }

    /// Number of `MimicGen`'s initial distribution in an environment's name, 0 for robosuite's own: that of `Square_D1` is 1.
    /// None in robosuite's names.
    #[must_use]
    pub fn distribution(environment: &str) -> Option<u32> {
        let (_, ending) = environment.rsplit_once('_')?;
        let digits = ending.strip_prefix('D')?;
        let plain = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
        digits.parse().ok().filter(|_| plain)
    }

    /// What a user reads who named a task without a record: which environments have one, and how the tasks are called.
    #[must_use]
    pub fn known() -> String {
        let environments: Vec<_> = RECORDS.iter().map(|task| task.environment.to_owned()).collect();
        let names: Vec<_> = RECORDS.iter().map(|task| format!("{:?}", task.name)).collect();
        format!(
            "of robosuite's environments, those simulated here are {}; set task to {}",
            enumerated(&environments, "and"),
            enumerated(&names, "or")
        )
    }
}

/// "a, b and c".
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

/// What is known of every task.
pub(crate) struct Summary {
    pub(crate) name: &'static str,
    pub(crate) environment: &'static str,
    pub(crate) about: &'static str,
    pub(crate) cameras: &'static [Camera],
    pub(crate) control_rate: usize,
}

/// What a pipeline file may name as its task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Push-T: the only one in the plane.
    PushT,
    /// A robosuite task that has a record.
    Known(RobosuiteTask),
    /// Any other robosuite environment of one arm with a two-finger gripper.
    Robosuite,
}

impl Task {
    /// All of them, in the order in which they are listed.
    pub fn all() -> impl Iterator<Item = Self> {
        let known = RobosuiteTask::all().map(Self::Known);
        std::iter::once(Self::PushT).chain(known).chain([Self::Robosuite])
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
        }
    }

    /// Name in pipeline files and artifacts.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.summary().name
    }

    /// Name of the environment for readers.
    #[must_use]
    pub fn environment(self) -> &'static str {
        self.summary().environment
    }

    /// Cameras whose images can be rendered.
    #[must_use]
    pub fn cameras(self) -> &'static [Camera] {
        self.summary().cameras
    }

    /// Control steps a second.
    #[must_use]
    pub fn control_rate(self) -> usize {
        self.summary().control_rate
    }

    /// Whether it takes place in the plane.
    #[must_use]
    pub fn is_planar(self) -> bool {
        self == Self::PushT
    }

    /// The robosuite task that has a record, and can be simulated.
    #[must_use]
    pub fn robosuite(self) -> Option<RobosuiteTask> {
        match self {
            Self::Known(task) => Some(task),
            Self::PushT | Self::Robosuite => None,
        }
    }

    /// Rotations after which the manipulated object looks the same.
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
        json_schema!({ "description": "Tasks that this version knows.", "oneOf": variants })
    }
}

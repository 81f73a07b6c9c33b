//! Files of projects that build on robomimic's layout: `MimicGen`, LIBERO, `RoboCasa` and robosuite 1.5's composite controllers.
//!
//! They differ from robomimic's files in what they contain (no rewards, no `/mask`), in where the object's pose is, in the time of
//! their observations, and in the frame of their actions. What a file claims is proven from its numbers, with a row in the table
//! `conventions`; files without these traits are not affected.

mod arms;
mod base;
mod bddl;
mod datagen;
mod evidence;
mod libero;
mod mimicgen;
mod target;

use nalgebra::Isometry3;
use re4_robosuite::conventions::Settings;
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::kinematics::Model;

use super::demo::Demo;
use super::fault::Hdf5Fault;
use super::interpret::{Prepared, Reading};
use super::reader::RobomimicReader;
use crate::tables::Convention;

use base::BaseFrame;

pub(super) use arms::{check_task, refuse_two_arms};
pub(super) use base::check_base;
pub(super) use datagen::{Datagen, FoundDatagen, GROUP as DATAGEN};
pub(super) use libero::Cameras;

/// The project whose layout a file has.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Family {
    /// robomimic's or robosuite's own.
    Plain,
    MimicGen,
    Libero,
    RoboCasa,
}

/// What a file has beyond robomimic's layout.
#[derive(Debug, Clone)]
pub(super) struct Relative {
    family: Family,
    /// The manipulated object that the file names, and where it names it.
    object: Option<(String, &'static str)>,
    /// The object's target, if the file names it.
    target: Option<String>,
    /// Names in `datagen_info/object_poses` of the first demonstration.
    poses_of: Vec<String>,
    /// What is proven of `datagen_info`.
    datagen: mimicgen::Proven,
    /// The frame of delta actions, if it is that of the robot's base.
    base: BaseFrame,
    /// Whether the observations of the file are one frame late.
    late: bool,
    rows: Vec<Convention>,
    warnings: Vec<String>,
}

/// Name of the manipulated object's body in `RoboCasa`'s models.
const ROBOCASA_OBJECT: &str = "obj";

impl Relative {
    /// Finds out what a file is, from its attributes and the names of its datasets.
    ///
    /// # Errors
    /// The file moves several objects, or its goal is not to place an object, and no setting names an object.
    pub(super) fn of(reader: &RobomimicReader, reading: &Reading, env: &EnvArgs) -> Result<Self, Hdf5Fault> {
        let mut relative = Self {
            family: Family::Plain,
            object: None,
            target: None,
            poses_of: reader.datagen_objects()?,
            datagen: mimicgen::Proven::default(),
            base: BaseFrame::default(),
            late: false,
            rows: Vec::new(),
            warnings: Vec::new(),
        };
        if let Some(scene) = mimicgen::Scene::of(&env.env_name, !relative.poses_of.is_empty()) {
            relative.warnings.extend(scene.check(&env.env_name, reading)?);
            relative.object = scene
                .object()
                .map(|object| (object.to_owned(), "the object that MimicGen's task moves"));
            relative.target = scene.target().map(str::to_owned);
            relative.family = Family::MimicGen;
        } else if let Some(task) = libero::Task::of(reader, env)? {
            relative.family = Family::Libero;
            relative.warnings.extend(task.check(reading)?);
            relative.object = task
                .object()
                .map(|object| (object, "attribute bddl_file_content of /data"));
            relative.target = task.target();
        } else if reader.has_episode_metadata()? {
            relative.family = Family::RoboCasa;
        }
        Ok(relative)
    }

    /// The name of the manipulated object in the file, if neither the task nor a setting names it.
    pub(super) fn object(&self, model: &Model) -> Option<String> {
        let casa = || {
            let known = self.family == Family::RoboCasa && model.object(ROBOCASA_OBJECT).is_ok();
            known.then(|| ROBOCASA_OBJECT.to_owned())
        };
        self.object.as_ref().map(|(name, _)| name.clone()).or_else(casa)
    }

    /// What defines the manipulated object, for the table of conventions.
    pub(super) fn object_source(&self, reading: &Reading) -> &'static str {
        const BODY: &str = "the body of the manipulated object";
        if reading.object.is_some() || reading.task.is_some() {
            return BODY;
        }
        let casa = || (self.family == Family::RoboCasa).then_some("RoboCasa's name of the manipulated object");
        self.object
            .as_ref()
            .map(|(_, source)| *source)
            .or_else(casa)
            .unwrap_or(BODY)
    }

    /// The name in `datagen_info/object_poses` that an object is followed by if neither observations nor states have its pose.
    pub(super) fn recorded_object(&self, set: Option<&str>) -> Option<String> {
        let own = self.object.as_ref().map(|(name, _)| name.as_str());
        let name = set.or(own)?;
        self.poses_of.iter().find(|known| *known == name).cloned()
    }

    /// The names in `datagen_info/object_poses`; `None` if there are none.
    pub(super) fn recorded_objects(&self) -> Option<String> {
        (!self.poses_of.is_empty()).then(|| self.poses_of.join(", "))
    }

    /// The object in the model that a name stands for: a body of this name, or the free body that has the poses of this name in
    /// `datagen_info/object_poses`.
    pub(super) fn body_of(name: &str, model: &Model, demos: &[Result<Demo, Hdf5Fault>]) -> Option<String> {
        let own = model.object(name).is_ok().then(|| name.to_owned());
        own.or_else(|| mimicgen::body_of(name, model, demos))
    }

    /// Whether models of all demonstrations are needed to read the actions.
    pub(super) fn needs_models(&self) -> bool {
        self.base.is_rotated()
    }

    /// Converts the actions of a demonstration to world axes, if they are in those of the robot's base.
    pub(super) fn convert(&self, demo: &mut Demo, model: Option<&Model>) -> Result<(), Hdf5Fault> {
        self.base.convert(demo, model)
    }

    /// Determines the frame of the actions of the first demonstrations, and converts these actions.
    ///
    /// # Errors
    /// The base of the robot moves, or the frame differs from the declared one.
    pub(super) fn learn_frame(
        &mut self,
        first: &mut [Prepared],
        env: &EnvArgs,
        settings: &Settings,
    ) -> Result<(), Hdf5Fault> {
        let (base, rows) = BaseFrame::learn(first, env, settings)?;
        self.base = base;
        self.rows.extend(rows);
        Ok(())
    }

    /// The declaration and the settings with which conventions are proven after [`Self::learn_frame`].
    pub(super) fn adapted(&self, env: EnvArgs, settings: &Settings) -> (EnvArgs, Settings) {
        if !self.base.is_rotated() {
            return (env, *settings);
        }
        let settings = Settings {
            allow_actions_beyond_range: true,
            action_frame: None,
            ..*settings
        };
        (env.with_wider_commands(), settings)
    }

    /// Proves what the file has beyond robomimic's layout, from its first demonstrations.
    ///
    /// # Errors
    /// Poses in `datagen_info` differ from those in observations and states.
    pub(super) fn prove(&mut self, first: &[Prepared], views: &[Checked<'_>]) -> Result<(), Hdf5Fault> {
        let mut proven = mimicgen::prove(views)?;
        self.rows.append(&mut proven.rows);
        self.warnings.append(&mut proven.warnings);
        self.datagen = proven;
        if self.family == Family::Libero {
            let (late, row) = libero::prove(first);
            self.late = late;
            self.rows.push(row);
        }
        let target = self.target.as_deref();
        self.warnings
            .extend(target.and_then(|target| target::spread(first, target)));
        Ok(())
    }

    /// Checks `datagen_info` and the time of the observations of a demonstration; the error says what differs.
    pub(super) fn check(&self, demo: &Demo, sites: &[Isometry3<f64>], view: &Checked<'_>) -> Result<(), String> {
        mimicgen::check(view, &self.datagen)?;
        if self.family == Family::Libero {
            libero::check(demo, sites, self.late)?;
        }
        Ok(())
    }

    /// Whether each row of the observations was made after the action of that row, so that images belong to the next frame.
    pub(super) fn is_late(&self) -> bool {
        self.late
    }

    /// The rows for the table of conventions.
    pub(super) fn rows(&self) -> &[Convention] {
        &self.rows
    }

    /// What the user should know.
    pub(super) fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// The name of the format, if it is not robomimic's.
    pub(super) fn format(&self) -> Option<&'static str> {
        match self.family {
            Family::Plain => None,
            Family::MimicGen => Some("hdf5, MimicGen"),
            Family::Libero => Some("hdf5, LIBERO"),
            Family::RoboCasa => Some("hdf5, RoboCasa"),
        }
    }
}

pub(super) use mimicgen::Checked;

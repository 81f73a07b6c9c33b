//! Computes poses from states and model by forward kinematics, for files without the corresponding observations.

use nalgebra::Isometry3;
use re4_robosuite::conventions::{Contradiction, zero_rows};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::kinematics::{Model, Observed};

use super::demo::Demo;
use super::fault::Hdf5Fault;
use super::interpret::{LEAVE_OUT, Reading};
use super::reader::{Layout, RobomimicReader};
use super::relatives::Relative;

/// Poses and finger positions of a demonstration, in the conventions of its file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Poses {
    /// Position of the grip site, world frame, metres.
    pub(super) eef_position: Vec<[f64; 3]>,
    /// Orientation of the end effector.
    pub(super) eef_quaternion: Vec<[f64; 4]>,
    /// Joint positions of the fingers, in metres.
    pub(super) fingers: Vec<[f64; 2]>,
    /// Position of the object (world frame, metres), then its quaternion x, y, z, w; `None` if it is read from observations.
    pub(super) object: Option<Vec<[f64; 7]>>,
}

/// What is computed from the states.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum FromStates {
    Nothing,
    /// Nothing: the pose of the object with this name is in `datagen_info`.
    Datagen(String),
    /// The pose of this object.
    Object(String),
    /// All required observations, and the pose of this object.
    All(String),
}

impl FromStates {
    /// Determines what must be computed from states, and which body is the object.
    pub(super) fn of(
        reader: &RobomimicReader,
        reading: &Reading,
        env: &EnvArgs,
        relative: &Relative,
        (model, demos): (Option<&Model>, &[Result<Demo, Hdf5Fault>]),
    ) -> Result<Self, Hdf5Fault> {
        let layout = reader.layout();
        if layout == Layout::Observed {
            let observed = reading.task.is_some() && !reader.surveyed.object_from_states;
            let stateless = model.is_none() || demos.iter().flatten().all(|demo| demo.states.is_none());
            if stateless
                && (reader.surveyed.lacks_objects || reading.task.is_none())
                && let Some(name) = relative.recorded_object(reading.object.as_deref())
            {
                return Ok(Self::Datagen(name));
            }
            if observed {
                return Ok(Self::Nothing);
            }
        }
        let environment = &env.env_name;
        let Some(model) = model else {
            if let Some(recorded) = relative.recorded_objects().filter(|_| layout == Layout::Observed) {
                return Err(Hdf5Fault::Other(format!(
                    "the manipulated object of environment {environment} is unknown; set ingest.object to one of {recorded}, whose poses are in datagen_info/object_poses"
                )));
            }
            return Err(Hdf5Fault::Other(format!(
                "poses of environment {environment} must be computed from the states, but the demonstrations have no attribute model_file; give a file with models"
            )));
        };
        let robot = model
            .robot(0)
            .map_err(|error| Hdf5Fault::Other(format!("{error}; give a file of one arm with a two-finger gripper")))?;
        if robot.fingers.is_none() {
            return Err(Hdf5Fault::Other(format!(
                "the gripper of the robot in environment {environment} does not have two sliding fingers, and no other gripper is supported; give a file with such a gripper"
            )));
        }
        let named = reading
            .object
            .clone()
            .or_else(|| reading.task.map(|task| task.object.to_owned()))
            .map(|name| Relative::body_of(&name, model, demos).unwrap_or(name))
            .or_else(|| Relative::body_of(&relative.object(model)?, model, demos));
        let candidates: Vec<&str> = model.free_bodies().map(|(_, name)| name).collect();
        let object = named.ok_or_else(|| {
        Hdf5Fault::Other(if candidates.is_empty() {
            format!("the model of environment {environment} has no free body that could be the manipulated object; give a file of a task that has one")
        } else {
            format!(
                "the manipulated object of environment {environment} is unknown; set ingest.object to one of {}",
                candidates.join(", ")
            )
        })
    })?;
        model.object(&object).map_err(|error| {
        Hdf5Fault::Other(if candidates.is_empty() {
            format!("the model of environment {environment} has no free body, so {object:?} cannot be the manipulated object; give a file of a task that has one")
        } else {
            format!("{error}; correct ingest.object")
        })
    })?;
        Ok(match layout {
            Layout::Observed => Self::Object(object),
            Layout::Raw => Self::All(object),
        })
    }

    /// Moves the observations out of a demonstration, and adds what is computed from its states.
    pub(super) fn complete(&self, demo: &mut Demo, model: Option<&Model>) -> Result<Poses, Hdf5Fault> {
        let mut poses = Poses {
            eef_position: std::mem::take(&mut demo.eef_position),
            eef_quaternion: std::mem::take(&mut demo.eef_quaternion),
            fingers: std::mem::take(&mut demo.fingers),
            object: None,
        };
        let name = match self {
            Self::Nothing => return Ok(poses),
            Self::Datagen(name) => {
                let recorded = demo.datagen.as_ref().and_then(|datagen| datagen.object(name));
                let recorded = recorded.ok_or_else(|| Hdf5Fault::Missing {
                    objects: vec![format!("data/{}/datagen_info/object_poses/{name}", demo.name)],
                    fix: "restore it, or leave the demonstration out with a filter key or ingest.select",
                })?;
                poses.object = Some(recorded.iter().map(row_of).collect());
                return Ok(poses);
            }
            Self::Object(name) | Self::All(name) => name,
        };
        let refuse = |why: String| {
            Hdf5Fault::Other(format!(
                "{}: poses cannot be computed from states and model_file: {why}",
                demo.name
            ))
        };
        let (Some(model), Some(states)) = (model, &demo.states) else {
            return Err(refuse(
                "one of the two is missing; restore it, or leave the demonstration out".to_owned(),
            ));
        };
        let rows = || states.values.chunks_exact(states.columns);
        // Rows of zeros were allocated but never recorded.
        if let Some(zeros) = zero_rows(&demo.actions, &rows().collect::<Vec<_>>()) {
            let why = Contradiction::zeros(&demo.name, &zeros);
            return Err(Hdf5Fault::Other(format!("{why}; {LEAVE_OUT}")));
        }
        let observed: Vec<Observed> = model.observe(rows(), Some(name)).map_err(|error| {
            refuse(format!(
                "{error}; restore what is wrong, or leave the demonstration out"
            ))
        })?;
        if *self == Self::All(name.clone()) {
            poses.eef_position = observed
                .iter()
                .map(|seen| seen.site.translation.vector.into())
                .collect();
            poses.eef_quaternion = observed.iter().map(|seen| seen.hand.rotation.coords.into()).collect();
            let fingers = observed
                .iter()
                .map(|seen| seen.gripper_qpos)
                .collect::<Option<Vec<_>>>();
            poses.fingers =
                fingers.ok_or_else(|| refuse("the gripper does not have two sliding fingers".to_owned()))?;
        }
        let pose = |seen: &Observed| seen.object.as_ref().map(row_of);
        poses.object = Some(observed.iter().filter_map(pose).collect());
        Ok(poses)
    }
}

/// Position and quaternion (x, y, z, w) of a pose.
fn row_of(pose: &Isometry3<f64>) -> [f64; 7] {
    let [x, y, z]: [f64; 3] = pose.translation.vector.into();
    let [qx, qy, qz, qw]: [f64; 4] = pose.rotation.coords.into();
    [x, y, z, qx, qy, qz, qw]
}

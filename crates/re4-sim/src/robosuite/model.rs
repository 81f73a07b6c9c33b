//! A compiled scene, with the indices of the robot and the object in it.

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use re4_mujoco::{Data, Kind, Library, Model, MujocoError};

use super::controller::JOINTS;
use super::{Fidelity, Profile, RobosuiteTask};
use crate::SimError;

/// Actuators of a Panda with its gripper: seven torque motors, two position actuators.
pub(super) const ACTUATORS: usize = 9;
/// Seconds per simulation step; a control step at 20 Hz is 0.05 s.
pub(super) const TIMESTEP: f64 = 0.002;

/// Indices of the bodies, sites and joints that are simulated, and the ranges of the actuators.
#[derive(Debug, Clone)]
pub(super) struct Robot {
    pub(super) arm_coordinates: [usize; JOINTS],
    pub(super) arm_freedoms: [usize; JOINTS],
    pub(super) finger_coordinates: [usize; 2],
    pub(super) torque_range: [[f64; 2]; JOINTS],
    pub(super) finger_range: [[f64; 2]; 2],
    pub(super) grip_site: usize,
    pub(super) hand: usize,
    pub(super) object: usize,
    /// First coordinate and first degree of freedom of the object's free joint.
    pub(super) object_joint: (usize, usize),
    pub(super) landmarks: Vec<usize>,
}

/// A compiled scene of a task. It is cheap to clone and can be shared by simulations in several threads.
#[derive(Clone)]
pub struct RobosuiteModel {
    pub(super) task: RobosuiteTask,
    pub(super) profile: Profile,
    pub(super) fidelity: Fidelity,
    pub(super) model: Model,
    pub(super) robot: Robot,
}

impl RobosuiteModel {
    /// The same model with another fidelity.
    #[must_use]
    pub fn with_fidelity(self, fidelity: Fidelity) -> Self {
        Self { fidelity, ..self }
    }

    /// Whether forces are also computed before the controller reads the state, as robosuite 1.4 does.
    pub(super) fn solves_thrice(&self) -> bool {
        self.profile == Profile::V1_4 && self.fidelity == Fidelity::Robosuite
    }

    /// Compiles the scene of a task from MJCF that refers to its files by absolute paths, such as a demonstration's `model_file`
    /// after its paths were rewritten.
    ///
    /// # Errors
    /// If MuJoCo refuses the model, or it is not a scene of the task with one Panda of this profile.
    pub fn compile(library: &Library, task: RobosuiteTask, profile: Profile, mjcf: &str) -> Result<Self, SimError> {
        let model = Model::compile(library, mjcf).map_err(|source| SimError::Mujoco {
            task: task.environment,
            source,
        })?;
        let robot = Robot::find(&model, task, profile)?;
        Ok(Self {
            task,
            profile,
            fidelity: Fidelity::default(),
            model,
            robot,
        })
    }

    /// The task.
    #[must_use]
    pub fn task(&self) -> RobosuiteTask {
        self.task
    }

    /// The version of robosuite whose behaviour is reproduced.
    #[must_use]
    pub fn profile(&self) -> Profile {
        self.profile
    }

    /// The compiled model, for example for rendering.
    #[must_use]
    pub fn mujoco(&self) -> &Model {
        &self.model
    }

    /// Length of a flattened state: time, coordinates, velocities.
    #[must_use]
    pub fn state_length(&self) -> usize {
        1 + self.model.nq() + self.model.nv()
    }
}

impl Robot {
    fn find(model: &Model, task: RobosuiteTask, profile: Profile) -> Result<Self, SimError> {
        let lacks = |error: MujocoError| SimError::Model {
            task: task.environment,
            reason: error.to_string(),
        };
        if model.nu() != ACTUATORS {
            return Err(SimError::Model {
                task: task.environment,
                reason: format!(
                    "the model has {} actuators, a Panda with its gripper has {ACTUATORS}",
                    model.nu()
                ),
            });
        }
        if model.timestep() != TIMESTEP {
            return Err(SimError::Model {
                task: task.environment,
                reason: format!("the model's time step is {} s, not {TIMESTEP} s", model.timestep()),
            });
        }
        if model.na() != 0 {
            return Err(SimError::Model {
                task: task.environment,
                reason: "the model has actuators with an internal state".to_owned(),
            });
        }
        let mut arm_coordinates = [0; JOINTS];
        let mut arm_freedoms = [0; JOINTS];
        for i in 0..JOINTS {
            (arm_coordinates[i], arm_freedoms[i]) = model.joint(&format!("robot0_joint{}", i + 1)).map_err(lacks)?;
        }
        let [first, second] = profile.finger_joints();
        let object_joint = task.joint();
        if !model.joint_is_free(&object_joint).map_err(lacks)? {
            return Err(SimError::Model {
                task: task.environment,
                reason: format!("the joint {object_joint} is not a free joint"),
            });
        }
        Ok(Self {
            arm_coordinates,
            arm_freedoms,
            finger_coordinates: [
                model.joint(first).map_err(lacks)?.0,
                model.joint(second).map_err(lacks)?.0,
            ],
            torque_range: std::array::from_fn(|i| model.control_range(i)),
            finger_range: std::array::from_fn(|i| model.control_range(JOINTS + i)),
            grip_site: model.id(Kind::Site, profile.grip_site()).map_err(lacks)?,
            hand: model.id(Kind::Body, "robot0_right_hand").map_err(lacks)?,
            object: model.id(Kind::Body, &task.body()).map_err(lacks)?,
            object_joint: model.joint(&object_joint).map_err(lacks)?,
            landmarks: task
                .landmarks
                .iter()
                .map(|name| model.id(Kind::Body, name))
                .collect::<Result<_, _>>()
                .map_err(lacks)?,
        })
    }

    pub(super) fn site_position(&self, data: &Data) -> Vector3<f64> {
        Vector3::from_column_slice(&data.site_xpos()[3 * self.grip_site..][..3])
    }

    pub(super) fn site_rotation(&self, data: &Data) -> Matrix3<f64> {
        Matrix3::from_row_slice(&data.site_xmat()[9 * self.grip_site..][..9])
    }

    pub(super) fn body_position(data: &Data, body: usize) -> Vector3<f64> {
        Vector3::from_column_slice(&data.xpos()[3 * body..][..3])
    }

    /// Rotation of a body as MuJoCo stores it, including the sign of the quaternion.
    pub(super) fn body_rotation(data: &Data, body: usize) -> UnitQuaternion<f64> {
        let [w, x, y, z] = std::array::from_fn(|i| data.xquat()[4 * body + i]);
        UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
    }

    pub(super) fn body_pose(data: &Data, body: usize) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::from(Self::body_position(data, body)),
            Self::body_rotation(data, body),
        )
    }
}

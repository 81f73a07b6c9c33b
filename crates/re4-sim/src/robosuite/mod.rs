//! The robosuite tasks that have a record in `re4-task`, on MuJoCo's own library.
//!
//! [`Robosuite`] computes what the Python package computes, in the same order: one Panda, `OSC_POSE` control at 20 Hz
//! on simulation steps of 2 ms, delta or absolute actions, the environments' own success rules and observations. A
//! [`Profile`] selects the version. The README of this crate describes the parity tests. Units are metres, radians and seconds;
//! the world frame is robosuite's, z up.
//!
//! As in robosuite, the poses in an observation after a step are those of 2 ms before its end, because the simulation advances
//! after they were computed. Right after a reset they are exact.

mod controller;
mod displace;
mod model;
mod placement;
mod profile;

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use re4_mujoco::Data;

pub use controller::{ArmAction, RobosuiteAction};
pub use model::RobosuiteModel;
pub use placement::{ObjectPlacement, Placement};
pub use profile::{Fidelity, Profile};
pub use re4_task::RobosuiteTask;

use crate::{SimError, Simulator};
use controller::{Controller, JOINTS};
use model::{ACTUATORS, Robot};
use re4_robosuite::hand_from_site;
use re4_task::{ObjectLayout, Positions};

/// Simulation steps per second.
const SIMULATION_RATE: usize = 500;

/// Number of simulation steps in a control step of a task.
#[must_use]
pub fn simulation_steps(task: RobosuiteTask) -> usize {
    SIMULATION_RATE / task.control_rate
}

/// Absolute value from which MuJoCo treats a simulation as unstable (`mjMAXVAL`).
const UNSTABLE_LIMIT: f64 = 1e10;

/// An initial state.
#[derive(Debug, Clone, PartialEq)]
pub enum RobosuiteScene {
    /// A recorded state: time, coordinates, velocities. As in robomimic's `reset_to`, the arm's controller is created
    /// with the arm in the model's initial pose, and keeps that pose as its null-space posture.
    Recorded(Vec<f64>),
    /// Coordinates of a new episode, at rest. The controller is created in this state.
    Placed(Vec<f64>),
}

/// The state from which the controller computes the first torques of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FirstTorques {
    /// The state in which the controller was created, as in robosuite: after a reset to a recorded state it is outdated
    /// for one simulation step.
    #[default]
    AsRobosuite,
    /// The requested state.
    Fresh,
}

/// The part of the state that a policy observes, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobosuiteObservation {
    /// Pose of the grip site, which the controller moves: the position is robomimic's `robot0_eef_pos`.
    pub grip_site: Isometry3<f64>,
    /// Rotation of the hand, robomimic's `robot0_eef_quat`.
    pub hand: UnitQuaternion<f64>,
    /// Pose of the manipulated object.
    pub object: Isometry3<f64>,
    /// Joint positions of the fingers, robomimic's `robot0_gripper_qpos`.
    pub fingers: [f64; 2],
}

impl RobosuiteObservation {
    /// robomimic's `object` vector, in the order of a robosuite version.
    ///
    /// robosuite 1.5 computes the part that is relative to the hand from the object's pose of the previous observation; this
    /// function uses the same observation.
    #[must_use]
    pub fn object_state(&self, task: RobosuiteTask, profile: Profile) -> Vec<f64> {
        let object = pose_numbers(&self.object);
        let apart = self.grip_site.translation.vector - self.object.translation.vector;
        let hand = Isometry3::from_parts(self.grip_site.translation, self.hand);
        let relative = || pose_numbers(&(hand.inverse() * self.object));
        match task.layout(profile.version()) {
            ObjectLayout::LiftEefMinusCube => object.into_iter().chain(apart.iter().copied()).collect(),
            ObjectLayout::LiftCubeMinusEef => object.into_iter().chain((-apart).iter().copied()).collect(),
            ObjectLayout::PoseFirst => object.into_iter().chain(relative()).collect(),
            ObjectLayout::RelativeFirst => relative().into_iter().chain(object).collect(),
        }
    }
}

/// Position, then quaternion in the order (x, y, z, w).
fn pose_numbers(pose: &Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// The result of one control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobosuiteStep {
    /// The state after the step.
    pub observation: RobosuiteObservation,
    /// Whether the task's success rule is satisfied.
    pub success: bool,
}

/// One simulation of a task.
pub struct Robosuite {
    model: RobosuiteModel,
    data: Data,
    controller: Controller,
    /// Work buffer for the coordinates.
    coordinates: Vec<f64>,
}

impl Robosuite {
    /// A simulation in the model's own initial state.
    ///
    /// # Errors
    /// If MuJoCo cannot allocate its data.
    pub fn new(model: &RobosuiteModel) -> Result<Self, SimError> {
        let mut data = Data::new(&model.model).map_err(|source| SimError::Mujoco {
            task: model.task.environment,
            source,
        })?;
        data.forward();
        Ok(Self {
            controller: Controller::new(model.profile, &model.robot, &data),
            coordinates: vec![0.0; data.qpos().len()],
            model: model.clone(),
            data,
        })
    }

    /// The compiled model of the task.
    #[must_use]
    pub fn model(&self) -> &RobosuiteModel {
        &self.model
    }

    /// MuJoCo's data, for example for rendering.
    #[must_use]
    pub fn data(&self) -> &Data {
        &self.data
    }

    /// The flattened state: time, coordinates and velocities.
    #[must_use]
    pub fn state(&self) -> Vec<f64> {
        std::iter::once(self.data.time())
            .chain(self.data.qpos().iter().copied())
            .chain(self.data.qvel().iter().copied())
            .collect()
    }

    /// The observation of the current state.
    #[must_use]
    pub fn observation(&self) -> RobosuiteObservation {
        let robot = &self.model.robot;
        let hand = Robot::body_rotation(&self.data, robot.hand);
        RobosuiteObservation {
            grip_site: Isometry3::from_parts(
                Translation3::from(robot.site_position(&self.data)),
                hand * hand_from_site(),
            ),
            hand,
            object: Robot::body_pose(&self.data, robot.object),
            fingers: robot.finger_coordinates.map(|at| self.data.qpos()[at]),
        }
    }

    /// Whether the task's success rule is satisfied.
    #[must_use]
    pub fn success(&self) -> bool {
        let robot = &self.model.robot;
        let position = |body| Robot::body_position(&self.data, body);
        let landmarks: Vec<_> = robot.landmarks.iter().map(|&body| position(body)).collect();
        (self.model.task.success)(&Positions {
            object: position(robot.object),
            grip_site: robot.site_position(&self.data),
            landmarks: &landmarks,
        })
    }

    /// Sets the state and computes the quantities that depend on it.
    fn set_state(&mut self, time: f64, coordinates: &[f64], velocities: &[f64]) {
        self.data.reset();
        self.data.set_time(time);
        self.data.qpos_mut().copy_from_slice(coordinates);
        self.data.qvel_mut().copy_from_slice(velocities);
        self.data.forward();
    }

    /// Runs one control step with recorded torques and finger targets instead of an action: one row of nine numbers per
    /// simulation step.
    ///
    /// # Errors
    /// As [`Simulator::step`].
    ///
    /// # Panics
    /// If the length of a row is not the number of the model's actuators.
    pub fn step_with_controls(&mut self, rows: &[Vec<f64>]) -> Result<RobosuiteStep, SimError> {
        for row in rows {
            self.stages_before_controls();
            self.controller.mark_used();
            self.data.ctrl_mut().copy_from_slice(row);
            self.data.force_stages();
            self.data.euler();
        }
        self.finish_step()
    }

    /// Runs one control step as [`Simulator::step`] does. The controls of every simulation step, seven torques and two finger
    /// targets, are passed to `through`, which may read and replace them. It also gets the simulation, with the poses of the state
    /// that the simulation step starts from.
    ///
    /// # Errors
    /// As [`Simulator::step`].
    pub fn step_through(
        &mut self,
        action: &RobosuiteAction,
        mut through: impl FnMut(&Self, &mut [f64; ACTUATORS]),
    ) -> Result<RobosuiteStep, SimError> {
        let (ArmAction::Delta(arm) | ArmAction::Absolute(arm)) = &action.arm;
        let numbers = || arm.iter().chain(std::iter::once(&action.gripper));
        if let Some(index) = numbers().position(|number| number.is_nan() || number.abs() >= UNSTABLE_LIMIT) {
            return Err(SimError::NotFinite {
                operation: "step",
                task: self.model.task.environment,
                what: "action",
                index,
                value: numbers().nth(index).copied().unwrap_or(f64::NAN),
            });
        }
        for substep in 0..simulation_steps(self.model.task) {
            self.stages_before_controls();
            if substep == 0 {
                self.controller.set_goal(&action.arm, &self.model.robot, &self.data);
            }
            if substep == 0 || self.model.profile == Profile::V1_4 {
                self.controller.move_gripper(action.gripper);
            }
            let torques = self.controller.torques(&self.model.robot, &self.data);
            let fingers = self.controller.gripper_control(&self.model.robot);
            let mut controls = [0.0; ACTUATORS];
            controls[..JOINTS].copy_from_slice(&torques);
            controls[JOINTS..].copy_from_slice(&fingers);
            through(self, &mut controls);
            self.data.ctrl_mut().copy_from_slice(&controls);
            self.data.force_stages();
            self.data.euler();
        }
        self.finish_step()
    }

    /// Sets the warm start of the constraint solver for the next step, one acceleration per degree of freedom. It is not
    /// part of a recorded state, but affects the last bits of the following states; a reset sets it to zeros.
    ///
    /// # Panics
    /// If the number of accelerations is not the number of degrees of freedom.
    pub fn set_solver_start(&mut self, accelerations: &[f64]) {
        self.data.qacc_warmstart_mut().copy_from_slice(accelerations);
    }

    /// Computes the stages of a simulation step that do not depend on its controls.
    fn stages_before_controls(&mut self) {
        self.data.motion_stages();
        // robosuite 1.4 runs the whole computation up to three times per step: once itself, once when its controller reads
        // the state, once in the step. Each run changes the solver's warm start for the next one.
        if self.model.solves_thrice() {
            let times = 1 + usize::from(self.controller.reads_state());
            for _ in 0..times {
                self.data.force_stages();
                self.repeat_motion_stages();
            }
        }
    }

    /// Runs the motion stages of a state again if this changes their bits: MuJoCo 2.3.7 normalises quaternions when it computes
    /// poses, which can change already normalised ones.
    fn repeat_motion_stages(&mut self) {
        self.coordinates.copy_from_slice(self.data.qpos());
        self.data.normalize_quaternions(&mut self.coordinates);
        if self.coordinates != self.data.qpos() {
            self.data.motion_stages();
        }
    }

    fn finish_step(&self) -> Result<RobosuiteStep, SimError> {
        let stable = |numbers: &[f64]| numbers.iter().all(|number| number.abs() < UNSTABLE_LIMIT);
        if stable(self.data.qpos()) && stable(self.data.qvel()) {
            Ok(RobosuiteStep {
                observation: self.observation(),
                success: self.success(),
            })
        } else {
            Err(SimError::Unstable {
                task: self.model.task.environment,
                reason: "coordinates that are not finite or too large".to_owned(),
            })
        }
    }
}

impl Simulator for Robosuite {
    type Scene = RobosuiteScene;
    type Reset = FirstTorques;
    type Observation = RobosuiteObservation;
    type Action = RobosuiteAction;
    type Step = RobosuiteStep;

    fn reset(&mut self, scene: &RobosuiteScene, first: FirstTorques) -> Result<RobosuiteObservation, SimError> {
        let task = self.model.task.environment;
        let (nq, nv) = (self.model.model.nq(), self.model.model.nv());
        let (RobosuiteScene::Recorded(numbers) | RobosuiteScene::Placed(numbers)) = scene;
        if let Some(index) = numbers
            .iter()
            .position(|number| number.is_nan() || number.abs() >= UNSTABLE_LIMIT)
        {
            return Err(SimError::NotFinite {
                operation: "reset",
                task,
                what: "state",
                index,
                value: numbers[index],
            });
        }
        let expected = match scene {
            RobosuiteScene::Recorded(_) => 1 + nq + nv,
            RobosuiteScene::Placed(_) => nq,
        };
        if numbers.len() != expected {
            return Err(SimError::StateLength {
                task,
                found: numbers.len(),
                expected,
                nq,
                nv: if expected == nq { 0 } else { nv },
            });
        }
        match scene {
            RobosuiteScene::Recorded(state) => {
                // robosuite creates the controller right after it loads the model, with the arm in its initial pose.
                self.data.reset();
                let mut start = self.data.qpos().to_vec();
                for (at, angle) in self.model.robot.arm_coordinates.iter().zip(INITIAL_JOINTS) {
                    start[*at] = angle;
                }
                self.set_state(0.0, &start, &vec![0.0; nv]);
                self.controller = Controller::new(self.model.profile, &self.model.robot, &self.data);
                self.set_state(state[0], &state[1..=nq], &state[1 + nq..]);
                if first == FirstTorques::Fresh {
                    self.controller.refresh(&self.model.robot, &self.data);
                }
            }
            RobosuiteScene::Placed(coordinates) => {
                self.set_state(0.0, coordinates, &vec![0.0; nv]);
                self.controller = Controller::new(self.model.profile, &self.model.robot, &self.data);
            }
        }
        Ok(self.observation())
    }

    fn step(&mut self, action: &RobosuiteAction) -> Result<RobosuiteStep, SimError> {
        self.step_through(action, |_, _| ())
    }
}

/// Joint angles in which robosuite's Panda starts, before noise.
pub const INITIAL_JOINTS: [f64; JOINTS] = [
    0.0,
    std::f64::consts::PI / 16.0,
    0.0,
    // As robosuite computes it: FRAC_PI_3 is not this quotient, but the next floating-point number.
    -std::f64::consts::PI / 2.0 - std::f64::consts::PI / 3.0,
    0.0,
    std::f64::consts::PI - 0.2,
    std::f64::consts::FRAC_PI_4,
];

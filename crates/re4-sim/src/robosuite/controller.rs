//! Operational-space control of the arm (`OSC_POSE`, fixed impedance), and the gripper.
//!
//! Formulas: O. Khatib, "A unified approach for motion and force control of robot manipulators", 1987, as robosuite uses them
//! (`controllers/osc.py` of 1.4.1, `controllers/parts/arm/osc.py` of 1.5.1): gains of 150 and critical damping, position and
//! orientation decoupled from each other, gravity and Coriolis forces compensated, and a posture held in the null space.

use nalgebra::{Matrix3, Matrix6, RowVector6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use re4_mujoco::Data;

use super::Profile;
use super::model::Robot;

/// Joints of the arm.
pub(super) const JOINTS: usize = 7;

pub(super) type Joints = SVector<f64, JOINTS>;
type Jacobian = SMatrix<f64, 6, JOINTS>;
type Inertia = SMatrix<f64, JOINTS, JOINTS>;

const STIFFNESS: f64 = 150.0;
const POSTURE_STIFFNESS: f64 = 10.0;

/// Metres and radians that a delta action of 1 means.
const DELTA_POSITION: f64 = 0.05;
const DELTA_ROTATION: f64 = 0.5;

/// Below this, numpy's pseudo-inverse takes a singular value for zero, relative to the maximum.
const SINGULAR: f64 = 1e-15;

/// What the arm is told at a control step. World frame; the grip site is what is steered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ArmAction {
    /// Translation and rotation vector in parts of 0.05 m and 0.5 rad, from the site's pose; cut to [-1, 1].
    Delta([f64; 6]),
    /// Goal position in metres and goal orientation as a rotation vector in radians.
    Absolute([f64; 6]),
}

/// An action of a control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobosuiteAction {
    /// The arm's part.
    pub arm: ArmAction,
    /// The gripper's part, of which the sign alone counts: below 0 opens, above 0 closes.
    pub gripper: f64,
}

/// The state of the arm that the controller computes with. It is a copy: the controller uses an old one after a reset.
#[derive(Debug, Clone)]
struct ArmState {
    position: Vector3<f64>,
    rotation: Matrix3<f64>,
    velocity: Vector3<f64>,
    angular_velocity: Vector3<f64>,
    joints: Joints,
    joint_velocity: Joints,
    jacobian: Jacobian,
    inertia: Inertia,
}

/// Work space of one simulation, so that control allocates nothing.
#[derive(Debug, Clone)]
struct Scratch {
    translation: Vec<f64>,
    rotation: Vec<f64>,
    inertia: Vec<f64>,
}

/// The controller of one simulation.
#[derive(Debug, Clone)]
pub(super) struct Controller {
    profile: Profile,
    scratch: Scratch,
    state: ArmState,
    /// Whether `state` has been used and must be read anew.
    used: bool,
    goal_position: Vector3<f64>,
    goal_rotation: Matrix3<f64>,
    posture: Joints,
    /// The gripper's command, from open (-1, 1) to closed (1, -1) in units of the half range of its actuators.
    gripper: [f64; 2],
}

impl Controller {
    /// A controller for the state that a simulation is in, which becomes the posture that it holds.
    pub(super) fn new(profile: Profile, robot: &Robot, data: &Data) -> Self {
        let freedoms = data.model().nv();
        let mut scratch = Scratch {
            translation: vec![0.0; 3 * freedoms],
            rotation: vec![0.0; 3 * freedoms],
            inertia: vec![0.0; freedoms * freedoms],
        };
        let state = ArmState::read(robot, data, &mut scratch);
        Self {
            profile,
            scratch,
            goal_position: state.position,
            goal_rotation: state.rotation,
            posture: state.joints,
            state,
            used: false,
            gripper: [0.0; 2],
        }
    }

    /// Forgets the state that the controller was made in: the next torques are those of the simulation's state.
    pub(super) fn refresh(&mut self, robot: &Robot, data: &Data) {
        self.state = ArmState::read(robot, data, &mut self.scratch);
    }

    /// Whether the next torques are computed from the state of the simulation, in place of one kept since the reset.
    pub(super) fn reads_state(&self) -> bool {
        self.used
    }

    /// Counts the state as used, where torques come from elsewhere.
    pub(super) fn mark_used(&mut self) {
        self.used = true;
    }

    fn update(&mut self, robot: &Robot, data: &Data) {
        if self.used {
            self.state = ArmState::read(robot, data, &mut self.scratch);
            self.used = false;
        }
    }

    /// Takes the goal of a control step.
    pub(super) fn set_goal(&mut self, action: &ArmAction, robot: &Robot, data: &Data) {
        self.update(robot, data);
        match action {
            ArmAction::Delta(delta) => {
                let motion: Vector6<f64> = Vector6::from_fn(|i, _| {
                    delta[i].clamp(-1.0, 1.0) * if i < 3 { DELTA_POSITION } else { DELTA_ROTATION }
                });
                self.goal_position = self.state.position + motion.fixed_rows::<3>(0);
                let turn: Vector3<f64> = motion.fixed_rows::<3>(3).into_owned();
                // 1.4 keeps the last goal where no rotation is asked for; 1.5 takes the present orientation.
                if self.profile == Profile::V1_5 || turn != Vector3::zeros() {
                    self.goal_rotation = single_precision_rotation(&turn) * self.state.rotation;
                }
            }
            ArmAction::Absolute(goal) => {
                self.goal_position = Vector3::new(goal[0], goal[1], goal[2]);
                let vector = Vector3::new(goal[3], goal[4], goal[5]);
                self.goal_rotation = match self.profile {
                    Profile::V1_4 => single_precision_rotation(&vector),
                    Profile::V1_5 => UnitQuaternion::from_scaled_axis(vector)
                        .to_rotation_matrix()
                        .into_inner(),
                };
            }
        }
    }

    /// Moves the gripper's command on. 1.4 does so every simulation step, 1.5 once a control step.
    pub(super) fn move_gripper(&mut self, command: f64) {
        let speed = match self.profile {
            Profile::V1_4 => 0.01,
            Profile::V1_5 => 0.2,
        };
        // numpy's sign is 0 at 0.
        let sign = if command > 0.0 {
            1.0
        } else if command < 0.0 {
            -1.0
        } else {
            0.0
        };
        for (finger, direction) in self.gripper.iter_mut().zip([-1.0, 1.0]) {
            *finger = (*finger + direction * speed * sign).clamp(-1.0, 1.0);
        }
    }

    /// Position targets of the two finger actuators.
    pub(super) fn gripper_control(&self, robot: &Robot) -> [f64; 2] {
        std::array::from_fn(|i| {
            let [low, high] = robot.finger_range[i];
            0.5 * (high + low) + 0.5 * (high - low) * self.gripper[i]
        })
    }

    /// Torques of the arm's actuators, within their limits.
    pub(super) fn torques(&mut self, robot: &Robot, data: &Data) -> [f64; JOINTS] {
        self.update(robot, data);
        self.used = true;
        let state = &self.state;
        let damping = 2.0 * STIFFNESS.sqrt();
        let force = STIFFNESS * (self.goal_position - state.position) - damping * state.velocity;
        let torque =
            STIFFNESS * orientation_error(&self.goal_rotation, &state.rotation) - damping * state.angular_velocity;

        let inverse = state.inertia.try_inverse().unwrap_or_else(Inertia::zeros);
        let jacobian = &state.jacobian;
        let inverse_jacobian_t = inverse * jacobian.transpose();
        let full: Matrix6<f64> = jacobian * inverse_jacobian_t;
        let position: Matrix3<f64> = full.fixed_view::<3, 3>(0, 0).into_owned();
        let orientation: Matrix3<f64> = full.fixed_view::<3, 3>(3, 3).into_owned();
        let decoupled_force = invert3(&position) * force;
        let decoupled_torque = invert3(&orientation) * torque;
        let wrench = Vector6::new(
            decoupled_force.x,
            decoupled_force.y,
            decoupled_force.z,
            decoupled_torque.x,
            decoupled_torque.y,
            decoupled_torque.z,
        );
        let bias = Joints::from_fn(|i, _| data.qfrc_bias()[robot.arm_freedoms[i]]);
        let posture = state.inertia
            * (POSTURE_STIFFNESS * (self.posture - state.joints)
                - 2.0 * POSTURE_STIFFNESS.sqrt() * state.joint_velocity);
        // (I - J̄ J)ᵀ p = p - Jᵀ Λ J M⁻¹ p, without forming the projection.
        let into_task: Vector6<f64> = inverse_jacobian_t.transpose() * posture;
        let held: RowVector6<f64> = (invert6(&full) * into_task).transpose();
        let torques = jacobian.transpose() * wrench + bias + posture - (held * jacobian).transpose();
        std::array::from_fn(|i| {
            let [low, high] = robot.torque_range[i];
            torques[i].clamp(low, high)
        })
    }
}

impl ArmState {
    fn read(robot: &Robot, data: &Data, scratch: &mut Scratch) -> Self {
        let freedoms = data.model().nv();
        data.jacobian(robot.grip_site, &mut scratch.translation, &mut scratch.rotation);
        data.inertia(&mut scratch.inertia);
        let velocity = |rows: &[f64]| {
            Vector3::from_fn(|row, _| {
                rows[row * freedoms..(row + 1) * freedoms]
                    .iter()
                    .zip(data.qvel())
                    .map(|(a, b)| a * b)
                    .sum::<f64>()
            })
        };
        let arm = &robot.arm_freedoms;
        Self {
            position: robot.site_position(data),
            rotation: robot.site_rotation(data),
            velocity: velocity(&scratch.translation),
            angular_velocity: velocity(&scratch.rotation),
            joints: Joints::from_fn(|i, _| data.qpos()[robot.arm_coordinates[i]]),
            joint_velocity: Joints::from_fn(|i, _| data.qvel()[arm[i]]),
            jacobian: Jacobian::from_fn(|row, i| {
                if row < 3 {
                    scratch.translation[row * freedoms + arm[i]]
                } else {
                    scratch.rotation[(row - 3) * freedoms + arm[i]]
                }
            }),
            inertia: Inertia::from_fn(|row, i| scratch.inertia[arm[row] * freedoms + arm[i]]),
        }
    }
}

/// Half the sum of the cross products of the columns: the sine of the angle along the axis, for small angles the rotation
/// vector from the current orientation to the desired one.
fn orientation_error(desired: &Matrix3<f64>, current: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * (0..3)
        .map(|i| current.column(i).cross(&desired.column(i)))
        .fold(Vector3::zeros(), |sum, part| sum + part)
}

fn invert3(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    matrix
        .try_inverse()
        .or_else(|| matrix.pseudo_inverse(SINGULAR * matrix.norm()).ok())
        .unwrap_or_else(Matrix3::zeros)
}

fn invert6(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    matrix
        .try_inverse()
        .or_else(|| matrix.pseudo_inverse(SINGULAR * matrix.norm()).ok())
        .unwrap_or_else(Matrix6::zeros)
}

/// A rotation vector as a matrix, by way of a quaternion in single precision, as robosuite's `quat2mat` does it: the
/// demonstrations were recorded with goals rounded like that.
fn single_precision_rotation(vector: &Vector3<f64>) -> Matrix3<f64> {
    let angle = vector.norm();
    // numpy's isclose to 0 with no absolute tolerance: exactly zero.
    let quaternion = if angle == 0.0 {
        [1.0, 0.0, 0.0, 0.0]
    } else {
        let axis = vector / angle;
        let sine = (angle / 2.0).sin();
        [(angle / 2.0).cos(), axis.x * sine, axis.y * sine, axis.z * sine]
    };
    let rounded = quaternion.map(|part| part as f32);
    // The BLAS that numpy brings adds products of single precision up in double precision.
    let squared = rounded.iter().map(|part| f64::from(part * part)).sum::<f64>() as f32;
    let scale = (2.0 / f64::from(squared)).sqrt();
    let q = rounded.map(|part| (f64::from(part) * scale) as f32);
    let product = |a: usize, b: usize| q[a] * q[b];
    let diagonal = |a: usize, b: usize| 1.0 - f64::from(product(a, a)) - f64::from(product(b, b));
    let sum = |a: usize, b: usize, c: usize, d: usize| f64::from(product(a, b) + product(c, d));
    let difference = |a: usize, b: usize, c: usize, d: usize| f64::from(product(a, b) - product(c, d));
    Matrix3::new(
        diagonal(2, 3),
        difference(1, 2, 3, 0),
        sum(1, 3, 2, 0),
        sum(1, 2, 3, 0),
        diagonal(1, 3),
        difference(2, 3, 1, 0),
        difference(1, 3, 2, 0),
        sum(2, 3, 1, 0),
        diagonal(1, 2),
    )
}

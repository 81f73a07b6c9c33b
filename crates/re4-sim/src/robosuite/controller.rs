//! Operational-space control of the arm (`OSC_POSE`, fixed impedance), and the gripper.
//!
//! Formulas: O. Khatib, "A unified approach for motion and force control of robot manipulators", 1987, as robosuite uses them
//! (`controllers/osc.py` of 1.4.1, `controllers/parts/arm/osc.py` of 1.5.1): stiffness 150 and critical damping, position and
//! orientation decoupled from each other, gravity and Coriolis forces compensated, and a posture task in the null space.

use nalgebra::{Matrix3, Matrix6, RowVector6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use re4_mujoco::Data;

use super::Profile;
use super::model::Robot;

/// Number of joints of the arm.
pub(super) const JOINTS: usize = 7;

pub(super) type Joints = SVector<f64, JOINTS>;
type Jacobian = SMatrix<f64, 6, JOINTS>;
type Inertia = SMatrix<f64, JOINTS, JOINTS>;

const STIFFNESS: f64 = 150.0;
const POSTURE_STIFFNESS: f64 = 10.0;

/// Metres and radians of a delta action of 1.
const DELTA_POSITION: f64 = 0.05;
const DELTA_ROTATION: f64 = 0.5;

/// Relative threshold below which numpy's pseudo-inverse treats a singular value as zero.
const SINGULAR_VALUE_CUTOFF: f64 = 1e-15;

/// The arm's command of a control step, in the world frame; it moves the grip site.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ArmAction {
    /// Translation and rotation vector in units of 0.05 m and 0.5 rad, relative to the site's pose; clipped to [-1, 1].
    Delta([f64; 6]),
    /// Goal position in metres and goal orientation as a rotation vector in radians.
    Absolute([f64; 6]),
}

/// The action of a control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobosuiteAction {
    /// The command of the arm.
    pub arm: ArmAction,
    /// The command of the gripper, of which only the sign counts: below 0 opens, above 0 closes.
    pub gripper: f64,
}

/// The state of the arm that the controller computes with. It is a copy, because after a reset the controller uses an older
/// state.
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

/// Work buffers of one simulation, so that the controller does not allocate.
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
    /// Whether `state` has been used, so that the next torques need a new one.
    used: bool,
    goal_position: Vector3<f64>,
    goal_rotation: Matrix3<f64>,
    posture: Joints,
    /// The gripper's command, from open (-1, 1) to closed (1, -1), in units of half the range of its actuators.
    gripper: [f64; 2],
}

impl Controller {
    /// A controller for the current state of a simulation, whose joint positions become the posture to keep.
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

    /// Replaces the state of the controller's creation: the next torques are computed from the simulation's current state.
    pub(super) fn refresh(&mut self, robot: &Robot, data: &Data) {
        self.state = ArmState::read(robot, data, &mut self.scratch);
    }

    /// Whether the next torques are computed from the simulation's current state instead of one kept since the reset.
    pub(super) fn reads_state(&self) -> bool {
        self.used
    }

    /// Marks the state as used when torques come from elsewhere.
    pub(super) fn mark_used(&mut self) {
        self.used = true;
    }

    fn update(&mut self, robot: &Robot, data: &Data) {
        if self.used {
            self.state = ArmState::read(robot, data, &mut self.scratch);
            self.used = false;
        }
    }

    /// Sets the goal of a control step.
    pub(super) fn set_goal(&mut self, action: &ArmAction, robot: &Robot, data: &Data) {
        self.update(robot, data);
        match action {
            ArmAction::Delta(delta) => {
                let motion: Vector6<f64> = Vector6::from_fn(|i, _| {
                    delta[i].clamp(-1.0, 1.0) * if i < 3 { DELTA_POSITION } else { DELTA_ROTATION }
                });
                self.goal_position = self.state.position + motion.fixed_rows::<3>(0);
                let rotation: Vector3<f64> = motion.fixed_rows::<3>(3).into_owned();
                // Without a commanded rotation, 1.4 keeps the last goal and 1.5 uses the present orientation.
                if self.profile == Profile::V1_5 || rotation != Vector3::zeros() {
                    self.goal_rotation = single_precision_rotation(&rotation) * self.state.rotation;
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

    /// Advances the gripper's command: 1.4 does so in every simulation step, 1.5 once per control step.
    pub(super) fn move_gripper(&mut self, command: f64) {
        let speed = match self.profile {
            Profile::V1_4 => 0.01,
            Profile::V1_5 => 0.2,
        };
        // `f64::signum` is 1 at 0, but numpy's sign is 0 there.
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

    /// Torques of the arm's actuators, clipped to their limits.
    pub(super) fn torques(&mut self, robot: &Robot, data: &Data) -> [f64; JOINTS] {
        self.update(robot, data);
        self.used = true;
        let state = &self.state;
        let damping = 2.0 * STIFFNESS.sqrt();
        let force = STIFFNESS * (self.goal_position - state.position) - damping * state.velocity;
        let torque =
            STIFFNESS * orientation_error(&self.goal_rotation, &state.rotation) - damping * state.angular_velocity;

        // Task-space inertia Λ = (J M⁻¹ Jᵀ)⁻¹. Position and orientation each get their own 3 x 3 block, which decouples them.
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
        // (I - J̄ J)ᵀ p = p - Jᵀ Λ J M⁻¹ p, without computing the projection matrix.
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

/// Half the sum of the cross products of the columns, which is the axis times the sine of the angle: for small angles the
/// rotation vector from the current orientation to the desired one.
fn orientation_error(desired: &Matrix3<f64>, current: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * (0..3)
        .map(|i| current.column(i).cross(&desired.column(i)))
        .fold(Vector3::zeros(), |sum, part| sum + part)
}

fn invert3(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    matrix
        .try_inverse()
        .or_else(|| matrix.pseudo_inverse(SINGULAR_VALUE_CUTOFF * matrix.norm()).ok())
        .unwrap_or_else(Matrix3::zeros)
}

fn invert6(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    matrix
        .try_inverse()
        .or_else(|| matrix.pseudo_inverse(SINGULAR_VALUE_CUTOFF * matrix.norm()).ok())
        .unwrap_or_else(Matrix6::zeros)
}

/// Converts a rotation vector to a matrix through a single-precision quaternion, as robosuite's `quat2mat` does: the
/// demonstrations were recorded with goals rounded like that.
fn single_precision_rotation(vector: &Vector3<f64>) -> Matrix3<f64> {
    let angle = vector.norm();
    // robosuite tests this with numpy's `isclose` to 0 without an absolute tolerance, which means exactly zero.
    let quaternion = if angle == 0.0 {
        [1.0, 0.0, 0.0, 0.0]
    } else {
        let axis = vector / angle;
        let sine = (angle / 2.0).sin();
        [(angle / 2.0).cos(), axis.x * sine, axis.y * sine, axis.z * sine]
    };
    let rounded = quaternion.map(|part| part as f32);
    // The BLAS of numpy accumulates products of single precision in double precision.
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

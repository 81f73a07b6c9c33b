//! Residuals: differences between recorded numbers and the values that a hypothesis predicts.

use nalgebra::{Isometry3, Vector3};

use super::demo::ValidDemo;
use super::{ActionKind, EefOrientation, ObjectLayout, QuaternionOrder, RelativeLag, part, pose};
use crate::actions;

/// Minimum change of the finger opening in a frame (metres) that counts as motion. A command changes it by 4 mm and more, while
/// the fingers of robosuite 1.0 vibrate by 0.4 mm when the arm moves.
pub(super) const FINGER_MOVES: f64 = 1e-3;
/// Number of frames over which the end effector's motion is compared with its actions. A single frame is too short, because the
/// motion lags behind the commands.
const WINDOW: usize = 4;
/// Minimum motion of the end effector (metres) in that window. Smaller motions provide no evidence about the actions.
const EEF_MOVES: f64 = 2e-3;
/// Minimum fraction of the distance to its goal that the end effector moves in a step if it follows the goal. With the default
/// stiffness the fraction is about 1/5. If deltas are read as goals, it is about 1/100.
const MINIMUM_APPROACH: f64 = 0.05;

/// The larger of the distance (metres) and the angle (radians) between two poses.
fn difference(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let distance = (a.translation.vector - b.translation.vector).norm();
    distance.max(a.rotation.angle_to(&b.rotation))
}

/// The frame of the relative object pose in a row under a hypothesis: the position of the grip site with the orientation of the
/// hand body. Returns `None` if the norm of the quaternion is zero.
fn hand(demo: &ValidDemo<'_>, t: usize, order: QuaternionOrder, frame: EefOrientation) -> Option<Isometry3<f64>> {
    let stored = order.rotation(demo.arrays.eef_quat[t])?;
    Some(pose(demo.arrays.eef_pos[t], frame.hand(stored)))
}

/// Difference between the recorded end-effector pose and the one from the state. Returns `None` without states.
pub(super) fn eef_kinematics(
    demo: &ValidDemo<'_>,
    t: usize,
    order: QuaternionOrder,
    frame: EefOrientation,
) -> Option<f64> {
    let observed = demo.observed.get(t)?;
    let Some(stored) = order.rotation(demo.arrays.eef_quat[t]) else {
        return Some(f64::INFINITY);
    };
    let rotation = match frame {
        EefOrientation::HandBody => observed.hand.rotation,
        EefOrientation::GripSite => observed.site.rotation,
    };
    let known = Isometry3::from_parts(observed.site.translation, rotation);
    Some(difference(&pose(demo.arrays.eef_pos[t], stored), &known))
}

/// Difference between the recorded object pose and the one from the state. Returns `None` without states.
pub(super) fn object_kinematics(
    demo: &ValidDemo<'_>,
    t: usize,
    layout: ObjectLayout,
    order: QuaternionOrder,
) -> Option<f64> {
    let known = demo.observed.get(t)?.object?;
    let row = demo.arrays.object?.row(t);
    let Some(stored) = object_pose(row, layout, order) else {
        return Some(f64::INFINITY);
    };
    Some(difference(&stored, &known))
}

/// Object pose (world frame) in a row of `obs/object`. Returns `None` if the norm of the quaternion is zero.
fn object_pose(row: &[f64], layout: ObjectLayout, order: QuaternionOrder) -> Option<Isometry3<f64>> {
    let start = layout.pose_start();
    Some(pose(part(row, start)?, order.rotation(part(row, start + 3)?)?))
}

/// A hypothesis about all conventions that the relative part of `obs/object` depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Relation {
    pub(super) layout: ObjectLayout,
    pub(super) object: QuaternionOrder,
    pub(super) eef: QuaternionOrder,
    pub(super) frame: EefOrientation,
    pub(super) lag: RelativeLag,
}

/// Difference between the relative part of a row and the one that the recorded poses give. Returns `None` if robosuite had not
/// computed it yet or there is no previous row.
pub(super) fn relative(demo: &ValidDemo<'_>, t: usize, relation: Relation) -> Option<f64> {
    let rows = demo.arrays.object?;
    let row = rows.row(t);
    if relation.layout.pending(row, t) {
        return None;
    }
    let start = relation.layout.relative_start();
    let stored: [f64; 3] = part(row, start)?;
    let (eef_t, object_t) = match relation.lag {
        RelativeLag::Current => (t, t),
        RelativeLag::ObjectOneLate => (t, t.checked_sub(1)?),
        RelativeLag::BothOneLate => (t.checked_sub(1)?, t.checked_sub(1)?),
    };
    let object_row = rows.row(object_t);
    let sign = match relation.layout {
        ObjectLayout::LiftEefMinusCube => 1.0,
        ObjectLayout::LiftCubeMinusEef => -1.0,
        ObjectLayout::PoseFirst | ObjectLayout::RelativeFirst => {
            let stored_quaternion: [f64; 4] = part(row, start + 3)?;
            let poses = (
                hand(demo, eef_t, relation.eef, relation.frame),
                object_pose(object_row, relation.layout, relation.object),
                relation.object.rotation(stored_quaternion),
            );
            let (Some(hand), Some(object), Some(rotation)) = poses else {
                return Some(f64::INFINITY);
            };
            return Some(difference(&(hand.inverse() * object), &pose(stored, rotation)));
        }
    };
    let cube: [f64; 3] = part(object_row, relation.layout.pose_start())?;
    let eef_minus_cube = Vector3::from(demo.arrays.eef_pos[eef_t]) - Vector3::from(cube);
    Some((Vector3::from(stored) - sign * eef_minus_cube).norm())
}

/// A fraction whose numerator and denominator are sums over frames.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fraction {
    against: f64,
    all: f64,
    pub(super) frames: usize,
}

impl Fraction {
    pub(super) fn add(&mut self, other: Self) {
        self.against += other.against;
        self.all += other.all;
        self.frames += other.frames;
    }

    /// The fraction, 0 to 1, or infinity if the denominator is zero.
    pub(super) fn value(&self) -> f64 {
        if self.all > 0.0 {
            self.against / self.all
        } else {
            f64::INFINITY
        }
    }

    /// The denominator, for example the finger travel in metres.
    pub(super) fn total(&self) -> f64 {
        self.all
    }

    /// 1 minus the fraction.
    pub(super) fn complement(&self) -> Self {
        Self {
            against: self.all - self.against,
            ..*self
        }
    }
}

/// Fraction of the finger travel that contradicts "a positive command closes", of all travel under commands other than 0.
pub(super) fn finger_travel(demo: &ValidDemo<'_>) -> Fraction {
    let mut fraction = Fraction::default();
    for (t, pair) in demo.arrays.gripper_qpos.windows(2).enumerate() {
        let opening = (pair[1][0] - pair[1][1]) - (pair[0][0] - pair[0][1]);
        let command = demo.actions[t][6];
        if opening.abs() < FINGER_MOVES || command == 0.0 {
            continue;
        }
        fraction.frames += 1;
        fraction.all += opening.abs();
        if (opening > 0.0) == (command > 0.0) {
            fraction.against += opening.abs();
        }
    }
    fraction
}

/// Sums for a least-squares fit of the end effector's motion to its actions, with one common gain.
#[derive(Debug, Clone, Copy, Default)]
struct Motion {
    step_ask: f64,
    ask_ask: f64,
    step_step: f64,
    frames: usize,
}

impl Motion {
    fn add(&mut self, other: Self) {
        self.step_ask += other.step_ask;
        self.ask_ask += other.ask_ask;
        self.step_step += other.step_step;
        self.frames += other.frames;
    }

    /// The fraction of the motion (sum of squares) that the best gain, but at least `minimum`, leaves unexplained. It is 1 for
    /// actions that are unrelated to the motion, above 1 for actions that contradict it, and infinite without motion.
    fn unexplained(&self, minimum: f64) -> f64 {
        if self.step_step <= 0.0 {
            return f64::INFINITY;
        }
        let best = if self.ask_ask > 0.0 {
            self.step_ask / self.ask_ask
        } else {
            0.0
        };
        let gain = best.max(minimum);
        1.0 - gain * (2.0 * self.step_ask - gain * self.ask_ask) / self.step_step
    }
}

/// The sums for distinguishing deltas from goals.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Kinds {
    deltas: Motion,
    goals: Motion,
}

impl Kinds {
    pub(super) fn add(&mut self, other: Self) {
        self.deltas.add(other.deltas);
        self.goals.add(other.goals);
    }

    /// The fraction of the motion that the actions leave unexplained if they are of this kind.
    pub(super) fn unexplained(&self, kind: ActionKind) -> f64 {
        match kind {
            ActionKind::Delta => self.deltas.unexplained(0.0),
            ActionKind::Absolute => self.goals.unexplained(MINIMUM_APPROACH),
        }
    }

    /// Number of windows in which the end effector moves.
    pub(super) fn frames(&self) -> usize {
        self.deltas.frames
    }
}

/// Compares the end effector's motion with its actions, read as deltas and as goals.
pub(super) fn motion(demo: &ValidDemo<'_>) -> Kinds {
    let mut kinds = Kinds::default();
    let positions = demo.arrays.eef_pos;
    for (t, window) in positions.windows(WINDOW + 1).enumerate() {
        let step = Vector3::from(window[WINDOW]) - Vector3::from(window[0]);
        if step.norm() < EEF_MOVES {
            continue;
        }
        let [mut motion, mut approach] = [Vector3::zeros(); 2];
        for (action, now) in demo.actions[t..].iter().zip(&window[..WINDOW]) {
            let action = actions::position(action);
            // The controller clips commands, and keyboard teleoperation records commands outside its range.
            motion += action.map(|command| command.clamp(-1.0, 1.0));
            approach += action - Vector3::from(*now);
        }
        let asked = |ask: Vector3<f64>| Motion {
            step_ask: step.dot(&ask),
            ask_ask: ask.norm_squared(),
            step_step: step.norm_squared(),
            frames: 1,
        };
        kinds.deltas.add(asked(motion));
        kinds.goals.add(asked(approach));
    }
    kinds
}

/// Difference between the recorded angular velocity and the change of the recorded orientation under a quaternion order, as a
/// fraction of the velocity.
pub(super) fn angular_velocity(demo: &ValidDemo<'_>, order: QuaternionOrder, control_freq: f64) -> Fraction {
    let mut fraction = Fraction::default();
    let Some(velocities) = demo.arrays.eef_vel_ang else {
        return fraction;
    };
    for (t, pair) in demo.arrays.eef_quat.windows(2).enumerate() {
        let mean = (Vector3::from(velocities[t]) + Vector3::from(velocities[t + 1])) / 2.0;
        // At rest the direction of the velocity is noise.
        if mean.norm() < 0.05 {
            continue;
        }
        let (Some(now), Some(next)) = (order.rotation(pair[0]), order.rotation(pair[1])) else {
            continue;
        };
        let change = (next * now.inverse()).scaled_axis() * control_freq;
        fraction.add(Fraction {
            against: (change - mean).norm(),
            all: mean.norm(),
            frames: 1,
        });
    }
    fraction
}

/// Angle (radians) between the goal orientation of an absolute action and the recorded orientation of the grip site.
pub(super) fn goal_angle(demo: &ValidDemo<'_>, t: usize, order: QuaternionOrder, frame: EefOrientation) -> Option<f64> {
    let stored = order.rotation(demo.arrays.eef_quat[t])?;
    Some(actions::rotation(&demo.actions[t]).angle_to(&frame.site(stored)))
}

/// Angle (radians) between the vertical and the closest axis of a cube under a quaternion order.
pub(super) fn tilt(row: &[f64], order: QuaternionOrder) -> Option<f64> {
    let rotation = order.rotation(part(row, 3)?)?;
    let matrix = rotation.to_rotation_matrix();
    let upright = matrix.matrix().row(2).iter().fold(0.0_f64, |best, z| best.max(z.abs()));
    Some(upright.min(1.0).acos())
}

//! How far numbers are from what a hypothesis says they are.

use nalgebra::{Isometry3, Vector3};

use super::demo::Sound;
use super::{ActionKind, EefOrientation, ObjectLayout, QuaternionOrder, RelativeLag, part, pose};
use crate::actions;

/// Fingers that part or close less than this in a frame (metres) tell nothing of the command's sign: commanded ones go 4 mm
/// and more, while those of robosuite 1.0 tremble by 0.4 mm as the arm moves.
pub(super) const FINGER_MOVES: f64 = 1e-3;
/// Frames over which the hand's motion is held against what their actions ask for: it lags behind single commands.
const WINDOW: usize = 4;
/// A hand that moves less than this (metres) in that time tells nothing of the actions.
const HAND_MOVES: f64 = 2e-3;
/// A hand that goes a smaller part of the way in a step does not follow its goal. With the default stiffness the part is about
/// a fifth; for actions that are deltas, taken for goals, it is about a hundredth.
const LEAST_APPROACH: f64 = 0.05;

/// The larger of a distance in metres and an angle in radians.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let distance = (a.translation.vector - b.translation.vector).norm();
    distance.max(a.rotation.angle_to(&b.rotation))
}

/// The hand's frame of a row under a hypothesis: at the grip site, oriented as the hand body.
fn hand(demo: &Sound<'_>, t: usize, order: QuaternionOrder, frame: EefOrientation) -> Option<Isometry3<f64>> {
    let stored = order.rotation(demo.arrays.eef_quat[t])?;
    Some(pose(demo.arrays.eef_pos[t], frame.hand(stored)))
}

/// `obs/robot0_eef_pos` and `_quat` against the pose that the state gives; none without states.
pub(super) fn eef_kinematics(demo: &Sound<'_>, t: usize, order: QuaternionOrder, frame: EefOrientation) -> Option<f64> {
    let observed = demo.observed.get(t)?;
    let Some(stored) = order.rotation(demo.arrays.eef_quat[t]) else {
        return Some(f64::INFINITY);
    };
    let rotation = match frame {
        EefOrientation::HandBody => observed.hand.rotation,
        EefOrientation::GripSite => observed.site.rotation,
    };
    let known = Isometry3::from_parts(observed.site.translation, rotation);
    Some(apart(&pose(demo.arrays.eef_pos[t], stored), &known))
}

/// The object's pose columns against the pose that the state gives; none without states.
pub(super) fn object_kinematics(
    demo: &Sound<'_>,
    t: usize,
    layout: ObjectLayout,
    order: QuaternionOrder,
) -> Option<f64> {
    let known = demo.observed.get(t)?.object?;
    let row = demo.arrays.object?.row(t);
    let Some(stored) = object_pose(row, layout, order) else {
        return Some(f64::INFINITY);
    };
    Some(apart(&stored, &known))
}

fn object_pose(row: &[f64], layout: ObjectLayout, order: QuaternionOrder) -> Option<Isometry3<f64>> {
    let start = layout.pose_start();
    Some(pose(part(row, start)?, order.rotation(part(row, start + 3)?)?))
}

/// Everything that the relative part of `obs/object` depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Relation {
    pub(super) layout: ObjectLayout,
    pub(super) object: QuaternionOrder,
    pub(super) eef: QuaternionOrder,
    pub(super) frame: EefOrientation,
    pub(super) lag: RelativeLag,
}

/// The relative part of a row against what the poses give; none where it was not yet computed, or there is no row before.
pub(super) fn relative(demo: &Sound<'_>, t: usize, relation: Relation) -> Option<f64> {
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
            return Some(apart(&(hand.inverse() * object), &pose(stored, rotation)));
        }
    };
    let cube: [f64; 3] = part(object_row, relation.layout.pose_start())?;
    let difference = Vector3::from(demo.arrays.eef_pos[eef_t]) - Vector3::from(cube);
    Some((Vector3::from(stored) - sign * difference).norm())
}

/// Sums over frames from which a fraction is taken.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Share {
    against: f64,
    all: f64,
    pub(super) frames: usize,
}

impl Share {
    pub(super) fn add(&mut self, other: Self) {
        self.against += other.against;
        self.all += other.all;
        self.frames += other.frames;
    }

    /// The share, 0 to 1; infinite where there is nothing.
    pub(super) fn value(&self) -> f64 {
        if self.all > 0.0 {
            self.against / self.all
        } else {
            f64::INFINITY
        }
    }

    /// What it is a fraction of: finger travel in metres, ...
    pub(super) fn total(&self) -> f64 {
        self.all
    }

    pub(super) fn complement(&self) -> Self {
        Self {
            against: self.all - self.against,
            ..*self
        }
    }
}

/// Finger travel against "a positive command closes", as a fraction of all travel under a command.
pub(super) fn finger_travel(demo: &Sound<'_>) -> Share {
    let mut share = Share::default();
    for (t, pair) in demo.arrays.gripper_qpos.windows(2).enumerate() {
        let opening = (pair[1][0] - pair[1][1]) - (pair[0][0] - pair[0][1]);
        let command = demo.actions[t][6];
        if opening.abs() < FINGER_MOVES || command == 0.0 {
            continue;
        }
        share.frames += 1;
        share.all += opening.abs();
        if (opening > 0.0) == (command > 0.0) {
            share.against += opening.abs();
        }
    }
    share
}

/// Sums for a fit of the hand's motion to what its actions ask for, with one gain for all.
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

    /// The fraction of the motion (sum of squares) that the best gain, at least `minimum`, leaves unexplained: 1 for an action that
    /// says nothing, more for one that says something else; infinite without motion.
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

/// What is needed to tell deltas from goals.
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

    /// The fraction of the motion that actions of a kind leave unexplained.
    pub(super) fn unexplained(&self, kind: ActionKind) -> f64 {
        match kind {
            ActionKind::Delta => self.deltas.unexplained(0.0),
            ActionKind::Absolute => self.goals.unexplained(LEAST_APPROACH),
        }
    }

    /// Windows in which the hand moves.
    pub(super) fn frames(&self) -> usize {
        self.deltas.frames
    }
}

/// The hand's motion against what actions ask for: as deltas, and as goals.
pub(super) fn motion(demo: &Sound<'_>) -> Kinds {
    let mut kinds = Kinds::default();
    let positions = demo.arrays.eef_pos;
    for (t, window) in positions.windows(WINDOW + 1).enumerate() {
        let step = Vector3::from(window[WINDOW]) - Vector3::from(window[0]);
        if step.norm() < HAND_MOVES {
            continue;
        }
        let [mut motion, mut approach] = [Vector3::zeros(); 2];
        for (action, now) in demo.actions[t..].iter().zip(&window[..WINDOW]) {
            let action = actions::position(action);
            // The controller cuts commands; keyboards give ones beyond its range.
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

/// Recorded angular velocity against the change of the recorded orientation under a quaternion order, as a fraction.
pub(super) fn angular_velocity(demo: &Sound<'_>, order: QuaternionOrder, control_freq: f64) -> Share {
    let mut share = Share::default();
    let Some(velocities) = demo.arrays.eef_vel_ang else {
        return share;
    };
    for (t, pair) in demo.arrays.eef_quat.windows(2).enumerate() {
        let mean = (Vector3::from(velocities[t]) + Vector3::from(velocities[t + 1])) / 2.0;
        if mean.norm() < 0.05 {
            continue;
        }
        let (Some(now), Some(next)) = (order.rotation(pair[0]), order.rotation(pair[1])) else {
            continue;
        };
        let change = (next * now.inverse()).scaled_axis() * control_freq;
        share.add(Share {
            against: (change - mean).norm(),
            all: mean.norm(),
            frames: 1,
        });
    }
    share
}

/// Angle between the goal's orientation of an absolute action and the recorded one.
pub(super) fn goal_angle(demo: &Sound<'_>, t: usize, order: QuaternionOrder, frame: EefOrientation) -> Option<f64> {
    let stored = order.rotation(demo.arrays.eef_quat[t])?;
    Some(actions::rotation(&demo.actions[t]).angle_to(&frame.site(stored)))
}

/// How far a resting cube's upright axis is from the vertical under a quaternion order.
pub(super) fn tilt(row: &[f64], order: QuaternionOrder) -> Option<f64> {
    let rotation = order.rotation(part(row, 3)?)?;
    let matrix = rotation.to_rotation_matrix();
    let upright = matrix.matrix().row(2).iter().fold(0.0_f64, |best, z| best.max(z.abs()));
    Some(upright.min(1.0).acos())
}

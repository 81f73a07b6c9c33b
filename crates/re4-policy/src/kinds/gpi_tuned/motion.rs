//! The actions of a plan, adapted to the observed poses.

use nalgebra::{Isometry3, Vector3};
use re4_geometry::spatial::{rotation_between, rotation_from_vector, rotation_vector};
use re4_rollout::{ArmAction, ArmState};

use super::frames::Frame;
use super::library::Library;
use super::phases::Stage;
use super::tuning::{OPEN, Rule, cap};
use crate::lookup::nearest;

impl Library {
    /// The action of a frame for the observed poses. `distances` are those of the present state.
    pub(super) fn action(
        &self,
        at: usize,
        stage: Stage,
        arm: &ArmState,
        object: &Isometry3<f64>,
        distances: &[Option<f64>],
    ) -> ArmAction {
        let frame = &self.frames[at];
        let goal = match self.tuning.rule {
            Rule::Lift => displaced(frame, &arm.eef, true),
            Rule::Can => {
                let mut goal = if self.switches.reach && stage == Stage::Pick {
                    let offset = frame.action.goal.translation.vector - frame.object.translation.vector;
                    Isometry3::from_parts((object.translation.vector + offset).into(), frame.action.goal.rotation)
                } else {
                    displaced(frame, &arm.eef, false)
                };
                if self.switches.flow {
                    goal.translation.vector += self.flow(arm, object, distances);
                }
                goal
            }
            Rule::Square if stage == Stage::Pick => object * (frame.object.inv_mul(&frame.action.goal)),
            Rule::Square => self.carried(at, stage, &arm.eef, object),
        };
        ArmAction {
            goal,
            gripper: frame.action.gripper,
        }
    }

    /// Can: a part of the mean way to where the end effector is in the neighbouring demonstrations some frames later, which is
    /// limited to 50 mm.
    fn flow(&self, arm: &ArmState, object: &Isometry3<f64>, distances: &[Option<f64>]) -> Vector3<f64> {
        let found = nearest(distances.iter().copied(), 8);
        let here = arm.eef.translation.vector;
        let (mut sum, mut total) = (Vector3::zeros(), 0.0);
        for (distance, at) in found {
            let later = &self.frames[(at + self.tuning.flow_ahead).min(self.end_of(at))];
            let there = if arm.fingers[0] > OPEN {
                let relative = later.arm.eef.inv_mul(&later.object).translation.vector;
                object.translation.vector - arm.eef.rotation * relative
            } else {
                later.arm.eef.translation.vector
            };
            let weight = 1.0 / (distance + 1e-6);
            sum += (there - here) * weight;
            total += weight;
        }
        if total > 0.0 {
            cap(sum / total, 0.05) * self.tuning.flow_gain
        } else {
            sum
        }
    }

    /// Square with the nut in the gripper: between the recorded displacement of the end effector and the goal that carries the
    /// nut to where the recorded action carries it.
    fn carried(&self, at: usize, stage: Stage, eef: &Isometry3<f64>, object: &Isometry3<f64>) -> Isometry3<f64> {
        let frame = &self.frames[at];
        let grasp = object.inv_mul(eef);
        // The pose of the nut at the recorded goal, if the recorded grasp is rigid.
        let nut = frame.action.goal * frame.arm.eef.inv_mul(&frame.object);
        let (moved, placed) = (displaced(frame, eef, true), nut * grasp);
        let raw = self.phases.raw_stage(object, 0);
        let part = match raw {
            Stage::Insert => 0.964_027,
            Stage::PreInsert => 0.924_328,
            _ => 0.835_840,
        };
        let position = moved.translation.vector * 0.373_175 + placed.translation.vector * 0.626_825;
        let rotation = rotation_between(&moved.rotation, &placed.rotation, part);
        let mut goal = Isometry3::from_parts(position.into(), rotation);
        if stage >= Stage::PreInsert && self.switches.flow {
            let later = &self.frames[(at + self.tuning.flow_ahead).min(self.end_of(at))];
            let wanted = later.object * grasp;
            let shift = cap(wanted.translation.vector - goal.translation.vector, 0.006_206);
            let turn = cap(rotation_vector(&(wanted.rotation * goal.rotation.inverse())), 0.127_581);
            goal.translation.vector += shift * self.tuning.flow_gain;
            goal.rotation = rotation_from_vector(turn * 0.310_497) * goal.rotation;
        }
        goal
    }
}

/// The recorded goal moved to the observed end effector: the same displacement, and with `turns` the same rotation from the
/// observed orientation.
fn displaced(frame: &Frame, eef: &Isometry3<f64>, turns: bool) -> Isometry3<f64> {
    let (goal, recorded) = (&frame.action.goal, &frame.arm.eef);
    let position = eef.translation.vector + goal.translation.vector - recorded.translation.vector;
    let rotation = if turns {
        goal.rotation * recorded.rotation.inverse() * eef.rotation
    } else {
        goal.rotation
    };
    Isometry3::from_parts(position.into(), rotation)
}

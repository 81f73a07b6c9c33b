//! A kinematic world in which a gripper picks up a block and places it, and a script that demonstrates the task.
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test file uses only some of these items, and a panic is how a test fails"
)]

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_episode::{Mode, SpatialFrame};
use re4_geometry::spatial::{Symmetry, pose_between, pose_distance, rotation_vector, step_toward};
use re4_policy::spatial::{
    SpatialDecision, SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge, SpatialPolicyConfig, SpatialRe4,
};
use re4_rollout::{Act, ArmAction, ArmState, Phase, Policy as _, PolicyError, PoseNoise, Space};

use crate::shown::Shown;

pub(crate) type SpatialAct = Act<Space, SpatialDecision>;

pub(crate) struct Random(Pcg64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Pcg64::new(u128::from(seed), 29))
    }

    /// Samples uniformly from `[low, high)`.
    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn pose(&mut self) -> Isometry3<f64> {
        let t = Vector3::from_fn(|_, _| self.range(-0.5, 0.5));
        let r = Vector3::from_fn(|_, _| self.range(-1.7, 1.7));
        Isometry3::from_parts(t.into(), UnitQuaternion::from_scaled_axis(r))
    }
}

pub(crate) fn at(x: f64, y: f64, z: f64) -> Translation3<f64> {
    Translation3::new(x, y, z)
}

pub(crate) fn yaw(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
}

/// Half the width of the block, which is also the height of its origin when it is on the table. Metres.
pub(crate) const HALF: f64 = 0.02;

/// Target position of the block.
pub(crate) const TARGET: [f64; 3] = [0.3, 0.2, HALF];

/// Initial pose of every episode: the gripper points down above the table.
pub(crate) fn home() -> Isometry3<f64> {
    Isometry3::from_parts(at(0.0, 0.0, 0.3), down(0.0))
}

/// The rotation of a gripper that points down, rotated about the vertical axis.
pub(crate) fn down(angle: f64) -> UnitQuaternion<f64> {
    yaw(angle) * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI)
}

/// Pose of the block on the table.
pub(crate) fn block(x: f64, y: f64, angle: f64) -> Isometry3<f64> {
    Isometry3::from_parts(at(x, y, HALF), yaw(angle))
}

/// The world. The grip site moves toward its goal with a lag, and the fingers move at a constant speed. A block between closed
/// fingers is held rigidly, and a released block falls flat on the table.
#[derive(Clone)]
pub(crate) struct World {
    pub(crate) eef: Isometry3<f64>,
    pub(crate) object: Isometry3<f64>,
    pub(crate) separation: f64,
    /// Pose of the held block in the frame of the grip site.
    pub(crate) held: Option<Isometry3<f64>>,
    pub(crate) lifted: bool,
    /// Maximum distance in metres from the grip site to the centre of the block at which the fingers catch the block.
    pub(crate) catch: f64,
    /// Whether every grasp fails.
    pub(crate) slippery: bool,
}

impl World {
    pub(crate) fn new(object: Isometry3<f64>) -> Self {
        Self {
            eef: home(),
            object,
            separation: 0.08,
            held: None,
            lifted: false,
            catch: 0.012,
            slippery: false,
        }
    }

    pub(crate) fn arm_state(&self) -> ArmState {
        ArmState {
            eef: self.eef,
            fingers: [0.5 * self.separation, -0.5 * self.separation],
        }
    }

    pub(crate) fn step(&mut self, action: &ArmAction) {
        // The grip site covers a third of the distance, at most 2.5 cm and 0.25 rad per step.
        let target = pose_between(&self.eef, &action.goal, 0.33);
        self.eef = step_toward(&self.eef, &target, 0.025, 0.25);
        if action.gripper > 0.0 {
            let eef_from_object = self.eef.inv_mul(&self.object);
            // The fingers close along the gripper's y axis and can only grasp sides of the block that face them.
            let angle = rotation_vector(&(self.object.rotation.inverse() * self.eef.rotation * down(0.0).inverse())).z;
            let quarter = angle.rem_euclid(PI / 2.0);
            let square = quarter.min(PI / 2.0 - quarter) < 0.25;
            let between = eef_from_object.translation.vector.norm() < self.catch && square && !self.slippery;
            let minimum = if between || self.held.is_some() {
                2.0 * HALF
            } else {
                0.0
            };
            self.separation = (self.separation - 0.01).max(minimum);
            if between && self.separation <= 2.0 * HALF && self.held.is_none() {
                self.held = Some(eef_from_object);
            }
        } else if action.gripper < 0.0 {
            self.separation = (self.separation + 0.01).min(0.08);
            if self.held.take().is_some() {
                let (_, _, angle) = self.object.rotation.euler_angles();
                self.object = block(self.object.translation.x, self.object.translation.y, angle);
            }
        }
        if let Some(held) = self.held {
            self.object = self.eef * held;
            self.lifted |= self.object.translation.z > 0.08;
        }
    }

    /// Returns whether the block was lifted, released, and is at the target.
    pub(crate) fn success(&self) -> bool {
        let off = self.object.translation.vector - Vector3::from(TARGET);
        self.lifted && self.held.is_none() && off.xy().norm() < 0.02 && off.z.abs() < 0.01
    }
}

/// Demonstrates the task: above the block, down, close, up, across, down, open, up. `grasp` rotates the gripper by multiples of
/// 90 degrees relative to the block.
pub(crate) fn demonstrate(object: Isometry3<f64>, grasp: i32) -> Vec<SpatialDemoFrame> {
    demonstrate_with_lead(object, grasp, 0.04)
}

/// As [`demonstrate`], with the set-point at most `lead` metres ahead of the gripper, which determines the pace.
pub(crate) fn demonstrate_with_lead(object: Isometry3<f64>, grasp: i32, lead: f64) -> Vec<SpatialDemoFrame> {
    let mut world = World::new(object);
    let (_, _, angle) = object.rotation.euler_angles();
    let rotation = down(angle + f64::from(grasp) * PI / 2.0);
    let pose = |p: Vector3<f64>, z: f64| Isometry3::from_parts(at(p.x, p.y, z), rotation);
    let (from, to) = (object.translation.vector, Vector3::from(TARGET));
    let mut frames = Vec::new();
    let mut closed = false;
    let mut go = |world: &mut World, goal: Isometry3<f64>, gripper: f64, steps: Option<usize>| {
        for i in 0..400 {
            let (distance, angle) = pose_distance(&world.eef, &goal);
            if steps.map_or(distance < 0.002 && angle < 0.02, |steps| i >= steps) {
                return;
            }
            let goal = step_toward(&world.eef, &goal, lead, 10.0 * lead);
            let v = rotation_vector(&goal.rotation);
            let frame = SpatialFrame {
                eef: world.eef,
                object: world.object,
                fingers: world.arm_state().fingers,
                delta: [0.0; 6],
                goal: [
                    goal.translation.x,
                    goal.translation.y,
                    goal.translation.z,
                    v.x,
                    v.y,
                    v.z,
                ],
                gripper,
                reward: None,
            };
            let mode = if closed { Mode::Transfer } else { Mode::Transit };
            frames.push(SpatialDemoFrame::new(&frame, mode));
            closed = gripper > 0.0;
            world.step(&ArmAction { goal, gripper });
        }
    };
    let w = &mut world;
    go(w, pose(from, 0.12), -1.0, None);
    go(w, pose(from, HALF), -1.0, None);
    go(w, pose(from, HALF), 1.0, Some(8));
    go(w, pose(from, 0.15), 1.0, None);
    go(w, pose(to, 0.15), 1.0, None);
    go(w, pose(to, HALF + 0.005), 1.0, None);
    go(w, pose(to, HALF + 0.005), -1.0, Some(4));
    go(w, pose(to, 0.12), -1.0, None);
    assert!(world.success(), "the script places the block");
    frames
}

/// Generates demonstrations from random placements in a square, with yaws within `spread` rad.
pub(crate) fn demonstrations(count: u32, spread: f64, seed: u64) -> SpatialDemoSet {
    let mut random = Random::new(seed);
    SpatialDemoSet::new((0..count).map(|number| {
        let placed = block(
            random.range(-0.15, 0.05),
            random.range(-0.2, 0.0),
            random.range(-spread, spread),
        );
        (number, demonstrate(placed, 0))
    }))
}

pub(crate) fn knowledge(
    demos: SpatialDemoSet,
    config: &SpatialPolicyConfig,
    symmetry: Symmetry,
) -> Arc<SpatialKnowledge> {
    Arc::new(SpatialKnowledge::new(demos, &config.retrieve, symmetry, |_, _| false).unwrap())
}

/// The result of an episode.
pub(crate) struct Episode {
    pub(crate) success: bool,
    pub(crate) acts: Vec<SpatialAct>,
    pub(crate) world: World,
    pub(crate) banned: Vec<u32>,
}

impl Episode {
    pub(crate) fn decisions(&self) -> Vec<&SpatialDecision> {
        self.acts.iter().filter_map(|act| act.decision.as_ref()).collect()
    }

    pub(crate) fn steps(&self, phase: Phase) -> usize {
        self.acts.iter().filter(|act| act.phase == phase).count()
    }
}

/// Returns the action of a policy that receives the object pose at every step.
pub(crate) fn observe_and_act(
    policy: &mut SpatialRe4,
    proprio: ArmState,
    object: Isometry3<f64>,
) -> Result<SpatialAct, PolicyError> {
    policy.act(&mut Shown {
        proprio,
        observes_object: true,
        flag: None,
        object: &mut || Ok(object),
    })
}

/// Runs a policy until success or for 400 steps. `disturb` may change the world before each step.
pub(crate) fn episode(
    config: &SpatialPolicyConfig,
    knowledge: &Arc<SpatialKnowledge>,
    object: Isometry3<f64>,
    mut noise: Option<PoseNoise>,
    mut disturb: impl FnMut(usize, &mut World),
) -> Episode {
    let mut world = World::new(object);
    let mut policy = SpatialRe4::new(config.clone(), Arc::clone(knowledge), world.eef);
    let mut acts: Vec<SpatialAct> = Vec::new();
    while acts.len() < 400 && !world.success() {
        disturb(acts.len(), &mut world);
        let object = noise
            .as_mut()
            .map_or(world.object, |noise| noise.perturb(&world.object));
        let act = observe_and_act(&mut policy, world.arm_state(), object).unwrap();
        world.step(&act.action);
        acts.push(act);
    }
    Episode {
        success: world.success(),
        banned: policy.banned().collect(),
        acts,
        world,
    }
}

//! A kinematic world in which a gripper picks a block up and places it, and a script that demonstrates it.
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test file uses a part of this one, and tests may end where they fail"
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

    /// Uniform in `[low, high)`.
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

/// Half the width of the block, and the height of its origin when it lies on the table.
pub(crate) const HALF: f64 = 0.02;

/// Where the block is to be placed.
pub(crate) const TARGET: [f64; 3] = [0.3, 0.2, HALF];

/// The gripper pointing down, above the table: where every episode starts.
pub(crate) fn home() -> Isometry3<f64> {
    Isometry3::from_parts(at(0.0, 0.0, 0.3), down(0.0))
}

/// Pointing down, turned about the vertical.
pub(crate) fn down(angle: f64) -> UnitQuaternion<f64> {
    yaw(angle) * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI)
}

/// The block on the table.
pub(crate) fn block(x: f64, y: f64, angle: f64) -> Isometry3<f64> {
    Isometry3::from_parts(at(x, y, HALF), yaw(angle))
}

/// The world: the grip site moves toward its goal with a lag, fingers move at a constant speed, a block between closed
/// fingers is held rigidly, and one that is let go falls flat on the table.
#[derive(Clone)]
pub(crate) struct World {
    pub(crate) eef: Isometry3<f64>,
    pub(crate) object: Isometry3<f64>,
    pub(crate) separation: f64,
    /// The block in the gripper.
    pub(crate) held: Option<Isometry3<f64>>,
    pub(crate) lifted: bool,
    /// How far, in metres, the grip site may be off the block's middle for the fingers to catch it.
    pub(crate) catch: f64,
    /// Steps until which every grasp fails.
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

    pub(crate) fn feel(&self) -> ArmState {
        ArmState {
            eef: self.eef,
            fingers: [0.5 * self.separation, -0.5 * self.separation],
        }
    }

    pub(crate) fn step(&mut self, action: &ArmAction) {
        // A third of the way, at most 2.5 cm and 0.25 rad a step.
        let part = pose_between(&self.eef, &action.goal, 0.33);
        self.eef = step_toward(&self.eef, &part, 0.025, 0.25);
        if action.gripper > 0.0 {
            let seen = self.eef.inv_mul(&self.object);
            // Fingers close along the gripper's y axis, over sides of the block that face them.
            let angle = rotation_vector(&(self.object.rotation.inverse() * self.eef.rotation * down(0.0).inverse())).z;
            let quarter = angle.rem_euclid(PI / 2.0);
            let square = quarter.min(PI / 2.0 - quarter) < 0.25;
            let between = seen.translation.vector.norm() < self.catch && square && !self.slippery;
            let minimum = if between || self.held.is_some() {
                2.0 * HALF
            } else {
                0.0
            };
            self.separation = (self.separation - 0.01).max(minimum);
            if between && self.separation <= 2.0 * HALF && self.held.is_none() {
                self.held = Some(seen);
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

    /// The block lies at the target, let go, after it was lifted.
    pub(crate) fn success(&self) -> bool {
        let off = self.object.translation.vector - Vector3::from(TARGET);
        self.lifted && self.held.is_none() && off.xy().norm() < 0.02 && off.z.abs() < 0.01
    }
}

/// Demonstrates: above the block, down, close, up, across, down, open, up. The gripper takes the block turned by `grasp` quarter
/// turns.
pub(crate) fn demonstrate(object: Isometry3<f64>, grasp: i32) -> Vec<SpatialDemoFrame> {
    let mut world = World::new(object);
    let (_, _, angle) = object.rotation.euler_angles();
    let turned = down(angle + f64::from(grasp) * PI / 2.0);
    let pose = |p: Vector3<f64>, z: f64| Isometry3::from_parts(at(p.x, p.y, z), turned);
    let (from, to) = (object.translation.vector, Vector3::from(TARGET));
    let mut frames = Vec::new();
    let mut closed = false;
    let mut go = |world: &mut World, goal: Isometry3<f64>, gripper: f64, steps: Option<usize>| {
        for i in 0..80 {
            let (off, turn) = pose_distance(&world.eef, &goal);
            if steps.map_or(off < 0.002 && turn < 0.02, |steps| i >= steps) {
                return;
            }
            let goal = step_toward(&world.eef, &goal, 0.04, 0.4);
            let v = rotation_vector(&goal.rotation);
            let frame = SpatialFrame {
                eef: world.eef,
                object: world.object,
                fingers: world.feel().fingers,
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

/// Demonstrations from placements in a square, yaws within `spread` rad.
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

/// What came of an episode.
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

/// What a policy does that is told a pose of the object.
pub(crate) fn observe_and_act(
    policy: &mut SpatialRe4,
    proprio: ArmState,
    object: Isometry3<f64>,
) -> Result<SpatialAct, PolicyError> {
    policy.act(&mut Shown {
        proprio,
        tells: true,
        object: &mut || Ok(object),
    })
}

/// Runs a policy until success or 400 steps; `meddle` may change the world before each.
pub(crate) fn episode(
    config: &SpatialPolicyConfig,
    knowledge: &Arc<SpatialKnowledge>,
    object: Isometry3<f64>,
    mut noise: Option<PoseNoise>,
    mut meddle: impl FnMut(usize, &mut World),
) -> Episode {
    let mut world = World::new(object);
    let mut policy = SpatialRe4::new(config.clone(), Arc::clone(knowledge), world.eef);
    let mut acts: Vec<SpatialAct> = Vec::new();
    while acts.len() < 400 && !world.success() {
        meddle(acts.len(), &mut world);
        let object = noise
            .as_mut()
            .map_or(world.object, |noise| noise.perturb(&world.object));
        let act = observe_and_act(&mut policy, world.feel(), object).unwrap();
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

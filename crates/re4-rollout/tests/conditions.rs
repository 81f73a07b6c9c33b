//! Conditions of rollouts: goals elsewhere, old observations, disturbances and noise.
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use re4_geometry::{Point2, Pose2, periodic_distance};
use re4_rollout::{
    Act, ArmAction, ArmState, Conditions, Displaced, Displacement, Disturbance, Disturbed, Domain, Env, Harness, Image,
    ObservedPose, Phase, Plane, PlaneScene, Policy, PolicyError, PolicyFactory, PoseNoise, PushTEnv, Rollout, Senses,
    Source, Space, SpaceFirst, Start, rollout, rollouts,
};
use re4_sim::robosuite::{Placement, RobosuiteObservation, RobosuiteStep, RobosuiteTask};
use re4_sim::{GOAL, ResetOrder, Scene, SimError};

/// Moves towards the middle of the block, and records what it observes.
struct Pusher;

/// What a policy observed at a step.
#[derive(Debug, Clone, PartialEq)]
struct Seen {
    pusher: Point2,
    block: Pose2,
    image: Vec<u8>,
}

impl PolicyFactory<Plane> for Pusher {
    type Policy = Self;

    fn start(&self, _: u32, _: &Point2) -> Self {
        Self
    }
}

impl Policy<Plane> for Pusher {
    type Decision = Seen;

    fn act(&mut self, senses: &mut dyn Senses<Plane>) -> Result<Act<Plane, Seen>, PolicyError> {
        let (pusher, block) = (senses.proprio(), senses.object()?.pose);
        let centre = block.transform_point(Point2::new(0.0, 45.0));
        // A step of 20 px towards the block, in the frame of the observations.
        let target = pusher + (centre - pusher).normalize() * 20.0;
        Ok(Act {
            action: target,
            phase: Phase::Replay,
            object: Some(block),
            decision: Some(Seen {
                pusher,
                block,
                image: senses.image("image")?.pixels.clone(),
            }),
        })
    }
}

fn pushed(scene: PlaneScene, conditions: &Conditions) -> Rollout<Plane, Seen> {
    let mut env = PushTEnv::new().unwrap();
    let start = Start { seed: 200_000, scene };
    rollout(&Pusher, &mut env, Source::Recorded, start, 15, conditions).unwrap()
}

fn scene(agent: Point2, block: Pose2, goal: Pose2) -> PlaneScene {
    PlaneScene {
        state: Scene { agent, block },
        order: ResetOrder::PoseIsPose,
        goal,
    }
}

/// Maximum deviation of a moved rollout in pixels.
const TOLERANCE: f64 = 1e-6;

fn apart(a: Pose2, b: Pose2) -> f64 {
    (a.translation() - b.translation())
        .norm()
        .max(100.0 * periodic_distance(a.theta, b.theta, TAU))
}

#[test]
fn a_moved_world_gives_the_same_rollout_up_to_the_motion() {
    let (agent, block) = (Point2::new(180.0, 330.0), Pose2::new(240.0, 230.0, 0.4));
    let plain = pushed(scene(agent, block, GOAL), &Conditions::default());
    assert!(plain.world_from_observed().is_none());
    // Nothing comes near a wall in any of these worlds.
    for motion in [
        Pose2::new(12.0, -9.0, 0.0),
        Pose2::new(470.0, 30.0, std::f64::consts::FRAC_PI_2),
        Pose2::new(500.0, 500.0, 3.0),
    ] {
        let goal = motion.compose(GOAL);
        let elsewhere = scene(motion.transform_point(agent), motion.compose(block), goal);
        let moved = pushed(elsewhere, &Conditions::default());
        assert_eq!(moved.steps.len(), plain.steps.len());
        let back = moved.world_from_observed().unwrap();
        assert!(apart(back, motion) < 1e-9);
        let mut worst = 0.0_f64;
        for (here, there) in plain.steps.iter().zip(&moved.steps) {
            // The recorded steps are in the world frame.
            let [from, to] = [here, there].map(|step| step.after.observation);
            let deviations = [
                (motion.transform_point(here.action) - there.action).norm(),
                (motion.transform_point(from.agent) - to.agent).norm(),
                apart(motion.compose(from.block), to.block),
                100.0 * (here.after.coverage - there.after.coverage).abs(),
                apart(motion.compose(here.seen.unwrap()), there.seen.unwrap()),
            ];
            worst = deviations.into_iter().fold(worst, f64::max);
        }
        for (here, there) in plain.decisions.iter().zip(&moved.decisions) {
            // The policy itself observes the problem of the demonstrations.
            worst = worst
                .max((here.pusher - there.pusher).norm())
                .max(apart(here.block, there.block));
            assert!((0.0..TAU).contains(&there.block.theta));
            // Images show the goal where it is in the demonstrations. Only the walls are elsewhere, and edges by a pixel.
            let pixel = |image: &[u8], x: usize, y: usize| [0, 1, 2].map(|c| image[3 * (96 * y + x) + c]);
            let inner = (20..76).flat_map(|y| (20..76).map(move |x| (x, y)));
            let differ = inner.filter(|&(x, y)| pixel(&here.image, x, y) != pixel(&there.image, x, y));
            assert!(differ.count() < 250, "{motion:?}");
        }
        // Contacts amplify the rounding errors of the motion.
        println!("{motion:?}: deviation of at most {worst:.1e} px");
        assert!(worst < TOLERANCE, "{motion:?}: {worst}");
        let block_moved = apart(block, plain.steps[14].after.observation.block);
        assert!(block_moved > 10.0, "the pusher moves the block by {block_moved} px");
    }
}

#[test]
fn the_goal_of_the_task_changes_no_bit_and_a_target_outside_of_the_window_is_limited() {
    let here = scene(Point2::new(180.0, 330.0), Pose2::new(240.0, 230.0, 0.4), GOAL);
    let one = pushed(here, &Conditions::default());
    let same = Pose2::new(GOAL.x, GOAL.y, GOAL.theta);
    assert_eq!(one, pushed(PlaneScene { goal: same, ..here }, &Conditions::default()));
    let motion = Pose2::new(100.0, -20.0, 1.0);
    let far = Plane::action_in_world(&motion, &Point2::new(900.0, -900.0));
    let free = motion.transform_point(Point2::new(900.0, -900.0));
    assert!(free.x > 512.0 && (0.0..=512.0).contains(&free.y), "{free}");
    assert_eq!(far, Point2::new(512.0, free.y));
    let inside = Plane::action_in_world(&motion, &Point2::new(50.0, 60.0));
    assert_eq!(inside, motion.transform_point(Point2::new(50.0, 60.0)));
}

/// A simulation whose state is the number of steps taken. Images show this number, too.
struct Counter {
    steps: u32,
    /// The first step before which a displacement is valid.
    displaceable: u32,
}

impl Counter {
    fn pose(&self) -> Isometry3<f64> {
        Translation3::new(f64::from(self.steps), 0.0, 0.0).into()
    }

    fn observation(&self) -> RobosuiteObservation {
        RobosuiteObservation {
            grip_site: self.pose(),
            hand: UnitQuaternion::identity(),
            object: self.pose(),
            fingers: [0.0; 2],
        }
    }
}

impl Env<Space> for Counter {
    fn reset(&mut self, _: &Placement) -> Result<SpaceFirst, SimError> {
        self.steps = 0;
        Ok(SpaceFirst {
            observation: self.observation(),
            state: Vec::new(),
        })
    }

    fn step(&mut self, _: &ArmAction) -> Result<RobosuiteStep, SimError> {
        self.steps += 1;
        Ok(RobosuiteStep {
            observation: self.observation(),
            success: false,
        })
    }

    fn proprio(&self) -> ArmState {
        ArmState::from(&self.observation())
    }

    fn object(&self) -> Isometry3<f64> {
        self.pose()
    }

    fn view(&self) -> Vec<f64> {
        vec![f64::from(self.steps)]
    }

    fn render(
        &mut self,
        view: &Vec<f64>,
        _: Option<&Isometry3<f64>>,
        _: &str,
        into: &mut Image,
    ) -> Result<(), PolicyError> {
        into.pixels = vec![view[0] as u8];
        Ok(())
    }

    fn displace(&mut self, _: &Displacement) -> Result<bool, SimError> {
        Ok(self.steps >= self.displaceable)
    }
}

/// Records the step that each kind of observation shows. Asks for the image only from its third step on.
struct Reader {
    step: u32,
}

impl PolicyFactory<Space> for Reader {
    type Policy = Self;

    fn start(&self, _: u32, first: &ArmState) -> Self {
        assert_eq!(first.eef.translation.x, 0.0);
        Self { step: 0 }
    }
}

impl Policy<Space> for Reader {
    type Decision = [u32; 4];

    fn act(&mut self, senses: &mut dyn Senses<Space>) -> Result<Act<Space, [u32; 4]>, PolicyError> {
        let read = |pose: &Isometry3<f64>| pose.translation.x as u32;
        let (eef, object) = (read(&senses.proprio().eef), read(&senses.object()?.pose));
        let image = if self.step < 3 {
            eef
        } else {
            u32::from(senses.image("agentview")?.pixels[0])
        };
        self.step += 1;
        Ok(Act {
            action: ArmAction {
                goal: Isometry3::identity(),
                gripper: 0.0,
            },
            phase: Phase::Replay,
            object: None,
            decision: Some([eef, object, image, senses.latency()]),
        })
    }
}

fn count(conditions: Conditions, displaceable: u32, seed: u32) -> Rollout<Space, [u32; 4]> {
    let task = RobosuiteTask::named("lift").unwrap();
    let start = Start {
        seed,
        scene: Placement::sample(task, seed),
    };
    let mut env = Counter { steps: 7, displaceable };
    rollout(&Reader { step: 0 }, &mut env, Source::Recorded, start, 9, &conditions).unwrap()
}

#[test]
fn every_observation_is_as_old_as_the_latency() {
    for latency in [0, 1, 2, 5] {
        let conditions = Conditions {
            latency,
            disturbance: None,
        };
        let decisions = count(conditions, 0, 1).decisions;
        assert_eq!(decisions.len(), 9);
        for (step, seen) in (0..).zip(decisions) {
            let shown = u32::saturating_sub(step, latency);
            assert_eq!(seen, [shown, shown, shown, latency], "step {step}, latency {latency}");
        }
    }
}

fn disturbance(kind: Disturbed, steps: [u32; 2]) -> Conditions {
    Conditions {
        latency: 0,
        disturbance: Some(Disturbance {
            kind,
            steps,
            translation: 40.0,
            rotation: 0.5,
        }),
    }
}

#[test]
fn a_disturbance_happens_once_in_its_range_of_steps_by_the_seed() {
    let mut steps = [0; 9];
    let mut pushers = 0;
    for seed in 0..600 {
        let applied = count(disturbance(Disturbed::Either, [2, 5]), 0, seed)
            .disturbance
            .unwrap();
        steps[applied.step as usize] += 1;
        let Displacement { what, motion } = applied.displacement;
        assert!((motion.translation().norm() - 40.0).abs() < 1e-9);
        let rotation = if what == Displaced::Object { 0.5 } else { 0.0 };
        assert_eq!(motion.theta.abs(), rotation);
        pushers += u32::from(what == Displaced::Pusher);
        assert_eq!(
            count(disturbance(Disturbed::Either, [2, 5]), 0, seed).disturbance,
            Some(applied)
        );
    }
    assert!((240..360).contains(&pushers), "{pushers}");
    let [none, range] = [[&steps[..2], &steps[6..]].concat(), steps[2..6].to_vec()];
    assert!(
        none.iter().all(|&n| n == 0) && range.iter().all(|&n| n > 110),
        "{steps:?}"
    );
    // Without a valid direction, it happens at the next step with one, or never.
    let put_off = |displaceable| count(disturbance(Disturbed::Object, [2, 5]), displaceable, 3).disturbance;
    assert_eq!(put_off(7).unwrap().step, 7);
    assert_eq!(put_off(100), None);
}

#[test]
fn the_block_and_the_pusher_are_moved_as_recorded() {
    for (kind, what) in [
        (Disturbed::Object, Displaced::Object),
        (Disturbed::Pusher, Displaced::Pusher),
    ] {
        let here = scene(Point2::new(100.0, 400.0), Pose2::new(240.0, 200.0, 0.4), GOAL);
        let mut disturbed = disturbance(kind, [3, 3]);
        disturbed.latency = 0;
        let rolled = pushed(here, &disturbed);
        let applied = rolled.disturbance.unwrap();
        assert_eq!((applied.step, applied.displacement.what), (3, what));
        let before = rolled.steps[2].after.observation;
        let seen = &rolled.decisions[3];
        let motion = applied.displacement.motion;
        let centre = Point2::new(0.0, 45.0);
        let (block, pusher) = match what {
            Displaced::Object => (motion.translation(), Point2::zeros()),
            Displaced::Pusher => (Point2::zeros(), motion.translation()),
        };
        let moved = seen.block.transform_point(centre) - before.block.transform_point(centre);
        assert!((moved - block).norm() < 1e-9);
        assert!(periodic_distance(seen.block.theta, before.block.theta + motion.theta, TAU) < 1e-9);
        assert!((seen.pusher - before.agent - pusher).norm() < 1e-9);
    }
}

#[test]
fn threads_do_not_change_disturbed_rollouts() {
    let starts: Vec<Start<Plane>> = (200_000..200_012)
        .map(|seed| {
            let mut start = Start::from_seed(re4_sim::SeedScheme::DiffusionPolicy, ResetOrder::Legacy, seed);
            start.scene.goal = re4_sim::random_goal(seed, start.scene.state.arrival(start.scene.order));
            start
        })
        .collect();
    let harness: Harness<'_, '_, Plane> = Harness {
        env: &|_| Ok(Box::new(PushTEnv::new()?)),
        source: &|seed| {
            let mut noise = PoseNoise::new(u64::from(seed), 2.0, 0.02);
            Source::Noisy(Box::new(move |pose| noise.perturb_planar(pose)))
        },
        max_steps: 20,
        conditions: Conditions {
            latency: 1,
            ..disturbance(Disturbed::Either, [2, 9])
        },
        progress: &|| true,
        times: &re4_rollout::ActTimes::default(),
    };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| rollouts(&Pusher, &harness, &starts)).unwrap()
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn noise_in_the_plane_has_its_standard_deviations() {
    let truth = Pose2::new(200.0, 300.0, 0.01);
    let mut noise = PoseNoise::new(7, 3.0, 0.05);
    let count = 20_000;
    let mut squares = [0.0; 3];
    for _ in 0..count {
        let seen: Pose2 = noise.perturb_planar(&truth);
        assert!((0.0..TAU).contains(&seen.theta));
        let turn = (seen.theta - truth.theta + 3.0).rem_euclid(TAU) - 3.0;
        for (sum, error) in squares.iter_mut().zip([seen.x - truth.x, seen.y - truth.y, turn]) {
            *sum += error * error;
        }
    }
    let [x, y, theta] = squares.map(|sum| (sum / f64::from(count)).sqrt());
    assert!(
        (x - 3.0).abs() < 0.06 && (y - 3.0).abs() < 0.06 && (theta - 0.05).abs() < 0.001,
        "{x} {y} {theta}"
    );
    let mut again = PoseNoise::new(7, 3.0, 0.05);
    let mut other = PoseNoise::new(8, 3.0, 0.05);
    assert_ne!(again.perturb_planar(&truth), other.perturb_planar(&truth));
    let known = ObservedPose::<Plane>::known(truth);
    assert!(!known.is_doubtful());
}

//! A policy that does not receive the object pose at every step and requests it from images.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod shown;
mod toy;

use std::sync::Arc;

use nalgebra::Isometry3;
use re4_episode::Mode;
use re4_geometry::spatial::{Symmetry, pose_distance};
use re4_policy::spatial::{ObjectEstimate, SpatialDecisionKind, SpatialPolicyConfig, SpatialRe4, WhileHeld};
use re4_rollout::{ArmState, Policy as _, PolicyError};
use shown::Shown;
use toy::{SpatialAct, World, block, demonstrations, episode, knowledge};

fn act_on_request(
    policy: &mut SpatialRe4,
    proprio: ArmState,
    object: &mut dyn FnMut() -> Result<Isometry3<f64>, PolicyError>,
) -> Result<SpatialAct, PolicyError> {
    act_on_flagged(policy, proprio, None, object)
}

fn act_on_flagged(
    policy: &mut SpatialRe4,
    proprio: ArmState,
    flag: Option<&'static str>,
    object: &mut dyn FnMut() -> Result<Isometry3<f64>, PolicyError>,
) -> Result<SpatialAct, PolicyError> {
    policy.act(&mut Shown {
        proprio,
        observes_object: false,
        flag,
        object,
    })
}

/// The result of an episode: its actions, the steps at which the policy requested the object pose, and whether it succeeded.
struct Episode {
    acts: Vec<SpatialAct>,
    requested_at: Vec<usize>,
    success: bool,
}

/// Runs an episode in which the policy receives `estimate(true pose)` when it requests the object pose.
fn run_on_request(
    config: &SpatialPolicyConfig,
    demos: u32,
    object: Isometry3<f64>,
    estimate: impl Fn(&Isometry3<f64>) -> Isometry3<f64>,
    mut disturb: impl FnMut(&mut World),
) -> Episode {
    let mut world = World::new(object);
    let known = knowledge(demonstrations(demos, 0.6, 1), config, Symmetry::None);
    let mut policy = SpatialRe4::new(config.clone(), known, world.eef);
    let (mut acts, mut requested_at) = (Vec::new(), Vec::new());
    while acts.len() < 400 && !world.success() {
        disturb(&mut world);
        let mut requests = 0;
        let act = act_on_request(&mut policy, world.arm_state(), &mut || {
            requests += 1;
            Ok(estimate(&world.object))
        })
        .unwrap();
        assert!(requests <= 1);
        if requests == 1 {
            requested_at.push(acts.len());
        }
        world.step(&act.action);
        acts.push(act);
    }
    Episode {
        success: world.success(),
        acts,
        requested_at,
    }
}

#[test]
fn the_pose_is_requested_only_at_retrievals() {
    for config in [SpatialPolicyConfig::paper(), SpatialPolicyConfig::re4()] {
        // The block slips out of the first grasp, so that the episode also contains a return home.
        let mut slipped = false;
        let run = run_on_request(
            &config,
            8,
            block(-0.05, -0.1, 0.1),
            |object| *object,
            |world| {
                world.slippery = !slipped;
                slipped |= world.separation < 0.011;
            },
        );
        assert!(run.success && run.acts.len() > 5 * run.requested_at.len());
        let chosen: Vec<usize> = (0..run.acts.len())
            .filter(|step| {
                let decision = run.acts[*step].decision.as_ref();
                decision
                    .is_some_and(|d| matches!(d.kind, SpatialDecisionKind::Retrieve | SpatialDecisionKind::Continue))
            })
            .collect();
        assert_eq!(run.requested_at, chosen);
        let kinds: Vec<_> = run
            .acts
            .iter()
            .filter_map(|act| Some(act.decision.as_ref()?.kind))
            .collect();
        assert!(kinds.contains(&SpatialDecisionKind::GraspLost), "{kinds:?}");
    }
}

/// The paper's policy uses poses at decisions only, so additional observations must not change its actions.
#[test]
fn poses_between_decisions_change_nothing() {
    let config = SpatialPolicyConfig::paper();
    for seed in 0..8 {
        let placed = block(-0.12 + 0.02 * f64::from(seed), -0.1, 0.1 * f64::from(seed));
        let run = run_on_request(&config, 5, placed, |object| *object, |_| {});
        let known = knowledge(demonstrations(5, 0.6, 1), &config, Symmetry::None);
        let observed = episode(&config, &known, placed, None, |_, _| {});
        assert_eq!(run.success, observed.success);
        let actions = |acts: &[SpatialAct]| acts.iter().map(|act| act.action).collect::<Vec<_>>();
        assert_eq!(actions(&run.acts), actions(&observed.acts));
        let decisions = |acts: &[SpatialAct]| acts.iter().filter_map(|act| act.decision.clone()).collect::<Vec<_>>();
        assert_eq!(decisions(&run.acts), decisions(&observed.acts));
    }
}

#[test]
fn after_a_doubtful_estimate_the_policy_looks_again_and_keeps_a_clear_one() {
    let mut config = SpatialPolicyConfig::re4();
    config.reframe.look_again = Some(3);
    config.reframe.held = WhileHeld::Carried;
    let (placed, wrong) = (block(-0.05, -0.1, 0.1), block(0.1, 0.1, 0.0));
    // For each step: the flag of an estimate that is requested then, and the estimate.
    let run = |doubtful: &dyn Fn(usize) -> bool| {
        let mut world = World::new(placed);
        let known = knowledge(demonstrations(8, 0.6, 1), &config, Symmetry::None);
        let mut policy = SpatialRe4::new(config.clone(), known, world.eef);
        let (mut requested_at, mut believed) = (Vec::new(), Vec::new());
        while believed.len() < 400 && !world.success() {
            let step = believed.len();
            let (flag, seen) = if doubtful(step) {
                ("unsure", wrong)
            } else {
                ("clear", world.object)
            };
            let mut requested = false;
            let act = act_on_flagged(&mut policy, world.arm_state(), Some(flag), &mut || {
                requested = true;
                Ok(seen)
            })
            .unwrap();
            if requested {
                requested_at.push(step);
            }
            believed.push(act.object.unwrap());
            world.step(&act.action);
        }
        (world.success(), requested_at, believed)
    };
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| pose_distance(a, b).0;

    // Doubtful until step 10: there is no clear estimate yet, so the doubtful one is used, and the policy looks every third step.
    let (success, requested_at, believed) = run(&|step| step < 10);
    assert!(success);
    assert_eq!(requested_at[..5], [0, 3, 6, 9, 12]);
    assert!(distance(&believed[3], &wrong) < 1e-9 && distance(&believed[12], &placed) < 1e-9);

    // Clear at the first step only: while the object is untouched, the clear estimate stays in use.
    let (success, requested_at, believed) = run(&|step| step > 0);
    assert!(success, "the clear estimate is enough for the grasp");
    assert!(requested_at.len() > 3);
    assert!(distance(&believed[requested_at[1]], &placed) < 1e-9);

    // Without the setting, the policy does not look between decisions.
    config.reframe.look_again = None;
    let quiet = run_on_request(&config, 8, placed, |object| *object, |_| {});
    assert!(quiet.success && quiet.requested_at.get(1).is_none_or(|step| *step > 8));
}

#[test]
fn the_true_pose_has_no_influence() {
    let config = SpatialPolicyConfig::re4();
    let estimated = block(0.0, -0.12, 0.3);
    let runs: Vec<Vec<SpatialAct>> = [block(-0.1, 0.0, 0.0), block(0.2, 0.3, -0.5)]
        .map(|placed| run_on_request(&config, 5, placed, |_| estimated, |world| world.slippery = true).acts)
        .into();
    assert_eq!(runs[0], runs[1]);
    let with_true_pose = run_on_request(&config, 5, block(-0.1, 0.0, 0.0), |object| *object, |_| {}).acts;
    assert_ne!(with_true_pose[0], runs[0][0]);
}

#[test]
fn between_requests_the_object_is_fixed_in_the_world_or_in_the_gripper() {
    let near = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let (distance, angle) = pose_distance(a, b);
        distance < 1e-12 && angle < 1e-7
    };
    let filter = SpatialPolicyConfig::re4().filter;
    for filter in [None, filter] {
        let group = Symmetry::None.group().unwrap();
        let mut estimate = ObjectEstimate::new(filter, group);
        let (over, lifted) = (toy::home(), toy::home() * Isometry3::translation(0.1, 0.0, -0.2));
        assert_eq!(estimate.carry(Mode::Transit, &over), None);
        let object = block(0.05, -0.02, 0.4);
        estimate.observe(Mode::Transit, &over, &object);
        assert!(near(&estimate.carry(Mode::Transit, &lifted).unwrap(), &object));
        // The gripper closes on the object, which then moves with it.
        assert!(near(&estimate.carry(Mode::Transfer, &over).unwrap(), &object));
        let along = lifted * over.inv_mul(&object);
        assert!(near(&estimate.carry(Mode::Transfer, &lifted).unwrap(), &along));
        // After the release, the object stays.
        assert!(near(&estimate.carry(Mode::Transit, &lifted).unwrap(), &along));
        assert!(near(&estimate.carry(Mode::Transit, &over).unwrap(), &along));
    }
}

#[test]
fn a_pose_that_cannot_be_observed_is_an_error() {
    let config = SpatialPolicyConfig::re4();
    let known = knowledge(demonstrations(5, 0.6, 1), &config, Symmetry::None);
    let world = World::new(block(0.0, 0.0, 0.0));
    let arm = world.arm_state();
    let mut policy = SpatialRe4::new(config.clone(), Arc::clone(&known), world.eef);
    let blind = act_on_request(&mut policy, arm, &mut || Err(PolicyError::unobservable("it is dark")));
    assert_eq!(blind.unwrap_err().to_string(), "cannot observe the scene: it is dark");
    let mut policy = SpatialRe4::new(config, known, world.eef);
    let not_finite = act_on_request(&mut policy, arm, &mut || Ok(Isometry3::translation(f64::NAN, 0.0, 0.0)));
    assert!(matches!(not_finite.unwrap_err(), PolicyError::Own(_)));
    let mut broken = arm;
    broken.fingers[0] = f64::NAN;
    assert!(act_on_request(&mut policy, broken, &mut || unreachable!()).is_err());
}

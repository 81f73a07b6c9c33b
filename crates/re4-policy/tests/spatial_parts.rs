//! Reframe, the bridge, averaged poses, noise and settings of the policy in SE(3), each tested separately.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic is how a test fails")]

mod shown;
mod toy;

use std::sync::Arc;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_episode::Mode;
use re4_fault::Remedy as _;
use re4_geometry::spatial::{Symmetry, pose_distance, rotation_vector};
use re4_policy::kinds::{Kinds as _, SpacePolicy};
use re4_policy::spatial::{
    ObjectEstimate, PoseFilterConfig, SpatialDemoSet, SpatialKnowledge, SpatialPolicyConfig, SpatialRe4,
    TransferReplay, reframe_spatial,
};
use re4_policy::{DemoNames, LookupError};
use re4_rollout::{ArmState, Phase, PolicyError, PoseNoise};
use toy::{Random, World, block, demonstrate, demonstrations, knowledge, observe_and_act, yaw};

fn pose() -> impl Strategy<Value = Isometry3<f64>> {
    any::<u64>().prop_map(|seed| Random::new(seed).pose())
}

fn close(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
    let (distance, angle) = pose_distance(a, b);
    distance < 1e-9 && angle < 1e-9
}

const TRANSFERS: [TransferReplay; 2] = [TransferReplay::Verbatim, TransferReplay::GraspCorrected];

proptest! {
    #[test]
    fn transit_keeps_the_object_relative_pose(o_j in pose(), x_j in pose(), o_q in pose(), x_q in pose(), a in pose()) {
        for transfer in TRANSFERS {
            let carry = reframe_spatial(Mode::Transit, transfer, (&o_j, &x_j), (&o_q, &x_q));
            prop_assert!(close(&o_q.inv_mul(&carry.near), &o_j.inv_mul(&x_j)));
            // The goals also keep their pose relative to the object.
            prop_assert!(close(&o_q.inv_mul(&carry.goal(&a)), &o_j.inv_mul(&a)));
            prop_assert!(close(&(carry.delta * o_j), &o_q));
        }
    }

    #[test]
    fn transfer_moves_the_held_object_to_the_pose_of_the_demonstration(
        o_j in pose(), x_j in pose(), o_q in pose(), x_q in pose(), a in pose()
    ) {
        let grasp = x_q.inv_mul(&o_q);
        let verbatim = reframe_spatial(Mode::Transfer, TransferReplay::Verbatim, (&o_j, &x_j), (&o_q, &x_q));
        prop_assert!(close(&(verbatim.near * grasp), &o_j));
        prop_assert!(close(&verbatim.near, &(verbatim.delta.inverse() * x_q)), "x_near = delta^-1 x_q, as in the paper");
        prop_assert!(close(&verbatim.goal(&a), &a));
        // With the difference between the grasps corrected, the held object goes where the demonstration's would.
        let corrected = reframe_spatial(Mode::Transfer, TransferReplay::GraspCorrected, (&o_j, &x_j), (&o_q, &x_q));
        prop_assert!(close(&(corrected.goal(&a) * grasp), &(a * x_j.inv_mul(&o_j))));
        prop_assert!(close(&corrected.near, &verbatim.near));
        // A goal at the demonstration's own end effector is the set-point.
        prop_assert!(close(&corrected.goal(&x_j), &corrected.near));
    }

    #[test]
    fn reframing_to_the_recorded_state_changes_nothing(o in pose(), x in pose(), a in pose()) {
        for mode in Mode::ALL {
            for transfer in TRANSFERS {
                let carry = reframe_spatial(mode, transfer, (&o, &x), (&o, &x));
                prop_assert!(close(&carry.near, &x) && close(&carry.goal(&a), &a));
                prop_assert!(close(&carry.delta, &Isometry3::identity()));
            }
        }
    }
}

#[test]
fn the_bridge_arrives_from_any_start() {
    let config = SpatialPolicyConfig::paper();
    let demos = demonstrations(6, 0.6, 8);
    let knowledge = knowledge(demos, &config, Symmetry::None);
    let mut random = Random::new(9);
    let mut bridges = 0;
    for _ in 0..100 {
        let mut world = World::new(block(
            random.range(-0.2, 0.2),
            random.range(-0.2, 0.2),
            random.range(-1.0, 1.0),
        ));
        let start = random.pose();
        world.eef = Isometry3::from_parts(start.translation, yaw(random.range(-1.0, 1.0)) * world.eef.rotation);
        world.eef.translation.z = random.range(0.1, 0.5);
        let mut policy = SpatialRe4::new(config.clone(), Arc::clone(&knowledge), world.eef);
        let mut goal = None;
        let mut left = f64::INFINITY;
        for step in 0.. {
            let act = observe_and_act(&mut policy, world.arm_state(), world.object).unwrap();
            if let Some(decision) = &act.decision {
                if goal.is_some() {
                    break;
                }
                goal = Some(decision.set_point);
            }
            let (distance, angle) = pose_distance(&world.eef, &goal.unwrap());
            if act.phase == Phase::Replay {
                let arrived =
                    distance <= config.replan.tolerance_translation && angle <= config.replan.tolerance_rotation;
                assert!(arrived || step >= 40, "{distance} {angle} after {step}");
                bridges += usize::from(arrived && step > 3);
                break;
            }
            let (lead, lead_angle) = pose_distance(&world.eef, &act.action.goal);
            assert!(
                lead <= 0.05 + 1e-9 && lead_angle <= 0.5 + 1e-9,
                "the set-point is at most a lead ahead"
            );
            assert!(act.action.gripper < 0.0);
            assert!(
                distance <= left + 1e-9,
                "the end effector approaches the goal at every step"
            );
            left = distance;
            world.step(&act.action);
        }
    }
    assert!(bridges > 60, "{bridges}");
}

#[test]
fn a_bridge_that_does_not_arrive_ends() {
    let config = SpatialPolicyConfig::paper();
    let knowledge = knowledge(demonstrations(6, 0.6, 8), &config, Symmetry::None);
    let world = World::new(block(0.1, 0.1, 0.0));
    let mut arm = world.arm_state();
    arm.eef.translation.x += 0.4;
    let mut policy = SpatialRe4::new(config.clone(), knowledge, world.eef);
    let phases: Vec<Phase> = (0..57)
        .map(|_| observe_and_act(&mut policy, arm, world.object).unwrap().phase)
        .collect();
    assert!(phases[..40].iter().all(|p| *p == Phase::Bridge));
    assert!(phases[40..56].iter().all(|p| *p == Phase::Replay));
    assert_eq!(phases[56], Phase::Bridge);
}

#[test]
fn actions_do_not_depend_on_the_yaw_of_a_symmetric_object() {
    // The can of the demonstration or of the query has a different yaw. With the symmetry, the actions must be the same.
    let mut config = SpatialPolicyConfig::re4();
    config.filter = None;
    let can = Symmetry::Full { axis: [0.0, 0.0, 1.0] };
    let plain = demonstrate(block(-0.05, -0.1, 0.2), 0);
    let mut rotated = plain.clone();
    for frame in &mut rotated {
        frame.object.rotation *= yaw(2.0);
    }
    let run = |frames: &[_], angle: f64| {
        let demos = SpatialDemoSet::new([(0, frames.to_vec())]);
        let knowledge = knowledge(demos, &config, can);
        let mut world = World::new(block(-0.07, -0.08, 0.2));
        let mut policy = SpatialRe4::new(config.clone(), knowledge, world.eef);
        let mut goals = Vec::new();
        while !world.success() && goals.len() < 200 {
            let mut object = world.object;
            object.rotation *= yaw(angle);
            let act = observe_and_act(&mut policy, world.arm_state(), object).unwrap();
            world.step(&act.action);
            goals.push(act.action.goal);
        }
        assert!(world.success());
        goals
    };
    let reference = run(&plain, 0.0);
    for (frames, angle) in [(&plain, 1.3), (&rotated, 0.0), (&rotated, -2.5)] {
        let goals = run(frames, angle);
        assert_eq!(goals.len(), reference.len());
        for (a, b) in goals.iter().zip(&reference) {
            let (distance, angle) = pose_distance(a, b);
            assert!(distance < 1e-6 && angle < 1e-6, "{distance} {angle}");
        }
    }
}

fn filter() -> ObjectEstimate {
    let config = PoseFilterConfig { samples: 20, gate: 4.0 };
    ObjectEstimate::new(Some(config), Symmetry::None.group().unwrap())
}

#[test]
fn averaging_reduces_the_error_in_both_modes() {
    for mode in Mode::ALL {
        let (mut raw, mut averaged, mut deviations) = (0.0, 0.0, (0.0, 0.0));
        for seed in 0..40 {
            let mut random = Random::new(seed);
            let (object, mut eef) = (random.pose(), random.pose());
            let held = eef.inv_mul(&object);
            let mut noise = PoseNoise::new(seed, 0.005, 0.08);
            let mut estimate = filter();
            for step in 0..40 {
                let truth = if mode == Mode::Transfer {
                    eef = Isometry3::translation(0.01, 0.0, 0.002)
                        * eef
                        * UnitQuaternion::from_scaled_axis(Vector3::z() * 0.02);
                    eef * held
                } else {
                    object
                };
                let observed = noise.perturb(&truth);
                let estimated = estimate.observe(mode, &eef, &observed);
                if step >= 20 {
                    raw += pose_distance(&observed, &truth).0;
                    averaged += pose_distance(&estimated, &truth).0;
                }
            }
            let (t, r) = estimate.deviations().unwrap();
            deviations = (deviations.0 + t / 40.0, deviations.1 + r / 40.0);
        }
        assert!(averaged < 0.45 * raw, "{mode}: {averaged} {raw}");
        assert!(
            (deviations.0 - 0.005).abs() < 5e-4 && (deviations.1 - 0.08).abs() < 8e-3,
            "{mode}: {deviations:?}"
        );
    }
}

#[test]
fn exact_observations_are_used_unchanged() {
    let mut estimate = filter();
    let mut random = Random::new(3);
    let mut object = random.pose();
    let eef = random.pose();
    for step in 0..100 {
        // The object rests, then moves, then rests again.
        if (40..60).contains(&step) {
            object.translation.x += 0.003;
        }
        let found = estimate.observe(Mode::Transit, &eef, &object);
        assert!(close(&found, &object), "{step}");
    }
}

#[test]
fn a_jump_restarts_the_average() {
    let mut estimate = filter();
    let mut noise = PoseNoise::new(4, 0.003, 0.03);
    let eef = Isometry3::identity();
    let here = Isometry3::translation(0.1, 0.2, 0.3);
    let there = Isometry3::translation(0.2, 0.2, 0.3);
    for _ in 0..30 {
        estimate.observe(Mode::Transit, &eef, &noise.perturb(&here));
    }
    let found = estimate.observe(Mode::Transit, &eef, &noise.perturb(&there));
    assert!(pose_distance(&found, &there).0 < 0.015);
}

#[test]
fn without_a_filter_observations_are_estimates() {
    let mut estimate = ObjectEstimate::new(None, Symmetry::None.group().unwrap());
    let mut random = Random::new(5);
    for _ in 0..10 {
        let (eef, object) = (random.pose(), random.pose());
        assert_eq!(estimate.observe(Mode::Transit, &eef, &object), object);
    }
}

#[test]
fn noise_is_normal_seeded_and_independent() {
    let sample = |seed| {
        let mut noise = PoseNoise::new(seed, 0.005, 0.1);
        let pose = Isometry3::from_parts(Vector3::new(0.3, -0.2, 0.1).into(), yaw(1.0));
        (0..4000)
            .map(|_| {
                let observed = noise.perturb(&pose);
                let t = (observed.translation.vector - pose.translation.vector) / 0.005;
                let r = rotation_vector(&(observed.rotation * pose.rotation.inverse())) / 0.1;
                [t.x, t.y, t.z, r.x, r.y, r.z]
            })
            .collect::<Vec<_>>()
    };
    let all = sample(1);
    assert_eq!(all, sample(1));
    assert_ne!(all, sample(2));
    for i in 0..6 {
        let mean = all.iter().map(|v| v[i]).sum::<f64>() / 4000.0;
        let variance = all.iter().map(|v| v[i] * v[i]).sum::<f64>() / 4000.0;
        let within_one = all.iter().filter(|v| v[i].abs() < 1.0).count() as f64 / 4000.0;
        assert!(
            mean.abs() < 0.06 && (variance - 1.0).abs() < 0.09,
            "{i}: {mean} {variance}"
        );
        assert!((within_one - 0.6827).abs() < 0.03, "{i}: {within_one}");
        let lag = all.windows(2).map(|w| w[0][i] * w[1][i]).sum::<f64>() / 4000.0;
        assert!(lag.abs() < 0.06, "{i}: {lag}");
    }
    let pose = Random::new(1).pose();
    assert!(close(&PoseNoise::new(1, 0.0, 0.0).perturb(&pose), &pose));
}

type Edit = fn(&mut SpatialPolicyConfig);

#[test]
fn presets_are_valid_and_errors_name_invalid_settings() {
    for name in SpacePolicy::NAMES {
        assert_eq!(SpacePolicy::defaults(name).unwrap().settings().check(false), Ok(()));
    }
    assert!(SpacePolicy::defaults("nothing").is_none());
    let edits: [(Edit, &str); 7] = [
        (
            |c| c.retrieve.translation_scale = 0.0,
            "retrieve.translation_scale is 0; give a finite number above 0",
        ),
        (
            |c| c.retrieve.eef_weight = -1.0,
            "retrieve.eef_weight is -1; give a finite number, 0 or more",
        ),
        (
            |c| c.replan.lead_rotation = f64::NAN,
            "replan.lead_rotation is NaN; give a finite number above 0",
        ),
        (|c| c.replay.horizon = 0, "replay.horizon is 0; give 1 or more"),
        (
            |c| c.recovery.lost_grasp = Some(f64::INFINITY),
            "recovery.lost_grasp is inf; give a finite number, 0 or more",
        ),
        (
            |c| c.recovery.ban.as_mut().unwrap().repeats = 1,
            "recovery.ban.repeats is 1; give 2 or more",
        ),
        (
            |c| c.filter.as_mut().unwrap().gate = 0.0,
            "filter.gate is 0; give a finite number above 0",
        ),
    ];
    for (edit, expected) in edits {
        let mut config = SpatialPolicyConfig::re4();
        edit(&mut config);
        assert_eq!(config.check(false).unwrap_err().sentence(), expected);
    }
}

#[test]
fn observations_and_demonstrations_that_are_not_finite_are_rejected() {
    let config = SpatialPolicyConfig::re4();
    let knowledge = knowledge(demonstrations(2, 0.6, 8), &config, Symmetry::None);
    let good = World::new(block(0.0, 0.0, 0.0));
    let broken: [fn(&mut ArmState, &mut Isometry3<f64>); 3] = [
        |arm, _| arm.eef.translation.x = f64::NAN,
        |_, object| object.translation.y = f64::INFINITY,
        |arm, _| arm.fingers[1] = f64::NAN,
    ];
    for invalidate in broken {
        let mut policy = SpatialRe4::new(config.clone(), Arc::clone(&knowledge), good.eef);
        let (mut arm, mut object) = (good.arm_state(), good.object);
        invalidate(&mut arm, &mut object);
        let refused = observe_and_act(&mut policy, arm, object).unwrap_err();
        assert!(refused.to_string().contains("not finite"), "{refused}");
    }
    let mut frames = demonstrate(block(0.0, 0.0, 0.0), 0);
    frames[3].goal.translation.x = f64::NAN;
    let refusal = |demos: SpatialDemoSet| {
        let refused = SpatialKnowledge::new(demos, &config.retrieve, Symmetry::None, |_, _| false);
        refused.err().unwrap().to_string()
    };
    let demos = SpatialDemoSet::new([(1, frames)]);
    assert!(refusal(demos.clone()).contains("episode 1, frame 3"));
    let names = DemoNames::new(vec!["demo_4".to_owned(), "demo_11".to_owned()]);
    assert!(refusal(demos.with_names(names)).contains("frame 3 of demo_11 has"));
}

#[test]
fn excluded_frames_and_tails_are_replayed_but_not_retrieved() {
    let config = SpatialPolicyConfig::re4();
    let frames = demonstrate(block(0.0, 0.0, 0.0), 0);
    let release = frames.iter().rposition(|f| f.mode == Mode::Transfer).unwrap();
    let demos = || SpatialDemoSet::new([(7, frames.clone())]);
    let built = SpatialKnowledge::new(demos(), &config.retrieve, Symmetry::None, |_, frame| frame < 5).unwrap();
    let numbers: Vec<u32> = built.index().frames().iter().map(|f| f.frame).collect();
    assert_eq!(numbers, (5..=release as u32).collect::<Vec<_>>());
    assert_eq!(built.demos().demo(7).unwrap().len(), frames.len());
    let paper = SpatialPolicyConfig::paper();
    let all = SpatialKnowledge::new(demos(), &paper.retrieve, Symmetry::None, |_, _| false).unwrap();
    assert_eq!(all.index().frames().len(), frames.len());
    // Without transfer frames, the policy cannot retrieve once the gripper has closed.
    let only_transit = SpatialKnowledge::new(demos(), &config.retrieve, Symmetry::None, |_, f| {
        frames[f as usize].mode == Mode::Transfer
    });
    let mut world = World::new(block(0.0, 0.0, 0.0));
    let mut policy = SpatialRe4::new(config, Arc::new(only_transit.unwrap()), world.eef);
    let refused = (0..200)
        .find_map(
            |_| match observe_and_act(&mut policy, world.arm_state(), world.object) {
                Ok(act) => {
                    world.step(&act.action);
                    None
                }
                Err(error) => Some(error),
            },
        )
        .unwrap();
    let PolicyError::Own(refused) = refused else {
        panic!("{refused}");
    };
    let refused = *refused.downcast::<LookupError>().unwrap();
    assert!(
        matches!(refused, LookupError::NoFrameOfMode { mode: Mode::Transfer }),
        "{refused}"
    );
}

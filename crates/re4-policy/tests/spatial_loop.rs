//! Tests of the whole loop in a kinematic world.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod shown;
mod toy;

use re4_geometry::spatial::Symmetry;
use re4_policy::DemoNames;
use re4_policy::spatial::{EndOfDemo, SpatialDecisionKind, SpatialDemoSet, SpatialPolicyConfig};
use re4_rollout::{Phase, PoseNoise};
use toy::{Episode, Random, block, demonstrate, demonstrations, episode, knowledge};

/// Returns the number of successes over 40 random placements, and the number of grasps lost in them. `noise` is in mm and
/// degrees; `catch` is in metres, see [`World`].
fn outcomes(config: &SpatialPolicyConfig, demos: u32, noise: f64, catch: f64) -> (usize, usize) {
    let knowledge = knowledge(demonstrations(demos, 0.6, 1), config, Symmetry::None);
    let mut random = Random::new(2);
    let mut lost = 0;
    let successes = (0..40)
        .filter(|&seed| {
            let placed = block(
                random.range(-0.15, 0.05),
                random.range(-0.2, 0.0),
                random.range(-0.6, 0.6),
            );
            let noise = PoseNoise::new(seed, 0.001 * noise, noise.to_radians());
            let run = episode(config, &knowledge, placed, Some(noise), |_, world| world.catch = catch);
            lost += kinds(&run)
                .iter()
                .filter(|kind| **kind == SpatialDecisionKind::GraspLost)
                .count();
            run.success
        })
        .count();
    (successes, lost)
}

/// Returns only the number of successes, without noise.
fn successes(config: &SpatialPolicyConfig, demos: u32) -> usize {
    outcomes(config, demos, 0.0, 0.012).0
}

#[test]
fn re4_generalises_from_five_demonstrations_and_re2_does_not() {
    assert_eq!(successes(&SpatialPolicyConfig::re4(), 5), 40);
    let paper = successes(&SpatialPolicyConfig::paper(), 5);
    assert!(paper >= 36, "{paper}");
    let re2 = successes(&SpatialPolicyConfig::re2(), 5);
    assert!(re2 <= 12, "{re2}");
}

#[test]
fn averaging_poses_reduces_the_effect_of_noise() {
    let averaged = outcomes(&SpatialPolicyConfig::re4(), 20, 5.0, 0.008);
    let mut single = SpatialPolicyConfig::re4();
    single.filter = None;
    let single = outcomes(&single, 20, 5.0, 0.008);
    assert!(averaged.0 >= 39 && averaged.1 <= 2, "{averaged:?}");
    assert!(
        single.0 < averaged.0 && single.1 > 5 * averaged.1.max(1),
        "{single:?}, {averaged:?}"
    );
}

#[test]
fn waiting_for_the_fingers_to_close_avoids_lost_grasps() {
    let settled = outcomes(&SpatialPolicyConfig::re4(), 20, 0.0, 0.008);
    let mut without_wait = SpatialPolicyConfig::re4();
    without_wait.replay.settle = None;
    let without_wait = outcomes(&without_wait, 20, 0.0, 0.008);
    assert_eq!(settled, (40, 0));
    assert!(without_wait.1 > 0, "{without_wait:?}");
}

#[test]
fn every_step_can_be_disabled_separately() {
    let mut no_bridge = SpatialPolicyConfig::paper();
    no_bridge.replan.enabled = false;
    let mut no_reframe = SpatialPolicyConfig::paper();
    no_reframe.reframe.enabled = false;
    for config in [SpatialPolicyConfig::paper(), no_bridge, no_reframe] {
        let knowledge = knowledge(demonstrations(5, 0.6, 1), &config, Symmetry::None);
        let run = episode(&config, &knowledge, block(0.0, -0.1, 0.2), None, |_, _| {});
        let decisions = run.decisions();
        let all = config.replan.enabled && config.reframe.enabled;
        assert!(!all || run.steps(Phase::Bridge) > 0);
        assert!(config.replan.enabled || run.steps(Phase::Bridge) == 0);
        let moved = decisions
            .iter()
            .filter_map(|d| d.choice)
            .any(|c| c.delta != nalgebra::Isometry3::identity());
        assert_eq!(moved, config.reframe.enabled);
    }
}

fn kinds(run: &Episode) -> Vec<SpatialDecisionKind> {
    run.decisions().iter().map(|d| d.kind).collect()
}

fn first_demo(run: &Episode) -> u32 {
    run.decisions()[0].choice.unwrap().demo
}

#[test]
fn after_a_missed_grasp_the_arm_returns_home_and_follows_another_demonstration() {
    let config = SpatialPolicyConfig::re4();
    let knowledge = knowledge(demonstrations(8, 0.6, 3), &config, Symmetry::None);
    let placed = block(-0.05, -0.1, 0.1);
    // The block slips out when the fingers close for the first time.
    let mut misses = 0;
    let run = episode(&config, &knowledge, placed, None, |_, world| {
        world.slippery = misses == 0;
        if world.separation < 0.011 {
            misses = 1;
        }
    });
    assert!(run.success, "{:?}", kinds(&run));
    let decisions = run.decisions();
    let lost = decisions
        .iter()
        .position(|d| d.kind == SpatialDecisionKind::GraspLost)
        .unwrap();
    assert!(run.steps(Phase::Home) > 3);
    assert_eq!(decisions[lost].newly_banned, [first_demo(&run)]);
    assert_eq!(run.banned, [first_demo(&run)]);
    let names = DemoNames::new((0..8).map(|number| format!("demo_{}", 3 * number + 1)).collect());
    let name_of = |demo: u32| format!("demo_{}", 3 * demo + 1);
    let reason = decisions[lost].reason(&names);
    assert!(reason.starts_with("the grasp is lost"), "{reason}");
    let end = format!("; banned: {}", name_of(first_demo(&run)));
    assert!(reason.ends_with(&end), "{reason}");
    let reason = decisions[0].reason(&names);
    let start = format!("{} from frame ", name_of(first_demo(&run)));
    assert!(reason.starts_with(&start), "{reason}");
    let next = decisions[lost + 1];
    assert_eq!(next.kind, SpatialDecisionKind::Retrieve);
    assert_ne!(next.choice.unwrap().demo, first_demo(&run));
    // Home is the initial pose of the episode, with the gripper open.
    let home: Vec<_> = run.acts.iter().filter(|a| a.phase == Phase::Home).collect();
    assert!(home.iter().all(|a| a.action.gripper < 0.0));
    assert!((next.eef.translation.vector - toy::home().translation.vector).norm() < 0.011);
}

#[test]
fn without_bans_the_same_demonstration_is_retrieved_again() {
    let mut config = SpatialPolicyConfig::re4();
    config.recovery.ban = None;
    let knowledge = knowledge(demonstrations(8, 0.6, 3), &config, Symmetry::None);
    let run = episode(&config, &knowledge, block(-0.05, -0.1, 0.1), None, |_, world| {
        world.slippery = true;
    });
    let retrieved: Vec<u32> = run
        .decisions()
        .iter()
        .filter(|d| d.kind == SpatialDecisionKind::Retrieve)
        .filter_map(|d| d.choice.map(|c| c.demo))
        .collect();
    assert!(
        retrieved.len() > 3 && retrieved.iter().all(|d| *d == retrieved[0]),
        "{retrieved:?}"
    );
    assert!(run.banned.is_empty());
}

#[test]
fn with_bans_every_demonstration_is_followed() {
    let config = SpatialPolicyConfig::re4();
    let knowledge = knowledge(demonstrations(3, 0.6, 3), &config, Symmetry::None);
    let run = episode(&config, &knowledge, block(-0.05, -0.1, 0.1), None, |_, world| {
        world.slippery = true;
    });
    let mut retrieved: Vec<u32> = run
        .decisions()
        .iter()
        .filter_map(|d| d.choice.map(|c| c.demo))
        .collect();
    retrieved.dedup();
    assert!(retrieved.len() > 3, "{retrieved:?}");
    assert!(retrieved.windows(2).all(|w| w[0] != w[1]));
    // Every demonstration is followed once before any is followed again.
    let mut first: Vec<u32> = retrieved[..3].to_vec();
    first.sort_unstable();
    assert_eq!(first, [0, 1, 2]);
}

#[test]
fn an_object_that_is_removed_from_the_gripper_is_detected_as_lost() {
    for config in [SpatialPolicyConfig::re4(), SpatialPolicyConfig::paper()] {
        let knowledge = knowledge(demonstrations(8, 0.6, 3), &config, Symmetry::None);
        let mut removed_at = None;
        let run = episode(&config, &knowledge, block(-0.05, -0.1, 0.1), None, |step, world| {
            if removed_at.is_none() && world.held.is_some() && world.object.translation.z > 0.1 {
                world.held = None;
                world.object = block(0.0, -0.05, 0.3);
                removed_at = Some(step);
            }
        });
        assert!(run.success, "{:?}", kinds(&run));
        let decisions = run.decisions();
        let lost = decisions
            .iter()
            .find(|d| d.kind == SpatialDecisionKind::GraspLost)
            .unwrap();
        assert!(lost.step as usize > removed_at.unwrap() && (lost.step as usize) < removed_at.unwrap() + 60);
    }
}

#[test]
fn the_policy_recovers_when_a_demonstration_ends_without_success() {
    // The block is moved back the first time that it is placed, so the demonstration ends without success.
    let config = SpatialPolicyConfig::re4();
    let knowledge = knowledge(demonstrations(8, 0.6, 3), &config, Symmetry::None);
    let mut moved_back = false;
    let run = episode(&config, &knowledge, block(-0.05, -0.1, 0.1), None, |_, world| {
        if !moved_back
            && world.lifted
            && world.held.is_some()
            && world.object.translation.z < 0.05
            && world.object.translation.x > 0.2
        {
            world.held = None;
            world.lifted = false;
            world.object = block(-0.1, -0.1, 0.0);
            world.separation = 0.02;
            moved_back = true;
        }
        // Keep the fingers apart so that the grasp does not count as lost.
        if moved_back && !world.lifted && world.held.is_none() && world.separation < 0.02 {
            world.separation = 0.02;
        }
    });
    assert!(moved_back && run.success, "{:?}", kinds(&run));
    let ended = run
        .decisions()
        .iter()
        .position(|d| d.kind == SpatialDecisionKind::DemoEnded);
    assert!(ended.is_some(), "{:?}", kinds(&run));
    assert_eq!(config.recovery.end_of_demo, EndOfDemo::GoHome);
    assert!(run.decisions()[ended.unwrap()].newly_banned.len() == 1);
}

#[test]
fn with_a_commit_margin_one_demonstration_is_followed_to_its_end() {
    let config = SpatialPolicyConfig::re4();
    let knowledge = knowledge(demonstrations(20, 0.6, 5), &config, Symmetry::None);
    let run = episode(&config, &knowledge, block(-0.02, -0.12, 0.3), None, |_, _| {});
    assert!(run.success);
    let choices: Vec<_> = run.decisions().iter().filter_map(|d| d.choice).collect();
    assert!(choices.iter().all(|c| c.demo == choices[0].demo));
    // Chunks are extended while the fingers move, and the policy never goes back to an earlier frame.
    assert!(
        choices.windows(2).all(|w| w[1].demo_frame > w[0].demo_end),
        "{choices:?}"
    );
    assert_eq!(kinds(&run)[1..], vec![SpatialDecisionKind::Continue; choices.len() - 1]);
    // The chunk with the release continues to the end of the demonstration.
    let frames = knowledge.demos().demo(choices[0].demo).unwrap();
    assert_eq!(choices.last().unwrap().demo_end as usize, frames.len() - 1);
}

#[test]
fn a_cube_is_grasped_in_any_equivalent_rotation() {
    // All demonstrations have yaws near 0, and the block is rotated by about 90 degrees. With the symmetry, this is an equivalent
    // pose.
    let config = SpatialPolicyConfig::re4();
    let cube = Symmetry::Fold {
        axis: [0.0, 0.0, 1.0],
        n: 4,
    };
    let placed = block(-0.05, -0.1, 1.7);
    let [plain, symmetric] = [Symmetry::None, cube].map(|symmetry| {
        let knowledge = knowledge(demonstrations(10, 0.3, 3), &config, symmetry);
        let run = episode(&config, &knowledge, placed, None, |_, _| {});
        assert!(run.success, "{symmetry:?}");
        let choice = run.decisions()[0].choice.unwrap();
        (choice.symmetry_rotation, choice.delta.rotation.angle(), choice.d_o)
    });
    assert_eq!(plain.0, 0.0);
    assert!(plain.1 > 1.3);
    assert!((symmetric.0 + std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    assert!(symmetric.1 < 0.5 && symmetric.2 < plain.2);
}

#[test]
fn the_same_episode_gives_the_same_actions() {
    let config = SpatialPolicyConfig::re4();
    let knowledge = knowledge(demonstrations(10, 0.6, 3), &config, Symmetry::None);
    let run = || {
        let noise = PoseNoise::new(7, 0.005, 0.08);
        episode(&config, &knowledge, block(-0.05, -0.1, 0.1), Some(noise), |_, _| {}).acts
    };
    assert_eq!(run(), run());
}

#[test]
fn repeated_retrievals_near_the_same_frame_lead_to_a_ban() {
    // The world does not move, so one demonstration is retrieved again and again until it is banned.
    let mut config = SpatialPolicyConfig::re4();
    config.retrieve.commit_margin = None;
    config.replan.enabled = false;
    let demos = SpatialDemoSet::new([0, 1].map(|n| (n, demonstrate(block(0.01 * f64::from(n), -0.1, 0.0), 0))));
    let knowledge = knowledge(demos, &config, Symmetry::None);
    let still = toy::home();
    let run = episode(&config, &knowledge, block(0.001, -0.1, 0.0), None, |_, world| {
        world.eef = still;
        world.separation = 0.08;
    });
    let demos: Vec<u32> = run
        .decisions()
        .iter()
        .filter_map(|d| d.choice.map(|c| c.demo))
        .collect();
    assert_eq!(demos[..4], [0, 0, 0, 1], "{demos:?}");
    assert_eq!(run.decisions()[3].newly_banned, [0]);
}

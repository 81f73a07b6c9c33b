//! What a policy believes about its own pusher, against the simulator.

mod common;

use common::Random;
use re4_geometry::{Point2, Pose2};
use re4_policy::{PusherModel, PusherState};
use re4_sim::{PushT, ResetOrder, Scene, Simulator as _};

#[test]
fn a_pusher_clear_of_the_block_moves_as_the_model_says() {
    let mut random = Random::new(1);
    let model = PusherModel::default();
    let mut simulator = PushT::new().unwrap();
    for _ in 0..50 {
        let scene = Scene {
            agent: random.point(20.0, 160.0),
            block: Pose2::new(400.0, 380.0, 0.0),
        };
        let mut now = simulator.reset(&scene, ResetOrder::Legacy).unwrap();
        let mut believed = PusherState {
            position: now.agent,
            velocity: now.agent_velocity,
        };
        for _ in 0..30 {
            let target = random.point(20.0, 160.0);
            believed = model.predict(believed, target);
            now = simulator.step(&target).unwrap().observation;
            assert!((believed.position - now.agent).norm() < 1e-6, "{believed:?}, {now:?}");
            assert!(
                (believed.velocity - now.agent_velocity).norm() < 1e-5,
                "{believed:?}, {now:?}"
            );
        }
    }
}

#[test]
fn the_simulated_pusher_arrives_in_the_steps_it_was_given() {
    let mut random = Random::new(2);
    let model = PusherModel::default();
    let mut simulator = PushT::new().unwrap();
    for steps in 2..9 {
        let scene = Scene {
            agent: random.point(60.0, 160.0),
            block: Pose2::new(400.0, 380.0, 0.0),
        };
        let mut now = simulator.reset(&scene, ResetOrder::Legacy).unwrap();
        let (goal, velocity) = (random.point(60.0, 160.0), Point2::new(random.range(-50.0, 50.0), 30.0));
        for left in (1..=steps).rev() {
            let here = PusherState {
                position: now.agent,
                velocity: now.agent_velocity,
            };
            now = simulator
                .step(&model.first_target(here, goal, velocity, left))
                .unwrap()
                .observation;
        }
        assert!((now.agent - goal).norm() < 1e-6, "{steps} steps: {now:?}");
        assert!((now.agent_velocity - velocity).norm() < 1e-4, "{steps} steps: {now:?}");
    }
}

//! Compares the policy's model of the pusher with the simulator.

mod common;

use common::Random;
use re4_geometry::{Point2, Pose2};
use re4_policy::{PusherModel, PusherState};
use re4_sim::{PushT, ResetOrder, Scene, Simulator as _};

#[test]
fn the_model_predicts_a_pusher_clear_of_the_block() {
    let mut random = Random::new(1);
    let model = PusherModel::default();
    let mut simulator = PushT::new().unwrap();
    for _ in 0..50 {
        let scene = Scene {
            agent: random.point(20.0, 160.0),
            block: Pose2::new(400.0, 380.0, 0.0),
        };
        let mut now = simulator.reset(&scene, ResetOrder::Legacy).unwrap();
        let mut predicted = PusherState {
            position: now.agent,
            velocity: now.agent_velocity,
        };
        for _ in 0..30 {
            let target = random.point(20.0, 160.0);
            predicted = model.predict(predicted, target);
            now = simulator.step(&target).unwrap().observation;
            assert!((predicted.position - now.agent).norm() < 1e-6, "{predicted:?}, {now:?}");
            assert!(
                (predicted.velocity - now.agent_velocity).norm() < 1e-5,
                "{predicted:?}, {now:?}"
            );
        }
    }
}

#[test]
fn the_simulated_pusher_arrives_in_the_given_steps() {
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

//! Push-T with other goals and with displaced blocks, against an oracle that samples points.

use re4_geometry::{Point2, Pose2};
use re4_sim::{
    AGENT_RADIUS, Canvas, GOAL, PushT, ResetOrder, Scene, SeedScheme, Simulator as _, WALL_FACES, random_goal,
    scene_from_seed,
};

/// Whether a point is on a T at this pose: in its bar or in its stem.
fn on_tee(pose: Pose2, point: Point2) -> bool {
    let p = pose.inverse_transform_point(point);
    let bar = p.x.abs() <= 60.0 && (0.0..=30.0).contains(&p.y);
    let stem = p.x.abs() <= 15.0 && (30.0..=120.0).contains(&p.y);
    bar || stem
}

/// Fraction of the goal that the block covers, over a grid of points in the goal's frame, 1 px apart.
fn sampled_coverage(block: Pose2, goal: Pose2) -> f64 {
    let (mut inside, mut covered) = (0_u32, 0_u32);
    for x in -60..60 {
        for y in 0..120 {
            let point = goal.transform_point(Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
            if on_tee(goal, point) {
                inside += 1;
                covered += u32::from(on_tee(block, point));
            }
        }
    }
    assert_eq!(inside, 6300);
    f64::from(covered) / f64::from(inside)
}

#[test]
fn coverage_and_success_are_those_of_the_goal() {
    let mut simulator = PushT::new().unwrap();
    let mut covering = 0;
    for seed in 0..300 {
        let goal = random_goal(seed, GOAL);
        // Near the goal, so that most blocks cover a part of it.
        let [dx, dy, turn] = [37, 61, 29].map(|factor| f64::from(seed * factor % 101) / 50.5 - 1.0);
        let size = f64::from(seed % 10) / 10.0;
        let block = Pose2::new(
            goal.x + 30.0 * size * dx,
            goal.y + 30.0 * size * dy,
            goal.theta + size * turn,
        );
        simulator.set_goal(goal);
        let agent = Point2::new(
            if goal.x < 256.0 { 480.0 } else { 30.0 },
            if goal.y < 256.0 { 480.0 } else { 30.0 },
        );
        simulator
            .reset(&Scene { agent, block }, ResetOrder::PoseIsPose)
            .unwrap();
        let outcome = simulator.outcome();
        let expected = sampled_coverage(outcome.observation.block, goal);
        assert!(
            (outcome.coverage - expected).abs() < 0.01,
            "seed {seed}: {} {expected}",
            outcome.coverage
        );
        assert_eq!(outcome.success, outcome.coverage > 0.95);
        let iou = expected / (2.0 - expected);
        assert!((outcome.iou - iou).abs() < 0.02);
        covering += u32::from(outcome.success);
        assert_eq!(simulator.goal(), goal);
    }
    assert!(covering > 20, "{covering}");
}

#[test]
fn an_image_shows_the_goal_where_it_is_and_the_scene_as_a_moved_camera_sees_it() {
    let green = [144, 238, 144];
    let at = |canvas: &Canvas, p: Point2| {
        let pixel = 3 * (p.y.round() as usize * Canvas::SIDE + p.x.round() as usize);
        <[u8; 3]>::try_from(&canvas.bytes()[pixel..pixel + 3]).unwrap()
    };
    let middle = |pose: Pose2| pose.transform_point(Point2::new(0.0, 20.0));
    let (goal, block) = (Pose2::new(150.0, 340.0, 2.0), Pose2::new(300.0, 150.0, 0.3));
    let mut simulator = PushT::new().unwrap();
    simulator.set_goal(goal);
    let agent = Point2::new(440.0, 440.0);
    simulator
        .reset(&Scene { agent, block }, ResetOrder::PoseIsPose)
        .unwrap();
    let canvas = simulator.render();
    assert_eq!(at(&canvas, middle(goal)), green);
    assert_ne!(at(&canvas, middle(GOAL)), green);
    // A canvas takes the goal of the simulator that renders to it.
    let mut reused = Canvas::new();
    simulator.render_into(&mut reused);
    assert_eq!(reused.bytes(), canvas.bytes());
    simulator.set_goal(GOAL);
    simulator.render_into(&mut reused);
    assert_eq!(at(&reused, middle(GOAL)), green);
    let mut seen = Canvas::new();
    seen.render_shapes(&simulator.shapes());
    assert_eq!(seen.bytes(), reused.bytes());
    simulator.set_goal(goal);
    let motion = GOAL.compose(goal.inverse());
    seen.render_shapes(&simulator.shapes().moved(motion));
    assert_eq!(at(&seen, middle(GOAL)), green);
    let moved = motion.compose(block);
    assert_eq!(at(&seen, middle(moved)), at(&canvas, middle(block)));
}

#[test]
fn the_arrival_of_a_scene_is_where_the_reset_places_the_block() {
    let mut simulator = PushT::new().unwrap();
    let mut checked = 0;
    for seed in 0..200 {
        let scene = scene_from_seed(SeedScheme::DiffusionPolicy, seed);
        for order in [ResetOrder::Legacy, ResetOrder::PoseIsPose] {
            let now = simulator.reset(&scene, order).unwrap();
            // A block that touches something is pushed away by the physics step of the reset.
            if simulator.contact_points() > 0 {
                continue;
            }
            let arrival = scene.arrival(order);
            assert!(
                (arrival.translation() - now.block.translation()).norm() < 1e-9,
                "seed {seed}"
            );
            checked += 1;
        }
    }
    assert!(checked > 200, "{checked}");
}

#[test]
fn only_valid_displacements_are_applied() {
    let mut simulator = PushT::new().unwrap();
    let (agent, block) = (Point2::new(120.0, 120.0), Pose2::new(300.0, 300.0, 1.0));
    simulator
        .reset(&Scene { agent, block }, ResetOrder::PoseIsPose)
        .unwrap();
    let mut valid = [0, 0];
    for i in 0..2000 {
        let before = simulator.observation();
        let [x, y, turn] = [131, 197, 83].map(|factor| f64::from(i * factor % 401) / 200.5 - 1.0);
        let motion = Pose2::new(180.0 * x, 180.0 * y, 2.0 * turn);
        let moves_block = i % 2 == 0;
        let applied = if moves_block {
            simulator.displace_block(motion)
        } else {
            simulator.displace_agent(motion.translation())
        };
        let after = simulator.observation();
        if !applied {
            assert_eq!(after, before);
            continue;
        }
        valid[i as usize % 2] += 1;
        // Neither overlaps a wall, nor the other: no point of the agent's rim is on the block, and no corner is in the agent.
        let rim = (0..360).map(|degree| {
            let angle = f64::from(degree).to_radians();
            after.agent + Point2::new(angle.cos(), angle.sin()) * (AGENT_RADIUS - 0.01)
        });
        let [low, high] = WALL_FACES;
        let free = |p: Point2| (low..=high).contains(&p.x) && (low..=high).contains(&p.y);
        for point in rim {
            assert!(!on_tee(after.block, point) && free(point));
        }
        assert!(simulator.block_vertices().iter().flatten().all(|corner| free(*corner)));
        if moves_block {
            assert_eq!(after.agent, before.agent);
            let centre = Point2::new(0.0, 45.0);
            let moved = after.block.transform_point(centre) - before.block.transform_point(centre);
            assert!((moved - motion.translation()).norm() < 1e-9);
        } else {
            assert_eq!(after.block, before.block);
            assert!((after.agent - before.agent - motion.translation()).norm() < 1e-9);
            assert_eq!(after.agent_velocity, Point2::new(0.0, 0.0));
        }
    }
    assert!(valid.iter().all(|&n| n > 100), "{valid:?}");
    // The physics goes on from the new state.
    let here = simulator.observation();
    let step = simulator.step(&here.agent).unwrap();
    assert!((step.observation.block.translation() - here.block.translation()).norm() < 1e-6);
}

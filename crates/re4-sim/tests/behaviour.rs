//! Resets, invalid input, coverage, and side effects of the Chipmunk library.

use std::f64::consts::{PI, TAU};
use std::process::Command;

use proptest::prelude::*;
use re4_geometry::{Point2, Pose2, periodic_distance};
use re4_sim::{
    AGENT_RADIUS, CENTRE_OF_GRAVITY, COORDINATE_LIMIT, GOAL, PushT, ResetOrder, Scene, SeedScheme, SimError, Simulator,
    TEE_AREA, chipmunk_version, coverage, iou, scene_from_seed, tee_rectangles, tee_vertices,
};

fn scene(agent: [f64; 2], block: [f64; 3]) -> Scene {
    Scene {
        agent: agent.into(),
        block: Pose2::new(block[0], block[1], block[2]),
    }
}

#[test]
fn the_legacy_reset_shifts_the_block_as_gym_pusht_does() {
    let mut simulator = PushT::new().unwrap();
    // gym-pusht 0.1.8, `reset(options={"reset_to_state": [...]})`.
    for (block, arrived) in [
        ([250.0, 260.0, 1.0], [287.866_194_32, 280.686_396_24]),
        ([20.0, 30.0, 1.0], [57.866_194_32, 50.686_396_24]),
    ] {
        let observed = simulator
            .reset(&scene([100.0, 120.0], block), ResetOrder::Legacy)
            .unwrap();
        assert!(
            (observed.block.x - arrived[0]).abs() < 1e-8 && (observed.block.y - arrived[1]).abs() < 1e-8,
            "{observed:?}"
        );
        assert_eq!(observed.agent, Point2::new(100.0, 120.0));
    }
}

#[test]
fn reset_orders_follow_their_formulas_and_from_observed_inverts_the_legacy_order() {
    let mut simulator = PushT::new().unwrap();
    let mut far = 0;
    for seed in 0..300 {
        for scheme in [SeedScheme::DiffusionPolicy, SeedScheme::GymPusht] {
            let requested = scene_from_seed(scheme, seed);
            // Far from the agent and the walls, so that the physics step of the reset moves nothing.
            let requested = Scene {
                agent: Point2::new(30.0, 30.0),
                ..requested
            };
            let p = requested.block;
            let (s, c) = p.theta.sin_cos();
            // requested + cog - R(theta) cog, with cog = (0, 45).
            let formula = Pose2::new(p.x + 45.0 * s, p.y + 45.0 - 45.0 * c, p.theta);
            let clear = |pose: Pose2| {
                tee_vertices(pose).iter().flatten().all(|v| {
                    (8.0..503.0).contains(&v.x) && (8.0..503.0).contains(&v.y) && (v - requested.agent).norm() > 140.0
                })
            };
            let arrives = |observed: Pose2, at: Pose2| {
                (observed.translation() - at.translation()).norm() < 1e-9
                    && periodic_distance(observed.theta, at.theta, TAU) < 1e-9
            };
            if clear(formula) {
                far += 1;
                let observed = simulator.reset(&requested, ResetOrder::Legacy).unwrap();
                assert!(arrives(observed.block, formula), "seed {seed}: {observed:?}");
                let again = Scene::from_observed(requested.agent, observed.block);
                assert!((again.block.translation() - p.translation()).norm() < 1e-9);
                let observed_again = simulator.reset(&again, ResetOrder::Legacy).unwrap();
                assert!(arrives(observed_again.block, observed.block));
            }
            if clear(p) {
                let observed = simulator.reset(&requested, ResetOrder::PoseIsPose).unwrap();
                assert!(arrives(observed.block, p), "seed {seed}: {observed:?}");
            }
        }
    }
    assert!(far > 100, "only {far} scenes were clear of everything");
}

#[test]
fn a_block_on_the_goal_is_a_success_and_one_far_away_is_not() {
    let mut simulator = PushT::new().unwrap();
    assert_eq!(simulator.goal(), GOAL);
    let on_goal = Scene {
        agent: Point2::new(50.0, 50.0),
        block: GOAL,
    };
    simulator.reset(&on_goal, ResetOrder::PoseIsPose).unwrap();
    let outcome = simulator.outcome();
    assert!((outcome.coverage - 1.0).abs() < 1e-12 && (outcome.iou - 1.0).abs() < 1e-12);
    assert!(outcome.success && outcome.score == 1.0 && outcome.contacts == 0);

    let corner = Pose2::new(100.0, 400.0, 0.0);
    simulator
        .reset(
            &Scene {
                agent: Point2::new(50.0, 50.0),
                block: corner,
            },
            ResetOrder::PoseIsPose,
        )
        .unwrap();
    let outcome = simulator.step(&Point2::new(60.0, 60.0)).unwrap();
    assert_eq!(
        (outcome.coverage, outcome.iou, outcome.score, outcome.success),
        (0.0, 0.0, 0.0, false)
    );
}

#[test]
fn a_block_off_the_goal_has_zero_coverage() {
    for measure in [coverage, re4_sim::iou] {
        // Compared as bits: an empty sum of floating-point numbers may be -0.
        assert_eq!(measure(Pose2::new(30.0, 30.0, 0.0), GOAL).to_bits(), 0.0_f64.to_bits());
    }
}

#[test]
fn success_is_strict_and_the_score_is_the_scaled_coverage() {
    let mut simulator = PushT::new().unwrap();
    let (mut below, mut above) = (0, 0);
    for i in 0..200 {
        let block = Pose2::new(GOAL.x + 0.02 * f64::from(i), GOAL.y, GOAL.theta);
        simulator
            .reset(
                &Scene {
                    agent: Point2::new(50.0, 50.0),
                    block,
                },
                ResetOrder::PoseIsPose,
            )
            .unwrap();
        let outcome = simulator.outcome();
        assert_eq!(outcome.success, outcome.coverage > 0.95);
        assert_eq!(outcome.score, (outcome.coverage / 0.95).min(1.0));
        if outcome.success { above += 1 } else { below += 1 }
    }
    assert!(below > 10 && above > 10);
}

#[test]
fn invalid_input_is_refused_and_changes_nothing() {
    let mut simulator = PushT::new().unwrap();
    let good = scene_from_seed(SeedScheme::DiffusionPolicy, 3);
    simulator.reset(&good, ResetOrder::Legacy).unwrap();
    let before = simulator.outcome();
    for bad in [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        1e300,
        -1e300,
        f64::MAX,
        COORDINATE_LIMIT * 1.01,
    ] {
        for (i, name) in ["agent_x", "agent_y", "block_x", "block_y", "block_theta"]
            .into_iter()
            .enumerate()
        {
            let mut v = [100.0, 100.0, 200.0, 200.0, 0.5];
            v[i] = bad;
            for order in [ResetOrder::Legacy, ResetOrder::PoseIsPose] {
                let error = simulator
                    .reset(&scene([v[0], v[1]], [v[2], v[3], v[4]]), order)
                    .unwrap_err();
                assert!(
                    matches!(error, SimError::Reset { coordinate, .. } if coordinate == name),
                    "{error}"
                );
            }
        }
        for (action, name) in [(Point2::new(bad, 1.0), "target_x"), (Point2::new(1.0, bad), "target_y")] {
            let error = simulator.step(&action).unwrap_err();
            assert!(
                matches!(error, SimError::Step { coordinate, .. } if coordinate == name),
                "{error}"
            );
            assert!(
                error
                    .to_string()
                    .starts_with(&format!("cannot step Push-T: {name} of the action is"))
            );
        }
    }
    assert_eq!(simulator.outcome(), before);
}

#[test]
fn extreme_but_allowed_scenes_do_not_abort_the_process() {
    let mut simulator = PushT::new().unwrap();
    let l = COORDINATE_LIMIT;
    for values in [
        // The agent on the block's centre of gravity, on a corner, on an edge and on a wall; the block on a corner of the walls.
        [200.0, 245.0, 200.0, 200.0, 0.0],
        [140.0, 200.0, 200.0, 200.0, 0.0],
        [200.0, 200.0, 200.0, 200.0, 0.0],
        [5.0, 5.0, 200.0, 200.0, 0.0],
        [5.0, 5.0, 5.0, 5.0, 0.0],
        [506.0, 506.0, 506.0, 461.0, PI],
        [l, l, l, l, l],
        [-l, l, l, -l, -l],
        [0.0, 0.0, -0.0, f64::MIN_POSITIVE, 5e-324],
    ] {
        for order in [ResetOrder::Legacy, ResetOrder::PoseIsPose] {
            simulator
                .reset(&scene([values[0], values[1]], [values[2], values[3], values[4]]), order)
                .unwrap();
            for target in [[256.0, 256.0], [l, -l], [-l, -l], [256.0, 256.0]] {
                for _ in 0..5 {
                    let step = simulator.step(&Point2::from(target)).unwrap();
                    assert!((0.0..=1.0).contains(&step.coverage) && (0.0..TAU).contains(&step.observation.block.theta));
                }
            }
        }
    }
}

#[test]
fn the_state_before_the_first_reset_equals_that_of_gym_pusht() {
    let mut simulator = PushT::new().unwrap();
    let observed = simulator.observation();
    assert_eq!(
        (observed.agent, observed.block),
        (Point2::new(256.0, 400.0), Pose2::new(256.0, 300.0, 0.0))
    );
    simulator.step(&Point2::new(256.0, 400.0)).unwrap();
    assert!(format!("{simulator:?}").contains("contact_points"));
}

#[test]
fn the_tee_is_two_rectangles_of_the_stated_area() {
    let area: f64 = tee_rectangles().iter().map(|r| re4_geometry::polygon_area(r)).sum();
    assert_eq!(area, TEE_AREA);
    let centre = tee_rectangles()
        .iter()
        .map(|r| r.iter().sum::<Point2>() / 4.0)
        .sum::<Point2>()
        / 2.0;
    assert_eq!(centre, CENTRE_OF_GRAVITY);
    assert_eq!(AGENT_RADIUS, 15.0);
}

#[test]
fn coverage_agrees_with_shapely() {
    let fixture: serde_json::Value = serde_json::from_str(include_str!("data/coverage.json")).unwrap();
    let rows: Vec<[f64; 5]> = serde_json::from_value(fixture["rows"].clone()).unwrap();
    assert_eq!(rows.len(), 205);
    for [x, y, theta, expected_coverage, expected_iou] in rows {
        let pose = Pose2::new(x, y, theta);
        assert!((coverage(pose, GOAL) - expected_coverage).abs() < 1e-12, "{pose:?}");
        assert!((iou(pose, GOAL) - expected_iou).abs() < 1e-12, "{pose:?}");
    }
}

/// Fraction of the goal's points, on a grid in its own frame, that are inside the block.
fn coverage_on_a_grid(block: Pose2, goal: Pose2, cell: f64) -> f64 {
    let inside = |p: Point2| {
        (p.x.abs() <= 60.0 && (0.0..=30.0).contains(&p.y)) || (p.x.abs() <= 15.0 && (30.0..=120.0).contains(&p.y))
    };
    let count = |low: f64, high: f64| ((high - low) / cell).round() as u32;
    let (mut points, mut covered) = (0_u32, 0_u32);
    for i in 0..count(-60.0, 60.0) {
        for j in 0..count(0.0, 120.0) {
            let p = Point2::new(-60.0 + (f64::from(i) + 0.5) * cell, (f64::from(j) + 0.5) * cell);
            if inside(p) {
                points += 1;
                covered += u32::from(inside(block.inverse_transform_point(goal.transform_point(p))));
            }
        }
    }
    f64::from(covered) / f64::from(points)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn coverage_agrees_with_a_grid_of_points(dx in -60.0..60.0f64, dy in -60.0..60.0f64, theta in -4.0..4.0f64) {
        let block = Pose2::new(GOAL.x + dx, GOAL.y + dy, theta);
        let counted = coverage_on_a_grid(block, GOAL, 0.5);
        let exact = coverage(block, GOAL);
        prop_assert!((exact - counted).abs() < 6e-3, "{exact} against {counted}");
        prop_assert!((iou(block, GOAL) - exact / (2.0 - exact)).abs() < 1e-12);
        // Neither depends on the common frame of the two poses, nor on which of them is the goal.
        prop_assert!((coverage(GOAL, block) - exact).abs() < 1e-10);
        let motion = Pose2::new(-31.0, 12.0, 2.2);
        prop_assert!((coverage(motion.compose(block), motion.compose(GOAL)) - exact).abs() < 1e-10);
    }
}

/// Run in a child process by the next test.
#[test]
fn makes_a_simulator() {
    PushT::new().unwrap();
}

#[test]
fn the_library_prints_nothing() {
    assert!(chipmunk_version().starts_with("7."), "{}", chipmunk_version());
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "makes_a_simulator", "--nocapture"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
    assert!(!text.contains("cpSpace") && !text.contains("DNDEBUG"), "{text}");
    assert!(output.stderr.is_empty());
}

#[test]
fn serialised_names_are_those_of_the_programs() {
    let json = |value: &str| value.to_owned();
    assert_eq!(serde_json::to_string(&ResetOrder::Legacy).unwrap(), json("\"legacy\""));
    assert_eq!(
        serde_json::to_string(&ResetOrder::PoseIsPose).unwrap(),
        json("\"pose\"")
    );
    assert_eq!(
        serde_json::to_string(&SeedScheme::DiffusionPolicy).unwrap(),
        json("\"diffusion_policy\"")
    );
    assert_eq!(
        serde_json::to_string(&SeedScheme::GymPusht).unwrap(),
        json("\"gym_pusht\"")
    );
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Overlapping bodies and targets far outside of the window: a failed assertion in the library would abort this test
    /// program. `PROPTEST_CASES` sets the number of episodes.
    #[test]
    fn no_allowed_input_aborts_the_process(
        agent in prop::array::uniform2(-50.0..562.0f64),
        near in prop::array::uniform2(-80.0..80.0f64),
        theta in -20.0..20.0f64,
        overlapping in any::<bool>(),
        targets in prop::collection::vec(prop::array::uniform2(-300.0..812.0f64), 8),
        far in prop::array::uniform2(-COORDINATE_LIMIT..COORDINATE_LIMIT),
    ) {
        let spread = if overlapping { 1.0 } else { 6.0 };
        let block = [agent[0] + spread * near[0], agent[1] + spread * near[1], theta];
        let mut simulator = PushT::new().unwrap();
        simulator.reset(&scene(agent, block), ResetOrder::PoseIsPose).unwrap();
        for target in targets.into_iter().chain([far, agent]) {
            let step = simulator.step(&target.into()).unwrap();
            prop_assert!((0.0..=1.0).contains(&step.coverage) && (0.0..=1.0).contains(&step.iou));
        }
    }
}

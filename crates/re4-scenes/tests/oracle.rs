//! Compares scenes with a direct implementation of the definition: the distance of every grid pose to every frame, and repeated
//! choice of the remaining pose with the largest distance.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may panic")]

use std::f64::consts::TAU;

use proptest::prelude::*;
use re4_fault::Remedy as _;
use re4_geometry::{Pose2, distance_point_to_convex, periodic_distance};
use re4_index::AngleMetric;
use re4_scenes::{ObjectFrame, ScenesConfig, ScenesError, SparseScene, sparse_scenes};
use re4_sim::{AGENT_RADIUS, PushT, ResetOrder, Scene, Simulator as _, WALL_FACES, tee_vertices};

fn frames(poses: &[(f64, f64, f64)]) -> Vec<ObjectFrame> {
    // Demonstrations of three frames each.
    let frame = |(i, &(x, y, theta)): (usize, &(f64, f64, f64))| ObjectFrame {
        episode: i as u32 / 3,
        frame: i as u32 % 3,
        object: Pose2::new(x, y, theta),
    };
    poses.iter().enumerate().map(frame).collect()
}

fn small() -> ScenesConfig {
    ScenesConfig {
        poses: 4,
        pushers: 2,
        grid: 7,
        ..ScenesConfig::sparse_observations()
    }
}

fn scenes(frames: &[ObjectFrame], config: &ScenesConfig) -> Result<Vec<SparseScene>, ScenesError> {
    sparse_scenes(frames, config, &|| true)
}

/// Minimum, maximum, and the unit of the dimension's normalisation.
fn range(values: impl Iterator<Item = f64>) -> (f64, f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    (low, high, if high > low { high - low } else { 1.0 })
}

fn line(low: f64, high: f64, n: u32) -> Vec<f64> {
    let step = (high - low) / f64::from(n - 1);
    (0..n).map(|i| low + step * f64::from(i)).collect()
}

/// Poses in the order of their choice with rho and the nearest frame; fewer than requested if no more keep the separation.
fn oracle(frames: &[ObjectFrame], config: &ScenesConfig) -> Vec<(Pose2, f64, u32, u32)> {
    let (x0, x1, x) = range(frames.iter().map(|f| f.object.x));
    let (y0, y1, y) = range(frames.iter().map(|f| f.object.y));
    let (t0, t1, t) = range(frames.iter().map(|f| f.object.theta.rem_euclid(TAU)));
    let (p, a, n) = (config.padding_position, config.padding_angle, config.grid);
    let angles = if t1 - t0 + 2.0 * a < TAU {
        line(t0 - a, t1 + a, n)
    } else {
        let step = TAU / f64::from(n);
        (0..n).map(|i| t0 - a + step * f64::from(i)).collect()
    };
    let mut poses = Vec::new();
    for gx in line(x0 - p, x1 + p, n) {
        for gy in line(y0 - p, y1 + p, n) {
            for gt in &angles {
                let pose = Pose2::new(gx, gy, gt.rem_euclid(TAU));
                let [low, high] = WALL_FACES;
                let corners = tee_vertices(pose);
                let reaches = corners
                    .iter()
                    .flatten()
                    .any(|c| c.x < low || c.y < low || c.x > high || c.y > high);
                if config.inside_walls && reaches {
                    continue;
                }
                let mut nearest = (f64::INFINITY, 0, 0);
                for f in frames {
                    let rotation = match config.angle {
                        AngleMetric::Periodic => periodic_distance(pose.theta, f.object.theta, TAU),
                        AngleMetric::Raw => (pose.theta - f.object.theta.rem_euclid(TAU)).abs(),
                    };
                    let square = |d: f64| d * d;
                    let rho =
                        (square((gx - f.object.x) / x) + square((gy - f.object.y) / y) + square(rotation / t)).sqrt();
                    if rho < nearest.0 {
                        nearest = (rho, f.episode, f.frame);
                    }
                }
                poses.push((pose, nearest.0, nearest.1, nearest.2));
            }
        }
    }
    let mut chosen: Vec<(Pose2, f64, u32, u32)> = Vec::new();
    while chosen.len() < config.poses as usize && !poses.is_empty() {
        // Rounding must not decide between equal distances: the first grid point is taken.
        let best = poses.iter().map(|p| p.1).fold(0.0, f64::max);
        let at = poses.iter().position(|p| p.1 >= best - 1e-9).unwrap();
        let taken = poses.remove(at);
        poses.retain(|(pose, ..)| {
            let rotation = periodic_distance(pose.theta, taken.0.theta, TAU) / t;
            let distance = ((pose.x - taken.0.x) / x)
                .hypot((pose.y - taken.0.y) / y)
                .hypot(rotation);
            distance >= config.separation
        });
        chosen.push(taken);
    }
    chosen
}

fn poses() -> impl Strategy<Value = Vec<(f64, f64, f64)>> {
    // Fewer than four could be symmetric, with ties all over the grid.
    prop::collection::vec((120.0..400.0f64, 120.0..400.0f64, -7.0..7.0f64), 4..25)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn chosen_poses_equal_those_of_the_oracle(
        poses in poses(), inside_walls: bool, raw: bool, separation in 0.05..0.6f64,
        padding in 0.0..60.0f64, padding_angle in 0.0..1.0f64,
    ) {
        let angle = if raw { AngleMetric::Raw } else { AngleMetric::Periodic };
        let config = ScenesConfig {
            inside_walls, angle, separation, padding_position: padding, padding_angle, ..small()
        };
        let frames = frames(&poses);
        let expected = oracle(&frames, &config);
        match scenes(&frames, &config) {
            Ok(scenes) => {
                prop_assert_eq!(scenes.len(), 8);
                let found: Vec<&SparseScene> = scenes.iter().step_by(2).collect();
                // Rounding may break a tie differently and change all later choices: then only the distances are comparable.
                for (scene, (pose, rho, demo, frame)) in found.into_iter().zip(&expected) {
                    prop_assert!((scene.rho - rho).abs() < 1e-9, "{scene:?} {rho}");
                    let same = (scene.block.translation() - pose.translation()).norm() < 1e-9
                        && periodic_distance(scene.block.theta, pose.theta, TAU) < 1e-9;
                    if !same {
                        break;
                    }
                    prop_assert_eq!((scene.nearest_demo, scene.nearest_frame), (*demo, *frame));
                }
            }
            Err(ScenesError::TooFewPoses { found, .. }) => prop_assert_eq!(found as usize, expected.len()),
            Err(other) => prop_assert!(false, "{other}"),
        }
    }

    #[test]
    fn scenes_satisfy_their_constraints(poses in poses(), seed: u32, clearance in 0.0..30.0f64) {
        let config = ScenesConfig { seed, clearance, ..small() };
        let Ok(scenes) = scenes(&frames(&poses), &config) else { return Ok(()) };
        for pair in scenes.chunks(2).collect::<Vec<_>>().windows(2) {
            prop_assert!(pair[0][0].rho >= pair[1][0].rho, "poses must be in descending order of rho");
        }
        let mut simulator = PushT::new().unwrap();
        for scene in &scenes {
            let [low, high] = WALL_FACES;
            for corner in tee_vertices(scene.block).iter().flatten() {
                prop_assert!(corner.iter().all(|v| (low..=high).contains(v)));
            }
            prop_assert!(scene.agent.iter().all(|v| (low + AGENT_RADIUS..=high - AGENT_RADIUS).contains(v)));
            for part in tee_vertices(scene.block) {
                prop_assert!(distance_point_to_convex(scene.agent, &part) >= AGENT_RADIUS + clearance);
            }
            // A reset keeps the scene unchanged: the physics step pushes no body out of another.
            let requested = Scene { agent: scene.agent, block: scene.block };
            let observed = simulator.reset(&requested, ResetOrder::PoseIsPose).unwrap();
            prop_assert!((observed.agent - scene.agent).norm() < 1e-9);
            prop_assert!((observed.block.translation() - scene.block.translation()).norm() < 1e-6, "{observed:?} {scene:?}");
            prop_assert!(periodic_distance(observed.block.theta, scene.block.theta, TAU) < 1e-6);
        }
    }

    #[test]
    fn more_pushers_or_another_seed_change_nothing_else(poses in poses(), seed: u32) {
        let frames = frames(&poses);
        let with = |pushers, seed| scenes(&frames, &ScenesConfig { pushers, seed, ..small() });
        let (Ok(two), Ok(three), Ok(other)) = (with(2, seed), with(3, seed), with(2, seed ^ 1)) else { return Ok(()) };
        let kept: Vec<_> = three.into_iter().filter(|s| s.pusher < 2).collect();
        prop_assert_eq!(&two, &kept);
        for (one, other) in two.iter().zip(&other) {
            prop_assert_eq!(one.block, other.block);
            prop_assert!(one.agent != other.agent);
        }
    }
}

#[test]
fn ties_are_taken_in_grid_order() {
    // One frame in the centre of the cube that its padding spans: all eight corners are equally far.
    let frames = frames(&[(256.0, 256.0, 1.0)]);
    let config = ScenesConfig {
        poses: 8,
        grid: 2,
        separation: 0.0,
        ..small()
    };
    let chosen: Vec<Pose2> = scenes(&frames, &config)
        .unwrap()
        .iter()
        .step_by(2)
        .map(|s| s.block)
        .collect();
    let expected: Vec<Pose2> = (0..8)
        .map(|i| {
            let side =
                |bit: u32, middle: f64, padding: f64| middle + padding * if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            Pose2::new(side(2, 256.0, 20.0), side(1, 256.0, 20.0), side(0, 1.0, 0.15))
        })
        .collect();
    assert_eq!(chosen, expected);
}

#[test]
fn angles_across_the_seam_are_near() {
    // Angles 0.1 and 2π - 0.1 are near each other for the separation, even if the distance to the demonstrations is raw.
    let frames = frames(&[(200.0, 200.0, 0.1), (300.0, 300.0, TAU - 0.1), (250.0, 250.0, 3.0)]);
    for angle in [AngleMetric::Periodic, AngleMetric::Raw] {
        let config = ScenesConfig {
            poses: 10,
            pushers: 1,
            grid: 20,
            separation: 0.3,
            angle,
            ..ScenesConfig::sparse_observations()
        };
        let chosen = scenes(&frames, &config).unwrap();
        let unit = TAU - 0.2;
        for (i, a) in chosen.iter().enumerate() {
            assert!((0.0..TAU).contains(&a.block.theta));
            for b in &chosen[..i] {
                let rotation = periodic_distance(a.block.theta, b.block.theta, TAU) / unit;
                let translation = (a.block.translation() - b.block.translation()).norm() / 100.0;
                assert!(translation.hypot(rotation) >= 0.3 - 1e-12, "{a:?} {b:?}");
            }
        }
    }
}

#[test]
fn impossible_requests_are_reported() {
    let some = frames(&[(200.0, 200.0, 0.1), (300.0, 300.0, 2.0)]);
    let message = |frames: &[ObjectFrame], config: ScenesConfig| scenes(frames, &config).unwrap_err().sentence();
    assert_eq!(
        message(
            &some,
            ScenesConfig {
                separation: 5.0,
                ..small()
            }
        ),
        "cannot choose scenes: only 1 of the 4 requested poses keep a separation of 5, out of 343 on the grid; lower scenes.separation or scenes.poses"
    );
    assert!(
        message(
            &some,
            ScenesConfig {
                clearance: 600.0,
                ..small()
            }
        )
        .contains("leaves no free position for the pusher")
    );
    assert!(message(&[], small()).contains("there are no frames"));
    let broken = frames(&[(200.0, 200.0, 0.1), (f64::NAN, 300.0, 2.0)]);
    assert!(message(&broken, small()).contains("episode 0, frame 1"));
    assert_eq!(sparse_scenes(&some, &small(), &|| false), Err(ScenesError::Interrupted));
}

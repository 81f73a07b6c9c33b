//! Tests both planners on random scenes with a distance to the block that is computed independently.

mod common;

use common::{OUTLINE, Random, distance_to_tee};
use rand_pcg::Pcg64;
use re4_geometry::{Point2, Pose2};
use re4_policy::{Obstacle, Plan, PlanKind, Planner, PolicyConfig, ReplanConfig, Workspace, plan};

const SAMPLE: f64 = 0.25;

fn config(planner: Planner, keepout: f64) -> ReplanConfig {
    ReplanConfig {
        planner,
        keepout,
        iterations: 3000,
        ..PolicyConfig::paper().replan
    }
}

fn planned(planner: Planner, keepout: f64, seed: u64, block: Pose2, start: Point2, goal: Point2) -> Plan {
    plan(
        &config(planner, keepout),
        Workspace::default(),
        block,
        start,
        goal,
        &mut Pcg64::new(u128::from(seed), 1),
    )
}

/// Returns the minimum distance to the block over points along a polyline that are at most `SAMPLE` pixels apart.
fn clearance(block: Pose2, path: &[Point2]) -> f64 {
    path.windows(2)
        .flat_map(|pair| {
            let (from, along) = (pair[0], pair[1] - pair[0]);
            let parts = (along.norm() / SAMPLE).ceil().max(1.0) as usize;
            (0..=parts).map(move |i| from + along * (i as f64 / parts as f64))
        })
        .map(|p| distance_to_tee(block, p))
        .fold(f64::INFINITY, f64::min)
}

/// Samples a scene whose ends are at least `keepout` from the block and well inside the window.
fn scene(random: &mut Random, keepout: f64) -> (Pose2, Point2, Point2) {
    let block = random.block();
    let mut free = || loop {
        let p = random.point(10.0, 502.0);
        if distance_to_tee(block, p) >= keepout + 1e-6 {
            return p;
        }
    };
    let (start, goal) = (free(), free());
    (block, start, goal)
}

#[test]
fn the_distance_to_the_obstacle_is_that_to_the_block() {
    let mut random = Random::new(1);
    let mut inside = 0;
    for _ in 0..5000 {
        let block = random.block();
        let p = block.translation() + random.point(-150.0, 150.0);
        let independent = distance_to_tee(block, p);
        let distance = Obstacle::at(block).distance(p);
        assert!(
            (distance - independent).abs() < 1e-9,
            "{block:?}, {p:?}: {distance}, {independent}"
        );
        inside += u32::from(distance == 0.0);
    }
    assert!(inside > 100, "{inside}");
}

#[test]
fn paths_keep_the_distance_and_connect_the_given_ends() {
    let mut random = Random::new(2);
    for planner in [Planner::Rrt, Planner::Visibility] {
        let mut kinds = [0, 0, 0];
        for seed in 0..400 {
            let keepout = random.range(14.0, 22.0);
            let (block, start, goal) = scene(&mut random, keepout);
            let found = planned(planner, keepout, seed, block, start, goal);
            assert_eq!((found.path.first(), found.path.last()), (Some(&start), Some(&goal)));
            let case = format!("{planner:?}, keep-out {keepout}, {block:?}, {start:?} to {goal:?}: {found:?}");
            let kept = clearance(block, &found.path);
            match found.kind {
                PlanKind::Direct | PlanKind::Planned => assert!(kept >= keepout - 1e-6, "{kept}: {case}"),
                PlanKind::Failed => assert_eq!(found.path, [start, goal], "{case}"),
                PlanKind::Off => panic!("{case}"),
            }
            match found.kind {
                PlanKind::Direct => kinds[0] += 1,
                PlanKind::Planned => kinds[1] += 1,
                _ => kinds[2] += 1,
            }
        }
        // A free end can be enclosed between the block and a wall, but this is rare.
        assert!(
            kinds[0] > 100 && kinds[1] > 50 && kinds[2] < 20,
            "{planner:?}: {kinds:?}"
        );
    }
}

#[test]
fn paths_from_and_to_contact_do_not_go_deeper_into_the_keepout() {
    let mut random = Random::new(3);
    let keepout = 18.0;
    for planner in [Planner::Rrt, Planner::Visibility] {
        let mut reached = 0;
        for seed in 0..300 {
            let (block, far, _) = scene(&mut random, keepout);
            // The pusher's radius is 15, so its centre is about 15 px from the block in contact.
            let near = loop {
                let p = block.translation() + random.point(-140.0, 140.0);
                let inside = (10.0..502.0).contains(&p.x) && (10.0..502.0).contains(&p.y);
                if inside && (14.0..keepout).contains(&distance_to_tee(block, p)) {
                    break p;
                }
            };
            for (start, goal) in [(near, far), (far, near)] {
                let found = planned(planner, keepout, seed, block, start, goal);
                assert_eq!((found.path.first(), found.path.last()), (Some(&start), Some(&goal)));
                if found.kind != PlanKind::Failed {
                    reached += 1;
                    // The visibility planner leaves contact in a straight move, along which the clearance may decrease by half a
                    // pixel.
                    let allowed =
                        distance_to_tee(block, near) - if planner == Planner::Rrt { 1e-6 } else { 0.5 + 1e-6 };
                    let kept = clearance(block, &found.path);
                    assert!(kept >= allowed, "{kept} < {allowed}: {planner:?}, {block:?}, {found:?}");
                }
            }
        }
        assert!(reached > 560, "{planner:?}: {reached} of 600");
    }
}

#[test]
fn the_visibility_path_is_not_longer_than_the_rrt_path() {
    let mut random = Random::new(4);
    let keepout = 18.0;
    let (mut compared, mut around_block) = (0, 0);
    for seed in 0..600 {
        let (block, start, goal) = scene(&mut random, keepout);
        let tree = planned(Planner::Rrt, keepout, seed, block, start, goal);
        let graph = planned(Planner::Visibility, keepout, seed, block, start, goal);
        if tree.kind == PlanKind::Failed {
            continue;
        }
        let case = format!("{block:?}, {start:?} to {goal:?}: {tree:?}, {graph:?}");
        assert_ne!(graph.kind, PlanKind::Failed, "{case}");
        assert!(
            graph.length() <= 1.01 * tree.length(),
            "{} > {}: {case}",
            graph.length(),
            tree.length()
        );
        assert!(graph.length() >= (goal - start).norm() - 1e-9, "{case}");
        compared += 1;
        around_block += u32::from(tree.kind == PlanKind::Planned);
    }
    assert!(compared > 550 && around_block > 100, "{compared}, {around_block}");
}

/// Returns the length of the shortest path around the block with a relative error of about 0.001. The shortest path consists of
/// straight segments and arcs of radius `keepout` around the corners, which are approximated by many points.
fn shortest(block: Pose2, keepout: f64, start: Point2, goal: Point2) -> f64 {
    const POINTS: usize = 40;
    let obstacle = Obstacle::at(block);
    let radius = keepout / (std::f64::consts::PI / POINTS as f64).cos() + 1e-6;
    let mut nodes = vec![start, goal];
    for corner in OUTLINE {
        let corner = block.transform_point(Point2::new(corner[0], corner[1]));
        nodes.extend((0..POINTS).map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / POINTS as f64;
            corner + Point2::new(angle.cos(), angle.sin()) * radius
        }));
    }
    let inside = |p: &Point2| (0.0..=512.0).contains(&p.x) && (0.0..=512.0).contains(&p.y);
    nodes.retain(|p| inside(p) && obstacle.distance(*p) >= keepout);
    let mut lengths = vec![f64::INFINITY; nodes.len()];
    lengths[0] = 0.0;
    let mut open: Vec<usize> = (0..nodes.len()).collect();
    while let Some(place) = (0..open.len()).min_by(|&a, &b| lengths[open[a]].total_cmp(&lengths[open[b]])) {
        let here = open.swap_remove(place);
        if here == 1 {
            break;
        }
        for &to in &open {
            let through = lengths[here] + (nodes[to] - nodes[here]).norm();
            if through < lengths[to] && obstacle.segment_distance(nodes[here], nodes[to]) >= keepout {
                lengths[to] = through;
            }
        }
    }
    lengths[1]
}

#[test]
fn the_visibility_path_is_nearly_the_shortest() {
    let mut random = Random::new(7);
    let keepout = 18.0;
    let mut ratios: Vec<f64> = Vec::new();
    for seed in 0..400 {
        let (block, start, goal) = scene(&mut random, keepout);
        let graph = planned(Planner::Visibility, keepout, seed, block, start, goal);
        if graph.kind == PlanKind::Planned {
            let ratio = graph.length() / shortest(block, keepout, start, goal);
            assert!(ratio < 1.04, "{ratio}: {block:?}, {start:?} to {goal:?}: {graph:?}");
            assert!(ratio > 0.998, "{ratio}: {block:?}, {start:?} to {goal:?}: {graph:?}");
            ratios.push(ratio);
        }
    }
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    println!(
        "{} paths, {mean} times as long as the shortest on average",
        ratios.len()
    );
    assert!(ratios.len() > 60 && mean < 1.01, "{mean} over {}", ratios.len());
}

#[test]
fn a_free_straight_segment_is_used() {
    let mut random = Random::new(5);
    let keepout = 18.0;
    let (mut free, mut blocked) = (0, 0);
    for seed in 0..500 {
        let (block, start, goal) = scene(&mut random, keepout);
        let straight = clearance(block, &[start, goal]);
        for planner in [Planner::Rrt, Planner::Visibility] {
            let found = planned(planner, keepout, seed, block, start, goal);
            if straight > keepout + 0.1 {
                assert_eq!(found.kind, PlanKind::Direct);
                assert_eq!((found.path.as_slice(), found.nodes), ([start, goal].as_slice(), 0));
                free += 1;
            } else if straight < keepout - 0.1 {
                assert_ne!(found.kind, PlanKind::Direct, "{straight}: {found:?}");
                blocked += 1;
            }
        }
    }
    assert!(free > 200 && blocked > 200, "{free}, {blocked}");
}

#[test]
fn paths_are_deterministic_and_the_rrt_depends_on_the_seed() {
    let mut random = Random::new(6);
    let (mut planned_by_tree, mut different) = (0, 0);
    for seed in 0..200 {
        let (block, start, goal) = scene(&mut random, 18.0);
        for planner in [Planner::Rrt, Planner::Visibility] {
            let one = planned(planner, 18.0, seed, block, start, goal);
            assert_eq!(one, planned(planner, 18.0, seed, block, start, goal));
            let other = planned(planner, 18.0, seed + 1, block, start, goal);
            match planner {
                Planner::Visibility => assert_eq!(one, other, "the visibility planner uses no random numbers"),
                Planner::Rrt if one.kind == PlanKind::Planned => {
                    planned_by_tree += 1;
                    different += u32::from(one != other);
                }
                Planner::Rrt => {}
            }
        }
    }
    assert!(
        planned_by_tree > 30 && different == planned_by_tree,
        "{different} of {planned_by_tree}"
    );
}

#[test]
fn the_disabled_planner_returns_the_start() {
    let off = ReplanConfig {
        enabled: false,
        ..config(Planner::Rrt, 18.0)
    };
    let start = Point2::new(20.0, 30.0);
    let goal = Point2::new(400.0, 400.0);
    let found = plan(
        &off,
        Workspace::default(),
        Pose2::new(250.0, 250.0, 1.0),
        start,
        goal,
        &mut Pcg64::new(1, 1),
    );
    assert_eq!((found.kind, found.path.as_slice()), (PlanKind::Off, [start].as_slice()));
}

//! Shortest paths around the block on its visibility graph.

use re4_geometry::{Point2, Pose2};
use re4_sim::tee_rectangles;

use crate::config::ReplanConfig;
use crate::replan::{Obstacle, Plan, PlanKind};
use crate::workspace::Workspace;

/// Number of waypoints around each corner of the block.
const DIRECTIONS: usize = 8;

/// Additional distance in pixels from the waypoints to the block, so that rounding does not make edges between them collide.
const MARGIN: f64 = 0.5;

/// Returns the shortest polyline from `start` to `goal` that keeps the configured distance from the block.
///
/// An end inside the keep-out is connected to the nearest point outside by one straight move away from the block.
pub(crate) fn shortest(
    config: &ReplanConfig,
    workspace: Workspace,
    obstacle: &Obstacle,
    block: Pose2,
    start: Point2,
    goal: Point2,
) -> Plan {
    let leave = escape(obstacle, start, config.keepout);
    let enter = escape(obstacle, goal, config.keepout);
    // Slightly smaller, so that rounding does not make points at exactly the keep-out distance collide.
    let keepout = config.keepout - 1e-9;
    let free = |a: Point2, b: Point2| obstacle.segment_distance(a, b) >= keepout;
    let assemble = |kind, middle: &[Point2], nodes| {
        let mut path = vec![start];
        for &p in [leave].iter().chain(middle).chain(&[enter, goal]) {
            if path.last().is_none_or(|last| (p - last).norm() > 1e-9) {
                path.push(p);
            }
        }
        Plan { kind, path, nodes }
    };
    // An end in contact is inside the keep-out. The straight segment may then enter the keep-out as deep as the end, by at most 3
    // px.
    let lowered = config
        .keepout
        .min(obstacle.distance(start))
        .min(obstacle.distance(goal))
        - 1e-9;
    if obstacle.segment_distance(start, goal) >= lowered.max(config.keepout - 3.0) {
        return Plan {
            kind: PlanKind::Direct,
            path: vec![start, goal],
            nodes: 0,
        };
    }
    if free(leave, enter) {
        return assemble(PlanKind::Direct, &[], 0);
    }
    // The waypoints of a corner are the vertices of a polygon around the circle of the keep-out, so the edges between
    // neighbouring waypoints stay outside the circle.
    let radius = (config.keepout + MARGIN) / (std::f64::consts::PI / DIRECTIONS as f64).cos();
    let mut nodes = vec![leave, enter];
    for corner in tee_rectangles().iter().flatten() {
        let corner = block.transform_point(*corner);
        for k in 0..DIRECTIONS {
            let angle = std::f64::consts::TAU * (k as f64 + 0.5) / DIRECTIONS as f64 + block.theta;
            let p = corner + Point2::new(angle.cos(), angle.sin()) * radius;
            if workspace.contains(p, 0.0) && obstacle.distance(p) >= keepout {
                nodes.push(p);
            }
        }
    }
    // Dijkstra's algorithm over at most 66 nodes (8 corners with 8 waypoints each, and two ends). An edge is tested for
    // collisions when it is first relaxed, which avoids testing all pairs.
    let n = nodes.len();
    let mut distance = vec![f64::INFINITY; n];
    let mut previous = vec![0; n];
    let mut done = vec![false; n];
    distance[0] = 0.0;
    loop {
        let next = (0..n)
            .filter(|&i| !done[i] && distance[i].is_finite())
            .min_by(|&a, &b| distance[a].total_cmp(&distance[b]));
        let Some(at) = next else {
            return assemble(PlanKind::Failed, &[], n as u32);
        };
        if at == 1 {
            break;
        }
        done[at] = true;
        for to in 0..n {
            let through = distance[at] + (nodes[to] - nodes[at]).norm();
            if !done[to] && through < distance[to] && free(nodes[at], nodes[to]) {
                distance[to] = through;
                previous[to] = at;
            }
        }
    }
    let mut middle = Vec::new();
    let mut at = previous[1];
    while at != 0 {
        middle.push(nodes[at]);
        at = previous[at];
    }
    middle.reverse();
    assemble(PlanKind::Planned, &middle, n as u32)
}

/// Returns the nearest point at the keep-out distance that can be reached from `p` by a straight move away from the block. It
/// samples 32 directions, in steps of 0.5 px up to 60 px. Returns `p` itself if it is outside the keep-out
/// or there is no such point.
fn escape(obstacle: &Obstacle, p: Point2, keepout: f64) -> Point2 {
    let here = obstacle.distance(p);
    if here >= keepout {
        return p;
    }
    let mut best = (f64::INFINITY, p);
    for k in 0..32 {
        let angle = std::f64::consts::TAU * f64::from(k) / 32.0;
        let direction = Point2::new(angle.cos(), angle.sin());
        let mut travel = keepout - here;
        while travel < 60.0 && travel < best.0 {
            let q = p + direction * travel;
            if obstacle.distance(q) >= keepout {
                if obstacle.segment_distance(p, q) >= here - 0.5 {
                    best = (travel, q);
                }
                break;
            }
            travel += 0.5;
        }
    }
    best.1
}

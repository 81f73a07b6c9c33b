//! Replan: a path for the pusher around the block, which is assumed static (paper, section "Replan" and appendix).

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_geometry::{Point2, Pose2, distance_point_to_convex, distance_segment_to_convex};
use re4_sim::tee_rectangles;

use crate::config::{Planner, ReplanConfig};
use crate::workspace::Workspace;

/// How a path was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanKind {
    /// The straight segment is collision-free.
    Direct,
    /// A planner found a path around the block.
    Planned,
    /// No path was found, so the straight segment is used.
    Failed,
    /// Replan is disabled.
    Off,
}

impl PlanKind {
    /// Returns the name of the kind in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            Self::Planned => "planned",
            Self::Failed => "failed",
            Self::Off => "off",
        }
    }
}

/// A path from the pusher to the start of the chunk.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// How the path was found.
    pub kind: PlanKind,
    /// Polyline from the pusher's position to the set-point, both included, in the frame of the observations, in pixels. Only the
    /// pusher's position if Replan is disabled.
    pub path: Vec<Point2>,
    /// Number of nodes of the searched tree or graph.
    pub nodes: u32,
}

impl Plan {
    /// Returns the length of the polyline in pixels.
    pub fn length(&self) -> f64 {
        self.path.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
    }
}

/// The block as an obstacle.
pub struct Obstacle {
    rectangles: [[Point2; 4]; 2],
}

impl Obstacle {
    /// Creates the obstacle for a block at a pose in the world frame.
    pub fn at(block: Pose2) -> Self {
        let mut rectangles = tee_rectangles();
        for corner in rectangles.iter_mut().flatten() {
            *corner = block.transform_point(*corner);
        }
        Self { rectangles }
    }

    /// Returns the distance from a point to the block in pixels; 0 inside the block.
    pub fn distance(&self, p: Point2) -> f64 {
        self.rectangles
            .iter()
            .map(|r| distance_point_to_convex(p, r))
            .fold(f64::INFINITY, f64::min)
    }

    /// Returns the distance from a segment to the block in pixels; 0 if they intersect.
    pub fn segment_distance(&self, a: Point2, b: Point2) -> f64 {
        self.rectangles
            .iter()
            .map(|r| distance_segment_to_convex(a, b, r))
            .fold(f64::INFINITY, f64::min)
    }
}

/// Plans a path from `start` to `goal` with the block fixed at `block`. All in the frame of `workspace`, in pixels. Only the RRT
/// planner uses `random`.
///
/// If an end is inside the keep-out, as for a pusher in contact, the keep-out shrinks to the distance of that end from the block,
/// so that the pusher can leave and make contact.
pub fn plan(
    config: &ReplanConfig,
    workspace: Workspace,
    block: Pose2,
    start: Point2,
    goal: Point2,
    random: &mut Pcg64,
) -> Plan {
    let obstacle = Obstacle::at(block);
    if !config.enabled {
        return Plan {
            kind: PlanKind::Off,
            path: vec![start],
            nodes: 0,
        };
    }
    match config.planner {
        Planner::Rrt => rrt(config, workspace, &obstacle, start, goal, random),
        Planner::Visibility => crate::visibility::shortest(config, workspace, &obstacle, block, start, goal),
    }
}

fn rrt(
    config: &ReplanConfig,
    workspace: Workspace,
    obstacle: &Obstacle,
    start: Point2,
    goal: Point2,
    random: &mut Pcg64,
) -> Plan {
    // Slightly smaller, so that rounding does not make an end at exactly this distance collide.
    let keepout = config
        .keepout
        .min(obstacle.distance(start))
        .min(obstacle.distance(goal))
        - 1e-9;
    let free = |a: Point2, b: Point2| obstacle.segment_distance(a, b) >= keepout;
    if free(start, goal) {
        return Plan {
            kind: PlanKind::Direct,
            path: vec![start, goal],
            nodes: 0,
        };
    }
    // Every node stores its position and the index of its parent.
    let mut nodes: Vec<(Point2, usize)> = vec![(start, 0)];
    for _ in 0..config.iterations {
        let sample = if unit(random) < config.goal_bias {
            goal
        } else {
            workspace.at(unit(random), unit(random))
        };
        let (nearest, from) =
            nodes
                .iter()
                .enumerate()
                .map(|(i, (p, _))| (i, *p))
                .fold((0, start), |best, candidate| {
                    if (candidate.1 - sample).norm_squared() < (best.1 - sample).norm_squared() {
                        candidate
                    } else {
                        best
                    }
                });
        let reach = (sample - from).norm();
        let to = if reach > config.step {
            from + (sample - from) * (config.step / reach)
        } else {
            sample
        };
        if !free(from, to) {
            continue;
        }
        nodes.push((to, nearest));
        if (goal - to).norm() <= config.step && free(to, goal) {
            let mut path = vec![goal];
            let mut at = nodes.len() - 1;
            loop {
                path.push(nodes[at].0);
                if at == 0 {
                    break;
                }
                at = nodes[at].1;
            }
            path.reverse();
            return Plan {
                kind: PlanKind::Planned,
                path,
                nodes: nodes.len() as u32,
            };
        }
    }
    Plan {
        kind: PlanKind::Failed,
        path: vec![start, goal],
        nodes: nodes.len() as u32,
    }
}

/// Samples a uniform number in `[0, 1)` with 53 random bits.
fn unit(random: &mut Pcg64) -> f64 {
    (random.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Returns points along a polyline that are at most `spacing` apart. The first point is excluded and the last one is included.
pub(crate) fn waypoints(path: &[Point2], spacing: f64) -> Vec<Point2> {
    let mut points = Vec::new();
    for pair in path.windows(2) {
        let length = (pair[1] - pair[0]).norm();
        let parts = (length / spacing).ceil().max(1.0);
        if length > 0.0 {
            points.extend((1..=parts as usize).map(|i| pair[0] + (pair[1] - pair[0]) * (i as f64 / parts)));
        }
    }
    points
}

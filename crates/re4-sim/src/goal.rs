//! Goals of Push-T at any pose, sampled by seed.

use std::f64::consts::TAU;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_geometry::Pose2;

use crate::{AGENT_RADIUS, WALL_FACES, coverage, tee_vertices};

/// Minimum distance of a random goal from the walls, in pixels: the agent fits between a block on the goal and every wall.
pub const GOAL_MARGIN: f64 = 2.0 * AGENT_RADIUS;

/// Maximum fraction of a random goal that the block covers at the start of an episode.
pub const START_COVERAGE: f64 = 0.5;

/// Maximum number of goals that are sampled for a seed. The limit is never reached: a block covers half of few goals.
const TRIES: usize = 1000;

/// The random goal of a seed for an episode in which the block starts at `block`.
///
/// The angle is uniform in `[0, 2π)`. The position is uniform over all positions at which the T has at least the distance
/// [`GOAL_MARGIN`] from every wall. A goal of which the block covers more than [`START_COVERAGE`] is sampled again. The random
/// numbers are independent of those that sample the scene of the seed.
pub fn random_goal(seed: u32, block: Pose2) -> Pose2 {
    // The stream number is the ASCII code of "goal".
    let mut random = Pcg64::new(u128::from(seed), 0x676f_616c);
    let mut unit = || (random.next_u64() >> 11) as f64 / 9_007_199_254_740_992.0;
    let mut sample = || {
        let theta = TAU * unit();
        let corners = tee_vertices(Pose2::new(0.0, 0.0, theta));
        let [x, y] = [0, 1].map(|axis| {
            let along = corners.iter().flatten().map(|corner| corner[axis]);
            let (low, high) = along.fold((0.0_f64, 0.0_f64), |(low, high), at| (low.min(at), high.max(at)));
            let (first, last) = (WALL_FACES[0] + GOAL_MARGIN - low, WALL_FACES[1] - GOAL_MARGIN - high);
            first + (last - first) * unit()
        });
        Pose2::new(x, y, theta)
    };
    let mut goal = sample();
    for _ in 1..TRIES {
        if coverage(block, goal) <= START_COVERAGE {
            break;
        }
        goal = sample();
    }
    goal
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth_in_walls;

    #[test]
    fn random_goals_are_inside_the_walls_at_any_angle_and_reach_the_margin() {
        let far = Pose2::new(-1000.0, 0.0, 0.0);
        let goals: Vec<Pose2> = (0..4000).map(|seed| random_goal(seed, far)).collect();
        let nearest = |goal: &Pose2| {
            let [low, high] = WALL_FACES;
            let corners = tee_vertices(*goal);
            let gaps = corners
                .iter()
                .flatten()
                .flat_map(|p| [p.x - low, p.y - low, high - p.x, high - p.y]);
            gaps.fold(f64::INFINITY, f64::min)
        };
        let gaps: Vec<f64> = goals.iter().map(nearest).collect();
        assert!(gaps.iter().all(|gap| *gap >= GOAL_MARGIN - 1e-9));
        assert!(gaps.iter().any(|gap| *gap < GOAL_MARGIN + 1.0));
        assert!(goals.iter().all(|goal| depth_in_walls(*goal) == 0.0));
        // Every eighth of the circle has an eighth of the angles, within five standard deviations.
        for part in 0..8 {
            let inside = |goal: &&Pose2| (goal.theta / TAU * 8.0) as usize == part;
            let count = goals.iter().filter(inside).count();
            assert!(count.abs_diff(500) < 105, "{part}: {count}");
        }
    }

    #[test]
    fn a_goal_depends_on_its_seed_and_is_not_where_the_block_starts() {
        let far = Pose2::new(-1000.0, 0.0, 0.0);
        for seed in 0..200 {
            let goal = random_goal(seed, far);
            assert_eq!(goal, random_goal(seed, far));
            assert_ne!(goal, random_goal(seed + 1, far));
            // A block that starts on the goal gets another one.
            let other = random_goal(seed, goal);
            assert!(coverage(goal, other) <= START_COVERAGE, "seed {seed}");
        }
    }
}

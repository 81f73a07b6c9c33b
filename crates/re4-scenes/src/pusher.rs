//! Places of the pusher.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_geometry::{Point2, Pose2, distance_point_to_convex};
use re4_sim::{AGENT_RADIUS, WALL_FACES, tee_vertices};

use crate::{ScenesConfig, ScenesError};

/// Draws for one position before the pose is given up: a block takes up a fortieth of the workspace, so that many failures
/// in a row mean that there is no place, or next to none.
const DRAWS: u32 = 10_000;

/// Positions drawn uniformly from where the pusher's disc is between the walls; those too near to the block are drawn again.
///
/// Every pose has a stream of random numbers of its own: asking for more poses or more pushers leaves the others as they are.
pub(crate) fn positions(block: Pose2, pose: u32, config: &ScenesConfig) -> Result<Vec<Point2>, ScenesError> {
    let mut generator = Pcg64::new(u128::from(config.seed), u128::from(pose));
    let [low, high] = [WALL_FACES[0] + AGENT_RADIUS, WALL_FACES[1] - AGENT_RADIUS];
    // 53 bits make a number in [0, 1).
    let mut coordinate = || low + (high - low) * ((generator.next_u64() >> 11) as f64 / 9_007_199_254_740_992.0);
    let block_parts = tee_vertices(block);
    let keep_out = AGENT_RADIUS + config.clearance;
    let is_free = |p: &Point2| {
        block_parts
            .iter()
            .all(|part| distance_point_to_convex(*p, part) >= keep_out)
    };
    let mut draw = || {
        let mut drawn = (0..DRAWS).map(|_| {
            let x = coordinate();
            Point2::new(x, coordinate())
        });
        drawn.find(is_free).ok_or(ScenesError::NoPlace {
            x: block.x,
            y: block.y,
            theta: block.theta,
            clearance: config.clearance,
        })
    };
    (0..config.pushers).map(|_| draw()).collect()
}

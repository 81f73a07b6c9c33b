//! Samples positions of the pusher.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_geometry::{Point2, Pose2, distance_point_to_convex};
use re4_sim::{AGENT_RADIUS, WALL_FACES, tee_vertices};

use crate::{ScenesConfig, ScenesError};

/// Maximum number of samples for one position: the block covers a fortieth of the workspace, so that many failures in a row
/// mean that there is no free position, or almost none.
const MAXIMUM_SAMPLES: u32 = 10_000;

/// Samples positions uniformly from those where the pusher's disc is between the walls, and rejects those too near to the block.
///
/// Every pose has its own stream of random numbers: more poses or more pushers do not change the other positions.
pub(crate) fn positions(block: Pose2, pose: u32, config: &ScenesConfig) -> Result<Vec<Point2>, ScenesError> {
    let mut generator = Pcg64::new(u128::from(config.seed), u128::from(pose));
    let [low, high] = [WALL_FACES[0] + AGENT_RADIUS, WALL_FACES[1] - AGENT_RADIUS];
    // A number in [0, 1) with 53 random bits.
    let mut coordinate = || low + (high - low) * ((generator.next_u64() >> 11) as f64 / 9_007_199_254_740_992.0);
    let block_parts = tee_vertices(block);
    let keep_out = AGENT_RADIUS + config.clearance;
    let is_free = |p: &Point2| {
        block_parts
            .iter()
            .all(|part| distance_point_to_convex(*p, part) >= keep_out)
    };
    let mut sample = || {
        let mut samples = (0..MAXIMUM_SAMPLES).map(|_| {
            let x = coordinate();
            Point2::new(x, coordinate())
        });
        samples.find(is_free).ok_or(ScenesError::NoPosition {
            x: block.x,
            y: block.y,
            theta: block.theta,
            clearance: config.clearance,
        })
    };
    (0..config.pushers).map(|_| sample()).collect()
}

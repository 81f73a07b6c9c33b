//! Greedy choice of poses that keep a separation.

use rayon::prelude::*;
use re4_geometry::Pose2;

use crate::sweep::{Candidate, Sweep};
use crate::{ScenesConfig, ScenesError};

/// Visits the candidates in descending order of `rho`, equal ones in grid order, and takes each pose that keeps the separation
/// from all poses taken before.
pub(crate) fn greedy(
    mut candidates: Vec<Candidate>,
    sweep: &Sweep,
    config: &ScenesConfig,
) -> Result<Vec<Pose2>, ScenesError> {
    // Grid indices are unique, so the order is total and an unstable sort is deterministic.
    candidates.par_sort_unstable_by(|a, b| b.rho.total_cmp(&a.rho).then(a.index.cmp(&b.index)));
    let wanted = config.poses as usize;
    let mut chosen: Vec<Pose2> = Vec::new();
    for candidate in &candidates {
        if chosen.len() == wanted {
            break;
        }
        let pose = sweep.pose(candidate.index);
        if chosen
            .iter()
            .all(|other| sweep.distance(pose, *other) >= config.separation)
        {
            chosen.push(pose);
        }
    }
    if chosen.len() < wanted {
        return Err(ScenesError::TooFewPoses {
            found: chosen.len() as u32,
            wanted: config.poses,
            separation: config.separation,
            candidates: candidates.len(),
        });
    }
    Ok(chosen)
}

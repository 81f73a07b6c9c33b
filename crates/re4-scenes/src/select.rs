//! The greedy choice of poses that keep apart.

use rayon::prelude::*;
use re4_geometry::Pose2;

use crate::sweep::{Candidate, Sweep};
use crate::{ScenesConfig, ScenesError};

/// Goes through the candidates from the maximum `rho` down, the first of the grid first among equals, and takes each pose
/// that keeps the separation from all taken before.
pub(crate) fn greedy(
    mut candidates: Vec<Candidate>,
    sweep: &Sweep,
    config: &ScenesConfig,
) -> Result<Vec<Pose2>, ScenesError> {
    // Places differ, so that the order is total and the unstable sort is as good as a stable one.
    candidates.par_sort_unstable_by(|a, b| b.rho.total_cmp(&a.rho).then(a.place.cmp(&b.place)));
    let wanted = config.poses as usize;
    let mut chosen: Vec<Pose2> = Vec::new();
    for candidate in &candidates {
        if chosen.len() == wanted {
            break;
        }
        let pose = sweep.pose(candidate.place);
        if chosen
            .iter()
            .all(|other| sweep.apart(pose, *other) >= config.separation)
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

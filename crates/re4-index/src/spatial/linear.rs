//! Reference implementation of Retrieve in SE(3): a linear scan that evaluates every frame.

use std::collections::BTreeSet;

use crate::IndexError;
use crate::spatial::metric::{Measure, State};
use crate::spatial::{IndexedSpatialFrame, SpatialMetric, SpatialQuery, SpatialRetrieved, Stage2};

/// Performs the two-stage lookup by a linear scan over `frames`, which must be sorted by episode and frame.
///
/// The tests use it as the oracle; [`crate::SpatialIndex::retrieve`] returns the same answer. Demonstrations in `banned` rank
/// after all others. Returns `None` if no frame has the query's mode.
///
/// # Errors
/// If the metric is invalid, or the query or a frame is not finite.
pub fn retrieve_spatial_linear(
    frames: &[IndexedSpatialFrame],
    metric: &SpatialMetric,
    query: &SpatialQuery,
    stage2: Stage2,
    banned: &BTreeSet<u32>,
) -> Result<Option<SpatialRetrieved>, IndexError> {
    let measure = Measure::new(*metric)?;
    let q = State::new(&query.eef, &query.object).ok_or(IndexError::QueryNotFinite)?;
    let mut best: Option<(bool, SpatialRetrieved)> = None;
    for demo in frames.chunk_by(|a, b| a.episode == b.episode) {
        let mut chosen: Option<SpatialRetrieved> = None;
        for frame in demo.iter().filter(|frame| frame.mode == query.mode) {
            let j = State::new(&frame.eef, &frame.object).ok_or(IndexError::NotFinite {
                episode: frame.episode,
                frame: frame.frame,
            })?;
            let distances = measure.distances_below(&q, &j, f64::INFINITY);
            if let Some(distances) = distances.filter(|d| chosen.is_none_or(|c| d.d_q < c.distances.d_q)) {
                chosen = Some(SpatialRetrieved {
                    episode: frame.episode,
                    frame: frame.frame,
                    distances,
                });
            }
        }
        let Some(chosen) = chosen else {
            continue;
        };
        let penalised = banned.contains(&chosen.episode);
        let better = best.is_none_or(|(other, b)| {
            let key = |r: &SpatialRetrieved| Measure::key(stage2, &r.distances);
            (penalised, key(&chosen)) < (other, key(&b))
        });
        if better {
            best = Some((penalised, chosen));
        }
    }
    Ok(best.map(|(_, chosen)| chosen))
}

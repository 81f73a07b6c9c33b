//! Reference implementation of the planar Retrieve: a linear scan that evaluates every frame twice.

use crate::metric::{admissible_squared, in_bounds, object_squared, state_squared};
use crate::{IndexError, IndexedFrame, Normalization, Query, Retrieved};

/// Performs the two-stage lookup by a linear scan over `frames`, which must be sorted by episode and frame.
///
/// The tests use it as the oracle and the benchmarks as the baseline; [`crate::RetrievalIndex::retrieve`] returns the same
/// answer. `epsilon` is in normalised units; infinity disables the filter. Returns `None` if no frame has the query's mode.
///
/// # Errors
/// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
pub fn retrieve_linear(
    frames: &[IndexedFrame],
    normalization: &Normalization,
    query: &Query,
    epsilon: f64,
) -> Result<Option<Retrieved>, IndexError> {
    let q = normalization.query(query);
    if !in_bounds(&q) {
        return Err(IndexError::QueryNotFinite);
    }
    let period = normalization.period();
    let mut best: Option<Retrieved> = None;
    let mut minimum_object = f64::INFINITY;
    for demo in frames.chunk_by(|a, b| a.episode == b.episode) {
        let admissible = || demo.iter().filter(|frame| frame.mode == query.mode);
        let distances = |frame: &IndexedFrame| {
            let n = normalization.frame(frame);
            let o = object_squared(&q, n[2], n[3], n[4], period);
            (o, state_squared(&q, n[0], n[1], o))
        };
        let minimum = admissible()
            .map(|frame| distances(frame).0)
            .fold(f64::INFINITY, f64::min);
        let limit = admissible_squared(minimum, epsilon);
        let mut chosen: Option<(f64, f64, &IndexedFrame)> = None;
        for frame in admissible() {
            let (o, s) = distances(frame);
            if o <= limit && chosen.is_none_or(|(nearest, ..)| s < nearest) {
                chosen = Some((s, o, frame));
            }
        }
        // The comparison is strict so that the lowest demonstration wins ties.
        if let Some((s, o, frame)) = chosen.filter(|(_, o, _)| *o < minimum_object) {
            minimum_object = o;
            best = Some(Retrieved {
                episode: frame.episode,
                frame: frame.frame,
                d_q: s.sqrt(),
                d_o: o.sqrt(),
            });
        }
    }
    Ok(best)
}

//! Mutual information of states and actions.

use std::num::NonZeroUsize;

use kiddo::{Chebyshev, ImmutableKdTree};
use rayon::prelude::*;

use crate::motion::FEATURES;

/// Numbers of neighbours over which the estimate is averaged (Hejna et al. 2025).
pub const NEIGHBOURS: [usize; 3] = [5, 6, 7];

/// Maximum number of chunks that chunks are compared with. With more chunks, these are evenly spaced, so the cost of a
/// demonstration does not grow with the dataset.
pub const REFERENCE: usize = 8192;

/// State and action of a chunk.
pub type Chunk = [[f32; FEATURES]; 2];

const JOINT: usize = 2 * FEATURES;

/// The contribution of each demonstration to the mutual information of states and actions, in nats (DemInf; Hejna et al. 2025, with
/// the estimator of Kraskov, Stögbauer and Grassberger 2004, and standardised numbers in place of learned embeddings). For a chunk
/// with distance e to its k-th neighbour in states and actions together (maximum norm), `n_s` states and `n_a` actions nearer than e:
///
/// ```text
/// psi(k) + psi(N) - psi(n_s + 1) - psi(n_a + 1)
/// ```
///
/// averaged over k = 5, 6, 7 and over the chunks of a demonstration. Demonstrations whose actions follow from the state, in states
/// that differ, have a high value. `None` for a demonstration without chunks, and for all if there are fewer than 9 chunks.
pub fn information(demos: &[&[Chunk]]) -> Vec<Option<f64>> {
    let all: Vec<&Chunk> = demos.iter().copied().flatten().collect();
    let chosen: Vec<Chunk> = reference(all.len()).map(|place| *all[place]).collect();
    let Some(space) = Space::over(&chosen) else {
        return vec![None; demos.len()];
    };
    demos.par_iter().map(|demo| space.mean_contribution(demo)).collect()
}

/// The places, in the order of all chunks, of those that others are compared with.
pub fn reference(chunks: usize) -> impl Iterator<Item = usize> {
    let count = chunks.min(REFERENCE);
    (0..count).map(move |number| number * chunks / count)
}

/// The chunks that others are compared with, standardised.
pub(crate) struct Space {
    means: [f64; JOINT],
    scales: [f64; JOINT],
    joint: ImmutableKdTree<f64, JOINT>,
    states: ImmutableKdTree<f64, FEATURES>,
    actions: ImmutableKdTree<f64, FEATURES>,
    count: usize,
}

impl Space {
    /// The space of the chosen chunks; `None` if they are too few.
    pub(crate) fn over(chosen: &[Chunk]) -> Option<Self> {
        let most = NEIGHBOURS.into_iter().max().unwrap_or(1);
        let count = chosen.len();
        if count < most + 2 {
            return None;
        }
        let chosen: Vec<[f64; JOINT]> = chosen.iter().map(joint).collect();
        let mean = |at: usize| chosen.iter().map(|point| point[at]).sum::<f64>() / count as f64;
        let means: [f64; JOINT] = std::array::from_fn(mean);
        let scales: [f64; JOINT] = std::array::from_fn(|at| {
            let squares = chosen.iter().map(|point| (point[at] - means[at]).powi(2));
            let deviation = (squares.sum::<f64>() / count as f64).sqrt();
            // A number that never changes tells nothing; rounding must not be scaled up to 1.
            let constant = deviation <= 1e-9 * (1.0 + means[at].abs());
            if constant { 0.0 } else { deviation.recip() }
        });
        let points: Vec<[f64; JOINT]> = chosen.iter().map(|point| standardise(point, &means, &scales)).collect();
        let half = |second: usize| points.iter().map(|point| part(point, second)).collect::<Vec<_>>();
        Some(Self {
            joint: ImmutableKdTree::new_from_slice(&points).ok()?,
            states: ImmutableKdTree::new_from_slice(&half(0)).ok()?,
            actions: ImmutableKdTree::new_from_slice(&half(1)).ok()?,
            means,
            scales,
            count,
        })
    }

    /// The mean contribution of the chunks of a demonstration; `None` if it has no chunks.
    pub(crate) fn mean_contribution(&self, demo: &[Chunk]) -> Option<f64> {
        let parts: Option<Vec<f64>> = demo.iter().map(|chunk| self.contribution(chunk)).collect();
        let parts = parts?;
        (!parts.is_empty()).then(|| parts.iter().sum::<f64>() / parts.len() as f64)
    }

    fn contribution(&self, chunk: &Chunk) -> Option<f64> {
        let point = standardise(&joint(chunk), &self.means, &self.scales);
        let most = NEIGHBOURS.into_iter().max()? + 1;
        let nearest = self
            .joint
            .query(&point)
            .nearest_n::<Chebyshev<f64>>(NonZeroUsize::new(most)?);
        let mut distances: Vec<f64> = nearest.execute().iter().map(|hit| hit.distance).collect();
        distances.sort_by(f64::total_cmp);
        // The chunk itself, if it is among those compared with, is not its own neighbour.
        let own = usize::from(distances.first() == Some(&0.0));
        let mut sum = 0.0;
        for k in NEIGHBOURS {
            let radius = *distances.get(k - 1 + own)?;
            let (state, action) = (part(&point, 0), part(&point, 1));
            let nearer = |count: usize| (count.saturating_sub(own)) as f64;
            let states = self.states.query(&state).within::<Chebyshev<f64>>(radius);
            let states = nearer(states.exclusive_boundaries().execute().len());
            let actions = self.actions.query(&action).within::<Chebyshev<f64>>(radius);
            let actions = nearer(actions.exclusive_boundaries().execute().len());
            sum += digamma(k as f64) + digamma(self.count as f64) - digamma(states + 1.0) - digamma(actions + 1.0);
        }
        Some(sum / NEIGHBOURS.len() as f64)
    }
}

fn joint(chunk: &Chunk) -> [f64; JOINT] {
    let mut point = [0.0; JOINT];
    for (to, from) in point.iter_mut().zip(chunk.iter().flatten()) {
        *to = f64::from(*from);
    }
    point
}

fn part(point: &[f64; JOINT], second: usize) -> [f64; FEATURES] {
    let mut half = [0.0; FEATURES];
    half.copy_from_slice(&point[second * FEATURES..(second + 1) * FEATURES]);
    half
}

fn standardise(point: &[f64; JOINT], means: &[f64; JOINT], scales: &[f64; JOINT]) -> [f64; JOINT] {
    std::array::from_fn(|at| (point[at] - means[at]) * scales[at])
}

/// The digamma function for arguments of at least 1, by its recurrence and its asymptotic series. The error is below 1e-12.
fn digamma(mut x: f64) -> f64 {
    let mut value = 0.0;
    while x < 12.0 {
        value -= x.recip();
        x += 1.0;
    }
    let square = (x * x).recip();
    let series = square * (1.0 / 12.0 - square * (1.0 / 120.0 - square * (1.0 / 252.0 - square * (1.0 / 240.0))));
    value + x.ln() - 0.5 / x - series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digamma_has_its_known_values() {
        let euler = 0.577_215_664_901_532_9;
        assert!((digamma(1.0) + euler).abs() < 1e-12);
        assert!((digamma(4.0) - (1.0 + 0.5 + 1.0 / 3.0 - euler)).abs() < 1e-12);
        assert!((digamma(100.0) - 4.600_161_852_738_087).abs() < 1e-12);
    }
}

//! The index: KD-trees as bounds, exact evaluation of the demonstrations that can win.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use re4_episode::Mode;

use crate::metric::{admissible_squared, object_squared, state_squared};
use crate::{AngleMetric, IndexError, IndexedFrame, Normalization, Query, Retrieved};

/// Frames asked of the tree in the first round; each further round asks four times as many.
const FIRST_ROUND: usize = 32;

/// Relative slack on bounds that come from the tree, whose sums may be rounded in another order than ours.
const BOUND_SLACK: f64 = 1e-9;

/// Retrieve over the frames of a set of demonstrations. Immutable; queries may run from many threads.
pub struct RetrievalIndex {
    normalization: Normalization,
    frames: Vec<IndexedFrame>,
    modes: Vec<ModeIndex>,
}

/// What one query cost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SearchStatistics {
    /// Demonstrations for which stage 1 was evaluated.
    pub demos_evaluated: u32,
    /// Rounds of tree queries.
    pub rounds: u32,
}

/// Frames of one mode, demonstration after demonstration, in columns.
struct ModeIndex {
    mode: Mode,
    demos: Vec<Demo>,
    /// Demonstration (position in `demos`) of every frame.
    demo_of: Vec<u32>,
    /// Position in `RetrievalIndex::frames` of every frame.
    position: Vec<u32>,
    columns: [Vec<f64>; 5],
    tree: ImmutableKdTree<f64, 3>,
}

struct Demo {
    start: usize,
    end: usize,
}

impl RetrievalIndex {
    /// Builds the index over `frames`, normalising by their own minima and maxima.
    ///
    /// # Errors
    /// When there are no frames, or one has a coordinate that is not finite.
    pub fn build(frames: Vec<IndexedFrame>, angle: AngleMetric) -> Result<Self, IndexError> {
        let normalization = Normalization::over(&frames, angle);
        Self::with_normalization(frames, normalization)
    }

    /// Builds the index with a given normalisation, as an index artifact records it.
    ///
    /// # Errors
    /// When there are no frames, or one has a coordinate that is not finite.
    pub fn with_normalization(mut frames: Vec<IndexedFrame>, normalization: Normalization) -> Result<Self, IndexError> {
        if frames.is_empty() {
            return Err(IndexError::Empty);
        }
        if u32::try_from(frames.len()).is_err() {
            return Err(IndexError::TooLarge { frames: frames.len() });
        }
        if let Some(bad) = frames
            .iter()
            .find(|f| normalization.frame(f).iter().any(|v| !v.is_finite()))
        {
            return Err(IndexError::NotFinite {
                episode: bad.episode,
                frame: bad.frame,
            });
        }
        frames.sort_by_key(|f| (f.episode, f.frame));
        let modes = Mode::ALL
            .into_iter()
            .filter_map(|mode| ModeIndex::build(mode, &frames, &normalization).transpose())
            .collect::<Result<_, _>>()?;
        Ok(Self {
            normalization,
            frames,
            modes,
        })
    }

    /// Indexed frames, sorted by episode and frame.
    pub fn frames(&self) -> &[IndexedFrame] {
        &self.frames
    }

    /// Ranges and angle metric in force.
    pub fn normalization(&self) -> &Normalization {
        &self.normalization
    }

    /// The two-stage lookup; exact. `epsilon` is in normalised units, infinity switches its filter off.
    ///
    /// `None` when no indexed frame has the query's mode.
    ///
    /// # Errors
    /// When the query is not finite.
    pub fn retrieve(&self, query: &Query, epsilon: f64) -> Result<Option<Retrieved>, IndexError> {
        Ok(self.retrieve_counted(query, epsilon)?.0)
    }

    /// [`Self::retrieve`], with what the search cost.
    ///
    /// # Errors
    /// When the query is not finite.
    pub fn retrieve_counted(
        &self,
        query: &Query,
        epsilon: f64,
    ) -> Result<(Option<Retrieved>, SearchStatistics), IndexError> {
        let q = self.normalization.query(query);
        if q.iter().any(|v| !v.is_finite()) {
            return Err(IndexError::QueryNotFinite);
        }
        let Some(mode) = self.modes.iter().find(|m| m.mode == query.mode) else {
            return Ok((None, SearchStatistics::default()));
        };
        let (best, statistics) = mode.search(&q, epsilon, self.normalization.period());
        let retrieved = best.map(|best| {
            let frame = &self.frames[mode.position[best.frame] as usize];
            Retrieved {
                episode: frame.episode,
                frame: frame.frame,
                d_q: best.state_squared.sqrt(),
                d_o: best.object_squared.sqrt(),
            }
        });
        Ok((retrieved, statistics))
    }
}

/// Winner of stage 1 in one demonstration.
#[derive(Clone, Copy)]
struct Stage1 {
    demo: u32,
    frame: usize,
    state_squared: f64,
    object_squared: f64,
}

impl ModeIndex {
    fn build(mode: Mode, frames: &[IndexedFrame], normalization: &Normalization) -> Result<Option<Self>, IndexError> {
        let mut index = Self {
            mode,
            demos: Vec::new(),
            demo_of: Vec::new(),
            position: Vec::new(),
            columns: std::array::from_fn(|_| Vec::new()),
            tree: ImmutableKdTree::default(),
        };
        let mut episode = None;
        for (position, frame) in frames.iter().enumerate().filter(|(_, f)| f.mode == mode) {
            let here = index.position.len();
            if episode != Some(frame.episode) {
                episode = Some(frame.episode);
                index.demos.push(Demo { start: here, end: here });
            }
            if let Some(demo) = index.demos.last_mut() {
                demo.end = here + 1;
            }
            index.demo_of.push(index.demos.len() as u32 - 1);
            index.position.push(position as u32);
            for (column, value) in index.columns.iter_mut().zip(normalization.frame(frame)) {
                column.push(value);
            }
        }
        if index.position.is_empty() {
            return Ok(None);
        }
        let [_, _, x, y, theta] = &index.columns;
        let points: Vec<[f64; 3]> = (0..x.len()).map(|i| [x[i], y[i], theta[i]]).collect();
        index.tree =
            ImmutableKdTree::new_from_slice(&points).map_err(|e| IndexError::Tree { reason: e.to_string() })?;
        Ok(Some(index))
    }

    /// Stage 1 in one demonstration, or `None` when its least `d_o` is already beyond `bound`.
    fn stage1(
        &self,
        demo: u32,
        q: &[f64; 5],
        epsilon: f64,
        period: f64,
        bound: f64,
        scratch: &mut Vec<f64>,
    ) -> Option<Stage1> {
        let range = self.demos[demo as usize].start..self.demos[demo as usize].end;
        let [eef_x, eef_y, x, y, theta] = &self.columns;
        let (x, y, theta) = (&x[range.clone()], &y[range.clone()], &theta[range.clone()]);
        scratch.clear();
        scratch.extend(
            x.iter()
                .zip(y)
                .zip(theta)
                .map(|((&x, &y), &t)| object_squared(q, x, y, t, period)),
        );
        let least = scratch.iter().copied().fold(f64::INFINITY, f64::min);
        if least > bound {
            return None;
        }
        let limit = admissible_squared(least, epsilon);
        let (eef_x, eef_y) = (&eef_x[range.clone()], &eef_y[range.clone()]);
        let mut chosen: Option<Stage1> = None;
        for (i, &o) in scratch.iter().enumerate() {
            if o <= limit {
                let s = state_squared(q, eef_x[i], eef_y[i], o);
                if chosen.is_none_or(|c| s < c.state_squared) {
                    chosen = Some(Stage1 {
                        demo,
                        frame: range.start + i,
                        state_squared: s,
                        object_squared: o,
                    });
                }
            }
        }
        chosen
    }

    /// Best-first over demonstrations, in the order of their least `d_o` as the tree yields it.
    fn search(&self, q: &[f64; 5], epsilon: f64, period: f64) -> (Option<Stage1>, SearchStatistics) {
        let mut best: Option<Stage1> = None;
        let mut statistics = SearchStatistics::default();
        let mut seen = vec![0u64; self.demos.len().div_ceil(64)];
        let mut scratch = Vec::new();
        let total = self.position.len();
        let mut count = FIRST_ROUND;
        loop {
            statistics.rounds += 1;
            let bound = best.map_or(f64::INFINITY, |b| b.object_squared * (1.0 + BOUND_SLACK));
            let (near, complete_to) = self.nearest(q, period, count, bound);
            for (least, frame) in near {
                if best.is_some_and(|b| least > b.object_squared * (1.0 + BOUND_SLACK)) {
                    return (best, statistics);
                }
                let demo = self.demo_of[frame as usize];
                let (word, bit) = (demo as usize / 64, 1u64 << (demo % 64));
                if seen[word] & bit != 0 {
                    continue;
                }
                seen[word] |= bit;
                statistics.demos_evaluated += 1;
                let bound = best.map_or(f64::INFINITY, |b| b.object_squared);
                if let Some(found) = self.stage1(demo, q, epsilon, period, bound, &mut scratch) {
                    let better = best.is_none_or(|b| (found.object_squared, found.demo) < (b.object_squared, b.demo));
                    if better {
                        best = Some(found);
                    }
                }
            }
            if count >= total || best.is_some_and(|b| complete_to > b.object_squared * (1.0 + BOUND_SLACK)) {
                return (best, statistics);
            }
            count = (count * 4).min(total);
        }
    }

    /// The `count` frames of least `d_o` within `bound` in ascending order, and the squared distance up to which the
    /// list is complete. Angles are compared by querying the tree at the angle and at its nearer alias a turn away.
    fn nearest(&self, q: &[f64; 5], period: f64, count: usize, bound: f64) -> (Vec<(f64, u32)>, f64) {
        let mut found = Vec::with_capacity(count);
        let mut complete_to = f64::INFINITY;
        let mut ask = |theta: f64| {
            let Some(n) = NonZeroUsize::new(count) else { return };
            let query = [q[2], q[3], theta];
            let query = self.tree.query(&query);
            let hits = if bound.is_finite() {
                query.nearest_n::<SquaredEuclidean<f64>>(n).within(bound).execute()
            } else {
                query.nearest_n::<SquaredEuclidean<f64>>(n).execute()
            };
            if hits.len() >= count {
                complete_to = complete_to.min(hits.last().map_or(f64::INFINITY, |h| h.distance));
            }
            found.extend(hits.iter().map(|h| (h.distance, h.item)));
        };
        ask(q[4]);
        if period.is_finite() {
            // Frames lie in [0, 1]; from the alias beyond the nearer end, none is closer than that end.
            let alias = if q[4] * 2.0 > 1.0 { q[4] - period } else { q[4] + period };
            let gap = if alias < 0.0 { -alias } else { alias - 1.0 };
            let gap_squared = gap.max(0.0) * gap.max(0.0);
            let reach = if bound.is_finite() { bound } else { f64::INFINITY };
            if gap_squared <= reach {
                ask(alias);
            }
        }
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        (found, complete_to)
    }
}

//! The planar index: a tree of boxes gives lower bounds, so that only demonstrations that can win are evaluated.

use std::collections::BTreeSet;
use std::ops::Range;

use re4_episode::Mode;

use crate::metric::{admissible_squared, in_bounds, object_squared, state_squared};
use crate::tree::{FAN, Pose, PoseTree};
use crate::{AngleMetric, Candidate, IndexError, IndexedFrame, Normalization, Query, Retrieved};

/// Index for Retrieve over the frames of a set of demonstrations.
///
/// The index is immutable, so several threads can query it at the same time.
pub struct RetrievalIndex {
    normalization: Normalization,
    frames: Vec<IndexedFrame>,
    modes: Vec<ModeIndex>,
}

/// Cost of one query.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SearchStatistics {
    /// Number of demonstrations for which stage 1 was evaluated.
    pub demos_evaluated: u32,
    /// Number of frame distances computed, in leaves of the tree and in stage 1. A frame can count more than once.
    pub frames_evaluated: u32,
}

/// Frames of one mode, grouped by demonstration, with their coordinates in columns.
struct ModeIndex {
    mode: Mode,
    /// The number of every demonstration, in ascending order.
    numbers: Vec<u32>,
    /// For every demonstration, the range of its frames in `position` and `columns`.
    demos: Vec<Range<usize>>,
    /// Position of every frame in `RetrievalIndex::frames`.
    position: Vec<u32>,
    /// Normalised coordinates in the order of [`Normalization::DIMENSIONS`].
    columns: [Vec<f64>; 5],
    tree: PoseTree,
}

impl RetrievalIndex {
    /// Builds the index over `frames` and normalises them by their own minima and maxima.
    ///
    /// # Errors
    /// If there are no frames, a frame has a coordinate that is not finite, or two frames of an episode have the same number.
    pub fn build(frames: Vec<IndexedFrame>, angle: AngleMetric) -> Result<Self, IndexError> {
        let normalization = Normalization::over(&frames, angle);
        Self::with_normalization(frames, normalization)
    }

    /// Builds the index with a given normalisation, such as the one that an index artifact stores.
    ///
    /// # Errors
    /// If there are no frames, a frame has a coordinate that is not finite, or two frames of an episode have the same number.
    pub fn with_normalization(mut frames: Vec<IndexedFrame>, normalization: Normalization) -> Result<Self, IndexError> {
        if frames.is_empty() {
            return Err(IndexError::Empty);
        }
        if u32::try_from(frames.len()).is_err() {
            return Err(IndexError::TooLarge { frames: frames.len() });
        }
        if let Some(bad) = frames.iter().find(|f| !in_bounds(&normalization.frame(f))) {
            return Err(IndexError::NotFinite {
                episode: bad.episode,
                frame: bad.frame,
            });
        }
        frames.sort_by_key(|f| (f.episode, f.frame));
        if let Some(pair) = frames
            .windows(2)
            .find(|w| (w[0].episode, w[0].frame) == (w[1].episode, w[1].frame))
        {
            return Err(IndexError::Duplicate {
                episode: pair[0].episode,
                frame: pair[0].frame,
            });
        }
        let modes = Mode::ALL
            .into_iter()
            .filter_map(|mode| ModeIndex::build(mode, &frames, &normalization))
            .collect();
        Ok(Self {
            normalization,
            frames,
            modes,
        })
    }

    /// Returns the indexed frames, sorted by episode and frame.
    pub fn frames(&self) -> &[IndexedFrame] {
        &self.frames
    }

    /// Returns the ranges and the angle metric that the index uses.
    pub fn normalization(&self) -> &Normalization {
        &self.normalization
    }

    /// Performs the two-stage lookup exactly. `epsilon` is in normalised units; infinity disables the filter.
    ///
    /// Returns `None` if no indexed frame has the query's mode.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve(&self, query: &Query, epsilon: f64) -> Result<Option<Retrieved>, IndexError> {
        Ok(self.retrieve_counted(query, epsilon)?.0)
    }

    /// Performs the lookup of [`Self::retrieve`] as if the demonstrations in `without` were not indexed. The normalisation stays that
    /// of the whole index. Returns `None` if no other demonstration has a frame of the query's mode.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve_without(
        &self,
        query: &Query,
        epsilon: f64,
        without: &BTreeSet<u32>,
    ) -> Result<Option<Retrieved>, IndexError> {
        Ok(self.candidate(query, epsilon, without)?.map(|found| found.retrieved))
    }

    /// The answer of [`Self::retrieve_without`], for [`Candidate::least`] over the answers of several indices, which must have the same
    /// normalisation. Indices that do not fit in memory together can be loaded and asked one after the other.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn candidate(
        &self,
        query: &Query,
        epsilon: f64,
        without: &BTreeSet<u32>,
    ) -> Result<Option<Candidate<Retrieved>>, IndexError> {
        Ok(self.search(query, epsilon, without)?.0)
    }

    /// Performs the lookup of [`Self::retrieve`] and also returns its cost.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve_counted(
        &self,
        query: &Query,
        epsilon: f64,
    ) -> Result<(Option<Retrieved>, SearchStatistics), IndexError> {
        let (found, statistics) = self.search(query, epsilon, &BTreeSet::new())?;
        Ok((found.map(|found| found.retrieved), statistics))
    }

    fn search(
        &self,
        query: &Query,
        epsilon: f64,
        without: &BTreeSet<u32>,
    ) -> Result<(Option<Candidate<Retrieved>>, SearchStatistics), IndexError> {
        let q = self.normalization.query(query);
        if !in_bounds(&q) {
            return Err(IndexError::QueryNotFinite);
        }
        let Some(mode) = self.modes.iter().find(|m| m.mode == query.mode) else {
            return Ok((None, SearchStatistics::default()));
        };
        let (best, statistics) = mode.search(&q, epsilon, self.normalization.period(), without);
        let Some(best) = best else {
            return Ok((None, statistics));
        };
        let frame = &self.frames[mode.position[best.frame] as usize];
        let retrieved = Retrieved {
            episode: frame.episode,
            frame: frame.frame,
            d_q: best.state_squared.sqrt(),
            d_o: best.object_squared.sqrt(),
        };
        let candidate = Candidate {
            retrieved,
            banned: false,
            key: best.object_squared,
            episode: frame.episode,
        };
        Ok((Some(candidate), statistics))
    }
}

/// Result of stage 1 in one demonstration.
#[derive(Clone, Copy)]
struct Stage1 {
    demo: u32,
    frame: usize,
    state_squared: f64,
    object_squared: f64,
}

impl ModeIndex {
    fn build(mode: Mode, frames: &[IndexedFrame], normalization: &Normalization) -> Option<Self> {
        let mut demos: Vec<Range<usize>> = Vec::new();
        let mut numbers = Vec::new();
        let mut position = Vec::new();
        let mut columns: [Vec<f64>; 5] = std::array::from_fn(|_| Vec::new());
        let mut episode = None;
        for (at, frame) in frames.iter().enumerate().filter(|(_, f)| f.mode == mode) {
            let here = position.len();
            match demos.last_mut() {
                Some(demo) if episode == Some(frame.episode) => demo.end = here + 1,
                _ => {
                    demos.push(here..here + 1);
                    numbers.push(frame.episode);
                }
            }
            episode = Some(frame.episode);
            position.push(at as u32);
            for (column, value) in columns.iter_mut().zip(normalization.frame(frame)) {
                column.push(value);
            }
        }
        if position.is_empty() {
            return None;
        }
        let [_, _, x, y, theta] = &columns;
        let poses = (0..).zip(&demos).flat_map(|(demo, range)| {
            range.clone().map(move |i| Pose {
                at: [x[i], y[i], theta[i]],
                demo,
            })
        });
        let tree = PoseTree::build(poses.collect());
        Some(Self {
            mode,
            numbers,
            demos,
            position,
            columns,
            tree,
        })
    }

    /// Evaluates stage 1 in one demonstration. `scratch` is a buffer that is reused between calls.
    fn stage1(&self, demo: u32, q: &[f64; 5], epsilon: f64, period: f64, scratch: &mut Vec<f64>) -> Stage1 {
        let range = self.demos[demo as usize].clone();
        let [eef_x, eef_y, x, y, theta] = self.columns.each_ref().map(|column| &column[range.clone()]);
        scratch.clear();
        scratch.extend(
            x.iter()
                .zip(y)
                .zip(theta)
                .map(|((&x, &y), &theta)| object_squared(q, x, y, theta, period)),
        );
        let minimum = scratch.iter().copied().fold(f64::INFINITY, f64::min);
        let limit = admissible_squared(minimum, epsilon);
        let mut chosen = Stage1 {
            demo,
            frame: range.start,
            state_squared: f64::INFINITY,
            object_squared: f64::INFINITY,
        };
        for (i, ((&o, &x), &y)) in scratch.iter().zip(eef_x).zip(eef_y).enumerate() {
            let s = state_squared(q, x, y, o);
            if o <= limit && s < chosen.state_squared {
                chosen.frame = range.start + i;
                chosen.state_squared = s;
                chosen.object_squared = o;
            }
        }
        chosen
    }

    /// Finds the demonstration that wins stage 2 among those that are not in `without`, or `None` if there is none.
    ///
    /// The first pass over the tree finds the demonstration that has the frame with the smallest `d_o`. Its stage 1 result bounds
    /// the answer. The second pass evaluates every other demonstration that has a frame within this bound. No other demonstration
    /// can win, because the `d_o` of a stage 1 result is never smaller than the minimum `d_o` of its demonstration.
    fn search(
        &self,
        q: &[f64; 5],
        epsilon: f64,
        period: f64,
        without: &BTreeSet<u32>,
    ) -> (Option<Stage1>, SearchStatistics) {
        let mut statistics = SearchStatistics::default();
        // Bit set of the demonstrations that are left out or have been evaluated.
        let mut seen = vec![0u64; self.demos.len().div_ceil(64)];
        for number in without {
            if let Ok(demo) = self.numbers.binary_search(number) {
                seen[demo / 64] |= 1 << (demo % 64);
            }
        }
        let mut nearest = None;
        self.tree.visit(q, period, f64::INFINITY, |distances, demos, reach| {
            statistics.frames_evaluated += FAN as u32;
            for (&distance, &demo) in distances.iter().zip(demos) {
                if distance < *reach && seen[demo as usize / 64] & (1 << (demo % 64)) == 0 {
                    *reach = distance;
                    nearest = Some(demo);
                }
            }
        });
        let Some(nearest) = nearest else {
            return (None, statistics);
        };
        let mut scratch = Vec::new();
        let mut evaluate = |demo: u32, statistics: &mut SearchStatistics| {
            statistics.demos_evaluated += 1;
            statistics.frames_evaluated += self.demos[demo as usize].len() as u32;
            self.stage1(demo, q, epsilon, period, &mut scratch)
        };
        let mut best = evaluate(nearest, &mut statistics);
        seen[nearest as usize / 64] |= 1 << (nearest % 64);
        self.tree
            .visit(q, period, best.object_squared, |distances, demos, reach| {
                statistics.frames_evaluated += FAN as u32;
                for (&distance, &demo) in distances.iter().zip(demos) {
                    let (word, bit) = (demo as usize / 64, 1u64 << (demo % 64));
                    if distance <= *reach && seen[word] & bit == 0 {
                        seen[word] |= bit;
                        let found = evaluate(demo, &mut statistics);
                        // The tree does not visit demonstrations in order, so the number of the demonstration decides ties
                        // explicitly.
                        if (found.object_squared, found.demo) < (best.object_squared, best.demo) {
                            *reach = found.object_squared;
                            best = found;
                        }
                    }
                }
            });
        (Some(best), statistics)
    }
}

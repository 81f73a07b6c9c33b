//! The SE(3) index: it visits lower bounds in ascending order and evaluates only demonstrations that can win.

use std::collections::BTreeSet;
use std::ops::Range;

use nalgebra::Isometry3;
use re4_episode::Mode;

use crate::spatial::metric::{Measure, State};
use crate::spatial::tree::RegionTree;
use crate::spatial::{IndexedSpatialFrame, SpatialDistances, SpatialMetric, SpatialQuery, SpatialRetrieved, Stage2};
use crate::{Candidate, IndexError, SearchStatistics};

/// Index for Retrieve over the frames of a set of demonstrations in SE(3).
///
/// The index is immutable, so several threads can query it at the same time.
pub struct SpatialIndex {
    measure: Measure,
    frames: Vec<IndexedSpatialFrame>,
    modes: Vec<ModeIndex>,
}

/// Frames of one mode, grouped by demonstration.
struct ModeIndex {
    mode: Mode,
    /// Number and range of frames of every demonstration, in ascending order of the number.
    demos: Vec<(u32, Range<usize>)>,
    states: Vec<State>,
    /// Number of the frame in its demonstration, for every state.
    numbers: Vec<u32>,
    tree: RegionTree,
}

impl SpatialIndex {
    /// Builds the index.
    ///
    /// # Errors
    /// If there are no frames, a frame has a coordinate that is not finite, two frames of an episode have the same number, or the
    /// metric is invalid: a scale that is not above 0, a weight below 0 or an invalid symmetry.
    pub fn build(mut frames: Vec<IndexedSpatialFrame>, metric: SpatialMetric) -> Result<Self, IndexError> {
        let measure = Measure::new(metric)?;
        if frames.is_empty() {
            return Err(IndexError::Empty);
        }
        if u32::try_from(frames.len()).is_err() {
            return Err(IndexError::TooLarge { frames: frames.len() });
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
            .map(|mode| ModeIndex::build(&measure, mode, &frames))
            .collect::<Result<_, _>>()?;
        Ok(Self { measure, frames, modes })
    }

    /// Returns the indexed frames, sorted by episode and frame.
    pub fn frames(&self) -> &[IndexedSpatialFrame] {
        &self.frames
    }

    /// Returns the metric of the index.
    pub fn metric(&self) -> &SpatialMetric {
        &self.measure.metric
    }

    /// Returns the number of demonstrations that have a frame of the mode.
    pub fn demos(&self, mode: Mode) -> usize {
        self.of_mode(mode).map_or(0, |m| m.demos.len())
    }

    /// Performs the two-stage lookup exactly. Demonstrations in `banned` rank after all others. Returns `None` if no frame has
    /// the query's mode.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve(
        &self,
        query: &SpatialQuery,
        stage2: Stage2,
        banned: &BTreeSet<u32>,
    ) -> Result<Option<SpatialRetrieved>, IndexError> {
        Ok(self.retrieve_counted(query, stage2, banned)?.0)
    }

    /// Performs the lookup of [`Self::retrieve`] as if the demonstrations in `without` were not indexed.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve_without(
        &self,
        query: &SpatialQuery,
        stage2: Stage2,
        banned: &BTreeSet<u32>,
        without: &BTreeSet<u32>,
    ) -> Result<Option<SpatialRetrieved>, IndexError> {
        let found = self.candidate(query, stage2, banned, without)?;
        Ok(found.map(|found| found.retrieved))
    }

    /// The answer of [`Self::retrieve_without`], for [`Candidate::least`] over the answers of several indices, which must have the same
    /// metric. Indices that do not fit in memory together can be loaded and asked one after the other.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn candidate(
        &self,
        query: &SpatialQuery,
        stage2: Stage2,
        banned: &BTreeSet<u32>,
        without: &BTreeSet<u32>,
    ) -> Result<Option<Candidate<SpatialRetrieved>>, IndexError> {
        let (found, _) = self.search(query, stage2, banned, without)?;
        Ok(found.map(|found| Candidate {
            retrieved: found,
            banned: banned.contains(&found.episode),
            key: Measure::key(stage2, &found.distances),
            episode: found.episode,
        }))
    }

    /// Performs the lookup of [`Self::retrieve`] and also returns its cost.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve_counted(
        &self,
        query: &SpatialQuery,
        stage2: Stage2,
        banned: &BTreeSet<u32>,
    ) -> Result<(Option<SpatialRetrieved>, SearchStatistics), IndexError> {
        self.search(query, stage2, banned, &BTreeSet::new())
    }

    fn search(
        &self,
        query: &SpatialQuery,
        stage2: Stage2,
        banned: &BTreeSet<u32>,
        without: &BTreeSet<u32>,
    ) -> Result<(Option<SpatialRetrieved>, SearchStatistics), IndexError> {
        let q = State::new(&query.eef, &query.object).ok_or(IndexError::QueryNotFinite)?;
        let mut statistics = SearchStatistics::default();
        let Some(mode) = self.of_mode(query.mode) else {
            return Ok((None, statistics));
        };
        let places = |numbers: &BTreeSet<u32>, skipped: &mut [bool]| {
            for number in numbers {
                if let Ok(at) = mode.demos.binary_search_by_key(number, |(number, _)| *number) {
                    skipped[at] = true;
                }
            }
        };
        let mut skipped = vec![false; mode.demos.len()];
        places(banned, &mut skipped);
        places(without, &mut skipped);
        let mut best = mode.search(&self.measure, &q, stage2, &skipped, &mut statistics);
        // Banned demonstrations count only if no other demonstration has a frame of the mode.
        if best.is_none() {
            for skip in &mut skipped {
                *skip = !*skip;
            }
            places(without, &mut skipped);
            best = mode.search(&self.measure, &q, stage2, &skipped, &mut statistics);
        }
        Ok((best, statistics))
    }

    /// Computes the answer of [`Self::retrieve`] without the tree by evaluating every frame. It is the baseline of the
    /// benchmarks.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve_scanning(
        &self,
        query: &SpatialQuery,
        stage2: Stage2,
        banned: &BTreeSet<u32>,
    ) -> Result<Option<SpatialRetrieved>, IndexError> {
        let q = State::new(&query.eef, &query.object).ok_or(IndexError::QueryNotFinite)?;
        let Some(mode) = self.of_mode(query.mode) else {
            return Ok(None);
        };
        let mut best: Option<(bool, f64, SpatialRetrieved)> = None;
        for demo in 0..mode.demos.len() as u32 {
            let Some(found) = mode.stage1(&self.measure, demo, &q) else {
                continue;
            };
            let penalised = banned.contains(&found.episode);
            let key = Measure::key(stage2, &found.distances);
            if best.is_none_or(|(other, minimum, _)| (penalised, key) < (other, minimum)) {
                best = Some((penalised, key, found));
            }
        }
        Ok(best.map(|(.., found)| found))
    }

    /// Returns the distances between a query and any state, indexed or not. The mode of the query is ignored.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query or of the state is not finite or is too large.
    pub fn distances(
        &self,
        query: &SpatialQuery,
        eef: &Isometry3<f64>,
        object: &Isometry3<f64>,
    ) -> Result<SpatialDistances, IndexError> {
        let q = State::new(&query.eef, &query.object).ok_or(IndexError::QueryNotFinite)?;
        let j = State::new(eef, object).ok_or(IndexError::QueryNotFinite)?;
        self.measure
            .distances_below(&q, &j, f64::INFINITY)
            .ok_or(IndexError::QueryNotFinite)
    }

    fn of_mode(&self, mode: Mode) -> Option<&ModeIndex> {
        self.modes.iter().find(|m| m.mode == mode)
    }
}

impl ModeIndex {
    fn build(measure: &Measure, mode: Mode, frames: &[IndexedSpatialFrame]) -> Result<Self, IndexError> {
        let mut demos: Vec<(u32, Range<usize>)> = Vec::new();
        let mut states = Vec::new();
        let mut numbers = Vec::new();
        for frame in frames.iter().filter(|f| f.mode == mode) {
            let here = states.len();
            match demos.last_mut() {
                Some((number, range)) if *number == frame.episode => range.end = here + 1,
                _ => demos.push((frame.episode, here..here + 1)),
            }
            states.push(State::new(&frame.eef, &frame.object).ok_or(IndexError::NotFinite {
                episode: frame.episode,
                frame: frame.frame,
            })?);
            numbers.push(frame.frame);
        }
        let tree = RegionTree::build(measure, demos.iter().map(|(_, range)| &states[range.clone()]));
        Ok(Self {
            mode,
            demos,
            states,
            numbers,
            tree,
        })
    }

    /// Evaluates stage 1 in one demonstration.
    fn stage1(&self, measure: &Measure, demo: u32, q: &State) -> Option<SpatialRetrieved> {
        let (episode, range) = &self.demos[demo as usize];
        let mut minimum = f64::INFINITY;
        let mut chosen = None;
        for (state, &frame) in self.states[range.clone()].iter().zip(&self.numbers[range.clone()]) {
            if let Some(distances) = measure.distances_below(q, state, minimum) {
                minimum = distances.d_q;
                chosen = Some(SpatialRetrieved {
                    episode: *episode,
                    frame,
                    distances,
                });
            }
        }
        chosen
    }

    /// Performs stage 2 over the demonstrations that are not skipped.
    fn search(
        &self,
        measure: &Measure,
        q: &State,
        stage2: Stage2,
        skipped: &[bool],
        statistics: &mut SearchStatistics,
    ) -> Option<SpatialRetrieved> {
        // The tree reports a demonstration once per entry, but it only needs to be evaluated once.
        let mut seen = skipped.to_vec();
        let mut best: Option<(f64, u32, SpatialRetrieved)> = None;
        // The tree bounds `d_o`. Since `d_q >= object_weight * d_o`, the weighted bound is valid for `d_q` as well.
        let weight = match stage2 {
            Stage2::Object => 1.0,
            Stage2::State => measure.metric.object_weight,
        };
        self.tree.visit(measure, q, |bound, demo| {
            if best.is_some_and(|(minimum, ..)| weight * bound > minimum) {
                return false;
            }
            let seen = &mut seen[demo as usize];
            if !*seen {
                *seen = true;
                statistics.demos_evaluated += 1;
                statistics.frames_evaluated += self.demos[demo as usize].1.len() as u32;
                if let Some(found) = self.stage1(measure, demo, q) {
                    let key = Measure::key(stage2, &found.distances);
                    if best.is_none_or(|(minimum, first, _)| (key, demo) < (minimum, first)) {
                        best = Some((key, demo, found));
                    }
                }
            }
            true
        });
        best.map(|(.., found)| found)
    }
}

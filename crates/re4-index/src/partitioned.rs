//! One index in several parts, for demonstrations that are indexed apart from each other.
//!
//! Each part holds some of the demonstrations. Retrieve takes a minimum over demonstrations, so the minimum of the parts' answers is the
//! answer of one index over all demonstrations, if the parts measure the same distances: a part must not be normalised by the
//! ranges of its own frames. Answers are compared by the squared distance, as one index compares them: different squares
//! can have the same root.

use std::collections::BTreeSet;

use re4_episode::Mode;

use crate::spatial::{IndexedSpatialFrame, SpatialIndex, SpatialMetric, SpatialQuery, SpatialRetrieved, Stage2};
use crate::{AngleMetric, IndexError, IndexedFrame, Normalization, Query, RetrievalIndex, Retrieved};

/// The answer of one part, with what decides between the answers of several parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate<R> {
    /// The answer.
    pub retrieved: R,
    /// Whether its demonstration ranks after all that are not banned.
    pub(crate) banned: bool,
    /// The distance of stage 2: squared for the planar index, not squared in SE(3).
    pub(crate) key: f64,
    /// Number of its demonstration.
    pub(crate) episode: u32,
}

impl<R> Candidate<R> {
    /// The answer of all parts; `None` if no part has one. The order of the parts does not matter.
    pub fn least(candidates: impl IntoIterator<Item = Self>) -> Option<Self> {
        candidates.into_iter().reduce(|best, next| {
            let order = next
                .banned
                .cmp(&best.banned)
                .then(next.key.total_cmp(&best.key))
                .then(next.episode.cmp(&best.episode));
            // The frame needs no comparison: the frames of a demonstration are in one part.
            if order.is_lt() { next } else { best }
        })
    }
}

/// Parts of an index, each over other demonstrations, that answer as one index over all of them: with the same demonstration and
/// frame, and bit for bit the same distances.
pub struct Partitioned<I> {
    parts: Vec<I>,
}

impl<I> Partitioned<I> {
    /// The parts.
    pub fn parts(&self) -> &[I] {
        &self.parts
    }
}

impl Partitioned<RetrievalIndex> {
    /// Distributes the demonstrations over `count` parts, in order, so that each part has about equally many. With fewer
    /// demonstrations there are fewer parts.
    ///
    /// # Errors
    /// If there are no frames, a frame has a coordinate that is not finite, or two frames of an episode have the same number.
    pub fn build(frames: Vec<IndexedFrame>, angle: AngleMetric, count: usize) -> Result<Self, IndexError> {
        let normalization = Normalization::over(&frames, angle);
        Self::with_normalization(split(frames, count, |frame| frame.episode), normalization)
    }

    /// Builds a part over each of several sets of demonstrations. `normalization` is that of all frames of all sets
    /// ([`Normalization::merged`]). Sets without frames are left out.
    ///
    /// # Errors
    /// If there are no frames, a frame has a coordinate that is not finite, two frames of an episode have the same number, or an
    /// episode is in two sets.
    pub fn with_normalization(sets: Vec<Vec<IndexedFrame>>, normalization: Normalization) -> Result<Self, IndexError> {
        let build = |frames| RetrievalIndex::with_normalization(frames, normalization);
        let parts = build_parts(sets, build)?;
        apart(
            parts
                .iter()
                .map(|part| numbers(part.frames(), |frame| (frame.episode, frame.frame))),
        )?;
        Ok(Self { parts })
    }

    /// Performs the lookup of [`RetrievalIndex::retrieve`] over all parts.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve(&self, query: &Query, epsilon: f64) -> Result<Option<Retrieved>, IndexError> {
        self.retrieve_without(query, epsilon, &BTreeSet::new())
    }

    /// Performs the lookup of [`RetrievalIndex::retrieve_without`] over all parts.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve_without(
        &self,
        query: &Query,
        epsilon: f64,
        without: &BTreeSet<u32>,
    ) -> Result<Option<Retrieved>, IndexError> {
        let answers = self.parts.iter().map(|part| part.candidate(query, epsilon, without));
        let answers = answers.collect::<Result<Vec<_>, _>>()?;
        Ok(Candidate::least(answers.into_iter().flatten()).map(|least| least.retrieved))
    }
}

impl Partitioned<SpatialIndex> {
    /// Distributes the demonstrations over `count` parts, in order, so that each part has about equally many. With fewer
    /// demonstrations there are fewer parts. The distances do not depend on the indexed frames.
    ///
    /// # Errors
    /// As [`SpatialIndex::build`].
    pub fn build(frames: Vec<IndexedSpatialFrame>, metric: SpatialMetric, count: usize) -> Result<Self, IndexError> {
        let sets = split(frames, count, |frame| frame.episode);
        let parts = build_parts(sets, |frames| SpatialIndex::build(frames, metric))?;
        Ok(Self { parts })
    }

    /// Returns the number of demonstrations that have a frame of the mode.
    pub fn demos(&self, mode: Mode) -> usize {
        self.parts.iter().map(|part| part.demos(mode)).sum()
    }

    /// Performs the lookup of [`SpatialIndex::retrieve`] over all parts.
    ///
    /// # Errors
    /// [`IndexError::QueryNotFinite`] if a coordinate of the query is not finite or is too large.
    pub fn retrieve(
        &self,
        query: &SpatialQuery,
        stage2: Stage2,
        banned: &BTreeSet<u32>,
    ) -> Result<Option<SpatialRetrieved>, IndexError> {
        self.retrieve_without(query, stage2, banned, &BTreeSet::new())
    }

    /// Performs the lookup of [`SpatialIndex::retrieve_without`] over all parts.
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
        let answers = self
            .parts
            .iter()
            .map(|part| part.candidate(query, stage2, banned, without));
        let answers = answers.collect::<Result<Vec<_>, _>>()?;
        Ok(Candidate::least(answers.into_iter().flatten()).map(|least| least.retrieved))
    }
}

/// Distributes frames over sets. The frames of a demonstration stay together.
fn split<F>(mut frames: Vec<F>, count: usize, episode: impl Fn(&F) -> u32) -> Vec<Vec<F>> {
    frames.sort_by_key(&episode);
    let episodes = frames.chunk_by(|a, b| episode(a) == episode(b));
    let lengths: Vec<usize> = episodes.map(<[F]>::len).collect();
    let count = count.clamp(1, lengths.len().max(1));
    let mut sets = Vec::with_capacity(count);
    for set in (0..count).rev() {
        let earlier: usize = lengths[..lengths.len() * set / count].iter().sum();
        sets.push(frames.split_off(earlier));
    }
    sets.reverse();
    sets
}

fn build_parts<F, I>(sets: Vec<Vec<F>>, build: impl Fn(Vec<F>) -> Result<I, IndexError>) -> Result<Vec<I>, IndexError> {
    let sets = sets.into_iter().filter(|frames| !frames.is_empty());
    let parts: Vec<I> = sets.map(build).collect::<Result<_, _>>()?;
    if parts.is_empty() {
        Err(IndexError::Empty)
    } else {
        Ok(parts)
    }
}

/// The demonstrations among sorted frames, each with the number of its first frame.
fn numbers<F>(frames: &[F], number: impl Fn(&F) -> (u32, u32)) -> Vec<(u32, u32)> {
    let demos = frames.chunk_by(|a, b| number(a).0 == number(b).0);
    demos.filter_map(|demo| demo.first().map(&number)).collect()
}

/// Checks that no demonstration is in two parts.
fn apart(parts: impl Iterator<Item = Vec<(u32, u32)>>) -> Result<(), IndexError> {
    let mut seen = BTreeSet::new();
    for (episode, frame) in parts.flatten() {
        if !seen.insert(episode) {
            return Err(IndexError::Duplicate { episode, frame });
        }
    }
    Ok(())
}

//! From demonstrations to rows of the table.

use crate::envelope::envelope_distance;
use rayon::prelude::*;

use crate::information::{Chunk, Space, reference};
use crate::motion::{FEATURES, Motion, chunks, idle_share, path_efficiency, regrasps};
use crate::novelty::{Descriptor, Paths, describe};
use crate::ranks::ranks;
use crate::smoothness::{log_dimensionless_jerk, spectral_arc_length};
use crate::tables::{Better, KINDS, PathRow, Ranks, ScoreRow, Scores, SketchRow};

/// What is kept of a demonstration: its own scores and what the comparison with others needs, at most about 4 kB.
#[derive(Debug, Clone, PartialEq)]
pub struct Sketch {
    episode: u32,
    scores: Scores,
    chunks: Vec<Chunk>,
    path: Option<Descriptor>,
}

/// Maximum number of chunks that are kept of a demonstration; of a longer one, evenly spaced chunks.
const CHUNKS: usize = 64;

impl Sketch {
    /// Sketches the demonstration with this number.
    pub fn of(episode: u32, motion: &Motion) -> Self {
        let all = chunks(motion);
        let kept = all.len().min(CHUNKS);
        let narrow = |number: usize| all[number * all.len() / kept].map(|part| part.map(|value| value as f32));
        Self {
            episode,
            scores: Scores {
                duration: Some(motion.duration()),
                path_efficiency: path_efficiency(motion),
                log_dimensionless_jerk: log_dimensionless_jerk(motion),
                spectral_arc_length: spectral_arc_length(motion),
                envelope_distance: envelope_distance(motion),
                idle_share: idle_share(motion),
                regrasps: regrasps(motion),
                information: None,
                novelty: None,
            },
            chunks: (0..kept).map(narrow).collect(),
            path: describe(motion),
        }
    }
}

impl Sketch {
    /// Number of the demonstration.
    pub fn episode(&self) -> u32 {
        self.episode
    }

    /// Number of its chunks.
    pub fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// Its row in table `sketches`.
    pub fn to_row(&self) -> SketchRow {
        SketchRow {
            episode: self.episode,
            scores: self.scores,
            chunks: self.chunks.as_flattened().as_flattened().to_vec(),
        }
    }

    /// Its row in table `paths`; `None` if it has no frames.
    pub fn to_path_row(&self) -> Option<PathRow> {
        Some(PathRow {
            episode: self.episode,
            knots: self.path.as_ref()?.coordinates(),
        })
    }

    /// The sketch of a row, without its path. `None` if the row has a part of a chunk.
    pub fn from_row(row: &SketchRow) -> Option<Self> {
        Some(Self {
            episode: row.episode,
            scores: row.scores,
            chunks: row.chunks()?,
            path: None,
        })
    }
}

impl SketchRow {
    /// The chunks. `None` if the row has a part of one.
    pub fn chunks(&self) -> Option<Vec<Chunk>> {
        let (halves, rest) = self.chunks.as_chunks::<FEATURES>();
        let (chunks, half) = halves.as_chunks::<2>();
        (rest.is_empty() && half.is_empty()).then(|| chunks.to_vec())
    }
}

/// What demonstrations are compared with: chunks of a sample, and the paths of all.
pub struct Others {
    space: Option<Space>,
    /// Numbers of the demonstrations with a path, ascending.
    described: Vec<u32>,
    paths: Paths,
}

impl Others {
    /// `reference` are the chunks at the places of [`reference`](crate::reference), `paths` those of all demonstrations, by number, of
    /// which there are `count`. `None` if a row has more or fewer positions than a path.
    pub fn new(reference: &[Chunk], count: usize, paths: impl IntoIterator<Item = PathRow>) -> Option<Self> {
        // Growing vectors would take up to three times the memory.
        let (mut described, mut all) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for row in paths {
            described.push(row.episode);
            all.push(Descriptor::of_coordinates(&row.knots)?);
        }
        Some(Self::of(reference, described, all))
    }

    fn of(reference: &[Chunk], described: Vec<u32>, paths: Vec<Descriptor>) -> Self {
        Self {
            space: Space::over(reference),
            described,
            paths: Paths::new(paths),
        }
    }

    /// The row of a demonstration, without ranks and quality.
    pub fn score(&self, sketch: &Sketch) -> ScoreRow {
        let place = self.described.binary_search(&sketch.episode).ok();
        let nearest = place.and_then(|place| self.paths.nearest(place));
        let space = self.space.as_ref();
        ScoreRow {
            episode: sketch.episode,
            quality: None,
            scores: Scores {
                information: space.and_then(|space| space.mean_contribution(&sketch.chunks)),
                novelty: nearest.map(|(_, distance)| distance),
                ..sketch.scores
            },
            rank: NO_RANKS,
            nearest: nearest.and_then(|(other, _)| self.described.get(other).copied()),
        }
    }
}

/// Scores the demonstrations, in the order of the sketches, which is that of their numbers.
pub fn score(sketches: &[Sketch]) -> Vec<ScoreRow> {
    let all: Vec<&Chunk> = sketches.iter().flat_map(|sketch| &sketch.chunks).collect();
    let chosen: Vec<Chunk> = reference(all.len()).map(|place| *all[place]).collect();
    let (described, paths) = sketches
        .iter()
        .filter_map(|sketch| Some((sketch.episode, sketch.path.clone()?)))
        .unzip();
    let others = Others::of(&chosen, described, paths);
    let mut rows: Vec<ScoreRow> = sketches.par_iter().map(|sketch| others.score(sketch)).collect();
    rank(&mut rows);
    rows
}

const NO_RANKS: Ranks = Ranks {
    duration: None,
    path_efficiency: None,
    log_dimensionless_jerk: None,
    spectral_arc_length: None,
    envelope_distance: None,
    idle_share: None,
    regrasps: None,
    information: None,
    novelty: None,
};

/// Fills in the ranks and the quality of the rows of all demonstrations.
pub fn rank(rows: &mut [ScoreRow]) {
    let mut sums = vec![(0.0, 0_u32); rows.len()];
    for kind in KINDS {
        let values: Vec<_> = rows.iter().map(|row| (kind.value)(&row.scores)).collect();
        let found = values.iter().flatten().count();
        for ((row, sum), rank) in rows
            .iter_mut()
            .zip(&mut sums)
            .zip(ranks(&values, kind.better != Better::Lower))
        {
            *(kind.place)(&mut row.rank) = rank;
            if let (Some(rank), true) = (rank, kind.better != Better::Neither && found > 1) {
                sum.0 += (found as f64 - rank) / (found - 1) as f64;
                sum.1 += 1;
            }
        }
    }
    for (row, (sum, count)) in rows.iter_mut().zip(sums) {
        row.quality = (count > 0).then(|| sum / f64::from(count));
    }
}

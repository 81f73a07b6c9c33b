//! From demonstrations to rows of the table.

use crate::envelope::envelope_distance;
use crate::information::{Chunk, information};
use crate::motion::{Motion, chunks, idle_share, path_efficiency, regrasps};
use crate::novelty::{Descriptor, describe, nearest};
use crate::ranks::ranks;
use crate::smoothness::{log_dimensionless_jerk, spectral_arc_length};
use crate::tables::{Better, KINDS, Ranks, ScoreRow, Scores};

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

/// Scores the demonstrations, in the order of the sketches.
pub fn score(sketches: &[Sketch]) -> Vec<ScoreRow> {
    let chunks: Vec<&[Chunk]> = sketches.iter().map(|sketch| &*sketch.chunks).collect();
    let informations = information(&chunks);
    let described: Vec<usize> = (0..sketches.len()).filter(|&at| sketches[at].path.is_some()).collect();
    let paths: Vec<Descriptor> = sketches.iter().filter_map(|sketch| sketch.path.clone()).collect();
    let mut novelties = vec![None; sketches.len()];
    for (&at, found) in described.iter().zip(nearest(&paths)) {
        novelties[at] = found.map(|(other, distance)| (sketches[described[other]].episode, distance));
    }
    let mut rows: Vec<ScoreRow> = sketches
        .iter()
        .zip(informations.into_iter().zip(novelties))
        .map(|(sketch, (information, novelty))| ScoreRow {
            episode: sketch.episode,
            quality: None,
            scores: Scores {
                information,
                novelty: novelty.map(|(_, distance)| distance),
                ..sketch.scores
            },
            rank: NO_RANKS,
            nearest: novelty.map(|(other, _)| other),
        })
        .collect();
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

/// Fills in the ranks and the quality.
fn rank(rows: &mut [ScoreRow]) {
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

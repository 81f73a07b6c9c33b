//! Shared test code: random demonstrations and queries, the real dataset, and the comparison of index and linear scan.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "each test file uses only some of these items, a panic is how a test fails, and skipped tests print the reason"
)]

use std::path::{Path, PathBuf};

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_index::{IndexedFrame, Query, RetrievalIndex, Retrieved, retrieve_linear};
use re4_ingest::Selection;
use re4_ingest::pusht::PushtReader;

pub(crate) struct Random(Pcg64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Pcg64::new(u128::from(seed), 17))
    }

    /// Samples uniformly from `[low, high)`.
    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Samples uniformly from `0..count`.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        (self.0.next_u64() % count as u64) as usize
    }

    pub(crate) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len())]
    }

    pub(crate) fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

pub(crate) fn frame(episode: u32, number: u32, mode: Mode, c: [f64; 5]) -> IndexedFrame {
    IndexedFrame {
        episode,
        frame: number,
        mode,
        eef: Point2::new(c[0], c[1]),
        object: Pose2::new(c[2], c[3], c[4]),
    }
}

pub(crate) fn query(mode: Mode, c: [f64; 5]) -> Query {
    Query {
        mode,
        eef: Point2::new(c[0], c[1]),
        object: Pose2::new(c[2], c[3], c[4]),
    }
}

pub(crate) fn coordinates(frame: &IndexedFrame) -> [f64; 5] {
    let (eef, object) = (frame.eef, frame.object);
    [eef.x, eef.y, object.x, object.y, object.theta]
}

/// The answer with its distances as bit patterns, so that differences in the last digit and NaN are detected.
pub(crate) fn bits(answer: Option<Retrieved>) -> Option<(u32, u32, u64, u64)> {
    answer.map(|a| (a.episode, a.frame, a.d_q.to_bits(), a.d_o.to_bits()))
}

/// Asserts that the index and the linear scan give the same answer, and returns it.
pub(crate) fn agreed(index: &RetrievalIndex, query: &Query, epsilon: f64) -> Option<Retrieved> {
    let fast = index.retrieve(query, epsilon).unwrap();
    let slow = retrieve_linear(index.frames(), index.normalization(), query, epsilon).unwrap();
    assert_eq!(
        bits(fast),
        bits(slow),
        "{query:?}, epsilon {epsilon}: {fast:?} differs from {slow:?}"
    );
    fast
}

/// Frames of the Push-T replay dataset. Returns `None` and prints a line if the dataset does not exist.
pub(crate) fn pusht() -> Option<Vec<IndexedFrame>> {
    let folder = std::env::var_os("RE4_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let dataset = folder.join("pusht/pusht_cchi_v7_replay.zarr");
    if !dataset.exists() {
        eprintln!("skipped: no dataset exists at {}; set RE4_DATA", dataset.display());
        return None;
    }
    let (episodes, _) = PushtReader::open(&dataset)
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap();
    let frames = episodes.planar_episodes().into_iter().flat_map(|episode| {
        (0..).zip(episode.frames).map(move |(number, f)| IndexedFrame {
            episode: episode.source,
            frame: number,
            mode: Mode::Transit,
            eef: f.eef,
            object: f.object,
        })
    });
    Some(frames.collect())
}

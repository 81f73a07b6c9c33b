//! Shared test code: random numbers, demonstrations generated in the simulator, the real dataset, and an independent
//! implementation of the distance to the block.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "each test file uses only some of these items, a panic is how a test fails, and skipped tests print the reason"
)]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng as _;
use re4_episode::{Mode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_index::{AngleMetric, IndexedFrame, RetrievalIndex};
use re4_ingest::Selection;
use re4_ingest::pusht::PushtReader;
use re4_policy::{ChunkLibrary, Decision, DemoSet, Knowledge, PolicyConfig, Re4Factory, collect_chunks};
use re4_rollout::{Conditions, Harness, Plane, PushTEnv, Rollout, RolloutError, Source, Start};
use re4_sim::{PushT, ResetOrder, SeedScheme, Simulator as _, scene_from_seed};

/// Maximum length of chunks in frames, as in the pipelines.
pub(crate) const LONGEST: usize = 256;

pub(crate) struct Random(Pcg64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(Pcg64::new(u128::from(seed), 23))
    }

    /// Samples uniformly from `[low, high)`.
    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn point(&mut self, low: f64, high: f64) -> Point2 {
        Point2::new(self.range(low, high), self.range(low, high))
    }

    pub(crate) fn block(&mut self) -> Pose2 {
        let at = self.point(100.0, 400.0);
        Pose2::new(at.x, at.y, self.range(-7.0, 7.0))
    }
}

/// Outline of the block in the block frame, in pixels: the T of gym-pusht 0.1.8 (`add_tee`, scale 30, length 4).
pub(crate) const OUTLINE: [[f64; 2]; 8] = [
    [-60.0, 0.0],
    [60.0, 0.0],
    [60.0, 30.0],
    [15.0, 30.0],
    [15.0, 120.0],
    [-15.0, 120.0],
    [-15.0, 30.0],
    [-60.0, 30.0],
];

/// Distance from a point to the block, 0 inside. Computed by the even-odd rule and the nearest point of each edge.
pub(crate) fn distance_to_tee(block: Pose2, p: Point2) -> f64 {
    let (dx, dy) = (p.x - block.x, p.y - block.y);
    let x = dx * block.theta.cos() + dy * block.theta.sin();
    let y = dy * block.theta.cos() - dx * block.theta.sin();
    let mut inside = false;
    let mut nearest = f64::INFINITY;
    for i in 0..OUTLINE.len() {
        let ([ax, ay], [bx, by]) = (OUTLINE[i], OUTLINE[(i + 1) % OUTLINE.len()]);
        if (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax) {
            inside = !inside;
        }
        let t = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax).powi(2) + (by - ay).powi(2));
        let t = t.clamp(0.0, 1.0);
        nearest = nearest.min((x - ax - t * (bx - ax)).hypot(y - ay - t * (by - ay)));
    }
    if inside { 0.0 } else { nearest }
}

pub(crate) type Demos = Vec<(u32, Vec<(PlanarFrame, Mode)>)>;

/// Generates demonstrations in the simulator: the pusher moves to a point beside the block, pushes through the middle of the
/// block and moves back, several times.
pub(crate) fn scripted(count: u32) -> Demos {
    let mut random = Random::new(9);
    let mut simulator = PushT::new().unwrap();
    (0..count)
        .map(|number| {
            let scene = scene_from_seed(SeedScheme::DiffusionPolicy, 700_000 + number);
            let mut now = simulator.reset(&scene, ResetOrder::Legacy).unwrap();
            let mut contacts = 0.0;
            let mut frames = Vec::new();
            for _ in 0..4 {
                let angle = random.range(0.0, std::f64::consts::TAU);
                let direction = Point2::new(angle.cos(), angle.sin());
                let middle = now.block.transform_point(Point2::new(0.0, 45.0)) + random.point(-20.0, 20.0);
                let inside = |p: Point2| Point2::new(p.x.clamp(20.0, 492.0), p.y.clamp(20.0, 492.0));
                for goal in [
                    middle + direction * 130.0,
                    middle - direction * 10.0,
                    middle + direction * 130.0,
                ]
                .map(inside)
                {
                    for _ in 0..15 {
                        let step = goal - now.agent;
                        let action = now.agent + step * (25.0 / step.norm()).min(1.0);
                        frames.push((
                            PlanarFrame {
                                eef: now.agent,
                                object: now.block,
                                action,
                                contacts,
                            },
                            Mode::Transit,
                        ));
                        let after = simulator.step(&action).unwrap();
                        contacts = f64::from(after.contacts);
                        now = after.observation;
                    }
                }
            }
            (number, frames)
        })
        .collect()
}

/// Removes the modes from demonstrations.
pub(crate) fn without_modes(demos: Demos) -> impl Iterator<Item = (u32, Vec<PlanarFrame>)> {
    let frames_of = |frames: Vec<(PlanarFrame, Mode)>| frames.into_iter().map(|(frame, _)| frame).collect();
    demos
        .into_iter()
        .map(move |(number, frames)| (number, frames_of(frames)))
}

/// Builds the data that a policy with either selector needs.
pub(crate) fn knowledge(demos: Demos, angle: AngleMetric) -> Arc<Knowledge> {
    let indexed = demos
        .iter()
        .flat_map(|(episode, frames)| {
            (0..).zip(frames).map(|(number, (frame, mode))| IndexedFrame {
                episode: *episode,
                frame: number,
                mode: *mode,
                eef: frame.eef,
                object: frame.object,
            })
        })
        .collect();
    let demos = DemoSet::new(without_modes(demos));
    let chunks = ChunkLibrary::build(collect_chunks(&demos, LONGEST)).unwrap();
    Arc::new(Knowledge {
        demos,
        index: RetrievalIndex::build(indexed, angle).unwrap(),
        chunks: Some(chunks),
    })
}

/// The benchmark's starts for these seeds.
pub(crate) fn starts(seeds: &[u32]) -> Vec<Start<Plane>> {
    let start = |&seed| Start::from_seed(SeedScheme::DiffusionPolicy, ResetOrder::Legacy, seed);
    seeds.iter().map(start).collect()
}

/// Rolls out RE4 with recorded poses.
pub(crate) fn rollouts(
    config: &PolicyConfig,
    knowledge: &Arc<Knowledge>,
    starts: &[Start<Plane>],
    max_steps: u32,
    progress: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Rollout<Plane, Decision>>, RolloutError> {
    let factory = Re4Factory {
        config: config.clone(),
        knowledge: Arc::clone(knowledge),
    };
    let harness = Harness {
        env: &|_| Ok(Box::new(PushTEnv::new()?)),
        source: &|_| Source::Recorded,
        conditions: Conditions::default(),
        max_steps,
        progress,
        times: &re4_rollout::ActTimes::default(),
    };
    re4_rollout::rollouts(&factory, &harness, starts)
}

/// The Push-T replay dataset. Returns `None` and prints a line if the dataset does not exist.
pub(crate) fn pusht() -> Option<Demos> {
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
    let demos = episodes.planar_episodes().into_iter().map(|episode| {
        let frames = episode.frames.into_iter().map(|frame| (frame, Mode::Transit));
        (episode.source, frames.collect())
    });
    Some(demos.collect())
}

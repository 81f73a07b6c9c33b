//! The stage `replay`: replays the actions of `episodes` open-loop and writes `replays`.

mod spatial;
mod tables;

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Stage};
use re4_episode::episode_name;
use re4_policy::{Divergence, OpenLoop, replay_open_loop};
use re4_sim::PushT;
use re4_stats::{median, spread};
use serde_json::json;

pub use tables::{DivergenceRow, PlanarDivergenceRow, PlanarReplay, ReplayRow, SpatialDivergence, SpatialReplay};

use crate::inputs::episodes::read_episodes;
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 4;

/// The demonstration's number in the raw dataset, and its replay.
type Replay = (u32, OpenLoop);

impl Runner {
    /// Makes the `replays` artifact of Push-T, or returns the existing one.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn replay(&self, episodes: &Built) -> Result<Built> {
        let recipe = Recipe::new(Stage::Replay, CODE_VERSION).input("episodes", episodes.artifact.key());
        self.build(&recipe, |writer| {
            let replays = replay_all(&episodes.artifact)?;
            writer.write_rows((0..).zip(&replays).map(|(episode, (source, replay))| row(episode, *source, replay)))?;
            let distances = |(episode, (_, replay)): (u32, &Replay)| {
                let distances = (0..).zip(replay.divergence.clone());
                distances.map(move |(frame, distance)| DivergenceRow {
                    episode,
                    frame,
                    distance,
                })
            };
            writer.write_rows((0..).zip(&replays).flat_map(distances))?;
            let frames = || replays.iter().flat_map(|(_, replay)| &replay.divergence);
            let distribution = |value: fn(&Divergence) -> f64| spread(frames().map(value), &[0.5, 0.9, 0.99, 1.0]);
            let count = replays.len().max(1) as f64;
            let mean = |value: fn(&OpenLoop) -> f64| replays.iter().map(|(_, r)| value(r)).sum::<f64>() / count;
            Ok(ArtifactSummary {
                summary: json!({
                    "episodes": replays.len(),
                    "frames": frames().count(),
                    "block_px": distribution(|d| d.block),
                    "pusher_px": distribution(|d| d.pusher),
                    "episodes_within_1_px": replays.iter().filter(|(_, r)| r.divergence.iter().all(|d| d.block <= 1.0)).count(),
                    "coverage_recorded_mean": mean(|r| r.coverage_recorded),
                    "coverage_replayed_mean": mean(|r| r.coverage_replayed),
                    "coverage_after_mean": mean(|r| r.coverage_after),
                }),
                warnings: Vec::new(),
            })
        })
    }
}

fn replay_all(episodes: &Artifact) -> Result<Vec<Replay>> {
    read_episodes(episodes)?
        .par_iter()
        .map(|episode| {
            let mut simulator = PushT::new()?;
            let replay = replay_open_loop(&mut simulator, &episode.frames)
                .with_context(|| format!("cannot replay {}", episode.name()))?
                .with_context(|| format!("cannot replay {}: it has no frames", episode.name()))?;
            Ok((episode.source, replay))
        })
        .collect::<Vec<_>>()
        .into_iter()
        .collect()
}

fn row(episode: u32, source: u32, replay: &OpenLoop) -> ReplayRow<PlanarReplay> {
    let distances = &replay.divergence;
    let largest = |value: fn(&Divergence) -> f64| distances.iter().map(value).fold(0.0, f64::max);
    let blocks: Vec<f64> = distances.iter().map(|d| d.block).collect();
    ReplayRow {
        episode,
        source_episode: Some(source),
        frames: distances.len(),
        replay: PlanarReplay {
            pusher_max: largest(|d| d.pusher),
            block_median: median(&blocks).unwrap_or(f64::NAN),
            block_max: largest(|d| d.block),
            block_final: blocks.last().copied().unwrap_or_default(),
            coverage_recorded: replay.coverage_recorded,
            coverage_replayed: replay.coverage_replayed,
            coverage_after: replay.coverage_after,
        },
        demo_name: Some(episode_name(source)),
    }
}

//! Replay: `episodes`, replayed open-loop, to `replays`.

mod spatial;

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use re4_artifact::{Artifact, Columns, Facts, Recipe, Stage, tables};
use re4_policy::{Divergence, OpenLoop, replay_open_loop};
use re4_sim::PushT;
use re4_stats::{median, spread};
use serde_json::json;

use crate::inputs::episodes::read_episodes;
use crate::runner::{Built, Runner};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 2;

/// A replay, with the number that the demonstration has in the raw dataset.
type Replay = (u32, OpenLoop);

impl Runner {
    /// The `replays` artifact.
    ///
    /// # Errors
    /// When an input, or a setting of the pipeline, does not allow it; or at Ctrl-C.
    pub fn replay(&self, episodes: &Built) -> Result<Built> {
        let recipe = Recipe::new(Stage::Replay, CODE_VERSION).input("episodes", episodes.artifact.key());
        self.build(&recipe, |writer| {
            let replays = replay_all(&episodes.artifact)?;
            let mut table = writer.table(&tables::REPLAYS)?;
            table.write_columns(replay_columns(&replays))?;
            table.finish()?;
            let mut table = writer.table(&tables::DIVERGENCE)?;
            table.write_columns(divergence_columns(&replays))?;
            table.finish()?;
            let frames = || replays.iter().flat_map(|(_, replay)| &replay.divergence);
            let distribution = |value: fn(&Divergence) -> f64| spread(frames().map(value), &[0.5, 0.9, 0.99, 1.0]);
            let count = replays.len().max(1) as f64;
            let mean = |value: fn(&OpenLoop) -> f64| replays.iter().map(|(_, r)| value(r)).sum::<f64>() / count;
            Ok(Facts {
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

fn replay_columns(replays: &[Replay]) -> Columns {
    let of = |value: fn(&OpenLoop) -> f64| replays.iter().map(|(_, r)| value(r)).collect::<Vec<f64>>();
    let largest = |r: &OpenLoop, value: fn(&Divergence) -> f64| r.divergence.iter().map(value).fold(0.0, f64::max);
    Columns::new(&tables::REPLAYS)
        .u32("episode", (0..replays.len() as u32).collect())
        .u32("source_episode", replays.iter().map(|(source, _)| *source).collect())
        .u32(
            "frames",
            replays.iter().map(|(_, r)| r.divergence.len() as u32).collect(),
        )
        .f64(
            "pusher_max",
            replays.iter().map(|(_, r)| largest(r, |d| d.pusher)).collect(),
        )
        .f64(
            "block_median",
            of(|r| median(&r.divergence.iter().map(|d| d.block).collect::<Vec<_>>()).unwrap_or(f64::NAN)),
        )
        .f64(
            "block_max",
            replays.iter().map(|(_, r)| largest(r, |d| d.block)).collect(),
        )
        .f64("block_final", of(|r| r.divergence.last().map_or(0.0, |d| d.block)))
        .f64("coverage_recorded", of(|r| r.coverage_recorded))
        .f64("coverage_replayed", of(|r| r.coverage_replayed))
        .f64("coverage_after", of(|r| r.coverage_after))
}

fn divergence_columns(replays: &[Replay]) -> Columns {
    let rows = || {
        replays.iter().enumerate().flat_map(|(e, (_, r))| {
            r.divergence
                .iter()
                .enumerate()
                .map(move |(f, d)| (e as u32, f as u32, d))
        })
    };
    let of = |value: fn(&Divergence) -> f64| rows().map(|(_, _, d)| value(d)).collect::<Vec<f64>>();
    Columns::new(&tables::DIVERGENCE)
        .u32("episode", rows().map(|(e, ..)| e).collect())
        .u32("frame", rows().map(|(_, f, _)| f).collect())
        .f64("pusher", of(|d| d.pusher))
        .f64("block_position", of(|d| d.block_position))
        .f64("block_angle", of(|d| d.block_angle))
        .f64("block", of(|d| d.block))
}

//! `re4-pipe video`: renders rollouts as a GIF file.

use std::io::BufWriter;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Stage};
use re4_fault::{bail, ensure};
use re4_report::{
    SceneRollout, VideoRollout, VideoSettings, is_spatial, planar_videos, scene_rollout, write_scene_video, write_video,
};
use re4_stages::{Interrupt, Rerendered};
use serde_json::json;

use super::Outcome;
use crate::arguments::VideoArguments;
use crate::console::Console;
use crate::output::Output;

/// Writes the video.
pub(crate) fn video(arguments: &VideoArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let interrupt = Interrupt::listen(None);
    let out = &arguments.out;
    if !out
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("gif"))
    {
        bail!("cannot write a video to {}", out.display(); "videos are GIF files, so give a name that ends in .gif");
    }
    let artifact = Artifact::open(&arguments.path)?;
    let kind = &artifact.manifest().artifact;
    ensure!(
        *kind == Stage::Rollout.artifact(),
        "cannot make a video of {}: it is an artifact of kind {kind}, not rollouts",
        arguments.path.display()
    );
    artifact.verify_bytes()?;
    let seeds = arguments.seeds.as_slice();
    let store = &arguments.common.artifacts;
    let mut videos = if is_spatial(&artifact) {
        let rerendered = Rerendered::new(&artifact, seeds, arguments.size, store)?;
        Videos::Spatial(
            rerendered.rollouts.iter().map(scene_rollout).collect(),
            Box::new(rerendered),
        )
    } else {
        let (rollouts, chunks) = planar_videos(&artifact, seeds, store)?;
        if !chunks {
            console.note(&format!(
                "the video shows no chunks, because the index of {} was not found",
                artifact.path().display()
            ));
        }
        Videos::Planar(rollouts, chunks)
    };

    let output = Output::at(out, "video")?;
    let temporary = output.temporary()?;
    let settings = VideoSettings {
        size: arguments.size,
        speed: arguments.speed,
    };
    let bar = console.progress(videos.states() as u64, "video");
    let mut going = || {
        bar.inc(1);
        !interrupt.requested()
    };
    let file = BufWriter::new(temporary.as_file());
    let summary = match &mut videos {
        Videos::Planar(rollouts, _) => write_video(file, rollouts, settings, &mut going),
        Videos::Spatial(rollouts, rerendered) => {
            let mut render = |rollout, state| rerendered.render(rollout, state).map_err(Into::into);
            write_scene_video(file, rollouts, settings, &mut render, &mut going)
        }
    }
    .with_context(|| format!("cannot make the video {}", out.display()))?;
    bar.finish_and_clear();
    let bytes = temporary
        .as_file()
        .metadata()
        .with_context(|| format!("cannot write the video {}", out.display()))?
        .len();
    output.keep(temporary)?;

    let seconds = f64::from(summary.duration_cs) / 100.0;
    let mut answer = json!({
        "path": out,
        "bytes": bytes,
        "width": summary.width,
        "height": summary.height,
        "frames": summary.frames,
        "seconds": seconds,
    });
    if let Videos::Planar(_, chunks) = videos {
        answer["chunks"] = json!(chunks);
    }
    console.answer(&answer)?;
    console.say(&format!(
        "video written to {}: {} x {} px, {} frames, {seconds} s, {bytes} bytes",
        out.display(),
        summary.width,
        summary.height,
        summary.frames
    ))?;
    Ok(Outcome::Done)
}

/// The rollouts in the video.
enum Videos {
    /// Rollouts of Push-T, and whether the video shows their chunks.
    Planar(Vec<VideoRollout>, bool),
    /// Rollouts of a robosuite task, and their simulations, which are rendered.
    Spatial(Vec<SceneRollout>, Box<Rerendered>),
}

impl Videos {
    /// Number of states of the longest rollout.
    fn states(&self) -> usize {
        let most = match self {
            Self::Planar(rollouts, _) => rollouts.iter().map(|rollout| rollout.states.len()).max(),
            Self::Spatial(rollouts, _) => rollouts.iter().map(|rollout| rollout.states.len()).max(),
        };
        most.unwrap_or(0)
    }
}

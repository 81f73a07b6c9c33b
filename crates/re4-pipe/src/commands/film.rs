//! `re4-pipe film`: rollouts as a GIF.

use std::io::BufWriter;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Stage};
use re4_fault::{bail, ensure};
use re4_report::{
    FilmRollout, FilmSettings, SceneRollout, is_spatial, planar_films, scene_rollout, write_film, write_scene_film,
};
use re4_stages::{Interrupt, Redrawn};
use serde_json::json;

use super::Outcome;
use crate::arguments::FilmArguments;
use crate::console::Console;
use crate::output::Output;

/// Writes the film, whole or not at all.
pub(crate) fn film(arguments: &FilmArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let interrupt = Interrupt::listen(None);
    let out = &arguments.out;
    if !out
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("gif"))
    {
        bail!("cannot write a film to {}", out.display(); "films are GIF files, give a name that ends in .gif");
    }
    let artifact = Artifact::open(&arguments.path)?;
    let kind = &artifact.manifest().artifact;
    ensure!(
        *kind == Stage::Rollout.artifact(),
        "cannot film {}: it is an artifact of kind {kind}, and films are made of rollouts",
        arguments.path.display()
    );
    artifact.verify_bytes()?;
    let seeds = arguments.seeds.as_slice();
    let store = &arguments.common.artifacts;
    let mut films = if is_spatial(&artifact) {
        let redrawn = Redrawn::new(&artifact, seeds, arguments.size, store)?;
        Films::Spatial(redrawn.rollouts.iter().map(scene_rollout).collect(), Box::new(redrawn))
    } else {
        let (rollouts, chunks) = planar_films(&artifact, seeds, store)?;
        if !chunks {
            console.note(&format!(
                "the index of {} is not beside it, so chunks are not drawn",
                artifact.path().display()
            ));
        }
        Films::Planar(rollouts, chunks)
    };

    let output = Output::at(out, "film")?;
    let temporary = output.temporary()?;
    let settings = FilmSettings {
        size: arguments.size,
        speed: arguments.speed,
    };
    let bar = console.progress(films.states() as u64, "film");
    let mut going = || {
        bar.inc(1);
        !interrupt.requested()
    };
    let file = BufWriter::new(temporary.as_file());
    let facts = match &mut films {
        Films::Planar(rollouts, _) => write_film(file, rollouts, settings, &mut going),
        Films::Spatial(rollouts, redrawn) => {
            let mut draw = |rollout, state| redrawn.draw(rollout, state).map_err(Into::into);
            write_scene_film(file, rollouts, settings, &mut draw, &mut going)
        }
    }
    .with_context(|| format!("cannot make the film {}", out.display()))?;
    bar.finish_and_clear();
    let bytes = temporary
        .as_file()
        .metadata()
        .with_context(|| format!("cannot write the film {}", out.display()))?
        .len();
    output.keep(temporary)?;

    let seconds = f64::from(facts.duration_cs) / 100.0;
    let mut answer = json!({
        "path": out,
        "bytes": bytes,
        "width": facts.width,
        "height": facts.height,
        "frames": facts.frames,
        "seconds": seconds,
    });
    if let Films::Planar(_, chunks) = films {
        answer["chunks"] = json!(chunks);
    }
    console.answer(&answer)?;
    console.say(&format!(
        "film in {}: {} x {} px, {} frames, {seconds} s, {bytes} bytes",
        out.display(),
        facts.width,
        facts.height,
        facts.frames
    ))?;
    Ok(Outcome::Done)
}

/// What is filmed.
enum Films {
    /// Push-T's rollouts, and whether the film shows chunks.
    Planar(Vec<FilmRollout>, bool),
    /// Rollouts of a robosuite task, and what draws them.
    Spatial(Vec<SceneRollout>, Box<Redrawn>),
}

impl Films {
    /// States of the longest rollout.
    fn states(&self) -> usize {
        let most = match self {
            Self::Planar(rollouts, _) => rollouts.iter().map(|rollout| rollout.states.len()).max(),
            Self::Spatial(rollouts, _) => rollouts.iter().map(|rollout| rollout.states.len()).max(),
        };
        most.unwrap_or(0)
    }
}

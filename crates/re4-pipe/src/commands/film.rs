//! `re4-pipe film`: rollouts as a GIF.

pub(super) mod spatial;

use std::io::BufWriter;
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail, ensure};
use arrow::array::RecordBatch;
use re4_artifact::Row as _;
use re4_artifact::{Artifact, ArtifactError, Stage, col_f64, col_f64_list, col_text, col_u32};
use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};
use re4_report::{FilmDecision, FilmRollout, FilmSettings, FilmState, write_film, write_scene_film};
use re4_sim::{GOAL, coverage};
use serde_json::json;

use super::{Outcome, names_of_decisions, rollout_tables};
use crate::arguments::FilmArguments;
use crate::console::Console;
use crate::output::Output;
use re4_stages::Interrupt;

/// Writes the film, whole or not at all.
pub(crate) fn film(arguments: &FilmArguments) -> Result<Outcome> {
    let console = Console::new(&arguments.common);
    let interrupt = Interrupt::listen(None);
    let out = &arguments.out;
    if !out
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("gif"))
    {
        bail!(
            "cannot write a film to {}; films are GIF files, give a name that ends in .gif",
            out.display()
        );
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
    let in_space = rollout_tables::in_space(&artifact);
    let mut films = if in_space {
        let store = &arguments.common.artifacts;
        Films::Spatial(Box::new(spatial::Films::read(&artifact, seeds, arguments.size, store)?))
    } else {
        let (rollouts, chunks) = read_films(&artifact, seeds, console)?;
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
        Films::Spatial(films) => {
            let rollouts = films.rollouts.clone();
            let mut draw = |rollout, state| films.draw(rollout, state).map_err(Into::into);
            write_scene_film(file, &rollouts, settings, &mut draw, &mut going)
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
    /// Rollouts of a robosuite task.
    Spatial(Box<spatial::Films>),
}

impl Films {
    /// States of the longest rollout.
    fn states(&self) -> usize {
        let most = match self {
            Self::Planar(rollouts, _) => rollouts.iter().map(|rollout| rollout.states.len()).max(),
            Self::Spatial(films) => films.rollouts.iter().map(|rollout| rollout.states.len()).max(),
        };
        most.unwrap_or(0)
    }
}

/// Films of some of an artifact's rollouts, in the order asked for, and whether they show chunks.
fn read_films(artifact: &Artifact, seeds: &[u32], console: Console) -> Result<(Vec<FilmRollout>, bool)> {
    let results = rollout_tables::results(artifact)?;
    let steps = rollout_tables::steps(artifact)?;
    let decisions = rollout_tables::decisions(artifact)?;
    let demos = Demos::of(artifact, console)?;
    let films = seeds.iter().map(|&seed| {
        let known = col_u32(&results, "seed")?;
        let row = known.iter().position(|other| *other == seed).with_context(|| {
            format!(
                "cannot film seed {seed}: the artifact {} has no such rollout; give one of its seeds",
                artifact.path().display()
            )
        })?;
        Ok(FilmRollout {
            seed,
            states: read_states(&results, row, &steps, seed)?,
            decisions: read_decisions(&decisions, seed, demos.as_ref())?,
        })
    });
    Ok((films.collect::<Result<_>>()?, demos.is_some()))
}

/// Rows of a table that belong to a seed.
fn rows_of(table: &RecordBatch, seed: u32) -> Result<Vec<usize>> {
    let seeds = col_u32(table, "seed")?.iter().enumerate();
    Ok(seeds.filter(|(_, other)| **other == seed).map(|(row, _)| row).collect())
}

fn read_states(results: &RecordBatch, row: usize, steps: &RecordBatch, seed: u32) -> Result<Vec<FilmState>> {
    let start = |name| -> Result<f64> { Ok(col_f64(results, name)?[row]) };
    let block = Pose2::new(start("object_x")?, start("object_y")?, start("object_theta")?);
    let mut states = vec![FilmState {
        pusher: Point2::new(start("eef_x")?, start("eef_y")?),
        block,
        coverage: coverage(block, GOAL),
        decision: 0,
        replaying: false,
    }];
    let column = |name| col_f64(steps, name);
    let (x, y, cover) = (column("eef_x")?, column("eef_y")?, column("coverage")?);
    let (bx, by, bt) = (column("object_x")?, column("object_y")?, column("object_theta")?);
    let (decision, phase) = (col_u32(steps, "decision")?, col_text(steps, "phase")?);
    let rows = rows_of(steps, seed)?;
    for (i, &at) in rows.iter().enumerate() {
        // A state is shown with the action that follows on it.
        let of_action = |at: usize| (decision[at] as usize, phase[at] == Some("replay"));
        if let Some(state) = states.last_mut() {
            (state.decision, state.replaying) = of_action(at);
        }
        let (decision, replaying) = of_action(rows.get(i + 1).copied().unwrap_or(at));
        states.push(FilmState {
            pusher: Point2::new(x[at], y[at]),
            block: Pose2::new(bx[at], by[at], bt[at]),
            coverage: cover[at],
            decision,
            replaying,
        });
    }
    Ok(states)
}

fn read_decisions(decisions: &RecordBatch, seed: u32, demos: Option<&Demos>) -> Result<Vec<FilmDecision>> {
    let number = |name| col_u32(decisions, name);
    let (demo, first, last) = (number("demo")?, number("demo_frame")?, number("demo_end")?);
    let names = names_of_decisions(decisions)?;
    let column = |name| col_f64(decisions, name);
    let (x, y, theta) = (column("delta_x")?, column("delta_y")?, column("delta_theta")?);
    let (modes, plans) = (col_text(decisions, "mode")?, col_f64_list(decisions, "plan_path")?);
    let rows = rows_of(decisions, seed)?;
    let film = |at: usize| {
        // What is replayed in transfer is not carried (re4-policy's `reframe`).
        let carry = match modes[at].and_then(Mode::from_name) {
            Some(Mode::Transfer) => Pose2::IDENTITY,
            _ => Pose2::new(x[at], y[at], theta[at]),
        };
        let chunk = demos.map_or(&[][..], |demos| demos.chunk(demo[at], first[at], last[at]));
        FilmDecision {
            demo: names[at].clone(),
            frames: (first[at], last[at]),
            plan: plans[at].chunks_exact(2).map(|p| Point2::new(p[0], p[1])).collect(),
            chunk: chunk.iter().map(|p| carry.transform_point(*p)).collect(),
        }
    };
    Ok(rows.into_iter().map(film).collect())
}

/// Where the pusher was in the demonstrations, from the index that the rollouts were made with.
struct Demos {
    /// Demonstration and frame of each position, ascending.
    frames: Vec<(u32, u32)>,
    positions: Vec<Point2>,
}

impl Demos {
    /// Nothing if the index is not in the same artifacts folder; says so.
    fn of(rollouts: &Artifact, console: Console) -> Result<Option<Self>> {
        let Some(folder) = index_folder(rollouts) else {
            console.note(&format!(
                "the index of {} is not beside it, so chunks are not drawn",
                rollouts.path().display()
            ));
            return Ok(None);
        };
        let index = Artifact::open(&folder)?;
        index.verify_bytes()?;
        let table = index
            .table(re4_index::IndexRow::<re4_index::PlanarState>::table())?
            .read_columns(&["episode", "frame", "eef_x", "eef_y"])?;
        let read = || -> Result<Self, ArtifactError> {
            let (episodes, frames) = (col_u32(&table, "episode")?, col_u32(&table, "frame")?);
            let (x, y) = (col_f64(&table, "eef_x")?, col_f64(&table, "eef_y")?);
            Ok(Self {
                frames: episodes.iter().copied().zip(frames.iter().copied()).collect(),
                positions: x.iter().zip(y).map(|(x, y)| Point2::new(*x, *y)).collect(),
            })
        };
        Ok(Some(read()?))
    }

    fn chunk(&self, demo: u32, first: u32, last: u32) -> &[Point2] {
        let start = self.frames.partition_point(|at| *at < (demo, first));
        let end = self.frames.partition_point(|at| *at <= (demo, last));
        self.positions.get(start..end).unwrap_or_default()
    }
}

/// Folder of the index artifact, if it is where the stages put it.
fn index_folder(rollouts: &Artifact) -> Option<PathBuf> {
    let key = rollouts.manifest().inputs.get("index")?;
    let folder = rollouts.path().join("../../index").join(key.short());
    folder.is_dir().then_some(folder)
}

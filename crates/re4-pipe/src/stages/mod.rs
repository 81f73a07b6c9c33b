//! The stages: which artifacts go in, which come out.

mod audit;
mod budgets;
mod demos;
mod index;
mod ingest;
mod pictures;
mod replay;
mod rollout;
mod scenes;
mod segment;
mod simulators;
mod spatial_modes;
mod train_pose;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Facts, Key, Recipe, Stage, Store, Writer};
use re4_ingest::{IngestError, Stop};
use serde_json::{Value, json};

use crate::arguments::{Common, StageArguments};
use crate::console::Console;
use crate::interrupt::Interrupt;
use crate::pipeline::{Pipeline, load};

pub(crate) use budgets::BUDGET_MEASURES;
pub(crate) use ingest::{INGEST_WORKER, encode_png, serve_ingest};
pub(crate) use rollout::{Lens, Studio, metrics, put_renderer_away, read_rollouts, unseen};
pub(crate) use simulators::Scenes;

/// A pipeline with all that its stages need.
pub(crate) struct Runner {
    /// The pipeline file, overrides applied.
    pub(crate) pipeline: Pipeline,
    /// Where artifacts are.
    pub(crate) store: Store,
    /// Where to print.
    pub(crate) console: Console,
    /// Ctrl-C.
    pub(crate) interrupt: Interrupt,
}

/// An artifact, and how it came about.
pub(crate) struct Built {
    /// Stage.
    pub(crate) stage: Stage,
    /// The artifact.
    pub(crate) artifact: Artifact,
    /// Whether it was there already.
    pub(crate) skipped: bool,
    /// How long making or checking it took.
    pub(crate) wall: Duration,
}

impl Built {
    /// For `--json`.
    pub(crate) fn to_json(&self) -> Value {
        json!({
            "stage": self.stage.as_str(),
            "artifact": self.artifact.path(),
            "key": self.artifact.key(),
            "skipped": self.skipped,
            "summary": self.artifact.manifest().summary,
            "warnings": self.artifact.manifest().warnings,
            "wall_s": self.wall.as_secs_f64(),
        })
    }
}

impl Runner {
    /// Reads the pipeline file, sets up threads and opens the store.
    pub(crate) fn new(arguments: &StageArguments, more_overrides: &[String]) -> Result<Self> {
        let mut overrides = arguments.set.clone();
        if arguments.no_images {
            overrides.push("ingest.images=false".to_owned());
        }
        overrides.extend_from_slice(more_overrides);
        let pipeline = load(&arguments.pipeline, &overrides)?;
        set_up_threads(&arguments.common)?;
        let artifacts = &arguments.common.artifacts;
        if let Some(file) = artifacts.ancestors().find(|path| path.is_file()) {
            anyhow::bail!(
                "cannot keep artifacts in {}: {} is a file; name a folder with --artifacts",
                artifacts.display(),
                file.display()
            );
        }
        let store = Store::open(artifacts)?;
        Ok(Self {
            pipeline,
            interrupt: Interrupt::listen(Some(&store)),
            store,
            console: Console::new(&arguments.common),
        })
    }

    /// The hash of a source. Ctrl-C ends the hashing.
    fn hash(&self, hash: impl FnOnce(Stop<'_>) -> Result<[u8; 32], IngestError>, stage: &str) -> Result<Key> {
        let hashed = hash(&|| self.interrupt.requested());
        self.interrupt.check(stage)?;
        Ok(Key::from_bytes(hashed?))
    }

    /// Makes an artifact unless it is there.
    fn build(&self, recipe: &Recipe, make: impl FnOnce(&Writer) -> Result<Facts>) -> Result<Built> {
        let start = Instant::now();
        if let Some(built) = self.unchanged(recipe, start)? {
            return Ok(built);
        }
        let writer = self.store.begin(recipe)?;
        let facts = make(&writer)?;
        self.interrupt.check(recipe.stage().as_str())?;
        self.made(writer.publish(facts)?, recipe, start)
    }

    /// The artifact of a recipe, if it is there.
    fn unchanged(&self, recipe: &Recipe, start: Instant) -> Result<Option<Built>> {
        let stage = recipe.stage();
        let Some(artifact) = self.store.lookup(stage, &recipe.key())? else {
            return Ok(None);
        };
        self.console.note(&format!(
            "{:>10}  {}  unchanged, skipped",
            stage.as_str(),
            artifact.path().display()
        ));
        Ok(Some(Built {
            stage,
            artifact,
            skipped: true,
            wall: start.elapsed(),
        }))
    }

    /// Records the run that made an artifact, and says so.
    fn made(&self, artifact: Artifact, recipe: &Recipe, start: Instant) -> Result<Built> {
        let stage = recipe.stage();
        let wall = start.elapsed();
        // Facts of the run itself stand beside the artifact, outside of every hash.
        self.store.record_run(
            stage,
            &recipe.key(),
            &json!({ "wall_s": wall.as_secs_f64(), "threads": rayon::current_num_threads() }),
        )?;
        let manifest = artifact.manifest();
        self.console.note(&format!(
            "{:>10}  {}  {}{}  {:.2} s",
            stage.as_str(),
            artifact.path().display(),
            headline(&manifest.summary),
            match manifest.warnings.len() {
                0 => String::new(),
                1 => ", 1 warning".to_owned(),
                n => format!(", {n} warnings"),
            },
            wall.as_secs_f64()
        ));
        Ok(Built {
            stage,
            artifact,
            skipped: false,
            wall,
        })
    }
}

/// Whole numbers of a summary, as `25650 frames, 206 episodes`.
fn headline(summary: &Value) -> String {
    summary
        .as_object()
        .map(|map| {
            map.iter()
                .filter(|(_, value)| value.is_u64())
                .map(|(name, value)| format!("{value} {}", name.replace('_', " ")))
                .collect::<Vec<_>>()
                .join(", ")
        })
        .unwrap_or_default()
}

/// The folders with raw datasets, in the order in which they are searched: `RE4_DATA` where it is set, then `data`.
pub(crate) fn data_folders() -> Vec<PathBuf> {
    let named = std::env::var_os("RE4_DATA")
        .filter(|value| !value.is_empty())
        .map(PathBuf::from);
    named.into_iter().chain([PathBuf::from("data")]).collect()
}

/// Sizes the thread pool as the command line asks.
pub(crate) fn set_up_threads(common: &Common) -> Result<()> {
    if let Some(jobs) = common.jobs {
        rayon::ThreadPoolBuilder::new()
            .num_threads(jobs.get())
            .build_global()
            .with_context(|| format!("cannot start {jobs} worker threads; give a smaller --jobs"))?;
    }
    Ok(())
}

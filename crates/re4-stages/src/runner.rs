//! The [`Runner`], which holds a pipeline and everything that all stages need.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Key, Recipe, Stage, Store, Writer};
use re4_fault::{OrFault as _, bail, fault};
use re4_ingest::{IngestError, Stop};
use serde_json::{Value, json};
use tracing::{debug, info, info_span};

use crate::interrupt::Interrupt;
use crate::notes::Notes;
use crate::pipeline::{Pipeline, read_pipeline};

/// Settings of a [`Runner`].
#[derive(Debug, Clone)]
pub struct Settings<'a> {
    /// The pipeline file.
    pub pipeline: &'a Path,
    /// Overrides of the file's settings, as `stage.key=value`.
    pub overrides: Vec<String>,
    /// The artifacts folder.
    pub artifacts: &'a Path,
    /// Number of worker threads. Default: one per processor.
    pub jobs: Option<NonZeroUsize>,
    /// Messages to the user.
    pub notes: Notes,
}

/// A pipeline, the artifact store and everything else that all stages need.
pub struct Runner {
    /// The pipeline, with overrides applied.
    pub pipeline: Pipeline,
    /// Path of the pipeline file.
    pub(crate) file: PathBuf,
    /// The artifacts folder.
    pub(crate) store: Store,
    /// Messages to the user.
    pub notes: Notes,
    /// Whether the user asked to stop, for instance by Ctrl-C.
    pub(crate) interrupt: Interrupt,
    /// Warnings of the stages run so far.
    warnings: Mutex<Vec<Value>>,
}

/// The artifact of a stage, and whether it existed before.
pub struct Built {
    /// The stage.
    pub stage: Stage,
    /// The artifact.
    pub artifact: Artifact,
    /// Whether the artifact existed already.
    pub skipped: bool,
    /// Wall time of building the artifact, or of verifying an existing one.
    pub wall: Duration,
}

impl Built {
    /// The value that is printed with `--json`.
    pub fn to_json(&self) -> Value {
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
    ///
    /// # Errors
    /// If the pipeline file cannot be used, or the artifacts folder cannot be created or opened.
    pub fn new(settings: &Settings<'_>) -> Result<Self> {
        let pipeline = read_pipeline(settings.pipeline, &settings.overrides)?;
        info!(file = %settings.pipeline.display(), overrides = ?settings.overrides, "pipeline read");
        if let Some(jobs) = settings.jobs {
            rayon::ThreadPoolBuilder::new()
                .num_threads(jobs.get())
                .build_global()
                .or_fault(|| fault!("cannot start {jobs} worker threads"; "give a smaller --jobs"))?;
        }
        let artifacts = settings.artifacts;
        if let Some(file) = artifacts.ancestors().find(|path| path.is_file()) {
            bail!(
                "cannot keep artifacts in {}: {} is a file", artifacts.display(), file.display();
                "name a folder with --artifacts"
            );
        }
        let store = Store::open(artifacts)?;
        let mut warnings = Vec::new();
        for message in &pipeline.without_effect {
            let warning = json!({ "stage": "pipeline", "code": "setting_without_effect", "message": message });
            settings.notes.warning(&warning);
            warnings.push(warning);
        }
        debug!(artifacts = %artifacts.display(), threads = rayon::current_num_threads(), "store open");
        Ok(Self {
            pipeline,
            file: settings.pipeline.to_owned(),
            interrupt: Interrupt::listen(Some(&store)),
            store,
            notes: settings.notes,
            warnings: Mutex::new(warnings),
        })
    }

    /// Computes the hash of a source. Ctrl-C ends the hashing.
    pub(crate) fn hash(
        &self,
        hash: impl FnOnce(Stop<'_>) -> Result<[u8; 32], IngestError>,
        stage: &str,
    ) -> Result<Key> {
        let start = Instant::now();
        let hashed = hash(&|| self.interrupt.requested());
        self.interrupt.check(stage)?;
        let hash = Key::from_bytes(hashed?);
        info!(stage, blake3 = %hash, wall = ?start.elapsed(), "source hashed");
        Ok(hash)
    }

    /// Returns the artifact of a recipe, and makes it with `make` if it does not exist.
    pub(crate) fn build(
        &self,
        recipe: &Recipe,
        make: impl FnOnce(&Writer) -> Result<ArtifactSummary>,
    ) -> Result<Built> {
        let start = Instant::now();
        let _span = info_span!("stage", name = recipe.stage().as_str()).entered();
        if let Some(built) = self.unchanged(recipe, start)? {
            return Ok(built);
        }
        let writer = self.store.begin(recipe)?;
        let summary = make(&writer)?;
        self.interrupt.check(recipe.stage().as_str())?;
        self.made(writer.publish(summary)?, recipe, start)
    }

    /// The artifact of a recipe, if it exists.
    pub(crate) fn unchanged(&self, recipe: &Recipe, start: Instant) -> Result<Option<Built>> {
        let stage = recipe.stage();
        let Some(artifact) = self.store.lookup(stage, &recipe.key())? else {
            info!(key = %recipe.key(), "artifact does not exist yet");
            return Ok(None);
        };
        crate::tables::refuse_newer(&artifact)?;
        info!(key = %recipe.key(), wall = ?start.elapsed(), "artifact exists and is intact");
        self.notes.note(&format!(
            "{:>10}  {}  unchanged, skipped",
            stage.as_str(),
            artifact.path().display()
        ));
        self.warn(&artifact, stage);
        Ok(Some(Built {
            stage,
            artifact,
            skipped: true,
            wall: start.elapsed(),
        }))
    }

    /// Repeats the warnings of an artifact, whether or not its stage was skipped: a user of `run` or `audit` never sees the
    /// output of `ingest`.
    fn warn(&self, artifact: &Artifact, stage: Stage) {
        for warning in &artifact.manifest().warnings {
            self.notes.warning(warning);
            let mut warning = warning.clone();
            if let Some(object) = warning.as_object_mut() {
                object.insert("stage".to_owned(), stage.as_str().into());
            }
            self.warnings
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(warning);
        }
    }

    /// The warnings of all stages run so far, each with its stage, in the order of the stages.
    pub fn warnings(&self) -> Vec<Value> {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Records the run that made an artifact, and prints a note.
    pub(crate) fn made(&self, artifact: Artifact, recipe: &Recipe, start: Instant) -> Result<Built> {
        let stage = recipe.stage();
        let wall = start.elapsed();
        // Wall time and threads differ between runs, so they are recorded outside of the artifact and of every hash.
        self.store.record_run(
            stage,
            &recipe.key(),
            &json!({ "wall_s": wall.as_secs_f64(), "threads": rayon::current_num_threads() }),
        )?;
        let manifest = artifact.manifest();
        for (name, table) in &manifest.tables {
            debug!(name, rows = table.rows, bytes = table.bytes, "table written");
        }
        info!(key = %recipe.key(), ?wall, "artifact published");
        self.notes.note(&format!(
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
        self.warn(&artifact, stage);
        Ok(Built {
            stage,
            artifact,
            skipped: false,
            wall,
        })
    }
}

/// A warning of a manifest in one line: its code and its message.
pub fn warning_text(warning: &Value) -> String {
    let word = |key: &str| warning.get(key).and_then(Value::as_str).unwrap_or_default();
    format!("{}: {}", word("code"), word("message"))
}

/// The integers of a summary, for instance `25650 frames, 206 episodes`.
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

//! The [`Runner`], which holds a pipeline and everything that all stages need.

use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Key, Recipe, Stage, Store, Writer};
use re4_fault::{OrFault as _, bail, fault};
use re4_ingest::robomimic::Surveyed;
use re4_ingest::{IngestError, Stop};
use serde_json::{Map, Value, json};
use tracing::{debug, info, info_span};

use crate::addresses::local_store;
use crate::hashes::{HashedFile, Hashes};
use crate::interrupt::Interrupt;
use crate::notes::Notes;
use crate::parts::{Parting, Share};
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
    /// What this process makes of an artifact in parts.
    pub share: Share,
    /// Hashes of sources that need not be computed again.
    pub hashes: &'a [HashedFile],
}

/// What all stages need besides their settings: the artifact store, the messages to the user and Ctrl-C. Pipelines that one process
/// runs share them.
pub struct Session {
    /// The artifacts folder.
    pub(crate) store: Store,
    /// Messages to the user.
    pub notes: Notes,
    /// What this process makes of an artifact in parts.
    pub(crate) share: Share,
    /// Hashes of sources.
    hashes: Arc<Hashes>,
    /// Whether the user asked to stop, for instance by Ctrl-C.
    pub(crate) interrupt: Interrupt,
    /// Warnings of the stages run so far.
    warnings: Mutex<Vec<Value>>,
    /// Warnings that were printed, if each is printed only once.
    said: Option<Arc<Mutex<BTreeSet<String>>>>,
    /// What the running stage measured for the record of its run.
    measured: Mutex<Map<String, Value>>,
}

impl Session {
    /// Sets up threads and opens the store. To be called once per process.
    ///
    /// # Errors
    /// If the threads cannot be started, or the artifacts folder cannot be created or opened; `artifacts` can also be the address of an
    /// object store.
    pub fn open(artifacts: &Path, jobs: Option<NonZeroUsize>, notes: Notes) -> Result<Self> {
        if let Some(jobs) = jobs {
            rayon::ThreadPoolBuilder::new()
                .num_threads(jobs.get())
                .build_global()
                .or_fault(|| fault!("cannot start {jobs} worker threads"; "give a smaller --jobs"))?;
        }
        let artifacts = local_store(artifacts)?;
        let artifacts = artifacts.as_path();
        if let Some(file) = artifacts.ancestors().find(|path| path.is_file()) {
            bail!(
                "cannot keep artifacts in {}: {} is a file", artifacts.display(), file.display();
                "name a folder with --artifacts"
            );
        }
        let store = Store::open(artifacts)?;
        debug!(artifacts = %artifacts.display(), threads = rayon::current_num_threads(), "store open");
        Ok(Self {
            interrupt: Interrupt::listen(Some(&store)),
            store,
            notes,
            share: Share::Whole,
            hashes: Arc::default(),
            warnings: Mutex::default(),
            said: None,
            measured: Mutex::default(),
        })
    }

    /// The same session for many pipelines: notes about unchanged artifacts are not printed, warnings once, and an artifact that
    /// was verified is not read again unless its files were written to.
    #[must_use]
    pub fn of_many_pipelines(self) -> Self {
        Self {
            store: self.store.verifying_once(),
            said: Some(Arc::default()),
            ..self
        }
    }

    /// The same session with hashes of sources that need not be computed again.
    #[must_use]
    pub fn trusting(self, hashes: &[HashedFile]) -> Self {
        Self {
            hashes: Arc::new(Hashes::of(hashes)),
            ..self
        }
    }

    /// The runner of a pipeline that was read from `file`.
    pub fn runner(&self, file: &Path, pipeline: Pipeline) -> Runner {
        let session = Self {
            store: self.store.clone(),
            notes: self.notes,
            share: self.share,
            hashes: Arc::clone(&self.hashes),
            interrupt: self.interrupt.clone(),
            warnings: Mutex::default(),
            said: self.said.clone(),
            measured: Mutex::default(),
        };
        for message in &pipeline.without_effect {
            session.say(json!({ "stage": "pipeline", "code": "setting_without_effect", "message": message }));
        }
        Runner {
            pipeline,
            file: file.to_owned(),
            session,
        }
    }
}

/// A pipeline and the session in which it runs.
pub struct Runner {
    /// The pipeline, with overrides applied.
    pub pipeline: Pipeline,
    /// Path of the pipeline file.
    pub(crate) file: PathBuf,
    session: Session,
}

impl Deref for Runner {
    type Target = Session;

    fn deref(&self) -> &Session {
        &self.session
    }
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
    /// The same runner in a session of many pipelines.
    #[must_use]
    pub fn of_many_pipelines(self) -> Self {
        Self {
            session: self.session.of_many_pipelines(),
            ..self
        }
    }

    /// The same runner with another shard of artifacts in parts. It prints no notes.
    pub(crate) fn sharing(&self, share: Share) -> Self {
        let mut runner = self.session.runner(&self.file, self.pipeline.clone());
        runner.session.notes = Notes::new(true);
        runner.session.share = share;
        runner
    }

    /// The same runner, which makes only some parts of the artifacts.
    pub(crate) fn with_share(mut self, share: Share) -> Self {
        self.session.share = share;
        self
    }

    /// Reads the pipeline file, sets up threads and opens the store.
    ///
    /// # Errors
    /// If the pipeline file cannot be used, or the artifacts folder cannot be created or opened.
    pub fn new(settings: &Settings<'_>) -> Result<Self> {
        let pipeline = read_pipeline(settings.pipeline, &settings.overrides)?;
        info!(file = %settings.pipeline.display(), overrides = ?settings.overrides, "pipeline read");
        let mut session = Session::open(settings.artifacts, settings.jobs, settings.notes)?;
        session.share = settings.share;
        session.hashes = Arc::new(Hashes::of(settings.hashes));
        if settings.share != Share::Whole {
            session.store = session.store.verifying_by_part();
        }
        Ok(session.runner(settings.pipeline, pipeline))
    }
}

impl Session {
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

    /// The hash of a file that was computed before, or else by `hash`.
    pub(crate) fn hashed_before(&self, path: &Path, hash: impl FnOnce() -> Result<Key>) -> Result<Key> {
        self.hashes.get(path, hash)
    }

    /// The hash of a file, if it was computed before and the file has not changed.
    pub(crate) fn known_hash(&self, path: &Path) -> Option<Key> {
        self.hashes.known(path)
    }

    /// What is known of the demonstrations in a file, if the file has not changed.
    pub(crate) fn surveyed(&self, path: &Path) -> Option<Surveyed> {
        self.hashes.surveyed(path)
    }

    /// Remembers what is known of the demonstrations in a file that was hashed.
    pub(crate) fn set_surveyed(&self, path: &Path, surveyed: &Surveyed) {
        self.hashes.set_surveyed(path, surveyed);
    }

    /// The files that were hashed so far, and those whose hashes were given.
    pub fn hashed(&self) -> Vec<HashedFile> {
        self.hashes.all()
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
        self.share.builds_whole(&self.store, recipe)?;
        let writer = self.store.begin(recipe)?;
        let summary = make(&writer)?;
        self.interrupt.check(recipe.stage().as_str())?;
        self.made(writer.publish(summary)?, recipe, start)
    }

    /// As [`Session::build`], for an artifact of several parts. See [`Parting::make`].
    pub(crate) fn build_parts(
        &self,
        recipe: &Recipe,
        parts: u32,
        make: impl Fn(&Writer, u32) -> Result<ArtifactSummary>,
        finish: impl FnOnce(&mut [Artifact], &Writer) -> Result<ArtifactSummary>,
    ) -> Result<Built> {
        let start = Instant::now();
        let _span = info_span!("stage", name = recipe.stage().as_str()).entered();
        if let Some(built) = self.unchanged(recipe, start)? {
            return Ok(built);
        }
        let parting = Parting {
            store: &self.store,
            recipe,
            parts,
            share: self.share,
            interrupt: &self.interrupt,
        };
        let artifact = parting.make(make, |numbered, writer| finish(numbered, writer))?;
        self.made(artifact, recipe, start)
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
        if self.said.is_none() {
            self.notes.note(&format!(
                "{:>10}  {}  unchanged, skipped",
                stage.as_str(),
                artifact.path().display()
            ));
        }
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
            let mut warning = warning.clone();
            if let Some(object) = warning.as_object_mut() {
                object.insert("stage".to_owned(), stage.as_str().into());
            }
            self.say(warning);
        }
    }

    /// Prints and keeps a warning.
    pub(crate) fn say(&self, warning: Value) {
        let new = self
            .said
            .as_ref()
            .is_none_or(|said| locked(said).insert(warning.to_string()));
        if new {
            self.notes.warning(&warning);
        }
        locked(&self.warnings).push(warning);
    }

    /// Adds a measurement to the record of the run of the current stage, which is no part of its artifact.
    pub(crate) fn measured(&self, name: &str, value: Value) {
        locked(&self.measured).insert(name.to_owned(), value);
    }

    /// The warnings of all stages run so far, each with its stage, in the order of the stages.
    pub fn warnings(&self) -> Vec<Value> {
        locked(&self.warnings).clone()
    }

    /// Records the run that made an artifact, and prints a note.
    pub(crate) fn made(&self, artifact: Artifact, recipe: &Recipe, start: Instant) -> Result<Built> {
        let stage = recipe.stage();
        let wall = start.elapsed();
        // Wall time and threads differ between runs, so they are recorded outside of the artifact and of every hash.
        let mut record = std::mem::take(&mut *locked(&self.measured));
        record.insert("wall_s".to_owned(), json!(wall.as_secs_f64()));
        record.insert("threads".to_owned(), json!(rayon::current_num_threads()));
        record.insert("finished_unix_s".to_owned(), json!(seconds_since_1970()));
        self.store.record_run(stage, &recipe.key(), &record)?;
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

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The time of the system's clock.
fn seconds_since_1970() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs())
}

/// The values in nested JSON objects, each with its path separated by dots.
pub fn leaves(value: &Value) -> Vec<(String, &Value)> {
    let Value::Object(map) = value else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for (name, value) in map {
        match value {
            Value::Object(inner) if !inner.is_empty() => {
                found.extend(
                    leaves(value)
                        .into_iter()
                        .map(|(rest, leaf)| (format!("{name}.{rest}"), leaf)),
                );
            }
            leaf => found.push((name.clone(), leaf)),
        }
    }
    found
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

//! The stage `ingest`: makes `episodes` from a raw dataset. How a dataset is opened depends on its format; how its demonstrations
//! are written does not.

mod describe;
mod hdf5;
mod helper;
mod lerobot;
mod message;
mod rendered;
mod renumber;
mod serve;
mod several;
mod spool;
mod tables;
mod worker;
mod write;
mod zarr;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use indicatif::ProgressBar;
use re4_artifact::{Artifact, Key, Recipe, Stage, Store};
use re4_fault::{Fault, OrFault as _, bail, ensure, fault};
use re4_ingest::lerobot::LerobotSource;
use re4_ingest::robomimic::RobomimicSource;
use re4_ingest::{DemoSource as _, LeftOut, OnBad, refusal};
use re4_task::Task;
use serde_json::{Value, json};

use crate::inputs::sources::{find_source, left_out};
use crate::pipeline::Pipeline;
use crate::runner::{Built, Runner};

pub use describe::describe;
pub use serve::serve_ingest;
use several::Found;
pub(crate) use several::one_file;
use worker::Request;
pub use worker::SUBCOMMAND as INGEST_WORKER;
pub(crate) use worker::WorkerCrashed;

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 7;

/// The same for the roles of signals, which only datasets of arms have.
const SIGNALS_VERSION: u32 = 2;

/// Name of the stage in messages about an interruption.
const STAGE: &str = "ingest";

impl Runner {
    /// Makes the `episodes` artifact, or returns the existing one.
    ///
    /// # Errors
    /// If the dataset cannot be ingested, a setting does not fit it, or the run is interrupted.
    pub fn ingest(&self) -> Result<Built> {
        let planar = self.pipeline.task.is_planar();
        let path = match several::found(&self.pipeline.ingest.source, |path| !planar && is_of_files(path))? {
            Found::One(path) => path,
            Found::Several(name, files) => {
                ensure!(
                    !planar,
                    "cannot ingest {}: Push-T is read from one zarr store or LeRobot dataset", name.display();
                    "give its path as ingest.source"
                );
                self.refuse_keys_of_lerobot(&name)?;
                return self.ingest_several(name, files);
            }
        };
        if LerobotSource::probe(&path) {
            return self.ingest_lerobot(path);
        }
        self.refuse_keys_of_lerobot(&path)?;
        // Other mismatches of format and task are reported when the source is opened.
        match (self.pipeline.task.is_planar(), RobomimicSource::probe(&path)) {
            (true, true) => bail!(
                "cannot ingest {}: it is an HDF5 file, but Push-T is read from a zarr store", path.display();
                "give a zarr store, or set task to the task of the file, such as \"can\""
            ),
            (true, false) => self.ingest_zarr(&path),
            (false, _) => self.ingest_hdf5(path),
        }
    }

    /// Refuses settings that only apply to LeRobot datasets.
    fn refuse_keys_of_lerobot(&self, path: &Path) -> Result<()> {
        let section = &self.pipeline.ingest;
        ensure!(
            section.lerobot.is_default(),
            "cannot ingest {}: the table [ingest.lerobot] applies only to LeRobot datasets", path.display();
            "remove it"
        );
        ensure!(
            !self.pipeline.task.is_planar() || section.filter.is_none(),
            "cannot ingest {}: a zarr store has no filter keys", path.display();
            "remove ingest.filter"
        );
        Ok(())
    }

    /// Lets a worker make the artifact.
    fn made_by_worker(&self, request: &Request, recipe: &Recipe, start: Instant) -> Result<Built> {
        let partly = self.attended(request, |bar| {
            worker::run(request, &self.interrupt, bar, &|path, surveyed| {
                self.set_surveyed(path, surveyed);
            })
        })?;
        if let Some(partly) = partly {
            return Err(partly.into());
        }
        let artifact = self.store.lookup(Stage::Ingest, &recipe.key())?;
        let artifact = artifact.or_fault(|| {
            fault!(
                "cannot ingest {}: the new artifact has disappeared, perhaps removed by another process", request.source.display();
                "run again"
            )
        })?;
        self.made(artifact, recipe, start)
    }

    /// Runs `work`, which uses a worker, and removes the unfinished artifact of a worker that failed.
    fn attended<T>(&self, request: &Request, work: impl FnOnce(&ProgressBar) -> Result<T>) -> Result<T> {
        let ended = work(&self.notes.progress(0, STAGE));
        if ended.is_err() {
            self.interrupt.check(STAGE)?;
            // Opening the store removes unfinished artifacts.
            Store::open(&request.artifacts)?;
        }
        ended
    }

    /// The files that a command with this pipeline reads: the pipeline file, the source, and the file of `ingest.compare`.
    ///
    /// # Errors
    /// If a source is not found.
    pub fn inputs(&self) -> Result<Vec<PathBuf>> {
        let section = &self.pipeline.ingest;
        let mut inputs = vec![self.file.clone()];
        for path in section.source.paths() {
            inputs.push(find_source(path)?);
        }
        if let Some(compare) = &section.compare {
            inputs.push(find_source(compare)?);
        }
        Ok(inputs)
    }

    /// The file of a dataset of one file.
    ///
    /// # Errors
    /// If the dataset has several; `what` needs one.
    pub fn one_file(&self, what: &str) -> Result<PathBuf> {
        one_file(&self.pipeline.ingest.source, what)
    }

    /// Returns an error if demonstrations were left out of an artifact and `ingest.on_bad` does not allow it. Needed because
    /// `on_bad` is not part of the key, so an artifact made with another setting may be found.
    fn refuse_left_out(&self, artifact: &Artifact, path: &Path) -> Result<()> {
        let left = left_out(artifact)?;
        let kept = artifact.manifest().summary["episodes"].as_u64().unwrap_or_default();
        if left.is_empty() || self.pipeline.ingest.on_bad == OnBad::LeaveOut {
            return Ok(());
        }
        Err(refused(path, &left, kept as usize + left.len()).into())
    }
}

/// Whether a folder is read as one of HDF5 files: it is none of another format.
fn is_of_files(path: &Path) -> bool {
    let zarr = [".zgroup", ".zarray", "zarr.json"];
    !LerobotSource::probe(path) && !zarr.iter().any(|name| path.join(name).exists())
}

/// The error for a dataset of `of` demonstrations of which `left` cannot be used.
fn refused(path: &Path, left: &[LeftOut], of: usize) -> Fault {
    Fault::from_sentence(&refusal(left, of)).at(format_args!("cannot ingest {}: ", path.display()))
}

/// The recipe of the artifact, which contains everything that determines its bytes: the hash of the source and all settings
/// except paths and `on_bad`. Paths are replaced by hashes of the files. `summary` is the description of the source for the
/// manifest.
fn recipe(pipeline: &Pipeline, hash: &Key, compare: Option<&Key>, render: &Value, summary: Value) -> Result<Recipe> {
    let mut config = json!(pipeline.ingest);
    if let Some(config) = config.as_object_mut() {
        for place in ["source", "compare", "on_bad"] {
            config.remove(place);
        }
        config.insert("task".to_owned(), json!(pipeline.task));
        if pipeline.task == Task::Arm {
            config.insert("signals_version".to_owned(), json!(SIGNALS_VERSION));
        }
        if let Some(compare) = compare {
            config.insert("compare_blake3".to_owned(), json!(compare));
        }
        if !pipeline.ingest.render.is_empty() {
            config.insert("render".to_owned(), render.clone());
        }
    }
    Ok(Recipe::new(Stage::Ingest, CODE_VERSION)
        .config(&config)?
        .source(hash.as_bytes(), summary))
}

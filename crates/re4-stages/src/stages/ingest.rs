//! Ingest: raw dataset to `episodes`. How a dataset is opened depends on its format; what is written of its demonstrations does
//! not.

mod hdf5;
mod rendered;
mod spool;
mod tables;
mod worker;
mod write;
mod zarr;

use std::path::{Path, PathBuf};

use anyhow::Result;
use re4_artifact::{Artifact, Key, Recipe, Stage};
use re4_fault::{Fault, bail};
use re4_ingest::robomimic::RobomimicSource;
use re4_ingest::{DemoSource as _, LeftOut, OnBad, refusal};
use serde_json::{Value, json};

use crate::inputs::sources::{find_source, left_out};
use crate::pipeline::Pipeline;
use crate::runner::{Built, Runner};

pub use hdf5::serve_ingest;
pub(crate) use worker::FellOver;
pub use worker::SUBCOMMAND as INGEST_WORKER;

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 3;

/// What becomes of an error of a stage that was asked to stop: that is what is told.
const STAGE: &str = "ingest";

impl Runner {
    /// The `episodes` artifact.
    ///
    /// # Errors
    /// When an input, or a setting of the pipeline, does not allow it; or at Ctrl-C.
    pub fn ingest(&self) -> Result<Built> {
        let path = find_source(&self.pipeline.ingest.source)?;
        // What is of another format than its task is read from says so when it is opened.
        match (self.pipeline.task.is_planar(), RobomimicSource::probe(&path)) {
            (true, true) => bail!(
                "cannot ingest {}: it is an HDF5 file, and Push-T is read from a zarr store", path.display();
                "give one, or set task to the file's own, such as \"can\""
            ),
            (true, false) => self.ingest_zarr(&path),
            (false, _) => self.ingest_hdf5(path),
        }
    }

    /// Files that a command with this pipeline reads.
    ///
    /// # Errors
    /// When the source is nowhere.
    pub fn inputs(&self) -> Result<Vec<PathBuf>> {
        let section = &self.pipeline.ingest;
        let mut inputs = vec![self.file.clone(), find_source(&section.source)?];
        if let Some(compare) = &section.compare {
            inputs.push(find_source(compare)?);
        }
        Ok(inputs)
    }

    /// Refuses an artifact that lacks demonstrations, where all are to be there.
    fn refuse_left_out(&self, artifact: &Artifact, path: &Path) -> Result<()> {
        let left = left_out(artifact)?;
        let kept = artifact.manifest().summary["episodes"].as_u64().unwrap_or_default();
        if left.is_empty() || self.pipeline.ingest.on_bad == OnBad::LeaveOut {
            return Ok(());
        }
        Err(refused(path, &left, kept as usize + left.len()).into())
    }
}

/// Why a dataset of so many demonstrations is refused for these.
fn refused(path: &Path, left: &[LeftOut], of: usize) -> Fault {
    Fault::from_sentence(&refusal(left, of)).at(format_args!("cannot ingest {}: ", path.display()))
}

/// Everything that decides the bytes of the artifact: the hash of the source, all settings but where it lies and what becomes of
/// demonstrations that cannot be used, and in their place what they lead to. `summary` are what the source says of itself.
fn recipe(pipeline: &Pipeline, hash: &Key, compare: Option<&Key>, render: &Value, summary: Value) -> Result<Recipe> {
    let mut config = json!(pipeline.ingest);
    if let Some(config) = config.as_object_mut() {
        for place in ["source", "compare", "on_bad"] {
            config.remove(place);
        }
        config.insert("task".to_owned(), json!(pipeline.task));
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

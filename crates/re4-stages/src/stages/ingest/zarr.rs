//! Ingests zarr stores of Push-T.

use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use re4_artifact::Key;
use re4_fault::ensure;
use re4_ingest::pusht::{PushtOptions, PushtReader, PushtSource};
use re4_ingest::{Fault, IngestError};
use serde_json::json;

use super::write::{Images, Ingest};
use super::{STAGE, recipe};
use crate::runner::{Built, Runner};

impl Runner {
    /// Makes the `episodes` artifact of a zarr store, or returns the existing one.
    pub(super) fn ingest_zarr(&self, path: &Path) -> Result<Built> {
        let start = Instant::now();
        let section = &self.pipeline.ingest;
        let stop = || self.interrupt.requested();
        // An interrupted reader returns `Fault::Stopped`, for which the message about the interruption is returned instead.
        let or_interrupted = |error: IngestError| match *error.fault {
            Fault::Stopped => self.interrupt.check(STAGE).err().unwrap_or_else(|| error.into()),
            _ => error.into(),
        };
        let reader = PushtReader::open_for(path, section.images, &stop).map_err(or_interrupted)?;
        let hash = reader.source_hash(&stop).map_err(or_interrupted)?;
        ensure!(
            section.render.is_empty() || !reader.has_images(),
            "cannot render images for {}: it has recorded images", path.display();
            "remove ingest.render"
        );
        let recipe = recipe(
            &self.pipeline,
            &Key::from_bytes(hash),
            None,
            &json!(section.render),
            json!(reader.info()),
        )?;
        if let Some(built) = self.unchanged(&recipe, start)? {
            self.refuse_left_out(&built.artifact, path)?;
            return Ok(built);
        }
        let bar = self.notes.progress(0, STAGE);
        let ingest = Ingest {
            section,
            source: path,
            compare: None,
            conventions: &[],
            images: if section.render.is_empty() {
                Images::Recorded
            } else {
                Images::PushT
            },
            threads: rayon::current_num_threads(),
            share: self.share,
            interrupt: &self.interrupt,
            progress: &|done, all| {
                bar.set_length(all);
                bar.set_position(done);
            },
        };
        let options = PushtOptions {
            conventions: section.pusht,
            on_bad: section.on_bad,
            images: section.images && section.render.is_empty(),
            stop: &stop,
        };
        let source = PushtSource::read(reader, &section.select, &options).map_err(or_interrupted)?;
        let artifact = ingest.publish(&source, &self.store, &recipe)?;
        bar.finish_and_clear();
        self.made(artifact, &recipe, start)
    }
}

//! Ingests LeRobot datasets. A worker process opens and hashes them, and another one makes the artifact: tables, images and videos are
//! decoded by libraries that may fail on damaged files.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use re4_artifact::{Key, Store};
use re4_fault::ensure;
use re4_ingest::lerobot::{LerobotChoice, LerobotFiles, LerobotSource};
use re4_ingest::pusht::PushtOptions;
use re4_ingest::{DemoSource as _, Fault, IngestError};
use re4_task::Domain;
use serde_json::{Value, json};

use super::STAGE;
use super::message::Message;
use super::worker::{self, Format, Request};
use super::write::{Images, Ingest};
use crate::addresses::address_of;
use crate::interrupt::Interrupt;
use crate::pipeline::Pipeline;
use crate::runner::{Built, Runner};

impl Runner {
    /// Makes the `episodes` artifact of a LeRobot dataset, or returns the existing one.
    pub(super) fn ingest_lerobot(&self, source: PathBuf) -> Result<Built> {
        let start = Instant::now();
        ensure!(
            self.pipeline.task.domain() != Domain::Space,
            "cannot ingest {}: a LeRobot dataset of a robosuite task does not have the pose of the object", source.display();
            "set task to \"arm\" to audit and segment it without an object, or give the HDF5 file with the demonstrations"
        );
        let mut request = Request {
            hash: None,
            format: Format::Lerobot(None),
            gl: None,
            source,
            pipeline: self.pipeline.clone(),
            artifacts: self.store.root().to_path_buf(),
            address: address_of(self.store.root()),
            threads: rayon::current_num_threads(),
            share: self.share,
            cautious: false,
        };
        let (hash, files) = self.attended(&request, |bar| worker::hashed(&request, &self.interrupt, bar))?;
        request.hash = Some(hash);
        request.format = Format::Lerobot(Some(files));
        let recipe = request.recipe(Value::Null)?;
        if let Some(built) = self.unchanged(&recipe, start)? {
            self.refuse_left_out(&built.artifact, &request.source)?;
            return Ok(built);
        }
        self.made_by_worker(&request, &recipe, start)
    }
}

/// What the pipeline reads of a dataset.
fn choice(pipeline: &Pipeline) -> LerobotChoice<'_> {
    let section = &pipeline.ingest;
    LerobotChoice {
        planar: pipeline.task.is_planar(),
        cameras: section.cameras.as_deref(),
        keys: &section.lerobot,
        split: section.filter.as_deref(),
        select: &section.select,
        images: section.images && section.render.is_empty(),
    }
}

/// In the worker: hashes the dataset, or makes and publishes the artifact of the files that were hashed.
pub(super) fn serve(request: &Request, files: Option<&LerobotFiles>, interrupt: &Interrupt) -> Result<Message> {
    let section = &request.pipeline.ingest;
    let stop = || interrupt.requested();
    // An interrupted reader returns `Fault::Stopped`, for which the message about the interruption is returned instead.
    let or_interrupted = |error: IngestError| match *error.fault {
        Fault::Stopped => interrupt.check(STAGE).err().unwrap_or_else(|| error.into()),
        _ => error.into(),
    };
    let choice = choice(&request.pipeline);
    let Some(files) = files else {
        let opened = choice.open(&request.source, &stop).map_err(or_interrupted)?;
        let (files, hash) = opened.hash(&request.source, &stop).map_err(or_interrupted)?;
        return Ok(Message::Hashed(Key::from_bytes(hash), files));
    };
    let options = PushtOptions {
        conventions: section.pusht,
        on_bad: section.on_bad,
        images: choice.images,
        stop: &stop,
    };
    let source = LerobotSource::read(&request.source, files.clone(), &choice, &options).map_err(or_interrupted)?;
    if !section.render.is_empty() {
        let recorded = source.recorded(&choice)?;
        ensure!(
            recorded.is_empty(),
            "cannot render images for {}: it has recorded images ({})", request.source.display(), recorded.join(", ");
            "remove ingest.render, or set ingest.lerobot.image to \"\""
        );
    }
    let recipe = request.recipe(json!(source.info()))?;
    let ingest = Ingest {
        section,
        source: &request.source,
        compare: None,
        conventions: source.conventions(),
        images: if section.render.is_empty() {
            Images::Recorded
        } else {
            Images::PushT
        },
        threads: request.threads,
        share: request.share,
        interrupt,
        progress: &|done, all| worker::progress(done, all, interrupt),
    };
    ingest.publish(&source, &Store::open(&request.artifacts)?, &recipe)?;
    Ok(Message::Done)
}

//! Ingests several HDF5 files as one dataset: a folder of files, or a list.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Key, Stage, Store};
use re4_fault::{ensure, fault};
use re4_ingest::robomimic::{Access, ArmSource, CamerasAsked, Files, Members, RobomimicSource, Several, files_of};
use re4_ingest::{Convention, DemoSource};
use re4_task::Task;
use serde_json::{Value, json};

use super::STAGE;
use super::hdf5::{choice, is_library_forced, needs_library, reading};
use super::message::Message;
use super::rendered::Rendering;
use super::spool::Spool;
use super::worker::{self, Format, Request};
use super::write::{Images, Ingest};
use crate::addresses::address_of;
use crate::inputs::sources::find_source;
use crate::interrupt::Interrupt;
use crate::parts::{DEMOS_IN_PART, Share, parts_of};
use crate::pipeline::{SourcePaths, label};
use crate::runner::{Built, Runner};

/// What `ingest.source` names.
pub(super) enum Found {
    /// One file, or a folder of another format.
    One(PathBuf),
    /// Several HDF5 files: the dataset in messages, and their paths in order.
    Several(PathBuf, Vec<PathBuf>),
}

/// Finds a source. `of_files` is whether a folder at a path is one of HDF5 files.
pub(super) fn found(source: &SourcePaths, of_files: impl Fn(&Path) -> bool) -> Result<Found> {
    let paths = source
        .paths()
        .iter()
        .map(|path| find_source(path))
        .collect::<Result<Vec<_>>>()?;
    let (name, mut files) = match paths.as_slice() {
        [only] if only.is_dir() && of_files(only) => (only.clone(), files_of(only)?),
        [only] => return Ok(Found::One(only.clone())),
        paths => (label(paths).into(), paths.to_vec()),
    };
    Ok(match files.pop() {
        // The same as the file itself.
        Some(only) if files.is_empty() => Found::One(only),
        Some(last) => {
            files.push(last);
            Found::Several(name, files)
        }
        None => Found::One(name),
    })
}

impl Runner {
    /// Makes the `episodes` artifact of several HDF5 files, or returns the existing one.
    pub(super) fn ingest_several(&self, name: PathBuf, paths: Vec<PathBuf>) -> Result<Built> {
        let start = Instant::now();
        let _span = tracing::info_span!("stage", name = "ingest").entered();
        let section = &self.pipeline.ingest;
        ensure!(
            section.compare.is_none(),
            "cannot ingest {}: ingest.compare applies only to a dataset of one file", name.display();
            "remove it, or ingest the files one by one"
        );
        let gl = (!section.render.is_empty())
            .then(|| re4_mujoco::Gl::of_process().map(|gl| gl.to_string()))
            .transpose()
            .with_context(|| format!("cannot render images for {}", name.display()))?;
        let mut members = Members::find(name.clone(), paths)?;
        let hash = members.hash(|file| {
            let hashed = self.hashed_before(file.path(), || self.hash(|stop| file.hash(stop), STAGE));
            anyhow::Ok(*hashed?.as_bytes())
        })?;
        members.set_surveyed(|path| self.surveyed(path));
        let mut request = Request {
            hash: Some(Key::from_bytes(hash)),
            format: Format::Several(Box::new(members.clone())),
            gl,
            source: name,
            pipeline: self.pipeline.clone(),
            artifacts: self.store.root().to_path_buf(),
            address: address_of(self.store.root()),
            threads: rayon::current_num_threads(),
            share: self.share,
            cautious: false,
        };
        let recipe = request.recipe(Value::Null)?;
        if let Some(built) = self.unchanged(&recipe, start)? {
            self.refuse_left_out(&built.artifact, &request.source)?;
            return Ok(built);
        }
        if section.render.is_empty() && !is_library_forced() {
            match self.made_directly(&request, &members) {
                Err(error) if needs_library(&error) => tracing::info!("the HDF5 library is needed"),
                made => return self.made(made?, &recipe, start),
            }
        }
        // What was found on the way is of use to the worker.
        members.set_surveyed(|path| self.surveyed(path));
        request.format = Format::Several(Box::new(members));
        self.made_by_worker(&request, &recipe, start)
    }

    fn made_directly(&self, request: &Request, members: &Members) -> Result<Artifact> {
        let bar = self.notes.progress(0, STAGE);
        let show = |done: u64, all: u64| {
            bar.set_length(all);
            bar.set_position(done);
        };
        let files = opened(request, members, Access::Direct)?;
        for (path, surveyed) in files.surveyed() {
            self.set_surveyed(path, surveyed);
        }
        let made = make(request, members, files, &self.interrupt, &show);
        bar.finish_and_clear();
        made
    }
}

/// In the worker: makes and publishes the artifact.
pub(super) fn serve(request: &Request, members: &Members, interrupt: &Interrupt) -> Result<Message> {
    let files = opened(request, members, Access::Library)?;
    for (path, surveyed) in files.surveyed() {
        worker::surveyed(request, path, surveyed);
    }
    make(request, members, files, interrupt, &|done, all| {
        worker::progress(done, all, interrupt);
    })?;
    Ok(Message::Done)
}

/// The demonstrations that this process reads, of `demos` in all.
fn needed(share: Share, demos: usize) -> Range<usize> {
    let parts = parts_of(demos, DEMOS_IN_PART);
    match share {
        Share::Parts(Stage::Ingest, shard) => {
            let own = shard.parts(parts);
            own.start as usize * DEMOS_IN_PART..demos.min(own.end as usize * DEMOS_IN_PART)
        }
        share if share.makes_none(Stage::Ingest) && parts > 1 => 0..0,
        _ => 0..demos,
    }
}

fn opened(request: &Request, members: &Members, access: Access) -> Result<Files> {
    let setting = request.pipeline.ingest.env_args.as_deref();
    let choice = choice(&request.pipeline, request.cautious);
    Ok(Files::open(members, &choice, access, setting, |demos| {
        needed(request.share, demos)
    })?)
}

fn make(
    request: &Request,
    members: &Members,
    files: Files,
    interrupt: &Interrupt,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Artifact> {
    let section = &request.pipeline.ingest;
    let cameras = if section.images && section.render.is_empty() {
        CamerasAsked::Named(section.cameras.clone())
    } else {
        CamerasAsked::None
    };
    // If a file changed while it was read, that is the error to report, not its consequences.
    let or_changed = |error: anyhow::Error| -> anyhow::Error {
        let unchanged = || -> Result<()> {
            interrupt.check(STAGE)?;
            Ok(members.unchanged()?)
        };
        unchanged().err().unwrap_or(error)
    };
    let write = Write {
        request,
        interrupt,
        progress,
    };
    if request.pipeline.task == Task::Arm {
        let source = ArmSource::several(files, &section.arm, &cameras).map_err(|error| or_changed(error.into()))?;
        let conventions = source.first()?.conventions().to_vec();
        return write.publish(&source, &conventions, |_| Ok(Images::Recorded));
    }
    let source = RobomimicSource::several(files, &reading(&request.pipeline), &cameras);
    let source: Several<RobomimicSource> = source.map_err(|error| or_changed(error.into()))?;
    let first = source.first()?;
    let env = first.env().clone();
    write.publish(&source, first.conventions(), |key| {
        if section.render.is_empty() {
            return Ok(Images::Recorded);
        }
        let recorded = first.reader().cameras(None)?;
        ensure!(
            recorded.is_empty(),
            "cannot render images for {}: it has recorded images ({})", request.source.display(), recorded.join(", ");
            "remove ingest.render"
        );
        let rendering = Rendering::new(&section.render, &env, &request.source)?;
        Ok(Images::Rendered(rendering, Spool::open(&request.artifacts, key)?))
    })
}

/// Everything that writing the artifact needs besides the source.
struct Write<'a> {
    request: &'a Request,
    interrupt: &'a Interrupt,
    progress: &'a (dyn Fn(u64, u64) + Sync),
}

impl<'a> Write<'a> {
    fn publish<S: DemoSource>(
        &self,
        source: &S,
        conventions: &[Convention],
        images: impl FnOnce(Key) -> Result<Images<'a>>,
    ) -> Result<Artifact> {
        let recipe = self.request.recipe(json!(source.info()))?;
        let ingest = Ingest {
            section: &self.request.pipeline.ingest,
            source: &self.request.source,
            compare: None,
            conventions,
            images: images(recipe.key())?,
            threads: self.request.threads,
            share: self.request.share,
            interrupt: self.interrupt,
            progress: self.progress,
        };
        let store = Store::open(&self.request.artifacts)?;
        ingest.publish(source, &store, &recipe)
    }
}

/// What `inspect` says of the files of a folder besides the first one.
pub(super) fn note(files: &[PathBuf]) -> Option<String> {
    let (first, others) = files.split_first()?;
    (!others.is_empty()).then(|| {
        let count = files.len();
        format!(
            "the folder has {count} HDF5 files, which are one dataset if it is the ingest.source; only {} was inspected",
            first.display()
        )
    })
}

/// The error for a command that needs a dataset of one file.
pub(crate) fn one_file(source: &SourcePaths, what: &str) -> Result<PathBuf> {
    match found(source, |_| true)? {
        Found::One(path) => Ok(path),
        Found::Several(name, _) => Err(fault!(
            "{what} needs a dataset of one file, but {} has several", name.display();
            "ingest the files one by one, or merge them into one file"
        )
        .into()),
    }
}

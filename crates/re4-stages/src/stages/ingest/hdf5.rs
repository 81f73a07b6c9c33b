//! Ingests HDF5 files of robosuite tasks. If the HDF5 library is needed, a separate worker process makes the artifact.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, Key, Store};
use re4_fault::{ensure, fault};
use re4_ingest::robomimic::{
    Access, ArmSource, Comparison, DemoChoice, Interpreter, Reading, RobomimicReader, RobomimicSource, Sources,
};
use re4_ingest::{DemoSource as _, IngestError, LeftOut};
use re4_robosuite::env_args::EnvArgs;
use re4_task::Task;
use serde_json::{Value, json};

use super::message::Message;
use super::rendered::{self, Rendering};
use super::spool::Spool;
use super::worker::{self, Format, Hdf5, Request};
use super::write::{Images, Ingest};
use super::{STAGE, recipe};
use crate::addresses::address_of;
use crate::inputs::sources::find_source;
use crate::interrupt::Interrupt;
use crate::pipeline::Pipeline;
use crate::runner::{Built, Runner};

impl Runner {
    /// Makes the `episodes` artifact of an HDF5 file, or returns the existing one. This process never uses the HDF5 library: it
    /// reads files of the simplest layout by itself, and leaves all others to a worker process.
    pub(super) fn ingest_hdf5(&self, source: PathBuf) -> Result<Built> {
        let start = Instant::now();
        let _span = tracing::info_span!("stage", name = "ingest").entered();
        let section = &self.pipeline.ingest;
        let gl = (!section.render.is_empty())
            .then(|| re4_mujoco::Gl::of_process().map(|gl| gl.to_string()))
            .transpose()
            .with_context(|| format!("cannot render images for {}", source.display()))?;
        let mut sources = Sources::open(&source)?;
        let compare = section.compare.as_deref().map(find_source).transpose()?;
        let compare_sources = compare.as_deref().map(Sources::open).transpose()?;
        let mut hdf5 = Hdf5 {
            identity: sources.identity(),
            surveyed: self.surveyed(sources.path()),
            compare_hash: None,
            compare_identity: compare_sources.as_ref().map(Sources::identity),
            compare,
        };
        let mut request = Request {
            hash: None,
            format: Format::Hdf5(Box::new(hdf5.clone())),
            gl,
            source,
            pipeline: self.pipeline.clone(),
            artifacts: self.store.root().to_path_buf(),
            address: address_of(self.store.root()),
            threads: rayon::current_num_threads(),
            share: self.share,
            cautious: false,
        };
        // If the hash is known, an existing artifact is found without opening the file.
        if compare_sources.is_none()
            && !sources.has_models_folder()
            && let Some(known) = self.known_hash(sources.path())
        {
            request.hash = Some(known);
            if let Some(built) = self.unchanged(&request.recipe(Value::Null)?, start)? {
                self.refuse_left_out(&built.artifact, &request.source)?;
                return Ok(built);
            }
            request.hash = None;
        }
        let hash = |sources: &Sources| self.hash_of_hdf5(sources);
        // The file is opened and its conventions are determined while it is hashed. If there is a folder of models, the hash also
        // covers the models that the file refers to, so hashing has to wait until the file is open.
        let single_file = !sources.has_models_folder();
        let (early, direct, learned) = std::thread::scope(|scope| {
            let hashing = single_file.then(|| scope.spawn(|| hash(&sources)));
            let direct = self.open_direct(&sources);
            let here = direct.as_ref().ok().and_then(Option::as_ref);
            let here = here.filter(|_| section.render.is_empty() && self.pipeline.task != Task::Arm);
            let learned = here.map(|reader| Interpreter::learn(reader, &reading(&self.pipeline)));
            (hashing.map(std::thread::ScopedJoinHandle::join), direct, learned)
        });
        let direct = direct?;
        tracing::info!(source = %request.source.display(), library = direct.is_none(), "HDF5 file opened");
        match &direct {
            Some(reader) => sources = reader.sources().clone(),
            // Only the library can read which models the file refers to.
            None if !single_file => {
                let names = self.attended(&request, |bar| worker::models(&request, &self.interrupt, bar))?;
                sources = sources.with_models(names);
            }
            None => {}
        }
        hdf5.identity = sources.identity();
        request.hash = Some(match early {
            Some(hashed) => hashed.map_err(|_| fault!("the thread that hashes the source stopped"; "run again"))??,
            None => hash(&sources)?,
        });
        if let Some(reader) = &direct {
            self.set_surveyed(sources.path(), reader.surveyed());
            hdf5.surveyed = Some(reader.surveyed().clone());
        }
        hdf5.compare_hash = compare_sources.as_ref().map(hash).transpose()?;
        request.format = Format::Hdf5(Box::new(hdf5));
        let recipe = request.recipe(Value::Null)?;
        if let Some(built) = self.unchanged(&recipe, start)? {
            self.refuse_left_out(&built.artifact, &request.source)?;
            return Ok(built);
        }
        if let Some(reader) = direct.filter(|_| section.render.is_empty()) {
            let bar = self.notes.progress(0, STAGE);
            let show = |done: u64, all: u64| {
                bar.set_length(all);
                bar.set_position(done);
            };
            let inputs = Inputs {
                reader,
                compare: compare_sources.clone(),
                access: Access::Direct,
                learned,
            };
            let made = make(&request, inputs, &self.interrupt, &show);
            bar.finish_and_clear();
            match made {
                Err(error) if needs_library(&error) => tracing::info!("the HDF5 library is needed after all"),
                made => return self.made(made?, &recipe, start),
            }
        }
        self.made_by_worker(&request, &recipe, start)
    }

    /// The hash of a file and of the models beside it that it refers to.
    fn hash_of_hdf5(&self, sources: &Sources) -> Result<Key> {
        let hash = || self.hash(|stop| sources.hash(stop), STAGE);
        if sources.has_models_folder() {
            hash()
        } else {
            self.hashed_before(sources.path(), hash)
        }
    }

    /// Opens the file without the HDF5 library; `None` if its layout needs the library.
    fn open_direct(&self, sources: &Sources) -> Result<Option<RobomimicReader>> {
        if is_library_forced() {
            return Ok(None);
        }
        let known = self.surveyed(sources.path());
        match RobomimicReader::open(sources, &choice(&self.pipeline, false), Access::Direct, known.as_ref()) {
            Err(error) if error.needs_library() => Ok(None),
            opened => Ok(Some(opened?)),
        }
    }
}

/// For tests: the value `library` makes ingest read every file with the HDF5 library.
const HDF5_VARIABLE: &str = "RE4_HDF5";

pub(super) fn is_library_forced() -> bool {
    std::env::var_os(HDF5_VARIABLE).is_some_and(|value| value == "library")
}

pub(super) fn needs_library(error: &anyhow::Error) -> bool {
    let cause = error.downcast_ref::<IngestError>();
    cause.is_some_and(IngestError::needs_library)
}

impl Request {
    /// The file of `ingest.compare`, and its hash.
    fn compared(&self) -> Option<(&Path, Option<&Key>)> {
        match &self.format {
            Format::Hdf5(hdf5) => Some((hdf5.compare.as_deref()?, hdf5.compare_hash.as_ref())),
            Format::Several(_) | Format::Lerobot(_) => None,
        }
    }

    /// The recipe of the artifact.
    pub(super) fn recipe(&self, summary: Value) -> Result<re4_artifact::Recipe> {
        let hash = self.hash.as_ref().context("the source was not hashed")?;
        let render = rendered::settings(&self.pipeline.ingest.render, self.gl.as_deref());
        recipe(
            &self.pipeline,
            hash,
            self.compared().and_then(|(_, hash)| hash),
            &render,
            summary,
        )
    }
}

/// In the worker: makes and publishes the artifact, or returns the models that the file refers to.
pub(super) fn serve(request: &Request, hdf5: &Hdf5, interrupt: &Interrupt) -> Result<Message> {
    let sources = Sources::open_again(&request.source, &hdf5.identity)?;
    let choice = choice(&request.pipeline, request.cautious);
    let reader = RobomimicReader::open(&sources, &choice, Access::Library, hdf5.surveyed.as_ref())?;
    worker::surveyed(request, sources.path(), reader.surveyed());
    if request.hash.is_none() {
        return Ok(Message::Models(
            reader.sources().model_names().map(str::to_owned).collect(),
        ));
    }
    // Models that were added or removed since the parent hashed the files are a change, too.
    if reader.sources().identity() != hdf5.identity {
        return Err(reader.sources().changed().into());
    }
    let compare = match (&hdf5.compare, &hdf5.compare_identity) {
        (Some(path), Some(identity)) => Some(Sources::open_again(path, identity)?),
        _ => None,
    };
    let inputs = Inputs {
        reader,
        compare,
        access: Access::Library,
        learned: None,
    };
    make(request, inputs, interrupt, &|done, all| {
        worker::progress(done, all, interrupt);
    })?;
    Ok(Message::Done)
}

/// The conventions of the file, and the demonstrations that were read for them and cannot be used.
type Learned = Result<(Interpreter, Vec<LeftOut>), IngestError>;

/// The opened files of an ingest.
struct Inputs {
    reader: RobomimicReader,
    compare: Option<Sources>,
    access: Access,
    /// The conventions, if they have been determined already.
    learned: Option<Learned>,
}

/// Makes and publishes the artifact.
fn make(
    request: &Request,
    inputs: Inputs,
    interrupt: &Interrupt,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Artifact> {
    let files = inputs.reader.sources().clone();
    let compare = inputs.compare.clone();
    let or_changed = |error: anyhow::Error| -> anyhow::Error {
        // If a file changed while it was read, that is the error to report, not its consequences.
        let unchanged = || -> Result<()> {
            interrupt.check(STAGE)?;
            files.unchanged()?;
            Ok(compare.as_ref().map_or(Ok(()), Sources::unchanged)?)
        };
        unchanged().err().unwrap_or(error)
    };
    let store = || Store::open(&request.artifacts);
    if request.pipeline.task == Task::Arm {
        let source = open_arm(request, inputs.reader).map_err(or_changed)?;
        let recipe = request.recipe(json!(source.info()))?;
        let ingest = Ingest {
            section: &request.pipeline.ingest,
            source: &request.source,
            compare: None,
            conventions: source.conventions(),
            images: Images::Recorded,
            threads: request.threads,
            share: request.share,
            interrupt,
            progress,
        };
        return ingest.publish(&source, &store()?, &recipe);
    }
    let source = open(request, inputs).map_err(or_changed)?;
    let recipe = request.recipe(json!(source.info()))?;
    let ingest = Ingest {
        section: &request.pipeline.ingest,
        source: &request.source,
        compare: request.compared().map(|(path, _)| path),
        conventions: source.conventions(),
        images: match rendering(request, source.reader(), source.env())? {
            Some(rendering) => Images::Rendered(rendering, Spool::open(&request.artifacts, recipe.key())?),
            None => Images::Recorded,
        },
        threads: request.threads,
        share: request.share,
        interrupt,
        progress,
    };
    ingest.publish(&source, &store()?, &recipe)
}

fn open_arm(request: &Request, reader: RobomimicReader) -> Result<ArmSource> {
    let cameras = cameras(request, &reader)?;
    Ok(ArmSource::new(reader, &request.pipeline.ingest.arm, cameras)?)
}

/// The cameras whose recorded images are ingested.
fn cameras(request: &Request, reader: &RobomimicReader) -> Result<Vec<String>> {
    let section = &request.pipeline.ingest;
    if !section.images || !section.render.is_empty() {
        return Ok(Vec::new());
    }
    Ok(reader.cameras(section.cameras.as_deref())?)
}

fn open(request: &Request, inputs: Inputs) -> Result<RobomimicSource> {
    let Inputs {
        reader,
        compare,
        access,
        learned,
    } = inputs;
    let learned = learned.unwrap_or_else(|| Interpreter::learn(&reader, &reading(&request.pipeline)))?;
    let comparison = compare.map(|sources| Comparison::open(&sources, access)).transpose()?;
    let cameras = cameras(request, &reader)?;
    Ok(RobomimicSource::new(reader, learned, comparison, cameras)?)
}

/// The rendering of the images that `ingest.render` requests; `None` if it requests none.
fn rendering<'a>(request: &'a Request, reader: &RobomimicReader, env: &EnvArgs) -> Result<Option<Rendering<'a>>> {
    let render = &request.pipeline.ingest.render;
    if render.is_empty() {
        return Ok(None);
    }
    let recorded = reader.cameras(None)?;
    ensure!(
        recorded.is_empty(),
        "cannot render images for {}: it has recorded images ({})", request.source.display(), recorded.join(", ");
        "remove ingest.render"
    );
    Ok(Some(Rendering::new(render, env, &request.source)?))
}

pub(super) fn choice(pipeline: &Pipeline, cautious: bool) -> DemoChoice {
    DemoChoice {
        filter: pipeline.ingest.filter.clone(),
        select: pipeline.ingest.select.clone(),
        cautious,
    }
}

pub(super) fn reading(pipeline: &Pipeline) -> Reading {
    let section = &pipeline.ingest;
    Reading {
        task: pipeline.task.robosuite(),
        object: section.object.clone(),
        env_args: section.env_args.clone(),
        conventions: section.conventions,
    }
}

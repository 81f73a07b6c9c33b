//! Renders images of robosuite's cameras from recorded states, with each demonstration's own model.

use std::cell::Cell;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Scope, ScopedJoinHandle};

use anyhow::{Context as _, Result};
use re4_fault::{OrFault as _, bail, ensure, fault};
use re4_ingest::Episode;
use re4_mujoco::{Data, Footprint, Gl, Kind, Library, Model, Renderer};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::models::{Appearance, split_appearance, with_assets};
use re4_sim::robosuite::Profile;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::helper::{Helper, Outcome, Setup};
use super::spool::Spool;
use super::tables::ImageTable;
use crate::inputs::images::encode_png;
use crate::inputs::simulators;
use crate::interrupt::Interrupt;
use crate::pipeline::Camera;

/// Side of an image in pixels, as in robomimic's datasets.
const SIDE: usize = Camera::Agentview.side();

/// Memory budget of the worker, in bytes: 512 MiB less a margin. It limits the number of threads, because all threads render in the
/// worker if no helper can be used. One thread always renders, even if it needs more.
const MEMORY: u64 = 480 << 20;

/// Memory that the process needs besides renderers, in bytes: its libraries, and queued demonstrations.
const PROCESS: u64 = 112 << 20;

/// Increase it whenever the same states give different images.
const RENDERING_VERSION: u32 = 1;

/// The rendering settings that are part of the artifact's key. The MuJoCo version is not among them because it follows from the
/// source file.
pub(super) fn settings(cameras: &[Camera], gl: Option<&str>) -> Value {
    json!({
        "assets": "robosuite-1.4.1",
        "cameras": cameras,
        "gl": gl,
        "side": SIDE,
        "version": RENDERING_VERSION,
    })
}

/// The version of robosuite whose images are reproduced.
fn profile(env: &EnvArgs) -> Result<Profile> {
    let Some(named) = env.env_version.as_deref() else {
        bail!(
            "the file does not name the robosuite version that recorded it";
            "set ingest.env_args to the file's env_args with env_version added"
        );
    };
    Profile::of(named)
        .with_context(|| format!("it was recorded with robosuite {named}, but only 1.4 and 1.5 are supported"))
}

/// Everything that rendering needs besides the demonstrations.
pub(super) struct Rendering<'a> {
    profile: Profile,
    library: Library,
    gl: Gl,
    cameras: Vec<&'static str>,
    source: &'a Path,
}

/// A demonstration to be rendered.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Job {
    episode: u32,
    demo: String,
    /// Names and half sizes (in metres) of the boxes whose sizes differ between demonstrations.
    boxes: Vec<(String, [f64; 3])>,
    /// Number of columns of the states.
    columns: usize,
    /// The states, one row per frame.
    states: Vec<f64>,
    cameras: Vec<String>,
}

/// Threads that render demonstrations with the same model (up to box sizes), until the queue ends.
struct RenderPool<'scope> {
    /// The common part of the models: MJCF without the box sizes.
    appearance: String,
    jobs: SyncSender<Job>,
    threads: Vec<ScopedJoinHandle<'scope, ()>>,
}

/// What the threads of a pool share.
struct Scene {
    model: Model,
    setup: Setup,
    /// Whether a thread renders in this process. It is the first one that gets a demonstration; the others use helpers.
    occupied: AtomicBool,
}

/// Where a thread renders.
enum Place {
    /// It has rendered nothing yet.
    Nowhere,
    Here(Box<Option<Renderer>>),
    InHelper(Helper),
}

impl Place {
    /// Renders a demonstration and stores its images in the spool. Stores nothing if it is interrupted.
    fn render(&mut self, job: &Job, scene: &Scene, interrupt: &Interrupt, done: &impl Fn(usize)) -> Result<()> {
        if let Self::Nowhere = self {
            *self = if scene.occupied.swap(true, Ordering::Relaxed) {
                Helper::start(&scene.setup).map_or(Self::Here(Box::default()), Self::InHelper)
            } else {
                Self::Here(Box::default())
            };
        }
        let reported = match self {
            Self::InHelper(helper) => match helper.render(job, interrupt, done) {
                Outcome::Stored | Outcome::Interrupted => return Ok(()),
                Outcome::Failed(images) => images,
            },
            _ => 0,
        };
        if let Self::Nowhere | Self::InHelper(_) = self {
            *self = Self::Here(Box::default());
        }
        let Self::Here(renderer) = self else { return Ok(()) };
        // Images that the helper has reported are not counted twice.
        let skipped = Cell::new(reported);
        let done = |images| match skipped.get() {
            0 => done(images),
            left => skipped.set(left - 1),
        };
        render_demo(job, &scene.model, renderer, &scene.setup.spool, interrupt, &done)
    }
}

impl RenderPool<'_> {
    /// Waits until all queued demonstrations are rendered and the renderers' memory is freed.
    fn finish(self) {
        drop(self.jobs);
        for thread in self.threads {
            if let Err(panic) = thread.join() {
                std::panic::resume_unwind(panic);
            }
        }
    }
}

/// Number of threads, at most `threads`, that can render a model in this process within [`MEMORY`].
fn pool_size(model: &Model, threads: usize) -> usize {
    let Footprint { shared, each } = Renderer::footprint(model, SIDE, SIDE);
    let room = MEMORY.saturating_sub(PROCESS + shared);
    usize::try_from(room / each.max(1)).map_or(threads, |fit| fit.clamp(1, threads.max(1)))
}

impl<'a> Rendering<'a> {
    pub(super) fn new(cameras: &[Camera], env: &EnvArgs, source: &'a Path) -> Result<Self> {
        let failed = || format!("cannot render images for {}", source.display());
        let mut cameras: Vec<_> = cameras.iter().map(|camera| camera.name()).collect();
        cameras.sort_unstable();
        let profile = profile(env).with_context(failed)?;
        Ok(Self {
            profile,
            library: simulators::library(profile).with_context(failed)?,
            gl: Gl::of_process().with_context(failed)?,
            cameras,
            source,
        })
    }

    /// Description of the rendering for the summary of the artifact.
    pub(super) fn summary(&self) -> Value {
        json!({
            "by": format!("MuJoCo {} with {}", self.library.version(), self.gl),
            "side": SIDE,
        })
    }

    /// Names of the cameras, in alphabetical order.
    pub(super) fn cameras(&self) -> Vec<String> {
        self.cameras.iter().map(|&camera| camera.to_owned()).collect()
    }

    /// Renders the images that are not in the spool. `read` passes the demonstrations in order to its argument; `progress` is
    /// called with the number of finished images.
    ///
    /// Each thread renders whole demonstrations; [`MEMORY`] limits the number of threads. If several demonstrations cannot be
    /// rendered, the first one is reported, independent of the number of threads.
    pub(super) fn render(
        &self,
        spool: &Spool,
        threads: usize,
        interrupt: &Interrupt,
        progress: &(impl Fn(usize) + Sync),
        read: impl FnOnce(&mut dyn FnMut(u32, Episode) -> Result<()>) -> Result<()>,
    ) -> Result<()> {
        let failure: Mutex<Option<(u32, anyhow::Error)>> = Mutex::new(None);
        let failed = || failure.lock().unwrap_or_else(PoisonError::into_inner);
        let count = Mutex::new(0);
        let done = |images: usize| {
            let mut count = count.lock().unwrap_or_else(PoisonError::into_inner);
            *count += images;
            progress(*count);
        };
        let work = |job: &Job, scene: &Scene, place: &mut Place| {
            // Demonstrations before a failed one are still rendered, because they may fail, too, and the first failure is
            // reported.
            let superseded = failed().as_ref().is_some_and(|(episode, _)| *episode < job.episode);
            if superseded || interrupt.requested() {
                return;
            }
            if let Err(error) = place.render(job, scene, interrupt, &done) {
                let error = error.context(self.cannot(&job.demo));
                let mut failure = failed();
                if failure.as_ref().is_none_or(|(episode, _)| job.episode < *episode) {
                    *failure = Some((job.episode, error));
                }
            }
        };
        let result = std::thread::scope(|scope| {
            let mut pool: Option<RenderPool<'_>> = None;
            // When reading ends, the pool is dropped, which closes its queue and ends its threads.
            read(&mut |episode, mut demo| {
                let frames = demo.frames.count();
                let name = demo.name.name;
                interrupt.check("ingest")?;
                // Stops the reading. The error of the demonstration itself replaces this one below.
                ensure!(failed().is_none(), "a demonstration cannot be rendered");
                let mut missing = Vec::new();
                for &camera in &self.cameras {
                    if spool.get(camera, episode, frames)?.is_none() {
                        missing.push(camera.to_owned());
                    }
                }
                done(frames * (self.cameras.len() - missing.len()));
                if missing.is_empty() {
                    return Ok(());
                }
                let lacks = |what| {
                    anyhow::Error::from(fault!("it has no {what}"; "remove ingest.render")).context(self.cannot(&name))
                };
                let mjcf = demo.model.take().ok_or_else(|| lacks("attribute model_file"))?;
                let states = demo.states.take().ok_or_else(|| lacks("dataset states"))?;
                let Appearance { rest, boxes } = split_appearance(&mjcf).with_context(|| self.cannot(&name))?;
                let pool = match &mut pool {
                    Some(pool) if pool.appearance == rest => pool,
                    other => {
                        // Frees the memory of the previous pool before the next model is compiled.
                        if let Some(last) = other.take() {
                            last.finish();
                        }
                        let model = compile(&self.library, &mjcf).with_context(|| self.cannot(&name))?;
                        let scene = Scene {
                            model,
                            setup: Setup {
                                profile: self.profile,
                                mjcf: mjcf.to_string(),
                                spool: spool.clone(),
                            },
                            occupied: AtomicBool::new(false),
                        };
                        other.insert(start_pool(scope, rest, scene, threads, &work))
                    }
                };
                let job = Job {
                    episode,
                    demo: name,
                    boxes,
                    columns: states.columns,
                    states: states.values,
                    cameras: missing,
                };
                pool.jobs
                    .send(job)
                    .map_err(|_| fault!("all rendering threads have stopped"; "run again").into())
            })
        });
        if let Some((_, error)) = failed().take() {
            return Err(error);
        }
        interrupt.check("ingest")?;
        result
    }

    fn cannot(&self, demo: &str) -> String {
        format!("cannot render the images of {demo} in {}", self.source.display())
    }

    /// Writes the images of the spool to table `images`, sorted by camera, episode and frame. Returns the number of images.
    pub(super) fn write(
        &self,
        spool: &Spool,
        demos: &(impl Iterator<Item = (u32, usize)> + Clone),
        mut table: ImageTable,
    ) -> Result<usize> {
        for &camera in &self.cameras {
            for (episode, frames) in demos.clone() {
                let images = spool.get(camera, episode, frames)?;
                let images = images.or_fault(|| fault!("images that were just rendered have disappeared, perhaps removed by another run of the same artifact"; "run again"))?;
                let places: Vec<(u32, u32)> = (0..frames as u32).map(|frame| (episode, frame)).collect();
                table.write(camera, &places, images)?;
            }
        }
        table.finish()
    }
}

/// Compiles the model of a demonstration. That takes seconds, so demonstrations that differ only in box sizes share a model.
pub(super) fn compile(library: &Library, mjcf: &str) -> Result<Model> {
    let text = with_assets(mjcf, &simulators::assets_folder())?;
    Model::compile(library, &text).context("its model_file does not compile")
}

/// Renders a demonstration and stores its images in the spool. Stores nothing if it is interrupted.
pub(super) fn render_demo(
    job: &Job,
    model: &Model,
    renderer: &mut Option<Renderer>,
    spool: &Spool,
    interrupt: &Interrupt,
    done: &impl Fn(usize),
) -> Result<()> {
    let (nq, nv) = (model.nq(), model.nv());
    ensure!(
        job.columns == 1 + nq + nv,
        "its states have {} numbers, but its model_file needs {}: the time, {nq} coordinates and {nv} velocities",
        job.columns,
        1 + nq + nv;
        "use the model_file that belongs to these states"
    );
    let renderer = match renderer {
        Some(renderer) => renderer,
        none => none.insert(Renderer::new(model, SIDE, SIDE)?),
    };
    let cameras = job
        .cameras
        .iter()
        .map(|camera| model.id(Kind::Camera, camera))
        .collect::<Result<Vec<_>, _>>()?;
    let model = model.with_boxes(job.boxes.iter().map(|(name, size)| (name.as_str(), *size)))?;
    let mut data = Data::new(&model)?;
    let mut pixels = vec![0; 3 * SIDE * SIDE];
    let mut images = vec![Vec::with_capacity(job.states.len() / job.columns); cameras.len()];
    for state in job.states.chunks_exact(job.columns) {
        if interrupt.requested() {
            return Ok(());
        }
        re4_rollout::set_state(&mut data, state).map_err(anyhow::Error::msg)?;
        for (&camera, images) in cameras.iter().zip(&mut images) {
            renderer.render_into(&mut data, camera, &mut pixels)?;
            images.push(encode_png(&pixels, SIDE as u32, SIDE as u32)?);
            done(1);
        }
    }
    for (camera, images) in job.cameras.iter().zip(&images) {
        spool.put(camera, job.episode, images)?;
    }
    Ok(())
}

/// Starts threads that render demonstrations of a model: one in this process, and the others with a helper each.
fn start_pool<'scope>(
    scope: &'scope Scope<'scope, '_>,
    appearance: String,
    scene: Scene,
    threads: usize,
    work: &'scope (impl Fn(&Job, &Scene, &mut Place) + Sync),
) -> RenderPool<'scope> {
    let threads = pool_size(&scene.model, threads);
    let scene = Arc::new(scene);
    let (jobs, queue) = sync_channel(threads);
    let queue = Arc::new(Mutex::new(queue));
    let threads = (0..threads)
        .map(|_| {
            let (queue, scene) = (Arc::clone(&queue), Arc::clone(&scene));
            scope.spawn(move || {
                let mut place = Place::Nowhere;
                while let Some(job) = next(&queue) {
                    work(&job, &scene, &mut place);
                }
            })
        })
        .collect();
    RenderPool {
        appearance,
        jobs,
        threads,
    }
}

/// Waits for the next demonstration; `None` if there are no more.
fn next(queue: &Mutex<Receiver<Job>>) -> Option<Job> {
    queue.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}

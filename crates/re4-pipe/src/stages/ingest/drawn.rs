//! Pictures of robosuite's cameras, drawn from recorded states through each demonstration's own model.

use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context as _, Result, anyhow, bail, ensure};
use re4_artifact::{Columns, Writer, tables};
use re4_ingest::robomimic::{Demo, Matrix};
use re4_mujoco::{Data, Gl, Kind, Library, Model, Renderer};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::models::{Looks, looks, with_assets};
use re4_sim::robosuite::Profile;
use serde_json::{Value, json};

use super::super::simulators;
use super::spool::Spool;
use super::{PICTURES_IN_GROUP, encode_png};
use crate::interrupt::Interrupt;
use crate::pipeline::Camera;

/// Side of a picture, in pixels: what robomimic's datasets hold.
const SIDE: usize = 84;

/// Raised whenever the same states give other pictures.
const DRAWING_VERSION: u32 = 1;

/// What the key of an artifact says of drawn pictures. Which MuJoCo draws follows from the file.
pub(super) fn settings(cameras: &[Camera], gl: Option<&str>) -> Value {
    json!({
        "assets": "robosuite-1.4.1",
        "cameras": cameras,
        "gl": gl,
        "side": SIDE,
        "version": DRAWING_VERSION,
    })
}

/// The version of robosuite whose pictures are drawn.
fn profile(env: &EnvArgs) -> Result<Profile> {
    let Some(named) = env.env_version.as_deref() else {
        bail!(
            "the file does not say which robosuite recorded it; give its env_args, with env_version, as ingest.env_args"
        );
    };
    Profile::of(named)
        .with_context(|| format!("it was recorded with robosuite {named}, and the versions known here are 1.4 and 1.5"))
}

/// What is drawn with: the library is there, and the cameras are known.
pub(super) struct Drawing<'a> {
    library: Library,
    gl: Gl,
    cameras: Vec<&'static str>,
    source: &'a Path,
    /// Models that were compiled, each with what it looks like; the newest last.
    compiled: Mutex<Vec<(String, Model)>>,
}

/// Models that are remembered: in known datasets all look alike.
const REMEMBERED: usize = 4;

/// A demonstration to be drawn.
struct Job {
    episode: u32,
    demo: String,
    model: Arc<str>,
    states: Matrix,
    cameras: Vec<&'static str>,
}

impl<'a> Drawing<'a> {
    pub(super) fn new(cameras: &[Camera], env: &EnvArgs, source: &'a Path) -> Result<Self> {
        let failed = || format!("cannot draw the pictures of {}", source.display());
        let mut cameras: Vec<_> = cameras.iter().map(|camera| camera.name()).collect();
        cameras.sort_unstable();
        Ok(Self {
            library: profile(env).and_then(simulators::library).with_context(failed)?,
            gl: Gl::of_process().with_context(failed)?,
            cameras,
            source,
            compiled: Mutex::new(Vec::new()),
        })
    }

    /// What the artifact says of its pictures.
    pub(super) fn facts(&self) -> Value {
        json!({
            "by": format!("MuJoCo {} with {}", self.library.version(), self.gl),
            "side": SIDE,
        })
    }

    /// Names of its cameras, in alphabetical order.
    pub(super) fn cameras(&self) -> Vec<String> {
        self.cameras.iter().map(|&camera| camera.to_owned()).collect()
    }

    /// Draws what is not yet in the spool. `read` hands on the demonstrations in order; `tell` hears how many pictures are
    /// done.
    ///
    /// Every thread draws whole demonstrations. Of several that cannot be drawn the first is reported, whatever the number of
    /// threads.
    pub(super) fn draw(
        &self,
        spool: &Spool,
        threads: usize,
        interrupt: &Interrupt,
        tell: &(impl Fn(usize) + Sync),
        read: impl FnOnce(&mut dyn FnMut(u32, Demo) -> Result<()>) -> Result<()>,
    ) -> Result<()> {
        let (jobs, queue) = sync_channel(threads);
        let queue = Mutex::new(queue);
        let failure: Mutex<Option<(u32, anyhow::Error)>> = Mutex::new(None);
        let failed = || failure.lock().unwrap_or_else(PoisonError::into_inner);
        let count = Mutex::new(0);
        let done = |pictures: usize| {
            let mut count = count.lock().unwrap_or_else(PoisonError::into_inner);
            *count += pictures;
            tell(*count);
        };
        let result = std::thread::scope(|scope| {
            for _ in 0..threads {
                scope.spawn(|| {
                    let mut renderer = None;
                    while let Some(job) = next(&queue) {
                        // Those before the one that failed are seen to their ends, so that the first one is told.
                        let in_vain = failed().as_ref().is_some_and(|(episode, _)| *episode < job.episode);
                        if in_vain || interrupt.requested() {
                            continue;
                        }
                        if let Err(error) = self.draw_demo(&job, &mut renderer, spool, interrupt, &done) {
                            let error = error.context(self.cannot(&job.demo));
                            let mut failure = failed();
                            if failure.as_ref().is_none_or(|(episode, _)| job.episode < *episode) {
                                *failure = Some((job.episode, error));
                            }
                        }
                    }
                });
            }
            // The queue ends with the reading.
            let jobs = jobs;
            read(&mut |episode, mut demo| {
                interrupt.check("ingest")?;
                ensure!(failed().is_none(), "a demonstration cannot be drawn");
                let mut missing = Vec::new();
                for &camera in &self.cameras {
                    if spool.get(camera, episode, demo.frames)?.is_none() {
                        missing.push(camera);
                    }
                }
                done(demo.frames * (self.cameras.len() - missing.len()));
                if missing.is_empty() {
                    return Ok(());
                }
                let lacks =
                    |what| anyhow!("it has no {what}; leave ingest.render out").context(self.cannot(&demo.name));
                let model = demo.model.take().ok_or_else(|| lacks("attribute model_file"))?;
                let states = demo.states.take().ok_or_else(|| lacks("dataset states"))?;
                let job = Job {
                    episode,
                    demo: demo.name,
                    model,
                    states,
                    cameras: missing,
                };
                jobs.send(job)
                    .map_err(|_| anyhow!("no thread draws any more; run again"))
            })
        });
        if let Some((_, error)) = failed().take() {
            return Err(error);
        }
        interrupt.check("ingest")?;
        result
    }

    fn cannot(&self, demo: &str) -> String {
        format!("cannot draw the pictures of {demo} in {}", self.source.display())
    }

    /// Draws a demonstration and puts its pictures into the spool, unless it is interrupted.
    fn draw_demo(
        &self,
        job: &Job,
        renderer: &mut Option<Renderer>,
        spool: &Spool,
        interrupt: &Interrupt,
        done: &impl Fn(usize),
    ) -> Result<()> {
        let model = self.model(&job.model)?;
        let (nq, nv) = (model.nq(), model.nv());
        ensure!(
            job.states.columns == 1 + nq + nv,
            "its states have {} numbers, but its model_file needs {}: the time, {nq} coordinates and {nv} velocities; states and model_file do not belong together",
            job.states.columns,
            1 + nq + nv
        );
        let renderer = match renderer {
            Some(renderer) if renderer.model().looks_like(&model) => renderer,
            other => {
                // The memory of the last one first.
                *other = None;
                other.insert(Renderer::new(&model, SIDE, SIDE)?)
            }
        };
        let cameras = job
            .cameras
            .iter()
            .map(|camera| model.id(Kind::Camera, camera))
            .collect::<Result<Vec<_>, _>>()?;
        let mut data = Data::new(&model)?;
        let mut pixels = vec![0; 3 * SIDE * SIDE];
        let mut pictures = vec![Vec::with_capacity(job.states.rows()); cameras.len()];
        for state in job.states.values.chunks_exact(job.states.columns) {
            if interrupt.requested() {
                return Ok(());
            }
            simulators::set_state(&mut data, state)?;
            for (&camera, pictures) in cameras.iter().zip(&mut pictures) {
                renderer.draw_into(&mut data, camera, &mut pixels)?;
                pictures.push(encode_png(&pixels, SIDE as u32, SIDE as u32)?);
                done(1);
            }
        }
        for (camera, pictures) in job.cameras.iter().zip(&pictures) {
            spool.put(camera, job.episode, pictures)?;
        }
        Ok(())
    }

    /// A demonstration's model. Compiling one takes seconds, so what looks alike is compiled once.
    fn model(&self, mjcf: &str) -> Result<Model> {
        let Looks { rest, boxes } = looks(mjcf)?;
        // One thread compiles, the others wait for what may be their model, too.
        let mut compiled = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
        let known = compiled.iter().find(|(known, _)| *known == rest);
        let model = if let Some((_, model)) = known {
            model.clone()
        } else {
            let text = with_assets(mjcf, &simulators::assets_folder())?;
            let model = Model::compile(&self.library, &text).context("its model_file does not compile")?;
            if compiled.len() == REMEMBERED {
                compiled.remove(0);
            }
            compiled.push((rest, model.clone()));
            model
        };
        drop(compiled);
        Ok(model.with_boxes(boxes.iter().map(|(name, size)| (name.as_str(), *size)))?)
    }

    /// Writes the pictures of the spool to their table: by camera, episode and frame.
    pub(super) fn write(&self, spool: &Spool, lengths: &[usize], writer: &Writer) -> Result<usize> {
        let mut table = writer.table_in_groups(&tables::CAMERA_IMAGES, PICTURES_IN_GROUP)?;
        let mut written = 0;
        for &camera in &self.cameras {
            for (episode, &frames) in (0_u32..).zip(lengths) {
                let pictures = spool.get(camera, episode, frames)?;
                let pictures = pictures.context(
                    "pictures that were just drawn are gone; another run of the same artifact may have removed them, so run again",
                )?;
                table.write_columns(
                    Columns::new(&tables::CAMERA_IMAGES)
                        .text("camera", vec![camera; frames])
                        .u32("episode", vec![episode; frames])
                        .u32("frame", (0..frames as u32).collect())
                        .binary("image", pictures),
                )?;
                written += frames;
            }
        }
        table.finish()?;
        Ok(written)
    }
}

/// The next demonstration for a thread; none when there are no more.
fn next(queue: &Mutex<Receiver<Job>>) -> Option<Job> {
    queue.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}

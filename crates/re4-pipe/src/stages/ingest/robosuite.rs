//! Ingest of robosuite's tasks: an HDF5 file to `episodes`, made in a process of its own.

use std::io::{BufRead as _, BufReader, Read as _};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use nix::sys::resource::{Resource, setrlimit};
use rayon::prelude::*;
use re4_artifact::{Columns, Facts, Key, Recipe, Stage, Store, Writer, tables};
use re4_ingest::robomimic::{
    Comparison, DemoChoice, GoalErrors, Interpreter, Layout, Reading, RobomimicReader, source_hash,
};
use re4_ingest::{Warning, WarningCode};
use re4_robosuite::conventions::{ActionKind, Task};
use re4_robosuite::env_args::EnvArgs;
use serde_json::{Value, json};

use super::super::{Built, Runner};
use super::drawn::{self, Drawing};
use super::spatial::{Row, Written, write_conventions, write_tables};
use super::spool::Spool;
use super::worker::{self, Order, Word};
use super::{PICTURES_IN_GROUP, encode_png, find_source};
use crate::console::{sentence, tell};
use crate::interrupt::Interrupt;
use crate::pipeline::{IngestSection, Pipeline, TaskName};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 1;

/// How long a worker that lost its parent may take to stop by itself.
const GRACE: Duration = Duration::from_secs(5);

/// Longest order that a worker reads.
const LONGEST_ORDER: u64 = 16 << 20;

impl Runner {
    /// The `episodes` artifact of a robosuite task. This process does not touch the file with the HDF5 library.
    pub(super) fn ingest_robosuite(&self) -> Result<Built> {
        let start = Instant::now();
        let section = &self.pipeline.ingest;
        let source = find_source(&section.source)?;
        let compare = section.compare.as_deref().map(find_source).transpose()?;
        let order = Order {
            hash: Key::from_bytes(source_hash(&source)?),
            compare_hash: compare.as_deref().map(source_hash).transpose()?.map(Key::from_bytes),
            gl: (!section.render.is_empty())
                .then(|| re4_mujoco::Gl::of_process().map(|gl| gl.to_string()))
                .transpose()
                .with_context(|| format!("cannot draw the pictures of {}", source.display()))?,
            source,
            compare,
            pipeline: self.pipeline.clone(),
            artifacts: self.store.root().to_path_buf(),
            threads: rayon::current_num_threads(),
        };
        let recipe = recipe(&order, Value::Null)?;
        if let Some(built) = self.unchanged(&recipe, start)? {
            return Ok(built);
        }
        let bar = self.console.progress(0, "ingest");
        let ended = worker::run(&order, &self.interrupt, &bar);
        if ended.is_err() {
            // What a worker that fell over had begun is removed when the store is opened.
            Store::open(self.store.root())?;
        }
        ended?;
        let artifact = self.store.lookup(Stage::Ingest, &recipe.key())?;
        let artifact = artifact.with_context(|| {
            format!(
                "cannot ingest {}: its artifact is gone; another process may have removed it, so run again",
                order.source.display()
            )
        })?;
        self.made(artifact, &recipe, start)
    }
}

/// Everything that decides the bytes of the artifact.
fn recipe(order: &Order, facts: Value) -> Result<Recipe> {
    let section = &order.pipeline.ingest;
    let mut config = json!({
        "cameras": section.cameras,
        "compare_blake3": order.compare_hash,
        "conventions": section.conventions,
        "env_args": section.env_args,
        "filter": section.filter,
        "images": section.images,
        "object": section.object,
        "select": section.select,
        "task": order.pipeline.task,
    });
    if !section.render.is_empty() {
        config["render"] = drawn::settings(&section.render, order.gl.as_deref());
    }
    Ok(Recipe::new(Stage::Ingest, CODE_VERSION)
        .config(&config)?
        .source(order.hash.as_bytes(), facts))
}

/// The worker: reads its order, makes and publishes the artifact, and tells how it went.
pub(crate) fn serve_ingest() -> Result<()> {
    let mut input = BufReader::new(std::io::stdin());
    let mut line = String::new();
    input
        .by_ref()
        .take(LONGEST_ORDER)
        .read_line(&mut line)
        .context("cannot read the order")?;
    let order: Order =
        serde_json::from_str(&line).context("ingest-worker is started by re4-pipe itself; use re4-pipe ingest")?;
    // A process may always lower its own limits; where the system refuses, the file's sizes are checked all the same.
    let memory = worker::memory(&order);
    let _ = setrlimit(Resource::RLIMIT_DATA, memory, memory);
    let _ = setrlimit(Resource::RLIMIT_CORE, 0, 0);
    let interrupt = Interrupt::listen();
    let stop = interrupt.clone();
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut input, &mut std::io::sink());
        stop.request();
        std::thread::sleep(GRACE);
        #[allow(
            clippy::exit,
            reason = "nobody waits for this process any more, and its thread is stuck in C code"
        )]
        std::process::exit(2);
    });
    let word = match make(&order, interrupt) {
        Ok(()) => Word::Done,
        Err(error) => Word::Failed(sentence(&error)),
    };
    tell(&word);
    Ok(())
}

fn make(order: &Order, interrupt: Interrupt) -> Result<()> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(order.threads)
        .build_global()
        .with_context(|| format!("cannot start {} worker threads; give a smaller --jobs", order.threads))?;
    let ingest = Ingest {
        order,
        interrupt,
        reader: RobomimicReader::open(&order.source, &choice(&order.pipeline))?,
    };
    let interpreter = Interpreter::learn(&ingest.reader, &reading(&order.pipeline))?;
    let env = interpreter.env();
    let facts = json!({
        "format": match ingest.reader.layout() {
            Layout::Observed => "hdf5, robomimic",
            Layout::Raw => "hdf5, robosuite raw",
        },
        "environment": env.env_name,
        "robosuite_version": env.env_version,
        "file": order.source.file_name().map(|name| name.to_string_lossy()),
    });
    let drawing = ingest.drawing(env)?;
    let recipe = recipe(order, facts)?;
    let writer = Store::open(&order.artifacts)?.begin(&recipe)?;
    let drawn = match drawing {
        Some(drawing) => Some((drawing, Spool::open(&order.artifacts, recipe.key())?)),
        None => None,
    };
    let facts = ingest.write(&interpreter, drawn.as_ref(), &writer)?;
    ingest.interrupt.check("ingest")?;
    writer.publish(facts)?;
    match drawn {
        Some((_, spool)) => spool.remove(),
        None => Ok(()),
    }
}

fn choice(pipeline: &Pipeline) -> DemoChoice {
    DemoChoice {
        filter: pipeline.ingest.filter.clone(),
        select: pipeline.ingest.select.clone(),
    }
}

fn reading(pipeline: &Pipeline) -> Reading {
    let section = &pipeline.ingest;
    Reading {
        task: match pipeline.task {
            TaskName::Lift => Task::Lift,
            TaskName::Can => Task::Can,
            TaskName::Square => Task::Square,
            TaskName::PushT | TaskName::Robosuite => Task::Other,
        },
        object: section.object.clone(),
        env_args: section.env_args.clone(),
        conventions: section.conventions,
    }
}

/// A worker at work.
struct Ingest<'a> {
    order: &'a Order,
    interrupt: Interrupt,
    reader: RobomimicReader,
}

impl Ingest<'_> {
    fn section(&self) -> &IngestSection {
        &self.order.pipeline.ingest
    }

    /// What draws the pictures that are asked for.
    fn drawing(&self, env: &EnvArgs) -> Result<Option<Drawing<'_>>> {
        let render = &self.section().render;
        if render.is_empty() {
            return Ok(None);
        }
        let recorded = self.reader.cameras(None)?;
        anyhow::ensure!(
            recorded.is_empty(),
            "cannot render pictures for {}: it holds recorded ones ({}); leave ingest.render out",
            self.order.source.display(),
            recorded.join(", ")
        );
        Ok(Some(Drawing::new(render, env, &self.order.source)?))
    }

    fn write(&self, interpreter: &Interpreter, drawn: Option<&(Drawing<'_>, Spool)>, writer: &Writer) -> Result<Facts> {
        let comparison = self.order.compare.as_deref().map(Comparison::open).transpose()?;
        let cameras = if let Some((drawing, _)) = drawn {
            drawing.cameras()
        } else if self.section().images {
            self.reader.cameras(self.section().cameras.as_deref())?
        } else {
            Vec::new()
        };
        write_conventions(writer, interpreter.conventions())?;
        let demos = self.reader.demos();
        let written = write_tables(writer, demos, |take| {
            self.reader.for_each(
                |episode, demo| {
                    let other = match &comparison {
                        Some(comparison) => comparison.actions(&demo.name, demo.frames)?,
                        None => None,
                    };
                    let columns = interpreter.interpret(&self.reader, &demo, other.as_deref())?;
                    anyhow::Ok(Row {
                        episode: episode as u32,
                        demo,
                        columns,
                    })
                },
                |episode, row| {
                    self.interrupt.check("ingest")?;
                    tell(&Word::Progress(episode as u64 + 1, demos.len() as u64));
                    take(row)
                },
            )
        })?;
        anyhow::ensure!(
            comparison.is_none() || !written.goal_errors.is_empty(),
            "cannot compare with {}: it holds none of the demonstrations of {}; leave ingest.compare out, or give the file of the same demonstrations",
            self.order.compare.as_deref().unwrap_or(&self.order.source).display(),
            self.order.source.display()
        );
        let pictures = match drawn {
            Some((drawing, spool)) => self.draw_pictures(drawing, spool, &written.lengths, writer)?,
            None => self.write_pictures(&cameras, &written.lengths, writer)?,
        };
        let warnings = self.warnings(interpreter, &cameras, &written, comparison.is_some())?;
        let mut summary = json!({
            "episodes": demos.len(),
            "frames": written.frames,
            "images": pictures,
            "cameras": cameras,
            "actions": match interpreter.action_kind() {
                ActionKind::Delta => "delta",
                ActionKind::Absolute => "absolute",
            },
        });
        if let Some((drawing, _)) = drawn {
            summary["drawn"] = drawing.facts();
        }
        if let Some(errors) = GoalErrors::of(&written.goal_errors) {
            summary["goal_error"] = json!(errors);
        }
        Ok(Facts { summary, warnings })
    }

    fn draw_pictures(&self, drawing: &Drawing<'_>, spool: &Spool, lengths: &[usize], writer: &Writer) -> Result<usize> {
        let all = (lengths.iter().sum::<usize>() * drawing.cameras().len()) as u64;
        drawing.draw(
            spool,
            self.order.threads,
            &self.interrupt,
            &|pictures| tell(&Word::Progress(pictures as u64, all)),
            |take| {
                self.reader
                    .for_each(|_, demo| anyhow::Ok(demo), |episode, demo| take(episode as u32, demo))
            },
        )?;
        drawing.write(spool, lengths, writer)
    }

    fn write_pictures(&self, cameras: &[String], lengths: &[usize], writer: &Writer) -> Result<usize> {
        if cameras.is_empty() {
            return Ok(0);
        }
        let all = (lengths.iter().sum::<usize>() * cameras.len()) as u64;
        let mut table = writer.table_in_groups(&tables::CAMERA_IMAGES, PICTURES_IN_GROUP)?;
        let mut written = 0;
        for camera in cameras {
            self.reader.for_each_block(camera, lengths, |block| {
                self.interrupt.check("ingest")?;
                let (height, width) = (block.height as u32, block.width as u32);
                let encoded = block
                    .bytes
                    .par_chunks_exact(block.height * block.width * 3)
                    .map(|pixels| encode_png(pixels, width, height))
                    .collect::<Result<Vec<_>>>()?;
                let pictures = encoded.len();
                table.write_columns(
                    Columns::new(&tables::CAMERA_IMAGES)
                        .text("camera", vec![camera; pictures])
                        .u32("episode", vec![block.episode as u32; pictures])
                        .u32("frame", block.frames.map(|frame| frame as u32).collect())
                        .binary("image", encoded),
                )?;
                written += pictures;
                tell(&Word::Progress(written as u64, all));
                anyhow::Ok(())
            })?;
        }
        table.finish()?;
        Ok(written)
    }

    fn warnings(
        &self,
        interpreter: &Interpreter,
        cameras: &[String],
        written: &Written,
        compared: bool,
    ) -> Result<Vec<Value>> {
        let warning = |code, message, count| Warning {
            code,
            message,
            episode: None,
            frame: None,
            count,
        };
        let mut warnings = Vec::new();
        if let Some((demo, dataset)) = written.single_precision.first() {
            let message = format!("single precision in {demo}/{dataset}, widened to double precision");
            warnings.push(warning(
                WarningCode::SinglePrecision,
                message,
                written.single_precision.len() as u64,
            ));
        }
        let conventions = interpreter.warnings().iter();
        warnings.extend(conventions.map(|text| warning(WarningCode::Convention, text.clone(), 1)));
        if let (true, Some(first)) = (compared, written.not_compared.first()) {
            let message = format!("not in the file to compare with: {first}");
            warnings.push(warning(
                WarningCode::NotCompared,
                message,
                written.not_compared.len() as u64,
            ));
        }
        warnings.extend(self.reader.skipped_warning(cameras)?);
        Ok(warnings.iter().map(serde_json::to_value).collect::<Result<_, _>>()?)
    }
}

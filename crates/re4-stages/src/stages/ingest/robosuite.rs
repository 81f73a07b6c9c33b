//! Ingest of robosuite's tasks: an HDF5 file to `episodes`. Where the HDF5 library is needed, it is made in a process of its own.

use std::io::{BufRead as _, BufReader, Read as _};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, bail};
use indicatif::ProgressBar;
use nix::sys::resource::{Resource, setrlimit};
use rayon::prelude::*;
use re4_artifact::{Artifact, Columns, Facts, Recipe, Stage, Store, Writer, tables};
use re4_ingest::robomimic::{
    Access, Comparison, Demo, DemoChoice, DemoName, GoalErrors, Interpreter, Layout, Reading, RobomimicReader, Sources,
};
use re4_ingest::{IngestError, LeftOut, OnBad, Warning, WarningCode, refusal};
use re4_robosuite::conventions::{ActionKind, Task};
use re4_robosuite::env_args::EnvArgs;
use serde_json::{Value, json};

use super::PICTURES_IN_GROUP;
use super::drawn::{self, Drawing};
use super::spatial::{Row, Written, write_conventions, write_left_out, write_tables};
use super::spool::Spool;
use super::worker::{self, Order, Word, tell};
use crate::inputs::pictures::encode_png;
use crate::inputs::sources::{find_source, left_out};
use crate::interrupt::Interrupt;
use crate::notes::sentence;
use crate::pipeline::{IngestSection, Pipeline, TaskName};
use crate::runner::{Built, Runner};

/// Raised whenever the same input gives other bytes.
const CODE_VERSION: u32 = 2;

/// How long a worker that lost its parent may take to stop by itself.
const GRACE: Duration = Duration::from_millis(400);

/// Longest order that a worker reads.
const LONGEST_ORDER: u64 = 16 << 20;

impl Runner {
    /// The `episodes` artifact of a robosuite task. This process does not touch the file with the HDF5 library: it reads the
    /// plainest files itself, and leaves all others to a worker.
    pub(super) fn ingest_robosuite(&self) -> Result<Built> {
        let start = Instant::now();
        let section = &self.pipeline.ingest;
        let source = find_source(&section.source)?;
        let gl = (!section.render.is_empty())
            .then(|| re4_mujoco::Gl::of_process().map(|gl| gl.to_string()))
            .transpose()
            .with_context(|| format!("cannot draw the pictures of {}", source.display()))?;
        let mut sources = Sources::open(&source)?;
        let compare = section.compare.as_deref().map(find_source).transpose()?;
        let compare_sources = compare.as_deref().map(Sources::open).transpose()?;
        let mut order = Order {
            hash: None,
            identity: sources.identity(),
            compare_hash: None,
            compare_identity: compare_sources.as_ref().map(Sources::identity),
            gl,
            source,
            compare,
            pipeline: self.pipeline.clone(),
            artifacts: self.store.root().to_path_buf(),
            threads: rayon::current_num_threads(),
            cautious: false,
        };
        let hash = |sources: &Sources| self.hash(|stop| sources.hash(stop), "ingest");
        // What there is and what it means is found out while the file is hashed, unless there may be models to be hashed, too.
        let alone = !sources.has_models_folder();
        let (early, direct, learned) = std::thread::scope(|scope| {
            let hashing = alone.then(|| scope.spawn(|| hash(&sources)));
            let direct = self.open_direct(&sources);
            let here = direct.as_ref().ok().and_then(Option::as_ref);
            let here = here.filter(|_| section.render.is_empty());
            let learned = here.map(|reader| Interpreter::learn(reader, &reading(&self.pipeline)));
            (hashing.map(std::thread::ScopedJoinHandle::join), direct, learned)
        });
        let direct = direct?;
        match &direct {
            Some(reader) => sources = reader.sources().clone(),
            // Which models there are is known to the library alone.
            None if !alone => {
                let names = self.attended(&order, |bar| worker::models(&order, &self.interrupt, bar))?;
                sources = sources.with_models(names);
            }
            None => {}
        }
        order.identity = sources.identity();
        order.hash = Some(match early {
            Some(hashed) => hashed.map_err(|_| anyhow!("the hashing stopped; run again"))??,
            None => hash(&sources)?,
        });
        order.compare_hash = compare_sources.as_ref().map(hash).transpose()?;
        let recipe = recipe(&order, Value::Null)?;
        if let Some(built) = self.unchanged(&recipe, start)? {
            self.refuse_left_out(&built.artifact)?;
            return Ok(built);
        }
        if let Some(reader) = direct.filter(|_| section.render.is_empty()) {
            let bar = self.notes.progress(0, "ingest");
            let tell = |done: u64, all: u64| {
                bar.set_length(all);
                bar.set_position(done);
            };
            let inputs = Inputs {
                reader,
                compare: compare_sources.clone(),
                access: Access::Direct,
                learned,
            };
            let made = make(&order, inputs, &self.interrupt, &tell);
            bar.finish_and_clear();
            match made {
                Err(error) if needs_library(&error) => {}
                made => return self.made(made?, &recipe, start),
            }
        }
        self.attended(&order, |bar| worker::run(&order, &self.interrupt, bar))?;
        let artifact = self.store.lookup(Stage::Ingest, &recipe.key())?;
        let artifact = artifact.with_context(|| {
            format!(
                "cannot ingest {}: its artifact is gone; another process may have removed it, so run again",
                order.source.display()
            )
        })?;
        self.made(artifact, &recipe, start)
    }

    /// The file, opened without the HDF5 library; none where that takes the library.
    fn open_direct(&self, sources: &Sources) -> Result<Option<RobomimicReader>> {
        if std::env::var_os(HDF5_VARIABLE).is_some_and(|value| value == "library") {
            return Ok(None);
        }
        match RobomimicReader::open(sources, &choice(&self.pipeline, false), Access::Direct) {
            Err(error) if error.needs_library() => Ok(None),
            opened => Ok(Some(opened?)),
        }
    }

    /// Lets a worker do something, and clears up after one that fell over.
    fn attended<T>(&self, order: &Order, work: impl FnOnce(&ProgressBar) -> Result<T>) -> Result<T> {
        let ended = work(&self.notes.progress(0, "ingest"));
        if ended.is_err() {
            self.interrupt.check("ingest")?;
            // What a worker that fell over had begun is removed when the store is opened.
            Store::open(&order.artifacts)?;
        }
        ended
    }

    /// Refuses an artifact that lacks demonstrations, where all are to be there.
    pub(super) fn refuse_left_out(&self, artifact: &Artifact) -> Result<()> {
        let left = left_out(artifact)?;
        if left.is_empty() || self.pipeline.ingest.on_bad == OnBad::LeaveOut {
            return Ok(());
        }
        let kept = artifact.manifest().summary["episodes"].as_u64().unwrap_or_default();
        bail!(
            "cannot ingest {}: {}",
            find_source(&self.pipeline.ingest.source)?.display(),
            refusal(&left, kept as usize + left.len())
        )
    }
}

/// Replaces the choice between reading beside the HDF5 library and with it, for tests: `library`.
const HDF5_VARIABLE: &str = "RE4_HDF5";

fn needs_library(error: &anyhow::Error) -> bool {
    let cause = error.downcast_ref::<IngestError>();
    cause.is_some_and(IngestError::needs_library)
}

/// Everything that decides the bytes of the artifact.
fn recipe(order: &Order, facts: Value) -> Result<Recipe> {
    let section = &order.pipeline.ingest;
    let hash = order.hash.context("the source was not hashed")?;
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
        .source(hash.as_bytes(), facts))
}

/// The worker: reads its order, makes and publishes the artifact, and tells how it went.
///
/// # Errors
/// When there is no order to read, or no store to publish in; all that is wrong later is told to the process that asked.
pub fn serve_ingest() -> Result<()> {
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
    let store = Store::open(&order.artifacts)?;
    let interrupt = Interrupt::listen_and_say(Some(&store), |sentence| tell(&Word::Failed(sentence.to_owned())));
    let stop = interrupt.clone();
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut input, &mut std::io::sink());
        stop.request();
        std::thread::sleep(GRACE);
        // Until the process has ended, nothing more is published.
        let _locked = store.abandon();
        #[allow(
            clippy::exit,
            reason = "nobody waits for this process any more, and its thread is stuck in C code"
        )]
        std::process::exit(2);
    });
    let word = match serve(&order, &interrupt) {
        Ok(word) => word,
        Err(error) => Word::Failed(sentence(&error)),
    };
    tell(&word);
    Ok(())
}

fn serve(order: &Order, interrupt: &Interrupt) -> Result<Word> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(order.threads)
        .build_global()
        .with_context(|| format!("cannot start {} worker threads; give a smaller --jobs", order.threads))?;
    let sources = Sources::open_again(&order.source, &order.identity)?;
    let reader = RobomimicReader::open(&sources, &choice(&order.pipeline, order.cautious), Access::Library)?;
    if order.hash.is_none() {
        return Ok(Word::Models(
            reader.sources().model_names().map(str::to_owned).collect(),
        ));
    }
    // Models that came or went since are a change, too.
    if reader.sources().identity() != order.identity {
        return Err(reader.sources().changed().into());
    }
    let compare = match (&order.compare, &order.compare_identity) {
        (Some(path), Some(identity)) => Some(Sources::open_again(path, identity)?),
        _ => None,
    };
    let inputs = Inputs {
        reader,
        compare,
        access: Access::Library,
        learned: None,
    };
    make(order, inputs, interrupt, &|done, all| {
        worker::progress(done, all, interrupt);
    })?;
    Ok(Word::Done)
}

/// Conventions, and the demonstrations that were met and cannot be used.
type Learned = Result<(Interpreter, Vec<LeftOut>), IngestError>;

/// What an ingest reads.
struct Inputs {
    reader: RobomimicReader,
    compare: Option<Sources>,
    access: Access,
    /// The conventions, where they are known already.
    learned: Option<Learned>,
}

impl Inputs {
    /// Whether all files are still what they were when they were hashed.
    fn unchanged(&self) -> Result<()> {
        self.reader.sources().unchanged()?;
        if let Some(compare) = &self.compare {
            compare.unchanged()?;
        }
        Ok(())
    }
}

/// Makes and publishes the artifact.
fn make(
    order: &Order,
    mut inputs: Inputs,
    interrupt: &Interrupt,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Artifact> {
    let learned = inputs.learned.take();
    let ingest = Ingest {
        order,
        interrupt,
        progress,
        inputs,
    };
    let made = ingest.publish(learned);
    if made.is_err() {
        interrupt.check("ingest")?;
        // Whatever is wrong with a file that changed is not what has to be mended.
        ingest.inputs.unchanged()?;
    }
    made
}

fn choice(pipeline: &Pipeline, cautious: bool) -> DemoChoice {
    DemoChoice {
        filter: pipeline.ingest.filter.clone(),
        select: pipeline.ingest.select.clone(),
        cautious,
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

/// An ingest at work.
struct Ingest<'a> {
    order: &'a Order,
    interrupt: &'a Interrupt,
    progress: &'a (dyn Fn(u64, u64) + Sync),
    inputs: Inputs,
}

/// What came of writing the tables.
enum Wrote {
    All(Facts),
    /// These demonstrations proved to be of no use after they had been written.
    Again(Vec<LeftOut>),
}

impl Ingest<'_> {
    fn section(&self) -> &IngestSection {
        &self.order.pipeline.ingest
    }

    fn reader(&self) -> &RobomimicReader {
        &self.inputs.reader
    }

    fn publish(&self, learned: Option<Learned>) -> Result<Artifact> {
        let learn = || Interpreter::learn(self.reader(), &reading(&self.order.pipeline));
        let (interpreter, mut excluded) = learned.unwrap_or_else(learn)?;
        let env = interpreter.env();
        let facts = json!({
            "format": match self.reader().layout() {
                Layout::Observed => "hdf5, robomimic",
                Layout::Raw => "hdf5, robosuite raw",
            },
            "environment": env.env_name,
            "robosuite_version": env.env_version,
            "file": self.order.source.file_name().map(|name| name.to_string_lossy()),
        });
        let drawing = self.drawing(env)?;
        let recipe = recipe(self.order, facts)?;
        let store = Store::open(&self.order.artifacts)?;
        let drawn = match drawing {
            Some(drawing) => Some((drawing, Spool::open(&self.order.artifacts, recipe.key())?)),
            None => None,
        };
        let artifact = loop {
            let writer = store.begin(&recipe)?;
            match self.write(&interpreter, drawn.as_ref(), &excluded, &writer)? {
                Wrote::All(facts) => {
                    self.interrupt.check("ingest")?;
                    self.inputs.unchanged()?;
                    break writer.publish(facts)?;
                }
                // Each time there are fewer.
                Wrote::Again(more) => excluded.extend(more),
            }
        };
        if let Some((_, spool)) = drawn {
            spool.remove()?;
        }
        Ok(artifact)
    }

    /// What draws the pictures that are asked for.
    fn drawing(&self, env: &EnvArgs) -> Result<Option<Drawing<'_>>> {
        let render = &self.section().render;
        if render.is_empty() {
            return Ok(None);
        }
        let recorded = self.reader().cameras(None)?;
        anyhow::ensure!(
            recorded.is_empty(),
            "cannot render pictures for {}: it holds recorded ones ({}); leave ingest.render out",
            self.order.source.display(),
            recorded.join(", ")
        );
        Ok(Some(Drawing::new(render, env, &self.order.source)?))
    }

    fn write(
        &self,
        interpreter: &Interpreter,
        drawn: Option<&(Drawing<'_>, Spool)>,
        excluded: &[LeftOut],
        writer: &Writer,
    ) -> Result<Wrote> {
        let comparison = match &self.inputs.compare {
            Some(sources) => Some(Comparison::open(sources, self.inputs.access)?),
            None => None,
        };
        let cameras = if let Some((drawing, _)) = drawn {
            drawing.cameras()
        } else if self.section().images {
            self.reader().cameras(self.section().cameras.as_deref())?
        } else {
            Vec::new()
        };
        write_conventions(writer, interpreter.conventions())?;
        let recorded: &[String] = if drawn.is_some() { &[] } else { &cameras };
        let demos = self.reader().demos();
        let mut left = Vec::new();
        let refuse = self.section().on_bad == OnBad::Refuse;
        let written = write_tables(writer, |take| {
            self.reader().for_each(
                |place, demo| {
                    self.interpret(
                        interpreter,
                        comparison.as_ref(),
                        recorded,
                        excluded,
                        &demos[place],
                        demo,
                    )
                },
                |place, row| {
                    self.interrupt.check("ingest")?;
                    (self.progress)(place as u64 + 1, demos.len() as u64);
                    match row {
                        Err(bad) => left.push(bad),
                        // What is refused in the end is only read on to learn what else is wrong.
                        Ok(_) if refuse && !left.is_empty() => {}
                        Ok(row) => take(row)?,
                    }
                    Ok(())
                },
            )
        })?;
        self.refuse(&left, refuse || written.demos.is_empty())?;
        anyhow::ensure!(
            comparison.is_none() || !written.goal_errors.is_empty(),
            "cannot compare with {}: it holds none of the demonstrations of {}; leave ingest.compare out, or give the file of the same demonstrations",
            self.order.compare.as_deref().unwrap_or(&self.order.source).display(),
            self.order.source.display()
        );
        let pictures = if let Some((drawing, spool)) = drawn {
            self.draw_pictures(drawing, spool, &written, writer)?
        } else {
            match self.write_pictures(&cameras, &written, writer)? {
                Ok(pictures) => pictures,
                Err(more) => {
                    left.extend(more.iter().cloned());
                    self.refuse(&left, refuse || left.len() == demos.len())?;
                    return Ok(Wrote::Again(more));
                }
            }
        };
        write_left_out(writer, &left)?;
        let warnings = self.warnings(interpreter, &cameras, &written, comparison.is_some(), &left)?;
        let mut summary = json!({
            "episodes": written.demos.len(),
            "frames": written.frames,
            "images": pictures,
            "cameras": cameras,
            "actions": match interpreter.action_kind() {
                ActionKind::Delta => "delta",
                ActionKind::Absolute => "absolute",
            },
        });
        if !left.is_empty() {
            summary["left_out"] = json!(left.len());
        }
        if let Some((drawing, _)) = drawn {
            summary["drawn"] = drawing.facts();
        }
        if let Some(errors) = GoalErrors::of(&written.goal_errors) {
            summary["goal_error"] = json!(errors);
        }
        Ok(Wrote::All(Facts { summary, warnings }))
    }

    /// Refuses the dataset for these demonstrations.
    fn refuse(&self, left: &[LeftOut], refuse: bool) -> Result<()> {
        anyhow::ensure!(
            left.is_empty() || !refuse,
            "cannot ingest {}: {}",
            self.order.source.display(),
            refusal(left, self.reader().demos().len())
        );
        Ok(())
    }

    /// The rows of a demonstration, or why it cannot be used.
    fn interpret(
        &self,
        interpreter: &Interpreter,
        comparison: Option<&Comparison>,
        cameras: &[String],
        excluded: &[LeftOut],
        name: &DemoName,
        demo: Result<Demo, LeftOut>,
    ) -> Result<Result<Row, LeftOut>> {
        if let Some(known) = excluded.iter().find(|left| left.demo == name.name) {
            return Ok(Err(known.clone()));
        }
        let demo = match demo {
            Ok(demo) => demo,
            Err(left) => return Ok(Err(left)),
        };
        if let Err(left) = self.reader().check_cameras(&demo, cameras)? {
            return Ok(Err(left));
        }
        let other = match comparison {
            Some(comparison) => comparison.actions(&demo.name, demo.frames)?,
            None => None,
        };
        match interpreter.interpret(self.reader(), &demo, other.as_deref()) {
            Ok(columns) => Ok(Ok(Row {
                name: name.clone(),
                demo,
                columns,
            })),
            Err(error) if error.needs_library() => Err(error.into()),
            Err(error) => Ok(Err(LeftOut {
                demo: name.name.clone(),
                why: error.fault.to_string(),
            })),
        }
    }

    fn draw_pictures(&self, drawing: &Drawing<'_>, spool: &Spool, written: &Written, writer: &Writer) -> Result<usize> {
        let lengths: Vec<usize> = written.demos.iter().map(|(_, frames)| *frames).collect();
        let all = (lengths.iter().sum::<usize>() * drawing.cameras().len()) as u64;
        drawing.draw(
            spool,
            self.order.threads,
            self.interrupt,
            &|pictures| (self.progress)(pictures as u64, all),
            |take| {
                let mut episode = 0;
                self.reader().for_each(
                    |_, demo| anyhow::Ok(demo),
                    |place, demo| {
                        let name = &self.reader().demos()[place];
                        match (demo, written.demos.get(episode)) {
                            (Ok(demo), Some((kept, _))) if kept == name => {
                                episode += 1;
                                take(episode as u32 - 1, demo)
                            }
                            _ => Ok(()),
                        }
                    },
                )
            },
        )?;
        drawing.write(spool, &lengths, writer)
    }

    /// Writes the recorded images; the demonstrations whose images cannot be decoded, where there are any.
    fn write_pictures(
        &self,
        cameras: &[String],
        written: &Written,
        writer: &Writer,
    ) -> Result<Result<usize, Vec<LeftOut>>> {
        if cameras.is_empty() {
            return Ok(Ok(0));
        }
        let demos: Vec<(String, usize)> = written
            .demos
            .iter()
            .map(|(demo, frames)| (demo.name.clone(), *frames))
            .collect();
        let all = (demos.iter().map(|(_, frames)| frames).sum::<usize>() * cameras.len()) as u64;
        let mut table = writer.table_in_groups(&tables::CAMERA_IMAGES, PICTURES_IN_GROUP)?;
        let mut pictures = 0;
        let mut left: Vec<LeftOut> = Vec::new();
        for camera in cameras {
            self.reader().for_each_block(camera, &demos, |block| {
                self.interrupt.check("ingest")?;
                let block = match block {
                    Ok(block) => block,
                    Err(bad) => {
                        if left.iter().all(|left| left.demo != bad.demo) {
                            left.push(bad);
                        }
                        return Ok(());
                    }
                };
                if !left.is_empty() {
                    return Ok(());
                }
                let (height, width) = (block.height as u32, block.width as u32);
                let encoded = block
                    .bytes
                    .par_chunks_exact(block.height * block.width * 3)
                    .map(|pixels| encode_png(pixels, width, height))
                    .collect::<Result<Vec<_>>>()?;
                let count = encoded.len();
                table.write_columns(
                    Columns::new(&tables::CAMERA_IMAGES)
                        .text("camera", vec![camera; count])
                        .u32("episode", vec![block.episode as u32; count])
                        .u32("frame", block.frames.map(|frame| frame as u32).collect())
                        .binary("image", encoded),
                )?;
                pictures += count;
                (self.progress)(pictures as u64, all);
                anyhow::Ok(())
            })?;
        }
        if !left.is_empty() {
            return Ok(Err(left));
        }
        table.finish()?;
        Ok(Ok(pictures))
    }

    fn warnings(
        &self,
        interpreter: &Interpreter,
        cameras: &[String],
        written: &Written,
        compared: bool,
        left: &[LeftOut],
    ) -> Result<Vec<Value>> {
        let warning = |code, message, count| Warning {
            code,
            message,
            episode: None,
            frame: None,
            count,
        };
        let mut warnings = self.reader().warnings().to_vec();
        if !left.is_empty() {
            let message = format!("left out: {}", refusal(left, self.reader().demos().len()));
            warnings.push(warning(WarningCode::LeftOut, message, left.len() as u64));
        } else if let Some(stale) = self.reader().total_warning(written.frames)? {
            warnings.push(stale);
        }
        if let Some(first) = written.skipped.first() {
            let message = format!("{first}; these values are not used, and stay empty in the table");
            warnings.push(warning(
                WarningCode::SkippedValues,
                message,
                written.skipped.len() as u64,
            ));
        }
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
        warnings.extend(self.reader().skipped_warning(cameras)?);
        Ok(warnings.iter().map(serde_json::to_value).collect::<Result<_, _>>()?)
    }
}

//! Runs the ingest of an HDF5 file in a worker process.
//!
//! The HDF5 library is written in C and can crash on a damaged file. The program therefore starts itself again with a hidden
//! subcommand. That worker process makes and publishes the artifact, and reports its progress, or why it stopped, as JSON lines
//! on its standard output. Its standard input stays open as long as the parent runs; when it closes, the worker stops. Whatever
//! happens to the worker, the user gets a one-sentence error, and the unfinished artifact is removed.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use indicatif::ProgressBar;
use re4_artifact::Key;
use re4_fault::{Fault, OrFault as _, Remedy, bail, fault};
use re4_ingest::Description;
use re4_ingest::lerobot::LerobotFiles;
use re4_ingest::robomimic::{Members, SourcesIdentity, Surveyed};
use serde::{Deserialize, Serialize};
use tracing::info;

use super::helper::Setup;
use super::message::{Message, send};
use crate::interrupt::Interrupt;
use crate::parts::{Partly, Share};
use crate::pipeline::Pipeline;

/// Name of the hidden subcommand.
pub const SUBCOMMAND: &str = "ingest-worker";

/// Maximum time between two messages of a worker. It reports every demonstration and every block of images.
const PATIENCE: Duration = Duration::from_mins(3);

/// Replaces [`PATIENCE`], in seconds, for tests.
const PATIENCE_VARIABLE: &str = "RE4_WORKER_PATIENCE";

/// For tests: a number and a file, separated by a space. When a worker has finished that many demonstrations or images, it writes
/// its process id to the file and waits, once, until the file is removed or the worker is asked to stop.
const GATE_VARIABLE: &str = "RE4_WORKER_GATE";

/// How long a worker may take to remove its unfinished artifact and exit after it was asked to stop.
const STOPPING: Duration = Duration::from_millis(300);

/// How long a worker may take to exit after its last message.
const EXITING: Duration = Duration::from_secs(5);

/// Environment variable for the number of threads that Mesa's software renderer starts per context.
const MESA_THREADS: &str = "LP_NUM_THREADS";

/// Memory limit of a worker without rendering, in bytes. A limit is needed because a damaged file can claim any size.
const MEMORY: u64 = 4 << 30;

/// Additional memory limit per rendering thread, in bytes. MuJoCo reserves far more for a simulation than it uses. Helpers inherit the
/// limit of the worker.
const RENDERING: u64 = 2 << 30;

/// Memory limit (`RLIMIT_DATA`) of the worker of this work, in bytes.
pub(super) fn memory(work: &Work) -> u64 {
    let rendering = match work {
        Work::Ingest(request) if request.gl.is_some() => request.threads as u64,
        _ => 0,
    };
    MEMORY + RENDERING.saturating_mul(rendering)
}

/// Maximum number of bytes that are kept of a worker's standard error.
const STDERR_KEPT: u64 = 1 << 16;

/// What the process of the hidden subcommand does, sent to it as one line of JSON.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Work {
    /// A worker makes an artifact.
    Ingest(Box<Request>),
    /// A worker describes a dataset.
    Describe(Question),
    /// A helper of a worker renders demonstrations, which follow as one line of JSON each.
    Render(Setup),
}

/// The task of a worker.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Request {
    /// The pipeline, overrides applied.
    pub(crate) pipeline: Pipeline,
    /// The dataset.
    pub(crate) source: PathBuf,
    /// Hash of the source. `None` asks only for what it depends on: see [`Message::Models`] and [`Message::Hashed`].
    pub(crate) hash: Option<Key>,
    /// Its format, and what depends on it.
    pub(crate) format: Format,
    /// The OpenGL library for rendering; `None` if nothing is rendered.
    pub(crate) gl: Option<String>,
    /// The artifacts folder.
    pub(crate) artifacts: PathBuf,
    /// Address of the object store of which the folder is the cache; without an object store, the folder.
    pub(crate) address: PathBuf,
    /// Number of threads.
    pub(crate) threads: usize,
    /// What to make of an artifact in parts.
    pub(crate) share: Share,
    /// Whether to stop at the first error in the file.
    pub(crate) cautious: bool,
}

/// A dataset to describe.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Question {
    /// The dataset.
    pub(crate) source: PathBuf,
    /// What reads it.
    pub(crate) reader: Reader,
    /// Whether to stop at the first error in the file.
    pub(crate) cautious: bool,
}

/// The format of a dataset that a worker reads.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Format {
    /// An HDF5 file.
    Hdf5(Box<Hdf5>),
    /// Several HDF5 files.
    Several(Box<Members>),
    /// A LeRobot dataset, with the identity of the files that were hashed.
    Lerobot(Option<LerobotFiles>),
}

/// What a worker needs to know about an HDF5 file.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Hdf5 {
    /// Identity of the files that were hashed.
    pub(crate) identity: SourcesIdentity,
    /// What is known of its demonstrations.
    pub(crate) surveyed: Option<Surveyed>,
    /// The file of `ingest.compare`.
    pub(crate) compare: Option<PathBuf>,
    /// Hash of the file of `ingest.compare`.
    pub(crate) compare_hash: Option<Key>,
    /// Identity of the file of `ingest.compare`.
    pub(crate) compare_identity: Option<SourcesIdentity>,
}

/// What reads a dataset in a worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Reader {
    /// The HDF5 library.
    Hdf5,
    /// The decoders of LeRobot datasets.
    Lerobot,
}

impl Reader {
    /// What is read, in messages.
    fn reads(self) -> &'static str {
        match self {
            Self::Hdf5 => "HDF5",
            Self::Lerobot => "LeRobot data",
        }
    }

    /// Its name in messages.
    fn name(self) -> &'static str {
        match self {
            Self::Hdf5 => "the HDF5 library",
            Self::Lerobot => "the decoder of tables, images and videos",
        }
    }

    /// What a dataset that needs too much memory is, if it is not damaged.
    fn too_large(self) -> &'static str {
        match self {
            Self::Hdf5 => "far larger than robomimic's files",
            Self::Lerobot => "with row groups far larger than those of LeRobot's writer",
        }
    }
}

impl Work {
    fn reader(&self) -> Reader {
        match self {
            Self::Describe(question) => question.reader,
            Self::Ingest(request) => match request.format {
                Format::Hdf5(_) | Format::Several(_) => Reader::Hdf5,
                Format::Lerobot(_) => Reader::Lerobot,
            },
            Self::Render(_) => Reader::Hdf5,
        }
    }

    fn source(&self) -> &Path {
        match self {
            Self::Describe(question) => &question.source,
            Self::Ingest(request) => &request.source,
            Self::Render(_) => Path::new(""),
        }
    }

    /// The OpenGL library for rendering.
    fn gl(&self) -> Option<&str> {
        match self {
            Self::Ingest(request) => request.gl.as_deref(),
            _ => None,
        }
    }

    /// What the parent does, in messages.
    fn verb(&self) -> &'static str {
        match self {
            Self::Describe(_) => "inspect",
            _ => "ingest",
        }
    }

    fn is_cautious(&self) -> bool {
        match self {
            Self::Describe(question) => question.cautious,
            Self::Ingest(request) => request.cautious,
            Self::Render(_) => false,
        }
    }

    /// The same work, ending at the first error in the file.
    fn cautiously(&self) -> Option<Self> {
        match self {
            Self::Ingest(request) => Some(Self::Ingest(Box::new(Request {
                cautious: true,
                ..(**request).clone()
            }))),
            Self::Describe(question) => Some(Self::Describe(Question {
                cautious: true,
                ..question.clone()
            })),
            Self::Render(_) => None,
        }
    }
}

/// Reports from the worker that `done` of `all` demonstrations or images are finished.
pub(super) fn progress(done: u64, all: u64, interrupt: &Interrupt) {
    send(&Message::Progress(done, all));
    wait_at_gate(done, interrupt);
}

/// Reports from the worker what was found out about the demonstrations of a file.
pub(super) fn surveyed(request: &Request, path: &Path, surveyed: &Surveyed) {
    // In cautious mode, only the first demonstration was looked at.
    if !request.cautious {
        send(&Message::Surveyed(path.to_owned(), Box::new(surveyed.clone())));
    }
}

/// Waits at the point that a test has set with [`GATE_VARIABLE`].
fn wait_at_gate(done: u64, interrupt: &Interrupt) {
    static PASSED: AtomicBool = AtomicBool::new(false);
    let Ok(gate) = std::env::var(GATE_VARIABLE) else { return };
    let Some((count, file)) = gate.split_once(' ') else {
        return;
    };
    let reached = count.parse().is_ok_and(|count: u64| done >= count);
    if !reached || PASSED.swap(true, Ordering::Relaxed) {
        return;
    }
    // The newline marks the end of the number, since the test may read the file while it is written.
    if std::fs::write(file, format!("{}\n", std::process::id())).is_ok() {
        while Path::new(file).exists() && !interrupt.requested() {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Receives what a worker found out about the demonstrations of a file.
type OnSurveyed<'a> = &'a dyn Fn(&Path, &Surveyed);

/// Runs a worker that makes the artifact. Returns what it made if that is not the whole artifact.
pub(super) fn run(
    request: &Request,
    interrupt: &Interrupt,
    bar: &ProgressBar,
    found: OnSurveyed<'_>,
) -> Result<Option<Partly>> {
    Ok(match work(&ingest(request), interrupt, bar, found)? {
        Message::Partly(partly) => Some(partly),
        _ => None,
    })
}

/// Asks a worker for the names of the model files that the source's demonstrations refer to.
pub(super) fn models(request: &Request, interrupt: &Interrupt, bar: &ProgressBar) -> Result<Vec<String>> {
    match work(&ingest(request), interrupt, bar, &|_, _| {})? {
        Message::Models(names) => Ok(names),
        _ => {
            bail!("the worker process did not return the names of the models in {}", request.source.display(); "run again")
        }
    }
}

/// Asks a worker for the hash of a LeRobot dataset.
pub(super) fn hashed(request: &Request, interrupt: &Interrupt, bar: &ProgressBar) -> Result<(Key, LerobotFiles)> {
    match work(&ingest(request), interrupt, bar, &|_, _| {})? {
        Message::Hashed(hash, files) => Ok((hash, files)),
        _ => bail!("the worker process did not return the hash of {}", request.source.display(); "run again"),
    }
}

fn ingest(request: &Request) -> Work {
    Work::Ingest(Box::new(request.clone()))
}

/// Asks a worker to describe a dataset.
pub(crate) fn described(question: Question, interrupt: &Interrupt, bar: &ProgressBar) -> Result<Description> {
    let source = question.source.clone();
    match work(&Work::Describe(question), interrupt, bar, &|_, _| {})? {
        Message::Described(description) => Ok(description),
        _ => bail!("the worker process did not describe {}", source.display(); "run again"),
    }
}

/// Runs a worker to its end. Returns its last message.
fn work(work: &Work, interrupt: &Interrupt, bar: &ProgressBar, found: OnSurveyed<'_>) -> Result<Message> {
    match (try_to_work(work, interrupt, bar, found), work.cautiously()) {
        // The crash may be the consequence of an earlier error in the file, after which reading went on. A second, cautious
        // worker stops at the first error, which is then reported.
        (Err(error), Some(cautious)) if error.is::<WorkerCrashed>() => try_to_work(&cautious, interrupt, bar, found),
        (worked, _) => worked,
    }
}

/// The library that reads the dataset crashed.
#[derive(Debug, thiserror::Error, Remedy)]
#[error("{0}")]
#[remedy(_0.remedy())]
pub(crate) struct WorkerCrashed(Fault);

fn try_to_work(work: &Work, interrupt: &Interrupt, bar: &ProgressBar, found: OnSurveyed<'_>) -> Result<Message> {
    let (reader, verb) = (work.reader(), work.verb());
    let name = reader.reads();
    let refuse = |why: Fault| why.at(format!("cannot {verb} {}: ", work.source().display()));
    let program = std::env::current_exe().with_context(|| {
        format!("cannot find the program's own file, which is needed to read {name} in a worker process")
    })?;
    let mut command = Command::new(program);
    command.arg(SUBCOMMAND);
    if work.is_cautious() {
        // The gate of a test applies only to the first worker.
        command.env_remove(GATE_VARIABLE);
    }
    if let Some(gl) = work.gl() {
        command.env("RE4_GL", gl);
        // Every rendering thread has its own process, so additional threads in Mesa would only compete with them.
        if std::env::var_os(MESA_THREADS).is_none() {
            command.env(MESA_THREADS, "0");
        }
    }
    let mut child = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .or_fault(|| fault!("cannot start a worker process to read {name}"; "end other programs and run again"))?;
    info!(process = child.id(), source = %work.source().display(), cautious = work.is_cautious(), "worker started to read {name}");
    interrupt.set_worker(Some(child.id()));
    let mut line = serde_json::to_vec(work)?;
    line.push(b'\n');
    let mut stdin = child.stdin.take();
    if let Some(stdin) = &mut stdin {
        // Writing fails if the worker has ended already; the reason is reported below.
        let _ = stdin.write_all(&line).and_then(|()| stdin.flush());
    }
    let stderr = child.stderr.take();
    let stderr = std::thread::spawn(move || read_stderr(stderr));
    let messages = listen(&mut child);
    let patience = std::env::var(PATIENCE_VARIABLE)
        .ok()
        .and_then(|text| text.parse().ok())
        .map_or(PATIENCE, Duration::from_secs);
    let ended = attend(&messages, interrupt, bar, patience, found);
    bar.finish_and_clear();
    // Closing its standard input makes the worker stop; it is killed if it does not stop in time.
    drop(stdin);
    let status = match &ended {
        Ended::Silent => end(&mut child),
        Ended::Interrupted => wait(&mut child, STOPPING),
        // It has sent its last message and only has to exit.
        _ => wait(&mut child, EXITING),
    };
    interrupt.set_worker(None);
    let status =
        status.with_context(|| format!("cannot get the exit status of the worker process that reads {name}"))?;
    info!(%status, "worker ended");
    match ended {
        // The artifact is published, even if the worker had to be killed afterwards.
        Ended::Message(
            message @ (Message::Done
            | Message::Partly(_)
            | Message::Models(_)
            | Message::Hashed(..)
            | Message::Described(_)),
        ) => return Ok(message),
        Ended::Message(Message::Failed { what, remedy }) => {
            interrupt.check(verb)?;
            return Err(Fault::new(what, remedy).into());
        }
        Ended::Silent => {
            return Err(refuse(fault!(
                "{} made no progress for {} s, so the file may be damaged or its disk may not respond",
                reader.name(), patience.as_secs();
                "copy the file to a local disk or download it again"
            ))
            .into());
        }
        // Ctrl-C in a terminal reaches the worker, too.
        Ended::Interrupted | Ended::Message(_) | Ended::Gone => interrupt.check(verb)?,
    }
    let stderr = stderr.join().unwrap_or_default();
    let refusal = refuse(how_it_ended(reader, status, &stderr));
    Err(match status.signal() {
        Some(SIGABRT | SIGBUS | SIGSEGV) => WorkerCrashed(refusal).into(),
        _ => refusal.into(),
    })
}

const SIGABRT: i32 = 6;
const SIGBUS: i32 = 7;
const SIGSEGV: i32 = 11;

/// Why the parent stopped listening.
enum Ended {
    /// The worker sent its last message.
    Message(Message),
    /// The worker closed its standard output without a last message.
    Gone,
    /// Ctrl-C.
    Interrupted,
    /// The worker reported nothing for too long.
    Silent,
}

/// Shows the worker's progress until its last message, its end, an interrupt or a timeout.
fn attend(
    messages: &Receiver<Message>,
    interrupt: &Interrupt,
    bar: &ProgressBar,
    patience: Duration,
    found: OnSurveyed<'_>,
) -> Ended {
    let mut last_progress = Instant::now();
    loop {
        // Checked in every iteration, because messages may arrive so fast that the receive below never times out.
        if interrupt.requested() {
            return Ended::Interrupted;
        }
        match messages.recv_timeout(Duration::from_millis(50)) {
            Ok(Message::Progress(done, all)) => {
                bar.set_length(all);
                bar.set_position(done);
                last_progress = Instant::now();
            }
            Ok(Message::Surveyed(path, surveyed)) => {
                found(&path, &surveyed);
                last_progress = Instant::now();
            }
            Ok(message) => return Ended::Message(message),
            Err(RecvTimeoutError::Disconnected) => return Ended::Gone,
            Err(RecvTimeoutError::Timeout) if last_progress.elapsed() > patience => return Ended::Silent,
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Receives the worker's messages in a thread. Lines that are not messages are skipped, since the C library may print, too.
fn listen(child: &mut Child) -> Receiver<Message> {
    let (sender, receiver) = channel();
    if let Some(stdout) = child.stdout.take() {
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if let Ok(message) = serde_json::from_str(&line)
                    && sender.send(message).is_err()
                {
                    break;
                }
            }
        });
    }
    receiver
}

fn read_stderr(stderr: Option<ChildStderr>) -> String {
    let mut bytes = Vec::new();
    if let Some(mut stderr) = stderr {
        let _ = stderr.by_ref().take(STDERR_KEPT).read_to_end(&mut bytes);
        // The rest has to be read, too; otherwise the worker would block when the pipe is full.
        let _ = std::io::copy(&mut stderr, &mut std::io::sink());
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Waits for the worker to exit, and kills it after `patience`.
fn wait(child: &mut Child, patience: Duration) -> std::io::Result<ExitStatus> {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if start.elapsed() > patience {
            return end(child);
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn end(child: &mut Child) -> std::io::Result<ExitStatus> {
    child.kill()?;
    child.wait()
}

/// The error for a worker that ended without a last message.
fn how_it_ended(reader: Reader, status: ExitStatus, stderr: &str) -> Fault {
    // The message that Rust prints when an allocation fails, here because of the memory limit.
    if stderr.contains("memory allocation of") {
        return fault!(
            "reading it needs more than {} GiB of memory, so it is damaged or {}",
            MEMORY >> 30, reader.too_large();
            "copy or download it again, or ingest fewer demonstrations with ingest.select"
        );
    }
    match (status.signal(), status.code()) {
        (Some(9), _) => {
            fault!("the worker process was killed (signal 9), perhaps for lack of memory"; "free some memory and run again")
        }
        (Some(signal @ (2 | 15)), _) => {
            fault!("the worker process was terminated (signal {signal})"; "run again")
        }
        (Some(25), _) => {
            fault!("the worker process exceeded the file size limit (signal 25)"; "raise the limit (ulimit -f) and run again")
        }
        (Some(signal), _) => fault!(
            "{} crashed (signal {signal}), so the file is damaged", reader.name();
            "copy or download it again"
        ),
        (None, code) => {
            let output = stderr.lines().find(|line| !line.trim().is_empty()).unwrap_or("nothing");
            fault!(
                "the worker process stopped with exit code {} and printed: {output}", code.unwrap_or_default();
                "run again, and report the error if it remains"
            )
        }
    }
}

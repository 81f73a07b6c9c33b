//! Reading HDF5 in a process of its own.
//!
//! The HDF5 library is written in C and can fall over on a damaged file. So the program runs itself once more, with a hidden
//! subcommand: that process makes and publishes the artifact, and tells how far it is, or why it stopped, in JSON lines on its
//! standard output. Its standard input stays open as long as this process lives; when it closes, the worker stops. Whatever
//! happens to the worker, the user gets one sentence, and what it had begun is removed.

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
use re4_ingest::robomimic::SourcesIdentity;
use serde::{Deserialize, Serialize};
use tracing::info;

use crate::interrupt::Interrupt;
use crate::pipeline::Pipeline;

/// Name of the hidden subcommand.
pub const SUBCOMMAND: &str = "ingest-worker";

/// How long a worker may be silent. It tells of every demonstration and every block of images.
const PATIENCE: Duration = Duration::from_mins(3);

/// Replaces [`PATIENCE`], in seconds, for tests.
const PATIENCE_VARIABLE: &str = "RE4_WORKER_PATIENCE";

/// For tests: a number and a file, separated by a blank. A worker that has done so many demonstrations or images writes its
/// process number to the file and waits, once, until the file is gone or it is asked to stop.
const GATE_VARIABLE: &str = "RE4_WORKER_GATE";

/// How long a worker that was asked to stop may take to clear up.
const CLEARING: Duration = Duration::from_millis(300);

/// How long a worker may take to end by itself.
const ENDING: Duration = Duration::from_secs(5);

/// Threads that Mesa's software renderer starts for each of its own.
const MESA_THREADS: &str = "LP_NUM_THREADS";

/// Most memory that a worker may write to, in bytes. Sizes in a damaged file can be anything.
const MEMORY: u64 = 4 << 30;

/// What a thread that draws may take beyond that: MuJoCo sets aside far more for a simulation than it touches.
const DRAWING: u64 = 2 << 30;

/// Most memory that the worker of this order may write to, in bytes.
pub(super) fn memory(order: &Order) -> u64 {
    let drawing = if order.gl.is_some() { order.threads as u64 } else { 0 };
    MEMORY + DRAWING.saturating_mul(drawing)
}

/// Most that is kept of what a worker prints on its standard error.
const LAST_WORDS: u64 = 1 << 16;

/// What a worker is to do.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Order {
    /// The pipeline, overrides applied.
    pub(crate) pipeline: Pipeline,
    /// The HDF5 file.
    pub(crate) source: PathBuf,
    /// Hash of the source; none where only the models are asked for that its demonstrations name.
    pub(crate) hash: Option<Key>,
    /// The files that were hashed.
    pub(crate) identity: SourcesIdentity,
    /// Another file of the same demonstrations.
    pub(crate) compare: Option<PathBuf>,
    /// Hash of that.
    pub(crate) compare_hash: Option<Key>,
    /// The files of that.
    pub(crate) compare_identity: Option<SourcesIdentity>,
    /// The OpenGL library to draw with, where anything is drawn.
    pub(crate) gl: Option<String>,
    /// The artifacts folder.
    pub(crate) artifacts: PathBuf,
    /// Threads.
    pub(crate) threads: usize,
    /// Whether to end at the first fault of the file.
    pub(crate) cautious: bool,
}

/// What a worker tells, one JSON object a line.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Word {
    /// Demonstrations, or images, that are done, and how many there are.
    Progress(u64, u64),
    /// Names of models beside the source.
    Models(Vec<String>),
    /// The artifact is published.
    Done,
    /// Why it stopped, and how to fix it.
    Failed {
        /// What is wrong.
        what: String,
        /// How to fix it, where that is known.
        remedy: Option<String>,
    },
}

/// One line of JSON for the process that started this one.
pub(super) fn tell(word: &Word) {
    if let Ok(text) = serde_json::to_string(word) {
        let mut output = std::io::stdout().lock();
        // Where nobody listens any more, this process is about to stop, too.
        let _ = writeln!(output, "{text}").and_then(|()| output.flush());
    }
}

impl Word {
    /// Why a worker stopped.
    pub(super) fn failed(fault: &Fault) -> Self {
        Self::Failed {
            what: fault.to_string(),
            remedy: fault.remedy().map(Into::into),
        }
    }
}

/// The worker tells that so many demonstrations, or images, of all are done.
pub(super) fn progress(done: u64, all: u64, interrupt: &Interrupt) {
    tell(&Word::Progress(done, all));
    wait_at_gate(done, interrupt);
}

/// Waits where a test has put a gate.
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
    // Without its newline the number is not whole.
    if std::fs::write(file, format!("{}\n", std::process::id())).is_ok() {
        while Path::new(file).exists() && !interrupt.requested() {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Lets a worker make the artifact.
pub(super) fn run(order: &Order, interrupt: &Interrupt, bar: &ProgressBar) -> Result<()> {
    work(order, interrupt, bar).map(drop)
}

/// Asks a worker for the models beside the source that its demonstrations name.
pub(super) fn models(order: &Order, interrupt: &Interrupt, bar: &ProgressBar) -> Result<Vec<String>> {
    match work(order, interrupt, bar)? {
        Word::Models(names) => Ok(names),
        _ => bail!("the process that reads {} did not say which models it names", order.source.display(); "run again"),
    }
}

/// Runs a worker to its end; its last word.
fn work(order: &Order, interrupt: &Interrupt, bar: &ProgressBar) -> Result<Word> {
    match try_to_work(order, interrupt, bar) {
        // Behind a fault of the file, the library may have been led astray: then that fault is what there is to tell.
        Err(error) if error.is::<FellOver>() => {
            let cautious = Order {
                cautious: true,
                ..order.clone()
            };
            try_to_work(&cautious, interrupt, bar)
        }
        worked => worked,
    }
}

/// The library fell over.
#[derive(Debug, thiserror::Error, Remedy)]
#[error("{0}")]
#[remedy(_0.remedy())]
pub(crate) struct FellOver(Fault);

fn try_to_work(order: &Order, interrupt: &Interrupt, bar: &ProgressBar) -> Result<Word> {
    let refuse = |why: Fault| why.at(format!("cannot ingest {}: ", order.source.display()));
    let program =
        std::env::current_exe().context("cannot find this program's own file to read HDF5 in another process")?;
    let mut command = Command::new(program);
    command.arg(SUBCOMMAND);
    if order.cautious {
        // A test's gate is for the first worker.
        command.env_remove(GATE_VARIABLE);
    }
    if let Some(gl) = &order.gl {
        command.env("RE4_GL", gl);
        // Every thread draws by itself, so Mesa needs no threads of its own.
        if std::env::var_os(MESA_THREADS).is_none() {
            command.env(MESA_THREADS, "0");
        }
    }
    let mut child = command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .or_fault(|| fault!("cannot start another process to read HDF5 in"; "end other programs and run again"))?;
    info!(process = child.id(), source = %order.source.display(), cautious = order.cautious, "worker started to read HDF5");
    interrupt.set_worker(Some(child.id()));
    let mut line = serde_json::to_vec(order)?;
    line.push(b'\n');
    let mut stdin = child.stdin.take();
    if let Some(stdin) = &mut stdin {
        // A worker that is gone already says why below.
        let _ = stdin.write_all(&line).and_then(|()| stdin.flush());
    }
    let stderr = child.stderr.take();
    let last_words = std::thread::spawn(move || last_words(stderr));
    let words = listen(&mut child);
    let patience = std::env::var(PATIENCE_VARIABLE)
        .ok()
        .and_then(|text| text.parse().ok())
        .map_or(PATIENCE, Duration::from_secs);
    let ended = attend(&words, interrupt, bar, patience);
    bar.finish_and_clear();
    // The worker stops once its standard input is closed, and is ended where it does not.
    drop(stdin);
    let status = match &ended {
        Ended::Silent => end(&mut child),
        Ended::Interrupted => wait(&mut child, CLEARING),
        // It has said its last word, and only has to end.
        _ => wait(&mut child, ENDING),
    };
    interrupt.set_worker(None);
    let status = status.context("cannot learn how the process that reads HDF5 ended")?;
    info!(%status, "worker ended");
    match ended {
        // The artifact is published, however long the worker took to go.
        Ended::Word(word @ (Word::Done | Word::Models(_))) => return Ok(word),
        Ended::Word(Word::Failed { what, remedy }) => {
            interrupt.check("ingest")?;
            return Err(Fault::new(what, remedy).into());
        }
        Ended::Silent => {
            return Err(refuse(fault!(
                "the HDF5 library made no headway for {} s, so the file may be damaged or its disk may not answer",
                patience.as_secs();
                "copy the file to a local disk or download it again"
            ))
            .into());
        }
        // Ctrl-C in a terminal reaches the worker, too.
        Ended::Interrupted | Ended::Word(_) | Ended::Gone => interrupt.check("ingest")?,
    }
    let last_words = last_words.join().unwrap_or_default();
    let refusal = refuse(how_it_ended(status, &last_words));
    Err(match status.signal() {
        Some(SIGABRT | SIGBUS | SIGSEGV) => FellOver(refusal).into(),
        _ => refusal.into(),
    })
}

const SIGABRT: i32 = 6;
const SIGBUS: i32 = 7;
const SIGSEGV: i32 = 11;

/// Why the parent no longer listens.
enum Ended {
    /// The last word of the worker.
    Word(Word),
    /// The worker closed its standard output without one.
    Gone,
    /// Ctrl-C.
    Interrupted,
    /// The worker was silent for too long.
    Silent,
}

/// Listens until the worker has said its last word.
fn attend(words: &Receiver<Word>, interrupt: &Interrupt, bar: &ProgressBar, patience: Duration) -> Ended {
    let mut heard = Instant::now();
    loop {
        // Also while words come faster than this loop would wait for one.
        if interrupt.requested() {
            return Ended::Interrupted;
        }
        match words.recv_timeout(Duration::from_millis(50)) {
            Ok(Word::Progress(done, all)) => {
                bar.set_length(all);
                bar.set_position(done);
                heard = Instant::now();
            }
            Ok(word) => return Ended::Word(word),
            Err(RecvTimeoutError::Disconnected) => return Ended::Gone,
            Err(RecvTimeoutError::Timeout) if heard.elapsed() > patience => return Ended::Silent,
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Words of the worker as they come. Lines that are none (the C library may print, too) are left out.
fn listen(child: &mut Child) -> Receiver<Word> {
    let (sender, receiver) = channel();
    if let Some(stdout) = child.stdout.take() {
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if let Ok(word) = serde_json::from_str(&line)
                    && sender.send(word).is_err()
                {
                    break;
                }
            }
        });
    }
    receiver
}

fn last_words(stderr: Option<ChildStderr>) -> String {
    let mut bytes = Vec::new();
    if let Some(mut stderr) = stderr {
        let _ = stderr.by_ref().take(LAST_WORDS).read_to_end(&mut bytes);
        // The rest has to be taken, too, or the worker would wait for ever.
        let _ = std::io::copy(&mut stderr, &mut std::io::sink());
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Waits for the worker to end, and ends it where it takes longer than that.
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

/// What is said of a worker that ended without a word of its own.
fn how_it_ended(status: ExitStatus, last_words: &str) -> Fault {
    if last_words.contains("memory allocation of") {
        return fault!(
            "reading it takes more than {} GiB of memory, so it is damaged or far larger than robomimic's files",
            MEMORY >> 30;
            "copy or download it again, or ingest fewer demonstrations with ingest.select"
        );
    }
    match (status.signal(), status.code()) {
        (Some(9), _) => {
            fault!("the process that read it was ended from outside (signal 9), perhaps for lack of memory"; "free some memory and run again")
        }
        (Some(signal @ (2 | 15)), _) => {
            fault!("the process that read it was ended from outside (signal {signal})"; "run again")
        }
        (Some(25), _) => {
            fault!("the process that read it was ended for writing more than a file may hold (signal 25)"; "raise that limit (ulimit -f) and run again")
        }
        (Some(signal), _) => fault!(
            "the HDF5 library fell over (signal {signal}), so the file is damaged";
            "copy or download it again"
        ),
        (None, code) => {
            let said = last_words
                .lines()
                .find(|line| !line.trim().is_empty())
                .unwrap_or("nothing");
            fault!(
                "the process that read it stopped with exit code {} and said: {said}", code.unwrap_or_default();
                "run again, and report it where that does not help"
            )
        }
    }
}

//! Ctrl-C and termination signals: the running stage ends at its next step, and its unfinished artifact is removed.
//!
//! Some steps spend seconds in foreign code (MuJoCo, LibTorch). If the stage has not ended in time, a watchdog removes the
//! unfinished artifact and ends the process.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use anyhow::Result;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use re4_artifact::Store;
use re4_fault::{Fault, fault};

use crate::notes;

/// Time within which a stage has to end after a request to stop.
const GRACE: Duration = Duration::from_millis(500);

/// Time for which the watchdog waits for a killed worker process to exit, so that the worker writes nothing more.
const GONE: Duration = Duration::from_millis(100);

/// Whether the program's final message is being printed. Either the stage or the watchdog prints it, but not both.
static ANSWERED: AtomicBool = AtomicBool::new(false);

/// Whether this process was asked to stop by a signal.
static SIGNALLED: AtomicBool = AtomicBool::new(false);

/// Exit code of an interrupted run: `EX_TEMPFAIL` of `sysexits.h`. Schedulers of clusters can be set to start a task that ends with it
/// again, and the same command continues the run.
pub const TRY_AGAIN: u8 = 75;

/// Whether this process was interrupted by a signal.
pub fn was_interrupted() -> bool {
    SIGNALLED.load(Ordering::SeqCst)
}

/// Whether the user asked to stop.
#[derive(Debug, Clone, Default)]
pub struct Interrupt(Arc<Asked>);

#[derive(Debug, Default)]
struct Asked {
    requested: AtomicBool,
    /// Process id of the worker that reads HDF5; 0 if there is none.
    worker: AtomicU32,
    /// The store that may contain an unfinished artifact.
    store: Mutex<Option<Store>>,
    /// How the watchdog reports that it ended the run.
    report: OnceLock<fn(Fault)>,
}

impl Interrupt {
    /// Handles Ctrl-C and termination signals from now on. The watchdog removes unfinished artifacts from `store`, and prints an
    /// error.
    pub fn listen(store: Option<&Store>) -> Self {
        Self::listen_with_report(store, |fault| notes::print_error(&fault.into()))
    }

    /// As [`Self::listen`], but the watchdog reports through `report`. For the worker process, whose output is read by a program.
    pub fn listen_with_report(store: Option<&Store>, report: fn(Fault)) -> Self {
        let interrupt = Self::default();
        *interrupt.store() = store.cloned();
        let _ = interrupt.0.report.set(report);
        let listener = interrupt.clone();
        // If no handler can be set, Ctrl-C ends the process at once, and the next run removes the unfinished artifact.
        let _ = ctrlc::set_handler(move || {
            SIGNALLED.store(true, Ordering::SeqCst);
            if !listener.0.requested.swap(true, Ordering::SeqCst) {
                let watchdog = listener.clone();
                std::thread::spawn(move || {
                    std::thread::sleep(GRACE);
                    watchdog.end();
                });
            }
        });
        interrupt
    }

    fn store(&self) -> std::sync::MutexGuard<'_, Option<Store>> {
        self.0.store.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the process id of the worker process, or `None` when it has ended.
    pub fn set_worker(&self, worker: Option<u32>) {
        self.0.worker.store(worker.unwrap_or(0), Ordering::SeqCst);
    }

    /// Ends the process, unless the stage is printing its final message.
    fn end(&self) {
        if !answer() {
            return;
        }
        let worker = self.0.worker.load(Ordering::SeqCst);
        if let Some(worker) = i32::try_from(worker).ok().filter(|&worker| worker > 0) {
            let _ = kill(Pid::from_raw(worker), Signal::SIGKILL);
            std::thread::sleep(GONE);
        }
        let store = self.store().clone();
        // Kept until the process has ended, so that nothing more is published.
        let _publication = store.as_ref().map(Store::abandon);
        if let Some(report) = self.0.report.get() {
            report(interrupted("the run"));
        }
        #[allow(
            clippy::exit,
            reason = "the stage does not respond, and its threads may be in foreign code that cannot be interrupted"
        )]
        std::process::exit(TRY_AGAIN.into());
    }

    /// Requests a stop, as Ctrl-C does.
    pub fn request(&self) {
        self.0.requested.store(true, Ordering::SeqCst);
    }

    /// Whether the user asked to stop.
    pub fn requested(&self) -> bool {
        self.0.requested.load(Ordering::SeqCst)
    }

    /// Returns an error if the user asked to stop.
    ///
    /// # Errors
    /// If the user asked to stop; the message names `stage`.
    pub fn check(&self, stage: &str) -> Result<()> {
        if self.requested() {
            return Err(interrupted(stage).into());
        }
        Ok(())
    }
}

/// The error of an interrupted stage.
fn interrupted(what: &str) -> Fault {
    fault!("{what} was interrupted"; "no unfinished artifact remains, so run the same command again to continue")
}

/// Claims the right to print the program's final message. Returns false if it was claimed before.
pub fn answer() -> bool {
    !ANSWERED.swap(true, Ordering::SeqCst)
}

//! Ctrl-C and requests to terminate: the running stage ends at its next step, and what it had begun to write is removed.
//!
//! Some steps take seconds inside of other people's code. So a watchdog ends the process where the stage has not answered in
//! time, after it has removed what was half-written.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use anyhow::Result;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use re4_artifact::Store;
use re4_fault::{Fault, fault};

use crate::notes;

/// How long a stage may take to answer.
const GRACE: Duration = Duration::from_millis(500);

/// How long a worker process that was killed may take to be gone.
const GONE: Duration = Duration::from_millis(100);

/// Whether the program's answer is being given: by the stage, or by the watchdog, and never by both.
static ANSWERED: AtomicBool = AtomicBool::new(false);

/// Whether the user asked to stop.
#[derive(Debug, Clone, Default)]
pub struct Interrupt(Arc<Asked>);

#[derive(Debug, Default)]
struct Asked {
    requested: AtomicBool,
    /// The process that reads HDF5 for this one; 0 where there is none.
    worker: AtomicU32,
    /// Where there may be something half-written.
    store: Mutex<Option<Store>>,
    /// How the watchdog says that it ended the run.
    say: OnceLock<fn(Fault)>,
}

impl Interrupt {
    /// Listens to Ctrl-C and to requests to terminate from now on. The watchdog clears up in this store.
    pub fn listen(store: Option<&Store>) -> Self {
        Self::listen_and_say(store, |fault| notes::print_error(&fault.into()))
    }

    /// The same for a process that does not speak to people.
    pub fn listen_and_say(store: Option<&Store>, say: fn(Fault)) -> Self {
        let interrupt = Self::default();
        *interrupt.store() = store.cloned();
        let _ = interrupt.0.say.set(say);
        let listener = interrupt.clone();
        // Without a handler the process ends at once and the next run removes what it left; that is safe too.
        let _ = ctrlc::set_handler(move || {
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

    /// Says which process works for this one; none any more.
    pub fn set_worker(&self, worker: Option<u32>) {
        self.0.worker.store(worker.unwrap_or(0), Ordering::SeqCst);
    }

    /// Ends the process, unless its answer is under way.
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
        // Held until the process has ended, so that nothing more is published.
        let _locked = store.as_ref().map(Store::abandon);
        if let Some(say) = self.0.say.get() {
            say(interrupted("the run"));
        }
        #[allow(
            clippy::exit,
            reason = "the stage does not answer, and its threads may be in code that knows of no end"
        )]
        std::process::exit(2);
    }

    /// Asks to stop, as Ctrl-C does.
    pub fn request(&self) {
        self.0.requested.store(true, Ordering::SeqCst);
    }

    /// Whether the user asked to stop.
    pub fn requested(&self) -> bool {
        self.0.requested.load(Ordering::SeqCst)
    }

    /// Goes on, unless the user asked to stop.
    ///
    /// # Errors
    /// When the user asked to stop: the sentence that says so.
    pub fn check(&self, stage: &str) -> Result<()> {
        if self.requested() {
            return Err(interrupted(stage).into());
        }
        Ok(())
    }
}

/// What is said where the user asked to stop.
fn interrupted(what: &str) -> Fault {
    fault!("{what} was interrupted"; "nothing half-written was left, run the same command again to go on")
}

/// Takes the right to give the program's answer; false where it is being given.
pub fn answer() -> bool {
    !ANSWERED.swap(true, Ordering::SeqCst)
}

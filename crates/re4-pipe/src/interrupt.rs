//! Ctrl-C: the running stage ends at its next step, and what it had begun to write is removed.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, bail};

/// Whether the user asked to stop.
#[derive(Debug, Clone, Default)]
pub(crate) struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Listens to Ctrl-C and to termination requests from now on.
    pub(crate) fn listen() -> Self {
        let interrupt = Self::default();
        let flag = Arc::clone(&interrupt.0);
        // Without a handler the process ends at once and the next run removes what it left; that is safe too.
        let _ = ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed));
        interrupt
    }

    /// Asks to stop, as Ctrl-C does.
    pub(crate) fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the user asked to stop.
    pub(crate) fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// An error once the user asked to stop.
    pub(crate) fn check(&self, stage: &str) -> Result<()> {
        if self.requested() {
            bail!("{stage} was interrupted; nothing half-written was left, run the same command again to go on");
        }
        Ok(())
    }
}

//! Threads of an object. Each object has its own, started when they are first needed, so that importing the module starts none and
//! a process can be forked before an object is used.

use std::sync::OnceLock;

use rayon::ThreadPool;
use re4_fault::{OrFault as _, fault};

/// A pool of threads.
pub(crate) struct Threads {
    count: usize,
    pool: OnceLock<ThreadPool>,
}

impl Threads {
    /// A pool of `count` threads; 0: one for each processor.
    pub(crate) fn new(count: usize) -> Self {
        let processors = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        Self {
            count: if count == 0 { processors() } else { count },
            pool: OnceLock::new(),
        }
    }

    /// Number of threads.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// Calls `body` in the pool.
    ///
    /// # Errors
    /// If the threads cannot be started, and the error of `body`.
    pub(crate) fn run<R: Send>(&self, body: impl FnOnce() -> anyhow::Result<R> + Send) -> anyhow::Result<R> {
        if self.pool.get().is_none() {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(self.count)
                .build()
                .or_fault(|| fault!("cannot start {} threads", self.count; "give a smaller number of threads"))?;
            // If another thread was first, its pool is used.
            let _ = self.pool.set(pool);
        }
        match self.pool.get() {
            Some(pool) => pool.install(body),
            None => body(),
        }
    }
}

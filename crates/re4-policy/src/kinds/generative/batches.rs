//! Generation of chunks for several rollouts in one pass through the network.
//!
//! A rollout that needs a chunk while no batch is being generated generates one for all rollouts that wait. A chunk does not depend on
//! the others of its batch (`re4-generative` tests this), so the results do not depend on how requests meet.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use re4_generative::{GenerativeError, Generator, Request, Sampler};

/// A generator that several rollouts share.
pub(super) struct Batches {
    generator: Generator,
    sampler: Sampler,
    queue: Mutex<Queue>,
    changed: Condvar,
}

#[derive(Default)]
struct Queue {
    /// Number of requests so far.
    tickets: u64,
    waiting: Vec<(u64, Request)>,
    done: BTreeMap<u64, Result<Vec<f32>, String>>,
    /// Whether a batch is being generated.
    busy: bool,
}

impl Batches {
    pub(super) fn new(generator: Generator, sampler: Sampler) -> Self {
        Self {
            generator,
            sampler,
            queue: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Generates a chunk.
    pub(super) fn generate(&self, request: Request) -> Result<Vec<f32>, GenerativeError> {
        let mut queue = self.lock();
        let ticket = queue.tickets;
        queue.tickets += 1;
        queue.waiting.push((ticket, request));
        loop {
            if let Some(done) = queue.done.remove(&ticket) {
                return done.map_err(GenerativeError::Device);
            }
            if queue.busy {
                queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
                continue;
            }
            queue.busy = true;
            let batch = std::mem::take(&mut queue.waiting);
            drop(queue);
            let (tickets, requests): (Vec<u64>, Vec<Request>) = batch.into_iter().unzip();
            let mut answer = Answer {
                batches: self,
                tickets,
                chunks: Err("the thread that generated the batch panicked".to_owned()),
            };
            let chunks = self.generator.generate(&requests, self.sampler);
            answer.chunks = chunks.map_err(|error| error.to_string());
            drop(answer);
            queue = self.lock();
        }
    }
}

/// The result of a batch, which is passed on when the value is dropped: also if the thread panics, so that no other waits for ever.
struct Answer<'a> {
    batches: &'a Batches,
    tickets: Vec<u64>,
    chunks: Result<Vec<Vec<f32>>, String>,
}

impl Drop for Answer<'_> {
    fn drop(&mut self) {
        let mut queue = self.batches.lock();
        let tickets = std::mem::take(&mut self.tickets);
        match &mut self.chunks {
            Ok(chunks) => queue
                .done
                .extend(tickets.into_iter().zip(std::mem::take(chunks).into_iter().map(Ok))),
            Err(why) => queue
                .done
                .extend(tickets.into_iter().map(|ticket| (ticket, Err(why.clone())))),
        }
        queue.busy = false;
        self.batches.changed.notify_all();
    }
}

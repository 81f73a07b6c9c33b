//! The training loop.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::Scope;
use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::memory::keep_freed_memory;
use crate::{Checkpoints, Schedule, TrainError};

/// Number of batches that are loaded in advance.
const PREFETCH: usize = 3;

/// A network in training, with its optimiser.
pub trait Learner {
    /// What a step is computed from.
    type Batch: Send;
    /// Errors of the training.
    type Error: From<TrainError> + Send;

    /// One step of the optimiser. Returns the losses before the step, the sum first. If a loss is not finite, the weights must
    /// stay unchanged.
    ///
    /// # Errors
    /// If the step cannot be computed.
    fn advance(&mut self, batch: &Self::Batch, learning_rate: f64) -> Result<Vec<f64>, Self::Error>;

    /// The loss of held-out data, which is only reported: it selects no checkpoint or setting. `None` if there is none.
    ///
    /// # Errors
    /// If the loss cannot be computed.
    fn held_out(&self) -> Result<Option<f64>, Self::Error>;

    /// Everything that [`Learner::restore`] needs: weights and the optimiser's state.
    ///
    /// # Errors
    /// A clause that says why it cannot be saved.
    fn save(&self) -> Result<Vec<Vec<u8>>, String>;

    /// Restores what [`Learner::save`] returned.
    ///
    /// # Errors
    /// A clause that says why it cannot be restored.
    fn restore(&mut self, parts: Vec<Vec<u8>>) -> Result<(), String>;
}

/// What is trained for how long.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Number of epochs. A checkpoint is kept after each.
    pub epochs: u32,
    /// Steps per epoch.
    pub steps: u32,
    /// The learning rate.
    pub schedule: Schedule,
    /// The setting of the learning rate, for the message about a loss that is not finite.
    pub setting: &'static str,
}

impl Plan {
    /// Total number of steps.
    pub fn all_steps(&self) -> u64 {
        u64::from(self.epochs) * u64::from(self.steps)
    }
}

/// The progress of a training.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Current epoch, from 1.
    pub epoch: u32,
    /// Total number of finished steps.
    pub steps: u64,
    /// Steps per second since the start of this process.
    pub rate: f64,
    /// Mean losses of the epoch so far.
    pub losses: Vec<f64>,
}

/// The results of a finished epoch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Epoch {
    /// Number of the epoch, from 1.
    pub epoch: u32,
    /// Total number of steps up to the end of the epoch.
    pub steps: u32,
    /// Learning rate of the epoch's last step.
    pub learning_rate: f64,
    /// Mean losses over the epoch's steps, the sum first.
    pub losses: Vec<f64>,
    /// Loss of the held-out data; `None` if there is none.
    pub held_out: Option<f64>,
}

/// The result of a training.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// One entry per epoch.
    pub epochs: Vec<Epoch>,
    /// Number of epochs that were restored from a checkpoint.
    pub resumed: u32,
    /// Steps per second in this process; `None` if all epochs were restored.
    pub rate: Option<f64>,
}

/// Trains, from the last valid checkpoint if there is one. `load` returns the batch of a step of an epoch, both from 0; a thread
/// calls it in order. `on_step` is called after every step; its error stops the training, and the checkpoints are kept.
///
/// # Errors
/// If a loss is not finite, a checkpoint cannot be written or read, or `load` fails; or the error that `on_step` returns.
pub fn fit<L: Learner, E: From<L::Error> + From<TrainError>>(
    learner: &mut L,
    plan: &Plan,
    load: &(dyn Fn(u32, u32) -> Result<L::Batch, L::Error> + Sync),
    checkpoints: &Checkpoints,
    mut on_step: impl FnMut(&Progress) -> Result<(), E>,
) -> Result<Fitted, E> {
    keep_freed_memory();
    let mut epochs: Vec<Epoch> = Vec::new();
    if let Some(last) = checkpoints.last()? {
        learner.restore(last.parts).map_err(|why| TrainError::Checkpoint {
            path: last.path,
            source: std::io::Error::other(why),
        })?;
        epochs = last.epochs;
    }
    let resumed = epochs.len() as u32;
    let clock = Instant::now();
    let mut done = 0_u64;
    for epoch in resumed..plan.epochs {
        let before = u64::from(epoch) * u64::from(plan.steps);
        let mut sums: Vec<f64> = Vec::new();
        let mut learning_rate = 0.0;
        std::thread::scope(|scope| -> Result<(), E> {
            let receiver = batches(scope, load, epoch, plan.steps);
            for step in 0..plan.steps {
                let batch = receiver.recv().map_err(|_| TrainError::Loader)??;
                learning_rate = plan.schedule.rate(before + u64::from(step), plan.all_steps());
                let losses = learner.advance(&batch, learning_rate)?;
                if losses.iter().any(|loss| !loss.is_finite()) {
                    return Err(TrainError::NotFinite {
                        epoch: epoch + 1,
                        step: step + 1,
                        kept: checkpoints.describe(epoch),
                        setting: plan.setting,
                    }
                    .into());
                }
                done += 1;
                sums.resize(losses.len(), 0.0);
                for (sum, loss) in sums.iter_mut().zip(losses) {
                    *sum += loss;
                }
                on_step(&Progress {
                    epoch: epoch + 1,
                    steps: before + u64::from(step) + 1,
                    rate: done as f64 / clock.elapsed().as_secs_f64(),
                    losses: sums.iter().map(|sum| sum / f64::from(step + 1)).collect(),
                })?;
            }
            Ok(())
        })?;
        epochs.push(Epoch {
            epoch: epoch + 1,
            steps: (epoch + 1) * plan.steps,
            learning_rate,
            losses: sums.iter().map(|sum| sum / f64::from(plan.steps)).collect(),
            held_out: learner.held_out()?,
        });
        let parts = learner
            .save()
            .map_err(|why| checkpoints.cannot_write(epochs.len(), why))?;
        checkpoints.keep(&parts, &epochs)?;
    }
    Ok(Fitted {
        epochs,
        resumed,
        rate: (done > 0).then(|| done as f64 / clock.elapsed().as_secs_f64()),
    })
}

/// The batches of an epoch in order, loaded in advance by a thread that ends when the receiver is dropped.
fn batches<'scope, 'env, B: Send + 'env, E: Send + 'env>(
    scope: &'scope Scope<'scope, 'env>,
    load: &'env (dyn Fn(u32, u32) -> Result<B, E> + Sync),
    epoch: u32,
    steps: u32,
) -> Receiver<Result<B, E>> {
    let (sender, receiver) = sync_channel(PREFETCH);
    scope.spawn(move || {
        for step in 0..steps {
            if !send(&sender, load(epoch, step)) {
                return;
            }
        }
    });
    receiver
}

/// Sends a batch, or the error. Returns whether the next batch is wanted.
fn send<B, E>(sender: &SyncSender<Result<B, E>>, batch: Result<B, E>) -> bool {
    let good = batch.is_ok();
    sender.send(batch).is_ok() && good
}

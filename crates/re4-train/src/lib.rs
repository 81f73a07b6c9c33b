//! What every training shares: the loop, the schedule of the learning rate, checkpoints, batches that are loaded in advance,
//! seeded samples, and the backends of burn.
//!
//! A training implements [`Learner`], which advances by one batch and can be saved and restored; [`fit`] runs it.

mod backend;
mod checkpoint;
mod error;
mod fit;
mod memory;
mod sample;
mod schedule;
pub mod tensors;

pub use backend::Backend;
pub use checkpoint::{Checkpoint, Checkpoints};
pub use error::TrainError;
pub use fit::{Epoch, Fitted, Learner, Plan, Progress, fit};
pub use sample::{below, normal, uniform};
pub use schedule::{Schedule, WarmUp};

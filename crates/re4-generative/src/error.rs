//! Errors of generative policies.

use std::path::PathBuf;

use re4_fault::{Fault, Remedy};
use re4_train::TrainError;

/// Why a network cannot be trained, loaded or used.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum GenerativeError {
    /// The training, its checkpoints or its backend.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Train(#[from] TrainError),
    /// There is nothing to train on.
    #[error("there are no demonstrations to train on")]
    #[remedy("select at least one demonstration")]
    NoDemonstrations,
    /// A number of the demonstrations is not finite.
    #[error("dimension {dimension} of the {what} of demonstration {demo} is not a finite number in frame {frame}")]
    #[remedy("leave the demonstration out with ingest.select, or correct it")]
    NotFinite {
        /// `observations` or `actions`.
        what: &'static str,
        /// Number of the demonstration.
        demo: u32,
        /// Number of the frame.
        frame: usize,
        /// Number of the dimension.
        dimension: usize,
    },
    /// A weights file cannot be used.
    #[error("cannot use the weights {path}: {why}", path = .path.display())]
    #[remedy(why.remedy())]
    Weights {
        /// The file.
        path: PathBuf,
        /// What is wrong, and how to fix it.
        why: Fault,
    },
    /// Values cannot be read from the backend.
    #[error("cannot read the network's values from its backend ({0})")]
    #[remedy("run again, training resumes from the last checkpoint")]
    Device(String),
}

//! Errors of a training.

use std::path::PathBuf;

use re4_fault::Remedy;

/// Why a training cannot start or continue.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum TrainError {
    /// This program was built without the backend.
    #[error("{setting} is \"{backend}\", but this program was built without it")]
    #[remedy("build it with --features torch, or set {setting} = \"flex\"")]
    NoBackend {
        /// The setting that names the backend.
        setting: &'static str,
        /// The backend.
        backend: &'static str,
    },
    /// `LibTorch` finds no GPU that it can use.
    #[error("{setting} is \"cuda\", but LibTorch finds no NVIDIA GPU")]
    #[remedy(
        "check that nvidia-smi lists a GPU and that this program's LibTorch supports CUDA, or set {setting} = \"torch\""
    )]
    NoGraphicsCard {
        /// The setting that names the backend.
        setting: &'static str,
    },
    /// The number of threads cannot be set.
    #[error("cannot set the number of threads ({0})")]
    #[remedy("set it once, before the first computation")]
    Threads(String),
    /// The thread that loads batches ended early.
    #[error("the thread that loads batches ended before the epoch did")]
    #[remedy("run again, training resumes from the last checkpoint")]
    Loader,
    /// A checkpoint cannot be written or read.
    #[error("cannot write or read the checkpoint {path}: {source}", path = .path.display())]
    #[remedy("free some space, or remove the checkpoint, and run again")]
    Checkpoint {
        /// The checkpoint.
        path: PathBuf,
        /// The underlying error.
        source: std::io::Error,
    },
    /// A checkpoint belongs to another training run.
    #[error("the checkpoint {path} is of another training run, with other data or settings", path = .path.display())]
    #[remedy("remove it and run again")]
    ForeignCheckpoint {
        /// The checkpoint.
        path: PathBuf,
    },
    /// The training diverged.
    #[error("the loss is not a finite number in step {step} of epoch {epoch}")]
    #[remedy("{kept}; lower {setting} and run again")]
    NotFinite {
        /// Epoch, from 1.
        epoch: u32,
        /// Step of the epoch, from 1.
        step: u32,
        /// Which checkpoint is kept.
        kept: String,
        /// The setting of the learning rate.
        setting: &'static str,
    },
}

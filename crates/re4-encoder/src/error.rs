//! What can go wrong.

use re4_fault::{Fault, Remedy};
use std::path::PathBuf;

/// An error of the encoder, in one sentence.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum EncoderError {
    /// This program was built without a backend.
    #[error("pose.encoder.backend is \"{0}\", and this program was built without it")]
    #[remedy("build it with --features torch, or set it to \"flex\"")]
    NoBackend(&'static str),
    /// No graphics card that `LibTorch` can use.
    #[error("pose.encoder.backend is \"cuda\", and LibTorch finds no NVIDIA graphics card")]
    #[remedy(
        "check that nvidia-smi lists one and that the LibTorch of this program is one for CUDA, or set it to \"torch\""
    )]
    NoGraphicsCard,
    /// The number of threads cannot be set.
    #[error("cannot set the number of threads ({0})")]
    #[remedy("set it once, before anything is computed")]
    Threads(String),
    /// A file of weights is not what it should be.
    #[error("cannot use the weights {path}: {why}", path = .path.display())]
    #[remedy(why.remedy())]
    Weights {
        /// The file.
        path: PathBuf,
        /// What is wrong, and how to fix it.
        why: Fault,
    },
    /// Scratch space cannot be written.
    #[error("cannot write images to a scratch file in {folder}: {source}", folder = .folder.display())]
    #[remedy("free some space and run again, training goes on from the last checkpoint")]
    Scratch {
        /// Where.
        folder: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Scratch space cannot be read.
    #[error("cannot read the scratch file of images: {0}")]
    #[remedy("run again, training goes on from the last checkpoint")]
    ScratchRead(std::io::Error),
    /// The thread that loads images ended.
    #[error("the thread that loads images ended before the epoch did")]
    #[remedy("run again, training goes on from the last checkpoint")]
    Loader,
    /// A checkpoint cannot be written or read.
    #[error("cannot keep or read the checkpoint {path}: {source}", path = .path.display())]
    #[remedy("free some space, or remove it, and run again")]
    Checkpoint {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A checkpoint of another training.
    #[error("the checkpoint {path} is of another training, with other data or settings", path = .path.display())]
    #[remedy("remove it and run again")]
    ForeignCheckpoint {
        /// Which.
        path: PathBuf,
    },
    /// The training diverged.
    #[error("the loss is not a finite number in step {step} of epoch {epoch}")]
    #[remedy("{kept}; lower pose.encoder.learning_rate and run again")]
    NotFinite {
        /// Epoch, from 1.
        epoch: u32,
        /// Step of the epoch, from 1.
        step: u32,
        /// What is kept.
        kept: String,
    },
    /// An image of another size.
    #[error("an image has {0} bytes where 84 x 84 pixels of three colours have 21168")]
    #[remedy("use images of that size")]
    Image(usize),
}

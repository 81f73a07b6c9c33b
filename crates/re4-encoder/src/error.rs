//! Errors of the encoder.

use re4_fault::{Fault, Remedy};
use std::path::PathBuf;

/// Why the encoder cannot be trained, loaded or used.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum EncoderError {
    /// This program was built without the backend.
    #[error("pose.encoder.backend is \"{0}\", but this program was built without it")]
    #[remedy("build it with --features torch, or set pose.encoder.backend = \"flex\"")]
    NoBackend(&'static str),
    /// `LibTorch` finds no GPU that it can use.
    #[error("pose.encoder.backend is \"cuda\", but LibTorch finds no NVIDIA GPU")]
    #[remedy(
        "check that nvidia-smi lists a GPU and that this program's LibTorch supports CUDA, or set pose.encoder.backend = \"torch\""
    )]
    NoGraphicsCard,
    /// Values cannot be read from the backend.
    #[error("cannot read the network's weights from its backend ({0})")]
    #[remedy("run again, training resumes from the last checkpoint")]
    Device(String),
    /// The number of threads cannot be set.
    #[error("cannot set the number of threads ({0})")]
    #[remedy("set it once, before the first computation")]
    Threads(String),
    /// A weights file cannot be used.
    #[error("cannot use the weights {path}: {why}", path = .path.display())]
    #[remedy(why.remedy())]
    Weights {
        /// The file.
        path: PathBuf,
        /// What is wrong, and how to fix it.
        why: Fault,
    },
    /// The scratch file of images cannot be written.
    #[error("cannot write images to a scratch file in {folder}: {source}", folder = .folder.display())]
    #[remedy("free some space and run again, training resumes from the last checkpoint")]
    Scratch {
        /// Folder of the scratch file.
        folder: PathBuf,
        /// The underlying error.
        source: std::io::Error,
    },
    /// The scratch file of images cannot be read.
    #[error("cannot read the scratch file of images: {0}")]
    #[remedy("run again, training resumes from the last checkpoint")]
    ScratchRead(std::io::Error),
    /// The image loading thread ended early.
    #[error("the image loading thread ended before the epoch did")]
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
    #[remedy("{kept}; lower pose.encoder.learning_rate and run again")]
    NotFinite {
        /// Epoch, from 1.
        epoch: u32,
        /// Step of the epoch, from 1.
        step: u32,
        /// Which checkpoint is kept.
        kept: String,
    },
    /// All pixels of an image are equal.
    #[error("all pixels of the image have the same colour")]
    #[remedy("check that the camera works and that images are rendered")]
    Blank,
    /// An image has the wrong size.
    #[error("an image has {0} bytes, but an RGB image of 84 x 84 pixels has 21168")]
    #[remedy("use RGB images of 84 x 84 pixels")]
    Image(usize),
}

//! Errors of the encoder.

use re4_fault::{Fault, Remedy};
use re4_train::TrainError;
use std::path::PathBuf;

/// Why the encoder cannot be trained, loaded or used.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum EncoderError {
    /// The training, its checkpoints or its backend.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Train(#[from] TrainError),
    /// Values cannot be read from the backend.
    #[error("cannot read the network's weights from its backend ({0})")]
    #[remedy("run again, training resumes from the last checkpoint")]
    Device(String),
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
    /// All pixels of an image are equal.
    #[error("all pixels of the image have the same colour")]
    #[remedy("check that the camera works and that images are rendered")]
    Blank,
    /// An image has the wrong size.
    #[error("an image has {0} bytes, but an RGB image of 84 x 84 pixels has 21168")]
    #[remedy("use RGB images of 84 x 84 pixels")]
    Image(usize),
}

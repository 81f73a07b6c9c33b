//! What can go wrong.

use std::path::PathBuf;

/// An error of the encoder, in one sentence.
#[derive(Debug, thiserror::Error)]
pub enum EncoderError {
    /// This program was built without a backend.
    #[error(
        "pose.encoder.backend is \"{0}\", and this program was built without it; build it with --features torch, or set it to \"flex\""
    )]
    NoBackend(&'static str),
    /// No graphics card that `LibTorch` can use.
    #[error(
        "pose.encoder.backend is \"cuda\", and LibTorch finds no NVIDIA graphics card; check that nvidia-smi lists one and that the LibTorch of this program is one for CUDA, or set it to \"torch\""
    )]
    NoGraphicsCard,
    /// The number of threads cannot be set.
    #[error("cannot set the number of threads ({0}); set it once, before anything is computed")]
    Threads(String),
    /// A file of weights is not what it should be.
    #[error("cannot use the weights {path}: {why}", path = .path.display())]
    Weights {
        /// The file.
        path: PathBuf,
        /// What is wrong, and how to mend it.
        why: String,
    },
    /// A picture of another size.
    #[error("a picture has {0} bytes where 84 x 84 pixels of three colours have 21168; use pictures of that size")]
    Picture(usize),
}

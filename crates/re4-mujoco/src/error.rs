//! What can go wrong with the library, a model or a simulation.

use re4_fault::Remedy;
use std::path::PathBuf;

use crate::Gl;

/// Why MuJoCo cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, Remedy)]
#[non_exhaustive]
pub enum MujocoError {
    /// There is no library.
    #[error("MuJoCo's library is not at {}", path.display())]
    #[remedy(
        "run scripts/setup-simulators.sh, or name the folder that it made in the environment variable RE4_SIMULATORS"
    )]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// The file cannot be loaded.
    #[error("cannot load MuJoCo's library {}: {reason}", path.display())]
    #[remedy("remove it and run scripts/setup-simulators.sh")]
    Load {
        /// The file.
        path: PathBuf,
        /// The system's words.
        reason: String,
    },
    /// The library is one whose structures are not known.
    #[error("the library {} is MuJoCo {found}, not {expected}", path.display())]
    #[remedy("remove it and run scripts/setup-simulators.sh")]
    Version {
        /// The file.
        path: PathBuf,
        /// What it says it is.
        found: String,
        /// What was looked for.
        expected: String,
    },
    /// A model does not compile.
    #[error("MuJoCo cannot compile the model: {reason}")]
    Model {
        /// MuJoCo's words.
        reason: String,
    },
    /// The model cannot be handed over as a file.
    #[error("cannot write the model for MuJoCo to a temporary file: {reason}")]
    #[remedy("free some space in the folder for temporary files")]
    Temporary {
        /// The system's words.
        reason: String,
    },
    /// A name that the model lacks.
    #[error("the model has no {kind} {name}")]
    NoSuch {
        /// What was looked for.
        kind: &'static str,
        /// Its name.
        name: String,
    },
    /// Neither of the OpenGL libraries is there.
    #[error("cannot draw images: {reason}")]
    #[remedy("install the Debian package libosmesa6, or libegl1 and libgl1-mesa-dri")]
    NoGl {
        /// What was tried, and the system's words.
        reason: String,
    },
    /// The environment variable that chooses between them says something else.
    #[error("the environment variable RE4_GL is {found}")]
    #[remedy("set it to osmesa or egl, or leave it out to take what is there")]
    GlName {
        /// What it says.
        found: String,
    },
    /// OpenGL refuses to work.
    #[error("cannot draw images with {gl}: {reason}")]
    #[remedy("choose the other library with the environment variable RE4_GL (osmesa or egl)")]
    Gl {
        /// `osmesa` or `egl`.
        gl: Gl,
        /// What failed.
        reason: &'static str,
    },
    /// There is no memory for a simulation.
    #[error("MuJoCo has no memory for a simulation")]
    #[remedy("run with fewer jobs")]
    Memory,
}

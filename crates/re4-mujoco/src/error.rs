//! Errors of the library, models, simulations and renderers.

use re4_fault::Remedy;
use std::path::PathBuf;

use crate::Gl;

/// Reasons why MuJoCo cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error, Remedy)]
#[non_exhaustive]
pub enum MujocoError {
    /// The library does not exist.
    #[error("MuJoCo's library does not exist at {}", path.display())]
    #[remedy(
        "run scripts/setup-simulators.sh, or set the environment variable RE4_SIMULATORS to the folder that it created"
    )]
    Missing {
        /// The path where it was looked for.
        path: PathBuf,
    },
    /// The library cannot be loaded.
    #[error("cannot load MuJoCo's library {}: {reason}", path.display())]
    #[remedy("remove it and run scripts/setup-simulators.sh")]
    Load {
        /// Path of the library.
        path: PathBuf,
        /// The system's message.
        reason: String,
    },
    /// The library is another version of MuJoCo.
    #[error("the library {} is MuJoCo {found}, not {expected}", path.display())]
    #[remedy("remove it and run scripts/setup-simulators.sh")]
    Version {
        /// Path of the library.
        path: PathBuf,
        /// Its version.
        found: String,
        /// The expected version.
        expected: String,
    },
    /// A model does not compile.
    #[error("MuJoCo cannot compile the model: {reason}")]
    Model {
        /// MuJoCo's message.
        reason: String,
    },
    /// The temporary file for passing the model to MuJoCo cannot be written.
    #[error("cannot write the model for MuJoCo to a temporary file: {reason}")]
    #[remedy("free some space in the folder for temporary files")]
    Temporary {
        /// The system's message.
        reason: String,
    },
    /// The model has no element with this name.
    #[error("the model has no {kind} {name}")]
    NoSuch {
        /// Kind of the element.
        kind: &'static str,
        /// Its name.
        name: String,
    },
    /// None of the OpenGL libraries can be loaded.
    #[error("cannot render images, because no OpenGL library can be loaded: {reason}")]
    #[remedy("install the Debian package libosmesa6, or libegl1 and libgl1-mesa-dri")]
    NoGl {
        /// The libraries that were tried, with the system's messages.
        reason: String,
    },
    /// The environment variable that chooses the OpenGL library has an invalid value.
    #[error("the environment variable RE4_GL has the invalid value {found}")]
    #[remedy("set it to osmesa or egl, or unset it to use the first library that is available")]
    GlName {
        /// Its value.
        found: String,
    },
    /// An OpenGL operation failed.
    #[error("cannot render images with {gl}: {reason}")]
    #[remedy("choose the other library with the environment variable RE4_GL (osmesa or egl)")]
    Gl {
        /// The library: `osmesa` or `egl`.
        gl: Gl,
        /// What failed.
        reason: &'static str,
    },
    /// MuJoCo cannot allocate a simulation.
    #[error("MuJoCo cannot allocate the memory for a simulation")]
    #[remedy("run with fewer jobs")]
    Memory,
}

//! The module `re4_pipe._native` of the Python package `re4-pipe`: simulators, Retrieve and policies for numpy arrays.
//!
//! The package in `python/re4_pipe` is its only caller. It converts arguments to contiguous arrays of the expected types, so the
//! interface here is narrow. Work is done without the interpreter's lock. Errors become `re4_pipe.Re4Error` with the message and
//! the remedy that the command line prints.

#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 passes the arguments of functions by value"
)]

mod arrays;
mod c_stderr;
mod errors;
mod policy;
mod pusht;
mod retriever;
mod robosuite;
mod threads;

use std::path::PathBuf;

use pyo3::prelude::*;
use re4_artifact::Artifact;

use errors::raised;

/// The manifest of an artifact as JSON. `verify`: whether every byte of its files is compared with the manifest.
#[pyfunction]
fn manifest(py: Python<'_>, folder: PathBuf, verify: bool) -> PyResult<String> {
    let read = || -> anyhow::Result<String> {
        let artifact = Artifact::open(&folder)?;
        if verify {
            artifact.verify_bytes()?;
        }
        Ok(serde_json::to_string(artifact.manifest())?)
    };
    py.detach(read).map_err(raised)
}

/// Adds the classes and functions to the module.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    c_stderr::set();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<pusht::PushTSims>()?;
    module.add_class::<robosuite::RobosuiteSims>()?;
    module.add_class::<retriever::PlaneIndex>()?;
    module.add_class::<retriever::SpaceIndex>()?;
    module.add_class::<policy::Policy>()?;
    module.add_function(wrap_pyfunction!(manifest, module)?)?;
    module.add_function(wrap_pyfunction!(robosuite::task_record, module)?)?;
    Ok(())
}

//! Errors as Python exceptions.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use re4_fault::Remedy as _;
use re4_stages::fault_of;

/// Converts an error to `re4_pipe.Re4Error(message, remedy)`.
pub(crate) fn raised(error: impl Into<anyhow::Error>) -> PyErr {
    let fault = fault_of(&error.into());
    let (message, remedy) = (fault.to_string(), fault.remedy().map(std::borrow::Cow::into_owned));
    Python::attach(|py| {
        let class = py
            .import("re4_pipe._errors")
            .and_then(|module| module.getattr("Re4Error"));
        match class.and_then(|class| class.call1((message.as_str(), remedy))) {
            Ok(value) => PyErr::from_value(value),
            // Only if the package is incomplete.
            Err(_) => PyRuntimeError::new_err(message),
        }
    })
}

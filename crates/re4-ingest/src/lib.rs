//! Readers and writers of raw demonstration datasets.
//!
//! [`pusht`] reads and writes the Push-T replay dataset: a Zarr v2 store, as a folder or in a `.zip` file. [`robomimic`] reads
//! demonstrations of robosuite's tasks from HDF5 files. A reader
//! checks everything it hands on; what it refuses is an [`IngestError`] that names the array and the index, what it
//! only finds odd is a [`Warning`] that travels with the data.

mod bitplanes;
mod compression;
mod error;
pub mod pusht;
pub mod robomimic;
mod selection;
mod store;
mod warning;
mod zarr;

pub use error::{Fault, IngestError};
pub use selection::{EpisodeRange, Selection, SelectionError};
pub use warning::{Warning, WarningCode};

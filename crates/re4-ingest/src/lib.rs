//! Readers and writers of raw demonstration datasets.
//!
//! A dataset of any format is a [`DemoSource`]: it recognizes its format by the kind of path, the extension or the first bytes,
//! describes its contents, and yields demonstrations one after the other. A fault of a single demonstration is a value
//! ([`LeftOut`]), not an error. [`pusht`] reads and writes the Push-T replay dataset, a Zarr store of format 2 or 3 in a folder
//! or a `.zip` file. [`robomimic`] reads demonstrations of robosuite's tasks from HDF5 files.
//! [`lerobot`] reads LeRobot datasets.
//!
//! A reader checks everything that it returns. An [`IngestError`] rejects a dataset and names the array and the index; a
//! [`Warning`] reports something unusual and is returned with the data.

mod bitplanes;
mod compression;
mod demos;
mod describe;
mod error;
mod left_out;
pub mod lerobot;
mod name;
pub mod pusht;
pub mod robomimic;
mod selection;
mod source;
mod store;
mod warning;
mod zarr;

pub use demos::{DemoName, DemoSource, Episode, FirstOf, Frames, ImageBlock, Info, Matrix, Tally};
pub use describe::{Description, Fact, Use};
pub use error::{Fault, IngestError};
pub use left_out::{OnBad, refusal};
pub use name::{Pick, SourceName};
use re4_artifact::episodes as tables;
pub use re4_artifact::episodes::{
    ArmColumns, Convention, DemoRow, EpisodeRow, FrameRow, ImageRow, KEYPOINTS, LeftOut, LeftOutFrameRow, ModelRow,
    PlanarColumns, SignalRole, SignalRow, SignalVector, SpatialColumns, StateRow,
};
pub use selection::{EpisodeRange, Selection, SelectionError};
pub use source::{SourceFile, Stop};
pub use warning::{Warning, WarningCode};

/// Version of the HDF5 library that this program was linked with: `1.10.8`.
#[must_use]
pub fn hdf5_version() -> String {
    let (major, minor, release) = hdf5::library_version();
    format!("{major}.{minor}.{release}")
}

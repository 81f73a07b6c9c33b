//! LeRobot datasets (v2.0, v2.1 and v3.0) as sources of demonstrations.
//!
//! The crate `re4-lerobot` reads the files and compares all counts. This module decides which features are used for what, selects
//! episodes, and checks that no file changes. The numbers of Push-T are judged as those of its zarr stores are, in [`crate::pusht`].

mod arm;
mod describe;
mod files;
mod keys;
mod opened;
mod roles;
mod source;

pub use describe::describe;
pub use files::LerobotFiles;
pub use keys::LerobotKeys;
pub use opened::LerobotDataset;
pub use source::{LerobotChoice, LerobotSource};

pub(crate) use keys::{Wanted, width};
pub(crate) use opened::{error_of, sentence};

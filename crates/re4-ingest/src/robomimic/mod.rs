//! Demonstrations of robosuite's tasks in HDF5: robomimic's layout, with observations, and robosuite's own raw one.
//!
//! A file has a group `/data` with one group a demonstration (`demo_0`, `demo_1`, ...), and perhaps `/mask` with lists of
//! their names. Values are handed on bit for bit.

mod assumed;
mod demo;
mod fault;
mod file;
mod reader;

pub use assumed::{Interpreted, interpret};
pub use demo::{Demo, Matrix};
pub use fault::Hdf5Fault;
pub use reader::{DemoChoice, DemoName, RobomimicReader};

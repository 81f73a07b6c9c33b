//! Demonstrations of robosuite's tasks in HDF5 files: robomimic's layout, with observations, and robosuite's raw layout.
//!
//! A file has a group `/data` with one group per demonstration (`demo_0`, `demo_1`, ...), and optionally a group `/mask` with
//! lists of their names. Values are returned bit for bit; what they mean is proven from the numbers ([`Interpreter`]).

mod arm;
mod demo;
mod describe;
mod direct;
mod fault;
mod file;
mod from_states;
mod images;
mod interpret;
mod library;
mod look;
mod mask;
mod members;
mod names;
mod reader;
mod recorded;
mod relatives;
mod several;
mod source;
mod sources;
mod stated;
mod summary;
mod survey;
mod used;

pub use arm::{ArmConfig, ArmSource};
pub use demo::Demo;
pub use describe::describe;
pub use fault::Hdf5Fault;
pub use file::Access;
pub use interpret::{Interpreted, Interpreter, Reading};
pub use mask::{MaskError, copy_with_filter};
pub use members::{Member, Members, files_of};
pub use reader::{DemoChoice, Layout, RobomimicReader};
pub use several::{CamerasAsked, FileSource, Files, Several};
pub use source::RobomimicSource;
pub use sources::{Sources, SourcesIdentity};
pub use summary::{Comparison, GoalErrors};
pub use survey::Surveyed;

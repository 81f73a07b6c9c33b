//! Tasks: one record says all that the workspace knows of one.
//!
//! [`TaskSpec`] is the record of a robosuite task; all records stand in `records.rs`, and nothing outside of that file tells
//! tasks apart by name. [`RobosuiteTask`] is a task that has a record, [`Task`] what a pipeline file may name: such a task,
//! Push-T, or any other robosuite environment. Metres and radians; world frame: robosuite's, z up.

mod camera;
mod layout;
mod names;
mod records;
mod spec;

pub use camera::Camera;
pub use layout::ObjectLayout;
pub use names::{RobosuiteTask, Task};
pub use spec::{Extent, ObjectRule, Positions, Solid, TaskSpec};

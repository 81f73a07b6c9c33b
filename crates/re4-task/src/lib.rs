//! Tasks. One record contains everything that the workspace knows about a task.
//!
//! [`TaskSpec`] is the record of a robosuite task. All records are in `records.rs`; code outside of that file does not
//! distinguish tasks by name. [`RobosuiteTask`] is a task with a record. [`Task`] is the value of `task` in a pipeline file: a
//! task with a record, Push-T, or any other robosuite environment.
//!
//! Lengths are in metres and angles in radians. The world frame is robosuite's, z upwards.

mod camera;
mod layout;
mod names;
mod records;
mod spec;

pub use camera::Camera;
pub use layout::ObjectLayout;
pub use names::{Domain, RobosuiteTask, Task};
pub use spec::{Extent, ObjectRule, Positions, Solid, TaskSpec};

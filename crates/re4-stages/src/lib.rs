//! What stages do: they read a pipeline file and artifacts, let the library crates compute, and leave artifacts.
//!
//! A [`Runner`] holds a pipeline, and has one method a stage. Stages know each other by their artifacts alone: what more than
//! one of them reads is in `inputs`, and no stage imports another.

#[doc(hidden)]
pub mod fuzzing;
mod inputs;
mod interrupt;
mod notes;
mod pipeline;
mod rerender;
mod runner;
mod stages;
pub mod tables;
#[doc(hidden)]
pub mod testing;

pub use inputs::sources::data_folders;
pub use interrupt::{Interrupt, answer};
pub use notes::{Notes, fault_of, print_error};
pub use pipeline::{
    Camera, Estimates, IndexSection, IngestSection, NoiseSection, Pipeline, Policy, PoseSection, PoseSource,
    RolloutSection, Seeds, Task, Variant, schema,
};
pub use rerender::{Rerendered, add_images};
pub use runner::{Built, Runner, Settings};
pub use stages::{
    BudgetRow, DivergenceRow, INGEST_WORKER, PlanarDivergenceRow, PlanarReplay, ReplayRow, SpatialDivergence,
    SpatialReplay, metrics, read_rollouts, serve_ingest,
};

//! What stages do: they read a pipeline file and artifacts, let the library crates compute, and leave artifacts.
//!
//! A [`Runner`] holds a pipeline, and has one method a stage. Stages know each other by their artifacts alone: what more than
//! one of them reads is in `inputs`, and no stage imports another.

mod doctor;
#[doc(hidden)]
pub mod fuzzing;
mod inputs;
mod interrupt;
mod notes;
mod pipeline;
mod reference;
mod rerender;
mod runner;
mod stages;
pub mod tables;
#[doc(hidden)]
pub mod testing;

pub use doctor::{Finding, State, doctor};
pub use inputs::sources::data_folders;
pub use interrupt::{Interrupt, answer};
pub use notes::{Notes, fault_of, print_error};
pub use pipeline::{
    Camera, Estimates, IndexSection, IngestSection, NoiseSection, Pipeline, Policy, PoseSection, PoseSource,
    RolloutSection, Seeds, Task, Variant, read_pipeline, schema,
};
pub use reference::{pipeline_reference, tables_reference};
pub use rerender::{Rerendered, add_images};
pub use runner::{Built, Runner, Settings, warning_text};
pub use stages::{
    BudgetRow, DivergenceRow, INGEST_WORKER, PlanarDivergenceRow, PlanarReplay, ReplayRow, SpatialDivergence,
    SpatialReplay, metrics, read_rollouts, serve_ingest,
};

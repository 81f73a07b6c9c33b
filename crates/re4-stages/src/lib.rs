//! The stages of a pipeline. Each stage reads the pipeline file and artifacts, calls the library crates and writes an artifact.
//!
//! A [`Runner`] holds a pipeline and has one method per stage. Stages exchange data only through artifacts: readers that more
//! than one stage uses are in `inputs`, and no stage imports another.

mod addresses;
mod doctor;
#[doc(hidden)]
pub mod fuzzing;
mod hashes;
mod inputs;
mod interrupt;
mod notes;
mod parts;
mod pipeline;
mod plan;
mod plan_file;
mod reference;
mod rerender;
mod runner;
mod stages;
mod suite;
pub mod tables;
mod tasks;
#[doc(hidden)]
pub mod testing;

pub use addresses::{address_of, is_address, local_artifact, local_artifacts, local_store};
pub use doctor::{Finding, State, doctor};
pub use hashes::HashedFile;
pub use inputs::simulators::TaskScene;
pub use inputs::sources::data_folders;
pub use interrupt::{Interrupt, TRY_AGAIN, answer, was_interrupted};
pub use notes::{Notes, fault_of, print_error};
pub use parts::{Partly, Share};
pub use pipeline::{
    Camera, Estimates, IndexSection, IngestSection, NoiseSection, Pipeline, Policy, PoseSection, PoseSource,
    RolloutSection, Seeds, SourcePaths, Task, Variant, read_pipeline, schema,
};
pub use plan::PlannedStage;
pub use plan_file::{Group, Plan};
pub use reference::{pipeline_reference, suite_reference, tables_reference};
pub use rerender::{Rerendered, add_images};
pub use runner::{Built, Runner, Session, Settings, leaves, warning_text};
pub use stages::{
    AnyLivePolicy, BudgetRow, Checked, Compared, Curated, Curation, DivergenceRow, INGEST_WORKER, Influenced, Judge,
    LivePolicy, PlanarDivergenceRow, PlanarReplay, PlannedCell, PlannedSuite, ReplayRow, SpatialDivergence,
    SpatialReplay, compare, compare_inputs, compare_shard, describe, merge_comparison, metrics, open_policy,
    planned_suite, read_rollouts, serve_ingest,
};
pub use suite::{Cell, Selection, Suite, is_suite, read_suite, suite_schema};
pub use tasks::Tasks;

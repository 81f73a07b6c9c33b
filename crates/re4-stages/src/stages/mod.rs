//! The stages: one module for each, named by its subcommand.

mod audit;
mod compare;
mod index;
mod ingest;
mod replay;
mod rollout;
mod scenes;
mod segment;
mod train;
mod train_pose;
mod training;

pub use compare::{
    Compared, PlannedCell, PlannedSuite, compare, compare_inputs, compare_shard, merge_comparison, planned_suite,
};
pub(crate) use ingest::WorkerCrashed;
pub use ingest::{INGEST_WORKER, describe, serve_ingest};
pub use replay::{DivergenceRow, PlanarDivergenceRow, PlanarReplay, ReplayRow, SpatialDivergence, SpatialReplay};
pub use rollout::{
    AnyLivePolicy, BudgetRow, Checked, Curated, Curation, Influenced, Judge, LivePolicy, metrics, open_policy,
    read_rollouts,
};
pub(crate) use rollout::{ImageObserver, MakeEstimator, RolloutArtifacts, scene_renderer};
pub(crate) use train::PolicyTrainingRow;

//! Arguments of `merge`, `plan` and `status`.

use std::num::NonZeroU32;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use re4_artifact::Stage;

use super::{Common, RolledArguments, SelectedArguments, StageArguments};

/// A stage of a pipeline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum StageArgument {
    Ingest,
    Segment,
    Observe,
    Audit,
    TrainEncoder,
    TrainPose,
    Index,
    Train,
    Scenes,
    Rollout,
    Compare,
    Influence,
}

impl From<StageArgument> for Stage {
    fn from(stage: StageArgument) -> Self {
        match stage {
            StageArgument::Ingest => Self::Ingest,
            StageArgument::Segment => Self::Segment,
            StageArgument::Observe => Self::Observe,
            StageArgument::Audit => Self::Audit,
            StageArgument::TrainEncoder => Self::TrainEncoder,
            StageArgument::TrainPose => Self::TrainPose,
            StageArgument::Index => Self::Index,
            StageArgument::Train => Self::Train,
            StageArgument::Scenes => Self::Scenes,
            StageArgument::Rollout => Self::Rollout,
            StageArgument::Compare => Self::Compare,
            StageArgument::Influence => Self::Influence,
        }
    }
}

/// Arguments of `merge`.
#[derive(Debug, Clone, Args)]
pub(crate) struct MergeArguments {
    /// Stage whose artifact is published; compare takes a suite file instead of a pipeline file
    #[arg(value_name = "STAGE", value_enum)]
    pub(crate) of: StageArgument,
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Settings of rollouts.
    #[command(flatten)]
    pub(crate) rolled: RolledArguments,
    /// The cells of a suite, for compare.
    #[command(flatten)]
    pub(crate) selected: SelectedArguments,
    /// Influence: scenes per demonstration, as for re4-pipe influence
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub(crate) starts: u32,
}

/// Arguments of `plan`.
#[derive(Debug, Clone, Args)]
pub(crate) struct PlanArguments {
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Settings of rollouts.
    #[command(flatten)]
    pub(crate) rolled: RolledArguments,
    /// The cells of a suite.
    #[command(flatten)]
    pub(crate) selected: SelectedArguments,
    /// Maximum number of tasks per stage
    #[arg(long, value_name = "N")]
    pub(crate) shards: NonZeroU32,
    /// Processors per task; each task runs as many threads
    #[arg(long, value_name = "N", default_value = "1")]
    pub(crate) cpus: NonZeroU32,
    /// List only the tasks whose parts or artifacts do not exist
    #[arg(long)]
    pub(crate) missing: bool,
}

/// Arguments of `status`.
#[derive(Debug, Clone, Args)]
pub(crate) struct StatusArguments {
    /// File with the output of re4-pipe plan --json
    #[arg(value_name = "PLAN.json")]
    pub(crate) plan: PathBuf,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

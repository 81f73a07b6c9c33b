//! Arguments of commands that read a suite file.

use std::path::PathBuf;

use clap::Args;
use re4_artifact::Shard;
use re4_stages::{Seeds, Selection};

use super::Common;

/// The cells of a suite that a command is about.
#[derive(Debug, Clone, Args)]
pub(crate) struct SelectedArguments {
    /// Names of the rows of a suite, separated by commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(crate) rows: Vec<String>,
    /// Names of the columns of a suite, separated by commas [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub(crate) columns: Vec<String>,
}

impl SelectedArguments {
    /// Whether neither rows nor columns are named.
    pub(crate) fn are_all(&self) -> bool {
        self.rows.is_empty() && self.columns.is_empty()
    }

    /// These cells with seeds and overrides.
    pub(crate) fn selection(&self, seeds: Option<Seeds>, set: Vec<String>) -> Selection {
        let trimmed = |names: &[String]| names.iter().map(|name| name.trim().to_owned()).collect();
        Selection {
            rows: trimmed(&self.rows),
            columns: trimmed(&self.columns),
            seeds,
            set,
        }
    }
}

/// Arguments of `compare`.
#[derive(Debug, Clone, Args)]
pub(crate) struct CompareArguments {
    /// Suite file
    #[arg(value_name = "SUITE.toml")]
    pub(crate) suite: PathBuf,
    /// The cells to run.
    #[command(flatten)]
    pub(crate) selected: SelectedArguments,
    /// Override a setting of every cell's pipeline; can be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Seeds of the scenes in place of those of the suite, such as 500..600 (600 is excluded)
    #[arg(long, value_name = "SEEDS")]
    pub(crate) seeds: Option<Seeds>,
    /// HTML page to write [default: the name of the suite file with the ending .html, in the current folder]
    #[arg(long, short, value_name = "OUT.html", conflicts_with = "shard")]
    pub(crate) output: Option<PathBuf>,
    /// Run only shard I of N of the parts of all cells, such as 0/8; re4-pipe merge compare makes the comparison afterwards
    #[arg(long, value_name = "I/N")]
    pub(crate) shard: Option<Shard>,
    /// With --shard: make only what the rollouts of several parts read, for a shard of the datasets
    #[arg(long, requires = "shard")]
    pub(crate) inputs: bool,
    /// Output of re4-pipe plan --json: use its hashes of the datasets' files unless these have changed
    #[arg(long, value_name = "PLAN.json")]
    pub(crate) plan: Option<PathBuf>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

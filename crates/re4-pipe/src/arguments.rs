//! The arguments of the command line.

mod addresses;
mod common;
mod curate;
mod export;
mod plan;
mod suite;

use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::Result;
use clap::{ArgAction, Args, Parser, Subcommand, ValueEnum};
use re4_artifact::{Shard, Stage};
use re4_fault::ensure;
use re4_stages::{Notes, Runner, Seeds, Settings, Share};

use crate::commands::plan::sources_of;

pub(crate) use self::curate::{AimArgument, ByArgument};
pub(crate) use self::export::{ExportArguments, ExportFormat};
pub(crate) use self::plan::{MergeArguments, PlanArguments, StatusArguments};
pub(crate) use self::suite::{CompareArguments, SelectedArguments};

/// From robot demonstrations to explainable imitation policies.
///
/// A pipeline file names a dataset and defines how it is ingested, segmented, indexed and rolled out. Each stage writes an
/// artifact: a folder with Parquet tables and a manifest, named after the hash of all inputs. A stage is skipped if its
/// artifact exists.
#[derive(Debug, Parser)]
#[command(name = "re4-pipe", version, max_term_width = 100, propagate_version = true)]
pub(crate) struct Arguments {
    /// Level of the log.
    #[arg(
        short,
        long,
        action = ArgAction::Count,
        global = true,
        display_order = 900,
        help = "Log to standard error; -vv logs more, and RUST_LOG sets the level of each crate"
    )]
    pub(crate) verbose: u8,
    /// The subcommand.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Subcommands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Read the raw dataset; writes the `episodes` artifact
    Ingest(StageArguments),
    /// Label the manipulation modes of the demonstrations; writes the `modes` and `audit` artifacts
    Segment(StageArguments),
    /// Measure the demonstrations, for the audit of more than 256; writes the `observations` artifact
    Observe(StageArguments),
    /// Check the demonstrations and their modes for errors; writes the `audit` artifact
    Audit(AuditArguments),
    /// robosuite: train the encoder that estimates poses from images; writes the `encoder` artifact
    TrainEncoder(StageArguments),
    /// Calibrate or train the pose estimator and estimate poses from images; writes the `poses` artifact
    TrainPose(StageArguments),
    /// Build the index from which the policy retrieves demonstrations; writes the `index` artifact
    Index(StageArguments),
    /// Train the network of a learned policy; writes the `policy` artifact
    Train(TrainArguments),
    /// Push-T: choose start scenes far from the demonstrations; writes the `scenes` artifact
    Scenes(StageArguments),
    /// Roll the policy out in the simulator; writes the `rollouts` artifact
    Rollout(RolloutArguments),
    /// Run the stages of a pipeline: up to the rollouts, or to the audit if it has no table `[rollout]`
    Run(RolloutArguments),
    /// Publish an artifact whose parts were made with --shard; exits with code 3 if parts are missing
    Merge(MergeArguments),
    /// List the commands that run a pipeline or a suite in parts, for a cluster, and what they need
    Plan(PlanArguments),
    /// Show which parts of a plan exist
    Status(StatusArguments),
    /// Compare policies over equal seeds: run the cells of a suite file; writes the `comparison` artifact and an HTML page
    Compare(CompareArguments),
    /// Compute what changes if each demonstration is left out, exactly; writes the `influence` artifact
    Influence(InfluenceArguments),
    /// Choose demonstrations: drop those that harm, judged on other scenes; writes the `curation` artifact
    Curate(CurateArguments),
    /// Replay the demonstrations' actions open-loop and measure the divergence; writes the `replays` artifact
    Replay(ReplayArguments),
    /// Render rollouts as a GIF video, with the plan and the coverage (Push-T) or the retrieved demonstrations (robosuite)
    #[command(alias = "film")]
    Video(VideoArguments),
    /// Verify every byte of artifacts against their manifests
    Verify(VerifyArguments),
    /// Print the contents of an artifact, or what a dataset is and what can be done with it
    Inspect(InspectArguments),
    /// Ask a question about any artifacts in SQL; prints a table, JSON or CSV, or writes Parquet
    #[cfg(feature = "query")]
    Query(QueryArguments),
    /// Write demonstrations or rollouts in the formats of other programs: LeRobot, robomimic, Push-T's zarr
    Export(ExportArguments),
    /// Write an HTML page about rollouts: scores, every seed, step budgets, and a viewer of every decision
    Report(ReportArguments),
    /// Download a dataset, or initial weights of an encoder, to the data folder
    Fetch(FetchArguments),
    /// Report what is installed and what is missing, with the command that installs it
    Doctor(DoctorArguments),
    /// Write JSON descriptions of all tables, and JSON Schemas of the pipeline file and the manifest
    Schemas(SchemasArguments),
    /// Write the reference pages: commands, pipeline file, tables
    #[command(hide = true)]
    Reference(ReferenceArguments),
    /// Read HDF5 files for another process of this program
    #[command(name = re4_stages::INGEST_WORKER, hide = true)]
    IngestWorker,
}

/// Options of all commands.
#[derive(Debug, Clone, Args)]
pub(crate) struct Common {
    /// Folder of the artifacts.
    #[arg(
        long,
        value_name = "DIR",
        default_value = "artifacts",
        help = "Folder of the artifacts, or the address of an object store: s3://, gs:// or az://BUCKET/FOLDER"
    )]
    pub(crate) artifacts: PathBuf,
    /// Number of worker threads; results do not depend on it [default: one per processor]
    #[arg(long, value_name = "N", value_parser = jobs)]
    pub(crate) jobs: Option<NonZeroUsize>,
    /// Print only one JSON object with the result on standard output
    #[arg(long)]
    pub(crate) json: bool,
    /// Print no notes and no progress bars
    #[arg(long, short)]
    pub(crate) quiet: bool,
}

/// Arguments of a stage.
#[derive(Debug, Clone, Args)]
pub(crate) struct StageArguments {
    /// Pipeline file
    #[arg(value_name = "PIPELINE.toml")]
    pub(crate) pipeline: PathBuf,
    /// Override a setting of the pipeline file; can be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Do not ingest images; same as --set ingest.images=false
    #[arg(long)]
    pub(crate) no_images: bool,
    /// Make only shard I of N of the parts of this stage's artifact, such as 0/8; re4-pipe merge publishes it afterwards
    #[arg(long, value_name = "I/N")]
    pub(crate) shard: Option<Shard>,
    /// Output of re4-pipe plan --json: use its hashes of the dataset's files unless these have changed
    #[arg(long, value_name = "PLAN.json")]
    pub(crate) plan: Option<PathBuf>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

impl StageArguments {
    /// Reads the pipeline and applies the overrides: first those of the command line, then `more_overrides`. For commands that are not
    /// made in parts.
    pub(crate) fn runner(&self, more_overrides: &[String]) -> Result<Runner> {
        ensure!(
            self.shard.is_none(),
            "--shard does not apply to this command";
            "give it to a command that runs one stage, such as ingest, segment, index or rollout"
        );
        self.runner_sharing(Share::Whole, more_overrides)
    }

    /// As [`Self::runner`], for a command that makes the artifact of `stage` or a shard of it.
    pub(crate) fn runner_of(&self, stage: Stage, more_overrides: &[String]) -> Result<Runner> {
        let share = self.shard.map_or(Share::Whole, |shard| Share::Parts(stage, shard));
        self.runner_sharing(share, more_overrides)
    }

    /// As [`Self::runner`], with a given shard.
    pub(crate) fn runner_sharing(&self, share: Share, more_overrides: &[String]) -> Result<Runner> {
        let mut overrides = self.set.clone();
        if self.no_images {
            overrides.push("ingest.images=false".to_owned());
        }
        overrides.extend_from_slice(more_overrides);
        let hashes = self.plan.as_deref().map(sources_of).transpose()?.unwrap_or_default();
        Runner::new(&Settings {
            pipeline: &self.pipeline,
            overrides,
            artifacts: &self.common.artifacts,
            jobs: self.common.jobs,
            notes: Notes::new(self.common.quiet),
            share,
            hashes: &hashes,
        })
    }
}

/// Arguments of `train`.
#[derive(Debug, Clone, Args)]
pub(crate) struct TrainArguments {
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// The policy to train; shorthand for --set policy.kind=NAME
    #[arg(long, value_name = "NAME")]
    pub(crate) policy: Option<String>,
}

/// Arguments of `audit`.
#[derive(Debug, Clone, Args)]
pub(crate) struct AuditArguments {
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Exit with code 1 if there is a finding of this severity or a higher one
    #[arg(long, value_name = "SEVERITY")]
    pub(crate) fail_on: Option<FailOn>,
    /// Also write an HTML page about the audit
    #[arg(long, value_name = "OUT.html")]
    pub(crate) html: Option<PathBuf>,
}

/// Minimum severity of a finding that fails the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FailOn {
    /// Only errors.
    Error,
    /// Errors and warnings.
    Warning,
}

/// Settings of rollouts that several commands have.
#[derive(Debug, Clone, Args)]
pub(crate) struct RolledArguments {
    /// Seeds of the scenes, such as 500..600 (600 is excluded) or 3,7; same as --set rollout.seeds=...
    #[arg(long, value_name = "SEEDS")]
    pub(crate) seeds: Option<String>,
    /// Kind of policy: re4, paper, re2, ...; same as --set policy.kind=...
    #[arg(long, value_name = "NAME")]
    pub(crate) policy: Option<String>,
    /// Maximum length of an episode in control steps.
    #[arg(
        long,
        value_name = "N",
        help = "Maximum length of an episode in control steps; same as --set rollout.max_steps=..."
    )]
    pub(crate) max_steps: Option<u32>,
}

impl RolledArguments {
    /// Reads the pipeline and applies the overrides.
    pub(crate) fn runner(&self, stage: &StageArguments) -> Result<Runner> {
        stage.runner(&self.overrides())
    }

    /// As [`Self::runner`], for a command that makes the artifact of `stage` or a shard of it.
    pub(crate) fn runner_of(&self, of: Stage, stage: &StageArguments) -> Result<Runner> {
        stage.runner_of(of, &self.overrides())
    }

    /// The overrides that the options stand for.
    pub(crate) fn overrides(&self) -> Vec<String> {
        // A value of an override as a string, whatever it looks like.
        let text = |value: &str| format!("\"{}\"", value.replace(['"', '\\'], ""));
        let seeds = self
            .seeds
            .as_deref()
            .map(|seeds| format!("rollout.seeds={}", text(seeds)));
        let kind = self.policy.as_deref().map(kind_override);
        let steps = self.max_steps.map(|steps| format!("rollout.max_steps={steps}"));
        [seeds, kind, steps].into_iter().flatten().collect()
    }
}

/// The override that `--policy` stands for.
pub(crate) fn kind_override(policy: &str) -> String {
    format!("policy.kind=\"{}\"", policy.replace(['"', '\\'], ""))
}

/// Arguments of `influence`.
#[derive(Debug, Clone, Args)]
pub(crate) struct InfluenceArguments {
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Settings of rollouts.
    #[command(flatten)]
    pub(crate) rolled: RolledArguments,
    /// Also judge each demonstration on N scenes that start from its own first state, perturbed
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub(crate) starts: u32,
    /// Roll out all scenes without each of N demonstrations and compare; exit with code 1 if an episode differs
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) check: usize,
    /// Also write an HTML page about the influence
    #[arg(long, value_name = "OUT.html")]
    pub(crate) html: Option<PathBuf>,
}

/// Arguments of `curate`.
#[derive(Debug, Clone, Args)]
pub(crate) struct CurateArguments {
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Settings of the rollouts that the choice is made on.
    #[command(flatten)]
    pub(crate) rolled: RolledArguments,
    /// What demonstrations are ranked by
    #[arg(long, value_enum, default_value_t = ByArgument::Combined)]
    pub(crate) by: ByArgument,
    /// What the choice aims at
    #[arg(long, value_enum, default_value_t = AimArgument::Harmful)]
    pub(crate) aim: AimArgument,
    /// Also choose on N scenes per demonstration that start from its own first state, perturbed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub(crate) starts: u32,
    /// Seeds to judge the choice on, other than those of the rollouts it is made on
    #[arg(long, value_name = "SEEDS")]
    pub(crate) judge: Option<Seeds>,
    /// Number of random sets of the same size that are judged, too
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=100))]
    pub(crate) random: u32,
    /// Also compute the learning curve: the best demonstrations, and as many random ones
    #[arg(long)]
    pub(crate) curve: bool,
    /// Also write the names of the kept demonstrations, one per line
    #[arg(long, value_name = "OUT.txt")]
    pub(crate) keep_list: Option<PathBuf>,
    /// Also write the choice as a setting for the pipeline file
    #[arg(long, value_name = "OUT.toml")]
    pub(crate) setting: Option<PathBuf>,
    /// HDF5 files: also write a copy of the dataset with the choice as a filter key; the copy must not exist
    #[arg(long, value_name = "OUT.hdf5")]
    pub(crate) mask: Option<PathBuf>,
    /// Name of the filter key below /mask
    #[arg(long, value_name = "NAME", default_value = "curated", requires = "mask")]
    pub(crate) filter_key: String,
    /// Also write an HTML page about the choice
    #[arg(long, value_name = "OUT.html")]
    pub(crate) html: Option<PathBuf>,
}

/// Arguments of `rollout` and `run`.
#[derive(Debug, Clone, Args)]
pub(crate) struct RolloutArguments {
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Settings of rollouts.
    #[command(flatten)]
    pub(crate) rolled: RolledArguments,
    /// Also write an HTML page about the rollouts, as re4-pipe report does
    #[arg(long, value_name = "OUT.html")]
    pub(crate) report: Option<PathBuf>,
    /// Push-T: also write the rollouts as a dataset in Push-T's zarr format; the folder must not exist
    #[arg(long, value_name = "OUT.zarr")]
    pub(crate) record: Option<PathBuf>,
}

/// Arguments of `replay`.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReplayArguments {
    /// Arguments of all stages.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Push-T: also plot the divergence as an SVG image
    #[arg(long, value_name = "OUT.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// robosuite tasks: exit with code 1 if the success rate of the replays is below this fraction, from 0 to 1
    #[arg(long = "fail-under", value_name = "FRACTION", value_parser = fraction)]
    pub(crate) minimum: Option<f64>,
}

/// Arguments of `video`.
#[derive(Debug, Clone, Args)]
pub(crate) struct VideoArguments {
    /// Folder of a `rollouts` artifact
    #[arg(value_name = "ARTIFACT")]
    pub(crate) path: PathBuf,
    /// GIF file to write
    #[arg(value_name = "OUT.gif")]
    pub(crate) out: PathBuf,
    /// Seeds of the rollouts, shown side by side, such as 503 or 500..504 (504 is excluded)
    #[arg(long, value_name = "SEEDS", visible_alias = "seed")]
    pub(crate) seeds: Seeds,
    /// Width and height of a scene in pixels, from 64 to 512; text is shown below scenes of at least 256 pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 256)]
    pub(crate) size: u32,
    /// Speed, from 0.1 to 50; 1 is real time: 10 control steps per second for Push-T, 20 for robosuite tasks
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub(crate) speed: f64,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `verify`.
#[derive(Debug, Clone, Args)]
pub(crate) struct VerifyArguments {
    /// Folders of artifacts [default: every artifact in the artifacts folder]
    #[arg(value_name = "ARTIFACT")]
    pub(crate) paths: Vec<PathBuf>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `inspect`.
#[derive(Debug, Clone, Args)]
pub(crate) struct InspectArguments {
    /// Folder of an artifact, or a dataset
    #[arg(value_name = "PATH")]
    pub(crate) path: PathBuf,
    /// Also print the first N rows of every table
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) rows: usize,
    /// Push-T: also render the rollout of this seed as an SVG image
    #[arg(long, value_name = "SEED", requires = "image")]
    pub(crate) seed: Option<u32>,
    /// SVG file to write
    #[arg(long, value_name = "OUT.svg", requires = "seed", alias = "picture")]
    pub(crate) image: Option<PathBuf>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `query`.
#[cfg(feature = "query")]
#[derive(Debug, Clone, Args)]
pub(crate) struct QueryArguments {
    /// SELECT statement over the tables of the artifacts, such as "select seed, success from results"
    #[arg(value_name = "SQL")]
    pub(crate) sql: String,
    /// Folders of artifacts, folders that contain such folders, or patterns in quotes such as 'artifacts/rollouts/*' [default: the
    /// artifacts folder]
    #[arg(value_name = "ARTIFACT")]
    pub(crate) paths: Vec<PathBuf>,
    /// Maximum number of rows to print as a table
    #[arg(long, value_name = "N", default_value_t = 50, conflicts_with_all = ["csv", "parquet", "json"])]
    pub(crate) rows: usize,
    /// Print all rows as CSV
    #[arg(long, conflicts_with_all = ["parquet", "json"])]
    pub(crate) csv: bool,
    /// Write all rows to a Parquet file instead of printing them
    #[arg(long, value_name = "OUT.parquet")]
    pub(crate) parquet: Option<PathBuf>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `report`.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReportArguments {
    /// Folders of `rollouts` artifacts, in the order in which the page shows them; or the folder of one `poses` artifact, to show
    /// the training of its encoder; or the folder of one `comparison` artifact
    #[arg(value_name = "ARTIFACT", required = true)]
    pub(crate) paths: Vec<PathBuf>,
    /// HTML file to write
    #[arg(long, short, value_name = "OUT.html", default_value = "report.html")]
    pub(crate) output: PathBuf,
    /// Seeds of the rollouts in the viewer, to keep the page small; the scores cover all rollouts [default: all]
    #[arg(long, value_name = "SEEDS")]
    pub(crate) seeds: Option<String>,
    /// robosuite tasks: number of rollouts in the viewer, failures first, with camera images of their decisions.
    #[arg(
        long,
        value_name = "N",
        alias = "pictures",
        help = "robosuite tasks: number of rollouts in the viewer, failures first, with camera images of their decisions, rendered by MuJoCo [default: 8 if poses are estimated from images, else 0]"
    )]
    pub(crate) images: Option<usize>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `fetch`.
#[derive(Debug, Clone, Args)]
pub(crate) struct FetchArguments {
    /// Name of the dataset or weights in data/datasets.toml
    #[arg(value_name = "DATASET")]
    pub(crate) dataset: String,
    /// Folder to download to.
    #[arg(
        long,
        value_name = "DIR",
        help = "Folder to download to [default: the folder that RE4_DATA names, else data]"
    )]
    pub(crate) destination: Option<PathBuf>,
    /// URL to download from instead of the one in data/datasets.toml
    #[arg(long, value_name = "URL")]
    pub(crate) url: Option<String>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `doctor`.
#[derive(Debug, Clone, Args)]
pub(crate) struct DoctorArguments {
    /// Pipeline file whose requirements are also checked; exit with code 1 if one is missing
    #[arg(value_name = "PIPELINE.toml")]
    pub(crate) pipeline: Option<PathBuf>,
    /// Override a setting of the pipeline file; can be repeated
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE", requires = "pipeline")]
    pub(crate) set: Vec<String>,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `schemas`.
#[derive(Debug, Clone, Args)]
pub(crate) struct SchemasArguments {
    /// Folder to write to
    #[arg(value_name = "DIR", default_value = "schemas")]
    pub(crate) folder: PathBuf,
    /// Write nothing; exit with code 1 if the folder is not up to date
    #[arg(long)]
    pub(crate) check: bool,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `reference`.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReferenceArguments {
    /// Folder to write to
    #[arg(value_name = "DIR", default_value = "docs/reference")]
    pub(crate) folder: PathBuf,
    /// Write nothing; exit with code 1 if the folder is not up to date
    #[arg(long)]
    pub(crate) check: bool,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Maximum of `--jobs`. More threads only need more memory.
const MAX_JOBS: usize = 1024;

fn jobs(text: &str) -> Result<NonZeroUsize, String> {
    text.parse()
        .ok()
        .filter(|jobs: &NonZeroUsize| jobs.get() <= MAX_JOBS)
        .ok_or_else(|| format!("give a whole number from 1 to {MAX_JOBS}"))
}

fn fraction(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|fraction| (0.0..=1.0).contains(fraction))
        .ok_or_else(|| "give a number from 0 to 1".to_owned())
}

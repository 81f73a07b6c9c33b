//! The command line.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::Result;
use clap::{ArgAction, Args, Parser, Subcommand, ValueEnum};
use re4_stages::{Notes, Runner, Seeds, Settings};

/// Staged batch jobs from robot demonstrations to explainable imitation policies.
///
/// A pipeline file names a dataset and how it is ingested, segmented, indexed and rolled out. Each stage leaves an
/// artifact: Parquet tables and a manifest, addressed by the hash of everything that went in. A stage whose artifact is
/// there is skipped.
#[derive(Debug, Parser)]
#[command(name = "re4-pipe", version, max_term_width = 100, propagate_version = true)]
pub(crate) struct Arguments {
    /// How much is logged.
    #[arg(
        short,
        long,
        action = ArgAction::Count,
        global = true,
        display_order = 900,
        help = "Log what is done on standard error; -vv logs more, RUST_LOG by crate"
    )]
    pub(crate) verbose: u8,
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Subcommands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Read the raw dataset into the `episodes` artifact
    Ingest(StageArguments),
    /// Label manipulation modes: the `modes` artifact
    Segment(StageArguments),
    /// Look for what is wrong with the demonstrations and their modes: the `audit` artifact
    Audit(AuditArguments),
    /// Calibrate the pose estimator and estimate poses from the images: the `poses` artifact
    TrainPose(StageArguments),
    /// Build what Retrieve searches: the `index` artifact
    Index(StageArguments),
    /// Choose scenes far from the demonstrations for the rollouts to start from: the `scenes` artifact
    Scenes(StageArguments),
    /// Roll the policy out in the simulator: the `rollouts` artifact
    Rollout(RolloutArguments),
    /// Run every stage of a pipeline
    Run(RolloutArguments),
    /// Replay the demonstrations' actions open-loop and measure how far the simulator strays from the recording
    Replay(ReplayArguments),
    /// Draw rollouts as a video: the scene, the plan, the reframed chunk, the coverage
    #[command(alias = "film")]
    Video(VideoArguments),
    /// Check every byte of artifacts against their manifests
    Verify(VerifyArguments),
    /// Show what an artifact holds: tables, rows, columns with units, provenance
    Inspect(InspectArguments),
    /// Write one HTML page over rollouts: scores, every seed, step budgets, and a viewer of each decision
    Report(ReportArguments),
    /// Download a dataset, or weights to start an encoder from, into the data folder
    Fetch(FetchArguments),
    /// Say what is installed, found and missing, with the command that gets it
    Doctor(DoctorArguments),
    /// Write the JSON descriptions of all tables, of the pipeline file and of the manifest
    Schemas(SchemasArguments),
    /// Write the pages of the reference: commands, pipeline file, tables
    #[command(hide = true)]
    Reference(ReferenceArguments),
    /// Read HDF5 for another process of this program
    #[command(name = re4_stages::INGEST_WORKER, hide = true)]
    IngestWorker,
}

impl Command {
    /// What all commands share, but for the one that people do not use.
    pub(crate) fn common(&self) -> Option<&Common> {
        match self {
            Self::Ingest(stage)
            | Self::Segment(stage)
            | Self::TrainPose(stage)
            | Self::Index(stage)
            | Self::Scenes(stage)
            | Self::Audit(AuditArguments { stage, .. })
            | Self::Replay(ReplayArguments { stage, .. }) => Some(&stage.common),
            Self::Rollout(rollout) | Self::Run(rollout) => Some(&rollout.stage.common),
            Self::Video(VideoArguments { common, .. })
            | Self::Verify(VerifyArguments { common, .. })
            | Self::Inspect(InspectArguments { common, .. })
            | Self::Report(ReportArguments { common, .. })
            | Self::Fetch(FetchArguments { common, .. })
            | Self::Doctor(DoctorArguments { common, .. })
            | Self::Schemas(SchemasArguments { common, .. })
            | Self::Reference(ReferenceArguments { common, .. }) => Some(common),
            Self::IngestWorker => None,
        }
    }
}

/// What all commands share.
#[derive(Debug, Clone, Args)]
pub(crate) struct Common {
    /// Folder that holds the artifacts
    #[arg(long, value_name = "DIR", default_value = "artifacts")]
    pub(crate) artifacts: PathBuf,
    /// Worker threads; results do not depend on it [default: all processors]
    #[arg(long, value_name = "N", value_parser = jobs)]
    pub(crate) jobs: Option<NonZeroUsize>,
    /// Print one JSON object on standard output, and nothing else
    #[arg(long)]
    pub(crate) json: bool,
    /// Print neither progress nor notes
    #[arg(long, short)]
    pub(crate) quiet: bool,
}

/// Arguments of a stage.
#[derive(Debug, Clone, Args)]
pub(crate) struct StageArguments {
    /// Pipeline file
    #[arg(value_name = "PIPELINE.toml")]
    pub(crate) pipeline: PathBuf,
    /// Override a setting of the pipeline file, as often as needed
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Leave the images out, for work on states; as --set ingest.images=false
    #[arg(long)]
    pub(crate) no_images: bool,
    /// What all commands share.
    #[command(flatten)]
    pub(crate) common: Common,
}

impl StageArguments {
    /// The pipeline with its overrides, those of the command line first.
    pub(crate) fn runner(&self, more_overrides: &[String]) -> Result<Runner> {
        let mut overrides = self.set.clone();
        if self.no_images {
            overrides.push("ingest.images=false".to_owned());
        }
        overrides.extend_from_slice(more_overrides);
        Runner::new(&Settings {
            pipeline: &self.pipeline,
            overrides,
            artifacts: &self.common.artifacts,
            jobs: self.common.jobs,
            notes: Notes::new(self.common.quiet),
        })
    }
}

/// Arguments of `audit`.
#[derive(Debug, Clone, Args)]
pub(crate) struct AuditArguments {
    /// What all stages share.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// End with exit code 1 when there is a finding of this severity or worse
    #[arg(long, value_name = "SEVERITY")]
    pub(crate) fail_on: Option<FailOn>,
    /// Also write the HTML page of the audit
    #[arg(long, value_name = "OUT.html")]
    pub(crate) html: Option<PathBuf>,
}

/// From which severity on a finding fails the command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FailOn {
    /// Errors alone.
    Error,
    /// Errors and warnings.
    Warning,
}

/// Arguments of `rollout` and `run`.
#[derive(Debug, Clone, Args)]
pub(crate) struct RolloutArguments {
    /// What all stages share.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Seeds of the scenes, half-open: 500..600; as --set rollout.seeds=...
    #[arg(long, value_name = "SEEDS")]
    pub(crate) seeds: Option<String>,
    /// Kind of the policy: re4, paper, re2, ...; as --set policy.kind=...
    #[arg(long, value_name = "NAME")]
    pub(crate) policy: Option<String>,
    /// Control steps an episode lasts at most.
    #[arg(
        long,
        value_name = "N",
        help = "Control steps an episode lasts at most; as --set rollout.max_steps=..."
    )]
    pub(crate) max_steps: Option<u32>,
    /// Also write the HTML page of the rollouts, as re4-pipe report does
    #[arg(long, value_name = "OUT.html")]
    pub(crate) report: Option<PathBuf>,
    /// Push-T: also write the rollouts as a dataset in its own zarr format, to a folder that does not exist yet
    #[arg(long, value_name = "OUT.zarr")]
    pub(crate) record: Option<PathBuf>,
}

/// Arguments of `replay`.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReplayArguments {
    /// What all stages share.
    #[command(flatten)]
    pub(crate) stage: StageArguments,
    /// Also draw the divergence as an SVG image
    #[arg(long, value_name = "OUT.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// robosuite tasks: end with exit code 1 when a smaller fraction of the replays than this succeeds, from 0 to 1
    #[arg(long = "fail-under", value_name = "FRACTION", value_parser = fraction)]
    pub(crate) minimum: Option<f64>,
}

/// Arguments of `video`.
#[derive(Debug, Clone, Args)]
pub(crate) struct VideoArguments {
    /// Folder of a rollouts artifact
    #[arg(value_name = "ARTIFACT")]
    pub(crate) path: PathBuf,
    /// File that the video is written to
    #[arg(value_name = "OUT.gif")]
    pub(crate) out: PathBuf,
    /// Seeds of the rollouts: 503, or several side by side: 500..504
    #[arg(long, value_name = "SEEDS", visible_alias = "seed")]
    pub(crate) seeds: Seeds,
    /// Width and height of a scene in pixels, from 64 to 512; text is below it from 256 on
    #[arg(long, value_name = "PIXELS", default_value_t = 256)]
    pub(crate) size: u32,
    /// Speed, from 0.1 to 50; at 1, a second holds as many control steps as in the simulator: 10 of Push-T, 20 of robosuite's tasks
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub(crate) speed: f64,
    /// What all commands share.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `verify`.
#[derive(Debug, Clone, Args)]
pub(crate) struct VerifyArguments {
    /// Artifact folders [default: every artifact in the artifacts folder]
    #[arg(value_name = "ARTIFACT")]
    pub(crate) paths: Vec<PathBuf>,
    /// What all commands share.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `inspect`.
#[derive(Debug, Clone, Args)]
pub(crate) struct InspectArguments {
    /// Artifact folder
    #[arg(value_name = "ARTIFACT")]
    pub(crate) path: PathBuf,
    /// Also print the first rows of every table
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) rows: usize,
    /// Push-T: also draw the rollout of this seed as an SVG image
    #[arg(long, value_name = "SEED", requires = "image")]
    pub(crate) seed: Option<u32>,
    /// File that the image is written to
    #[arg(long, value_name = "OUT.svg", requires = "seed", alias = "picture")]
    pub(crate) image: Option<PathBuf>,
    /// What all commands share.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `report`.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReportArguments {
    /// Folders of rollouts artifacts, in the order in which the page shows them
    #[arg(value_name = "ARTIFACT", required = true)]
    pub(crate) paths: Vec<PathBuf>,
    /// File that the page is written to
    #[arg(long, short, value_name = "OUT.html", default_value = "report.html")]
    pub(crate) output: PathBuf,
    /// Rollouts that the viewer holds, to keep the page small; all count in the figures [default: all]
    #[arg(long, value_name = "SEEDS")]
    pub(crate) seeds: Option<String>,
    /// Rollouts in the viewer, failures first, whose decisions are shown in the camera's image, drawn by MuJoCo
    #[arg(
        long,
        value_name = "N",
        alias = "pictures",
        help = "Rollouts in the viewer, failures first, whose decisions are shown in the camera's image, drawn by MuJoCo [default: 8 where poses come from images, else none]"
    )]
    pub(crate) images: Option<usize>,
    /// What all commands share.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `fetch`.
#[derive(Debug, Clone, Args)]
pub(crate) struct FetchArguments {
    /// Dataset or weights, as data/datasets.toml names them
    #[arg(value_name = "DATASET")]
    pub(crate) dataset: String,
    /// Folder to put it into.
    #[arg(
        long,
        value_name = "DIR",
        help = "Folder to put it into [default: the folder in RE4_DATA, else data]"
    )]
    pub(crate) destination: Option<PathBuf>,
    /// Address to download from in place of the official one
    #[arg(long, value_name = "URL")]
    pub(crate) url: Option<String>,
    /// What all commands share.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `doctor`.
#[derive(Debug, Clone, Args)]
pub(crate) struct DoctorArguments {
    /// Pipeline file whose needs are checked, too: exit code 1 if one of them is not met
    #[arg(value_name = "PIPELINE.toml")]
    pub(crate) pipeline: Option<PathBuf>,
    /// Override a setting of the pipeline file, as often as needed
    #[arg(long = "set", value_name = "STAGE.KEY=VALUE", requires = "pipeline")]
    pub(crate) set: Vec<String>,
    /// Arguments of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `schemas`.
#[derive(Debug, Clone, Args)]
pub(crate) struct SchemasArguments {
    /// Folder to write to
    #[arg(value_name = "DIR", default_value = "schemas")]
    pub(crate) folder: PathBuf,
    /// Write nothing; fail (exit code 1) when the folder is not up to date
    #[arg(long)]
    pub(crate) check: bool,
    /// What all commands share.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// Arguments of `reference`.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReferenceArguments {
    /// Folder to write to
    #[arg(value_name = "DIR", default_value = "docs/reference")]
    pub(crate) folder: PathBuf,
    /// Write nothing; fail (exit code 1) when the folder is not up to date
    #[arg(long)]
    pub(crate) check: bool,
    /// Arguments of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

/// More threads would only cost memory.
const MOST_JOBS: usize = 1024;

fn jobs(text: &str) -> Result<NonZeroUsize, String> {
    text.parse()
        .ok()
        .filter(|jobs: &NonZeroUsize| jobs.get() <= MOST_JOBS)
        .ok_or_else(|| format!("give a whole number from 1 to {MOST_JOBS}"))
}

fn fraction(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|fraction| (0.0..=1.0).contains(fraction))
        .ok_or_else(|| "give a number from 0 to 1".to_owned())
}

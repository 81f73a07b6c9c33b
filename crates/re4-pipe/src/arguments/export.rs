//! The arguments of `export`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use re4_export::{Format, Images};

use super::Common;

/// Arguments of `export`.
#[derive(Debug, Clone, Args)]
pub(crate) struct ExportArguments {
    /// Folder of an `episodes` or `rollouts` artifact
    #[arg(value_name = "ARTIFACT")]
    pub(crate) artifact: PathBuf,
    /// Folder or file to write; it must not exist
    #[arg(value_name = "OUT")]
    pub(crate) out: PathBuf,
    /// Format of the output
    #[arg(long, value_enum, value_name = "FORMAT", default_value_t = ExportFormat::Lerobot)]
    pub(crate) format: ExportFormat,
    /// Export only these demonstrations: a keep-list with one name per line, or the folder of a `curation` artifact
    #[arg(long, value_name = "KEEP")]
    pub(crate) keep: Option<PathBuf>,
    /// Rollouts: export only those that succeeded
    #[arg(long)]
    pub(crate) successes: bool,
    /// Add the mode of every frame from this `modes` artifact of the same demonstrations
    #[arg(long, value_name = "ARTIFACT")]
    pub(crate) modes: Option<PathBuf>,
    /// Add the estimated object poses from this `poses` artifact of the same demonstrations
    #[arg(long, value_name = "ARTIFACT")]
    pub(crate) poses: Option<PathBuf>,
    /// The task in words [default: a sentence about the task]
    #[arg(long, value_name = "TEXT")]
    pub(crate) task: Option<String>,
    /// LeRobot: write states and actions in double precision
    #[arg(long)]
    pub(crate) float64: bool,
    /// LeRobot: encode images as videos, with loss, in place of PNG files
    #[arg(long, value_enum, value_name = "CODEC")]
    pub(crate) video: Option<VideoCodec>,
    /// Write no images
    #[arg(long, conflicts_with = "video")]
    pub(crate) no_images: bool,
    /// Options of all commands.
    #[command(flatten)]
    pub(crate) common: Common,
}

impl ExportArguments {
    /// How images are written.
    pub(crate) fn images(&self) -> Images {
        match self.video {
            Some(VideoCodec::H264) => Images::H264,
            None if self.no_images => Images::None,
            None => Images::Png,
        }
    }
}

/// Formats of `export`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExportFormat {
    /// LeRobot v3.0, a folder.
    Lerobot,
    /// LeRobot v2.1, a folder.
    #[value(name = "lerobot-v2.1")]
    LerobotV21,
    /// robomimic's HDF5 file, for robosuite tasks.
    Robomimic,
    /// Push-T's zarr store, a folder without images.
    PushtZarr,
}

impl ExportFormat {
    pub(crate) fn format(self) -> Format {
        match self {
            Self::Lerobot => Format::Lerobot,
            Self::LerobotV21 => Format::LerobotV2,
            Self::Robomimic => Format::Robomimic,
            Self::PushtZarr => Format::PushtZarr,
        }
    }
}

/// Codecs of videos.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum VideoCodec {
    /// H.264.
    H264,
}

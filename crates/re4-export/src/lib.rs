//! Writes demonstrations and rollouts in the formats of other programs: `LeRobot` datasets, robomimic's HDF5 files, and Push-T's
//! zarr store.
//!
//! [`export`] reads an `episodes` or `rollouts` artifact one episode at a time. The output is written to a temporary sibling and
//! renamed, so that it is complete or absent. The same artifacts and options give the same bytes.

mod formats;
mod images;
mod inputs;
mod plane;
mod space;
mod take;

use std::path::Path;

use anyhow::Result;
pub use re4_lerobot::write::Limits;

use self::inputs::Inputs;
pub use self::take::Take;

/// Formats of the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// `LeRobot` v3.0, a folder.
    Lerobot,
    /// `LeRobot` v2.1, a folder.
    LerobotV2,
    /// robomimic's HDF5 file.
    Robomimic,
    /// Push-T's zarr store, a folder.
    PushtZarr,
}

impl Format {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lerobot => "lerobot",
            Self::LerobotV2 => "lerobot-v2.1",
            Self::Robomimic => "robomimic",
            Self::PushtZarr => "pusht-zarr",
        }
    }
}

/// How images are written to a `LeRobot` dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Images {
    /// As PNG files in the tables, without loss.
    #[default]
    Png,
    /// As videos in H.264, with loss.
    H264,
    /// Not at all.
    None,
}

/// What to export.
#[derive(Debug, Clone)]
pub struct Request<'a> {
    /// Folder of the artifact, `episodes` or `rollouts`.
    pub artifact: &'a Path,
    /// The format.
    pub format: Format,
    /// The path to write to. It must not exist, or be an empty folder.
    pub out: &'a Path,
    /// A keep-list (a text file with one name of a demonstration per line) or the folder of a `curation` artifact.
    pub keep: Option<&'a Path>,
    /// Folder of a `modes` artifact of the same demonstrations.
    pub modes: Option<&'a Path>,
    /// Folder of a `poses` artifact of the same demonstrations.
    pub poses: Option<&'a Path>,
    /// The task in words; `None` for that of the task's record.
    pub task: Option<&'a str>,
    /// Whether only rollouts that succeeded are exported.
    pub successes: bool,
    /// Whether states and actions are written in double precision.
    pub double: bool,
    /// How images are written.
    pub images: Images,
    /// Version of the program, written to the dataset.
    pub program: &'a str,
    /// When the next file of a `LeRobot` dataset begins.
    pub limits: Limits,
}

/// Calls of the export to its caller.
#[derive(Clone, Copy)]
pub struct Hooks<'a> {
    /// Whether to stop, asked after every episode.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called with the number of episodes before the first one, and then after each episode with the number that are done.
    pub progress: &'a dyn Fn(usize, usize),
}

/// What was exported.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exported {
    /// Number of episodes.
    pub episodes: usize,
    /// Number of frames.
    pub frames: usize,
    /// Size of the output in bytes.
    pub bytes: u64,
    /// Names of the features, of the datasets below a demonstration, or of the arrays.
    pub features: Vec<String>,
    /// What the user should know about the output, one sentence each.
    pub notes: Vec<String>,
}

/// Exports an artifact.
///
/// # Errors
/// An artifact is damaged, of another kind, or not of the same demonstrations; the format does not fit the task; a name in the
/// keep-list is unknown; a value cannot be represented; the output exists or cannot be written.
pub fn export(request: &Request<'_>, hooks: Hooks<'_>) -> Result<Exported> {
    let inputs = Inputs::open(request)?;
    match request.format {
        Format::Lerobot | Format::LerobotV2 => formats::lerobot::write(&inputs, request, hooks),
        Format::Robomimic => formats::robomimic::write(&inputs, request, hooks),
        Format::PushtZarr => formats::zarr::write(&inputs, request, hooks),
    }
}

//! The Push-T replay dataset: a Zarr store of format 2 or 3 with `data/state`, `data/action`, `meta/episode_ends`, and optionally
//! `data/n_contacts`, `data/keypoint` and `data/img`.
//!
//! Layout, units and ranges follow `pusht_cchi_v7_replay.zarr` of Diffusion Policy (Chi et al., 2023): positions in
//! pixels of a 512 x 512 window with y down, angles in radians from 0 to 2π, one row per frame at 10 Hz. Row `t` contains the
//! state at `t` and the action taken there. `meta/episode_ends` contains exclusive, cumulative ends.

mod conventions;
mod describe;
mod episodes;
mod follow;
pub(crate) mod from_lerobot;
mod images;
mod judge;
mod keypoints;
mod reader;
mod reward;
mod settle;
mod source;
mod validate;
mod writer;

pub use crate::tables::KEYPOINTS;
pub use conventions::{ActionKind, AngleUnit, PushtConventions};
pub use describe::describe;
pub use episodes::{PushtEpisodes, Recorded};
pub use images::{IMAGE_BUDGET, ImageBlock, ImageBlocks};
pub use reader::{PushtOptions, PushtReader, PushtReading};
pub use source::PushtSource;
pub use validate::{ANGLE_TOLERANCE, POSITION_HIGH, POSITION_LOW, SHORT_EPISODE, WINDOW};
pub use writer::{KEYPOINTS_IN_BLOCK, PushtWriter, RecordError, RecordedEpisode};

//! `GetPose`: object poses from images.
//!
//! Push-T's estimator has a closed form and learns nothing (paper, appendix "Push-T", Pose Estimation): the block is found
//! by its colour, its largest connected region gives the position by its centroid and a fixed pixel-to-world affine, and
//! the log-polar transform of the region gives the angle by a cross-correlation with one anchor. The block's outline is then
//! aligned with the image. Every estimate says how far it is to be trusted.
//!
//! Poses in space come from a learned encoder, which is elsewhere; how good they are is measured in [`spatial`].

mod anchor;
mod component;
mod estimator;
mod image;
mod log_polar;
mod outline;
mod refine;
mod smooth;
pub mod spatial;
mod tables;

pub use anchor::{Anchor, AnchorBuilder, AnchorError};
pub use estimator::{Estimate, Flag, LogPolarEstimator};
pub use image::{ImageError, PushtImage, SIDE};
pub use outline::Outline;
pub use smooth::{between_clear, by_mode};
pub use tables::{AnchorRow, PoseErrorRow, PoseRow, SpatialEstimate, TrainingRow};

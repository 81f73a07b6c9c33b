//! `GetPose`: object poses from images.
//!
//! Push-T's estimator has a closed form and is not trained (paper, appendix "Push-T", Pose Estimation). It segments the block
//! by colour. The centroid of the largest connected component and a fixed pixel-to-world affine give the position. The log-polar
//! transform of the component gives the angle by cross-correlation with one anchor image (log-polar registration). The estimator
//! then aligns the block's outline with the image. Every estimate has a confidence and a flag.
//!
//! SE(3) poses come from a learned encoder, which is another crate; [`spatial`] evaluates them.

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
pub use image::{ImageError, PushtImage, SIDE, Storage};
pub use outline::Outline;
pub use smooth::{between_clear, by_mode};
pub use tables::{AnchorRow, LabelRow, PoseErrorRow, PoseRow, SpatialEstimate, TrainingRow};

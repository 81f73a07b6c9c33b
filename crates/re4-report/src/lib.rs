//! Statistics, tables and pictures.

mod picture;
mod statistics;

pub use picture::{PictureDecision, PictureError, RolloutPicture, divergence_plot, rollout_picture};
pub use statistics::{Interval, RESAMPLES, mean, mean_interval, median, quantile, wilson_interval};

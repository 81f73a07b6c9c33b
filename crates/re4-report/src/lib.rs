//! Statistics, pictures, and the page to look at rollouts with.

mod budget;
pub mod html;
mod picture;
mod statistics;

pub use budget::{budgets, running_maxima};
pub use picture::{PictureDecision, PictureError, RolloutPicture, divergence_plot, rollout_picture};
pub use statistics::{Interval, RESAMPLES, mean, mean_interval, median, quantile, wilson_interval};

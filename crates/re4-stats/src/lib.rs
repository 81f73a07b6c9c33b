//! Statistics of results: quantiles, confidence intervals, step budgets. No other crate implements them.
//!
//! The same values in the same order give the same bits on every machine. Values are summed in the order of the input.

mod budget;
mod durations;
mod intervals;
mod paired;
mod quantiles;

pub use budget::{budgets, running_maxima};
pub use durations::Durations;
pub use intervals::{Interval, RESAMPLES, mean, mean_interval, wilson_interval};
pub use paired::{SignTest, paired_interval, sign_test};
pub use quantiles::{median, nearest_rank, outer_fence, quantile, robust_deviation, sorted, spread, upper_median};

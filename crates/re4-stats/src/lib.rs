//! Statistics of results, each implemented once: quantiles, intervals, step budgets.
//!
//! The same values in the same order give the same bits on every machine. Sums go in the order of their input.

mod budget;
mod intervals;
mod quantiles;

pub use budget::{budgets, running_maxima};
pub use intervals::{Interval, RESAMPLES, mean, mean_interval, wilson_interval};
pub use quantiles::{median, nearest_rank, outer_fence, quantile, robust_deviation, sorted, spread, upper_median};

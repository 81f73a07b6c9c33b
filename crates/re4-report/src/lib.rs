//! Statistics, tables and pictures.

mod picture;
mod statistics;

mod film;

pub use film::{
    FILM_SIZES, FILM_SPEEDS, FILM_TILES, FilmDecision, FilmError, FilmFacts, FilmRollout, FilmSettings, FilmState,
    write_film,
};
pub use picture::{PictureDecision, PictureError, RolloutPicture, divergence_plot, rollout_picture};
pub use statistics::{Interval, RESAMPLES, mean, mean_interval, median, quantile, wilson_interval};

//! Statistics, tables, pictures and films.

mod film;
mod picture;
mod statistics;

pub use film::{
    FILM_SIZES, FILM_SPEEDS, FILM_TILES, FilmDecision, FilmError, FilmFacts, FilmRollout, FilmSettings, FilmState,
    write_film,
};
pub use picture::{PictureDecision, PictureError, RolloutPicture, divergence_plot, rollout_picture};
pub use statistics::{Interval, RESAMPLES, mean, mean_interval, median, quantile, wilson_interval};

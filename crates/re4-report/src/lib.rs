//! Statistics, pictures, films, and the page to look at rollouts with.

mod budget;
mod film;
pub mod html;
mod picture;
mod statistics;

pub use budget::{budgets, running_maxima};
pub use film::{
    DrawScene, FILM_SIZES, FILM_SPEEDS, FILM_TILES, FilmDecision, FilmError, FilmFacts, FilmRollout, FilmSettings,
    FilmState, SceneRollout, SceneState, write_film, write_scene_film,
};
pub use picture::{PictureDecision, PictureError, RolloutPicture, divergence_plot, rollout_picture, training_plot};
pub use statistics::{Interval, RESAMPLES, mean, mean_interval, median, quantile, wilson_interval};

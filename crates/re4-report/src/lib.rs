//! Pictures, films, and the page to look at rollouts with.

mod film;
pub mod html;
mod picture;

pub use film::{
    DrawScene, FILM_SIZES, FILM_SPEEDS, FILM_TILES, FilmDecision, FilmError, FilmFacts, FilmRollout, FilmSettings,
    FilmState, SceneRollout, SceneState, write_film, write_scene_film,
};
pub use picture::{PictureDecision, PictureError, RolloutPicture, divergence_plot, rollout_picture, training_plot};

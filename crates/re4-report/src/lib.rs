//! Pages, films and pictures of artifacts.

mod film;
pub mod html;
mod picture;
mod sources;

pub use film::{
    DrawScene, FILM_SIZES, FILM_SPEEDS, FILM_TILES, FilmDecision, FilmError, FilmFacts, FilmRollout, FilmSettings,
    FilmState, SceneRollout, SceneState, write_film, write_scene_film,
};
pub use picture::{PictureError, divergence_plot, rollout_picture, training_plot};
pub use sources::audit::{AuditSources, audit_page};
pub use sources::findings::Findings;
pub use sources::plane::{planar_films, planar_rollout};
pub use sources::report::{AddPictures, LARGE_PAGE, ReportPage, open_rollouts, report_page};
pub use sources::space::{scene_rollout, spatial_rollouts};
pub use sources::{find_input, is_spatial, stated};

//! HTML pages, videos, images and text summaries of artifacts.

pub mod html;
mod sources;
mod svg;
mod video;

pub use sources::audit::{AuditSources, audit_page};
pub use sources::comparison::comparison_page;
pub use sources::findings::Findings;
pub use sources::influence::{curation_page, influence_page};
pub use sources::plane::{planar_rollout, planar_videos};
pub use sources::report::{AddImages, LARGE_PAGE, ReportPage, open_rollouts, report_page};
pub use sources::space::{scene_rollout, spatial_rollouts};
pub use sources::training::training_page;
pub use sources::{find_input, is_spatial, stated};
pub use svg::{ImageError, divergence_plot, rollout_image, training_plot};
pub use video::{
    RenderScene, SceneRollout, SceneState, VIDEO_SIZES, VIDEO_SPEEDS, VIDEO_TILES, VideoDecision, VideoError,
    VideoRollout, VideoSettings, VideoState, VideoSummary, write_scene_video, write_video,
};

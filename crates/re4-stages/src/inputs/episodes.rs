//! Reads Push-T demonstrations from an `episodes` artifact.

use anyhow::Result;
use re4_artifact::{Artifact, Row as _, columns};
use re4_episode::{PlanarEpisode, PlanarFrame};
use re4_geometry::{Point2, Pose2};
use re4_ingest::{EpisodeRow, FrameRow, PlanarColumns};

columns! {
    /// The columns of table `frames` that stages read.
    pub struct Recorded {
        /// Number of the demonstration.
        pub episode: u32,
        /// Position of the pusher, px.
        pub eef: Point2,
        /// Pose of the block.
        pub object: Option<Pose2>,
        /// Target position of the pusher, px.
        pub action: Point2,
        /// Number of contact points.
        pub contacts: Option<f64>,
    }
}

/// The demonstrations of an `episodes` artifact.
///
/// # Errors
/// If the artifact cannot be read, or a pose of the block is null.
pub(crate) fn read_episodes(artifact: &Artifact) -> Result<Vec<PlanarEpisode>> {
    let episodes = read_frames(artifact)?;
    let mut frames = episodes.iter().flat_map(|episode| &episode.frames);
    if frames.any(|frame| frame.known_object().is_none()) {
        return Err(super::demos::no_object(artifact.path()).into());
    }
    Ok(episodes)
}

/// Same as [`read_episodes`], but the pose of the block may be unknown.
pub(crate) fn read_frames(artifact: &Artifact) -> Result<Vec<PlanarEpisode>> {
    let mut episodes: Vec<PlanarEpisode> = artifact
        .read::<EpisodeRow>()?
        .into_iter()
        .map(|row| PlanarEpisode {
            source: row.source_episode.unwrap_or(row.episode),
            frames: Vec::with_capacity(row.frames),
        })
        .collect();
    for row in artifact.table(FrameRow::<PlanarColumns>::table())?.read::<Recorded>()? {
        let Some(episode) = episodes.get_mut(row.episode as usize) else {
            anyhow::bail!(
                "cannot read {}: table frames refers to episode {}, which table episodes does not contain",
                artifact.path().display(),
                row.episode
            );
        };
        episode.frames.push(PlanarFrame {
            eef: row.eef,
            object: row.object.unwrap_or(PlanarFrame::UNKNOWN),
            action: row.action,
            contacts: row.contacts.unwrap_or(f64::NAN),
        });
    }
    Ok(episodes)
}

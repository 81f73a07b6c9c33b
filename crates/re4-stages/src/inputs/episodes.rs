//! Push-T's demonstrations out of an `episodes` artifact.

use anyhow::Result;
use re4_artifact::{Artifact, col_f64, col_f64_or_null, col_u32, tables};
use re4_episode::{PlanarEpisode, PlanarFrame};
use re4_geometry::{Point2, Pose2};

/// The demonstrations of an `episodes` artifact.
pub(crate) fn read_episodes(artifact: &Artifact) -> Result<Vec<PlanarEpisode>> {
    let listing = artifact.table(&tables::EPISODES)?.read_all()?;
    let mut episodes: Vec<PlanarEpisode> = col_u32(&listing, "source_episode")?
        .iter()
        .zip(col_u32(&listing, "frames")?)
        .map(|(&source, &frames)| PlanarEpisode {
            source,
            frames: Vec::with_capacity(frames as usize),
        })
        .collect();
    let frames = artifact.table(&tables::FRAMES)?.read_columns(&[
        "episode",
        "eef_x",
        "eef_y",
        "object_x",
        "object_y",
        "object_theta",
        "action_x",
        "action_y",
        "contacts",
    ])?;
    let column = |name| col_f64(&frames, name);
    let (eef_x, eef_y) = (column("eef_x")?, column("eef_y")?);
    let (x, y, theta) = (column("object_x")?, column("object_y")?, column("object_theta")?);
    let (action_x, action_y) = (column("action_x")?, column("action_y")?);
    let contacts = col_f64_or_null(&frames, "contacts")?;
    for (i, &episode) in col_u32(&frames, "episode")?.iter().enumerate() {
        let Some(episode) = episodes.get_mut(episode as usize) else {
            anyhow::bail!(
                "cannot read {}: table frames names episode {episode}, which table episodes lacks",
                artifact.path().display()
            );
        };
        episode.frames.push(PlanarFrame {
            eef: Point2::new(eef_x[i], eef_y[i]),
            object: Pose2::new(x[i], y[i], theta[i]),
            action: Point2::new(action_x[i], action_y[i]),
            contacts: contacts[i].unwrap_or(f64::NAN),
        });
    }
    Ok(episodes)
}

//! Reads Push-T demonstrations from an `episodes` artifact.

use std::ops::Range;
use std::path::PathBuf;

use anyhow::Result;
use re4_artifact::{Artifact, Row as _, Table, columns};
use re4_episode::{PlanarEpisode, PlanarFrame};
use re4_fault::{bail, ensure};
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
    let episodes = PlanarEpisodes::open(artifact)?;
    episodes.read_known(0..episodes.count())
}

/// Same as [`read_episodes`], but the pose of the block may be unknown.
pub(crate) fn read_frames(artifact: &Artifact) -> Result<Vec<PlanarEpisode>> {
    let episodes = PlanarEpisodes::open(artifact)?;
    episodes.read(0..episodes.count())
}

/// The demonstrations of an `episodes` artifact, which are read some at a time.
pub(crate) struct PlanarEpisodes {
    frames: Table,
    /// Number of every demonstration in its source.
    sources: Vec<u32>,
    /// First row of every demonstration in table `frames`, and the number of rows.
    starts: Vec<u64>,
    /// Path of the artifact, for messages.
    path: PathBuf,
}

impl PlanarEpisodes {
    /// Reads the lengths of the demonstrations.
    ///
    /// # Errors
    /// If the artifact cannot be read, or its tables do not list the same number of frames.
    pub(crate) fn open(artifact: &Artifact) -> Result<Self> {
        let frames = artifact.table(FrameRow::<PlanarColumns>::table())?;
        let (mut sources, mut starts) = (Vec::new(), vec![0]);
        let mut end = 0;
        for row in artifact.read::<EpisodeRow>()? {
            sources.push(row.source_episode.unwrap_or(row.episode));
            end += row.frames as u64;
            starts.push(end);
        }
        let path = artifact.path().to_path_buf();
        ensure!(
            end == frames.rows(),
            "cannot read {}: table frames has {} rows, but table episodes lists {end}", path.display(), frames.rows();
            "delete the artifact and ingest the dataset again"
        );
        Ok(Self {
            frames,
            sources,
            starts,
            path,
        })
    }

    /// Number of demonstrations.
    pub(crate) fn count(&self) -> usize {
        self.sources.len()
    }

    /// The rows of some demonstrations in tables with one row per frame.
    pub(crate) fn rows(&self, demos: Range<usize>) -> Range<u64> {
        self.starts[demos.start]..self.starts[demos.end]
    }

    /// Reads some demonstrations. Poses of the block may be unknown.
    pub(crate) fn read(&self, demos: Range<usize>) -> Result<Vec<PlanarEpisode>> {
        let lengths = self.starts[demos.start..=demos.end].windows(2);
        let mut episodes: Vec<PlanarEpisode> = self.sources[demos.clone()]
            .iter()
            .zip(lengths)
            .map(|(&source, rows)| PlanarEpisode {
                source,
                frames: Vec::with_capacity((rows[1] - rows[0]) as usize),
            })
            .collect();
        for row in self.frames.read_range::<Recorded>(self.rows(demos.clone()))? {
            let place = (row.episode as usize).checked_sub(demos.start);
            let Some(episode) = place.and_then(|place| episodes.get_mut(place)) else {
                bail!(
                    "cannot read {}: table frames refers to episode {}, which table episodes does not list there",
                    self.path.display(),
                    row.episode;
                    "delete the artifact and ingest the dataset again"
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

    /// As [`PlanarEpisodes::read`].
    ///
    /// # Errors
    /// Also if a pose of the block is null.
    pub(crate) fn read_known(&self, demos: Range<usize>) -> Result<Vec<PlanarEpisode>> {
        let episodes = self.read(demos)?;
        let mut frames = episodes.iter().flat_map(|episode| &episode.frames);
        if frames.any(|frame| frame.known_object().is_none()) {
            return Err(super::demos::no_object(&self.path).into());
        }
        Ok(episodes)
    }
}

//! Reads demonstrations of robosuite tasks from artifacts one at a time, so that a dataset need not fit in memory.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, ByEpisode, Row as _};
use re4_audit::SpatialDemo;
use re4_episode::{SpatialEpisode, episode_name};
use re4_fault::{Fault, OrFault as _, ensure, fault};
use re4_ingest::{DemoRow, EpisodeRow, FrameRow, LeftOut, LeftOutFrameRow, SpatialColumns};
use re4_policy::DemoNames;
use re4_segment::{ModeRow, SegmentRow, SegmentedSpatial, SpatialEvidence, SpatialSegment};

/// Number of demonstrations that are processed in parallel and held in memory at a time.
const BATCH: usize = 64;

/// The names of an artifact's demonstrations in their source.
pub(crate) fn demo_names(episodes: &Artifact) -> Result<DemoNames> {
    // Older artifacts have no table `demos`; names are then derived from episode numbers.
    if episodes.has::<DemoRow>() {
        return Ok(DemoNames::new(names(episodes)?));
    }
    let rows = episodes.read::<EpisodeRow>()?.into_iter();
    Ok(DemoNames::new(
        rows.map(|row| episode_name(row.source_episode.unwrap_or(row.episode)))
            .collect(),
    ))
}

/// The names in table `demos`.
fn names(episodes: &Artifact) -> Result<Vec<String>> {
    let rows = episodes.read::<DemoRow>()?;
    Ok(rows.into_iter().map(|row| row.demo).collect())
}

/// The names of demonstrations by their numbers, which do not begin with 0 in a part of an artifact.
pub(crate) struct Names(BTreeMap<u32, String>);

impl Names {
    /// Reads the names of an artifact or of a part of one.
    pub(crate) fn read(episodes: &Artifact) -> Result<Self> {
        let rows = episodes.read::<DemoRow>()?.into_iter();
        Ok(Self(rows.map(|row| (row.episode, row.demo)).collect()))
    }

    /// Number of demonstrations.
    pub(crate) fn count(&self) -> usize {
        self.0.len()
    }

    /// The name of a demonstration.
    pub(crate) fn of(&self, number: u32) -> Option<String> {
        self.0.get(&number).cloned()
    }
}

/// Whether an `episodes` artifact has demonstrations of a robosuite task.
pub(crate) fn is_spatial(episodes: &Artifact) -> Result<bool> {
    let frames = episodes.table_named(FrameRow::<SpatialColumns>::NAME)?;
    Ok(frames.domain().as_deref() == Some(FrameRow::<SpatialColumns>::table().domain))
}

/// The error of a stage that needs object poses when the dataset has none.
pub(super) fn no_object(episodes: &Path) -> Fault {
    fault!(
        "the demonstrations of {} have no object poses, which this stage needs", episodes.display();
        "ingest a dataset with object poses"
    )
}

/// The demonstrations of an `episodes` artifact, in order.
pub(crate) struct SpatialEpisodes {
    rows: ByEpisode<FrameRow<SpatialColumns>>,
    names: Names,
    /// Path of the artifact, for messages.
    path: PathBuf,
}

impl SpatialEpisodes {
    /// Opens the artifact's tables.
    pub(crate) fn open(artifact: &Artifact) -> Result<Self> {
        Ok(Self {
            rows: ByEpisode::open(artifact, |row: &FrameRow<_>| row.episode)?,
            names: Names::read(artifact)?,
            path: artifact.path().to_owned(),
        })
    }

    /// Number of demonstrations.
    pub(crate) fn demos(&self) -> usize {
        self.names.count()
    }

    fn read(&self, number: u32, rows: &[FrameRow<SpatialColumns>]) -> Result<(u32, SpatialEpisode)> {
        let name = self.names.of(number).or_fault(|| {
            fault!(
                "cannot read {}: table frames refers to demonstration {number}, which table demos does not contain",
                self.path.display();
                "delete the artifact and ingest the dataset again"
            )
        })?;
        let frames = rows.iter().map(|row| row.recorded.frame()).collect::<Option<_>>();
        let frames = frames.or_fault(|| no_object(&self.path))?;
        Ok((number, SpatialEpisode { name, frames }))
    }
}

impl Iterator for SpatialEpisodes {
    type Item = Result<(u32, SpatialEpisode)>;

    fn next(&mut self) -> Option<Self::Item> {
        let rows = self.rows.next()?;
        Some(
            rows.map_err(Into::into)
                .and_then(|(number, rows)| self.read(number, &rows)),
        )
    }
}

/// The demonstrations of an `episodes` artifact with their segmentation from a `modes` artifact, in order.
pub(crate) struct SegmentedEpisodes {
    episodes: SpatialEpisodes,
    modes: ByEpisode<ModeRow<SpatialEvidence>>,
    segments: ByEpisode<SegmentRow<SpatialSegment>>,
}

impl SegmentedEpisodes {
    /// Opens the tables of both artifacts.
    pub(crate) fn open(episodes: &Artifact, modes: &Artifact) -> Result<Self> {
        Ok(Self {
            episodes: SpatialEpisodes::open(episodes)?,
            modes: ByEpisode::open(modes, |row: &ModeRow<_>| row.episode)?,
            segments: ByEpisode::open(modes, |row: &SegmentRow<_>| row.episode)?,
        })
    }

    fn join(&mut self, number: u32, episode: SpatialEpisode) -> Result<SpatialDemo> {
        let name = episode.name.clone();
        let missing = || {
            fault!(
                "the modes artifact does not match the demonstrations: {name} is not segmented";
                "delete the modes artifact and segment the dataset again"
            )
        };
        let (modes_of, modes) = self.modes.next().with_context(missing)??;
        let (segments_of, segments) = self.segments.next().with_context(missing)??;
        let segmented = SegmentedSpatial::from_rows(modes, segments);
        let frames = segmented.modes.len();
        ensure!(
            segmented
                .segments
                .last()
                .is_some_and(|last| last.segment.frames.end == frames),
            "the tables segments and modes of {name} have different numbers of frames";
            "delete the modes artifact and segment the dataset again"
        );
        ensure!(
            modes_of == number && segments_of == number && frames == episode.frames.len(),
            "{}",
            missing()
        );
        Ok(SpatialDemo {
            number,
            episode,
            segmented,
        })
    }
}

impl Iterator for SegmentedEpisodes {
    type Item = Result<SpatialDemo>;

    fn next(&mut self) -> Option<Self::Item> {
        let episode = self.episodes.next()?;
        Some(episode.and_then(|(number, episode)| self.join(number, episode)))
    }
}

/// The demonstrations that were left out of an `episodes` artifact although they can be read, with their numbers in table
/// `left_out`. Artifacts without such demonstrations, and older ones, have none.
pub(crate) struct LeftOutEpisodes {
    rows: Option<ByEpisode<LeftOutFrameRow<SpatialColumns>>>,
    names: Vec<String>,
    path: PathBuf,
}

impl LeftOutEpisodes {
    /// Opens the table of their frames; `left` are the rows of table `left_out`.
    pub(crate) fn open(artifact: &Artifact, left: &[LeftOut]) -> Result<Self> {
        let table = artifact.has::<LeftOutFrameRow<SpatialColumns>>() && !left.is_empty();
        let rows = table.then(|| ByEpisode::open(artifact, |row: &LeftOutFrameRow<_>| row.left_out));
        Ok(Self {
            rows: rows.transpose()?,
            names: left.iter().map(|left| left.demo.clone()).collect(),
            path: artifact.path().to_owned(),
        })
    }
}

impl Iterator for LeftOutEpisodes {
    type Item = Result<(u32, SpatialEpisode)>;

    fn next(&mut self) -> Option<Self::Item> {
        let (names, path) = (&self.names, &self.path);
        let rows = self.rows.as_mut()?.next()?;
        Some(rows.map_err(Into::into).and_then(|(number, rows)| {
            let frames = rows.iter().map(|row| row.recorded.frame()).collect::<Option<_>>();
            let frames = frames.or_fault(|| no_object(path))?;
            let name = names.get(number as usize).cloned().unwrap_or_default();
            Ok((number, SpatialEpisode { name, frames }))
        }))
    }
}

/// Groups the items of an iterator into batches.
pub(crate) fn in_batches<T>(mut items: impl Iterator<Item = Result<T>>) -> impl Iterator<Item = Result<Vec<T>>> {
    std::iter::from_fn(move || {
        let batch: Result<Vec<T>> = items.by_ref().take(BATCH).collect();
        match batch {
            Ok(batch) if batch.is_empty() => None,
            batch => Some(batch),
        }
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;
    use re4_artifact::{ArtifactSummary, Recipe, SixAxis, Stage, Store};

    use super::*;
    use re4_fault::Remedy as _;

    #[test]
    fn missing_object_poses_are_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let writer = store.begin(&Recipe::new(Stage::Ingest, 1)).unwrap();
        let demo = DemoRow {
            episode: 0,
            demo: "demo_4".to_owned(),
            filter_keys: String::new(),
            model: None,
            goal_error_position: None,
            goal_error_rotation: None,
        };
        let recorded = SpatialColumns {
            eef: Isometry3::identity(),
            object: None,
            fingers: [0.04, -0.04],
            delta: SixAxis::default(),
            goal: SixAxis::default(),
            gripper: -1.0,
            reward: None,
            done: None,
            raw_eef: None,
            raw_gripper: None,
        };
        let frame = FrameRow {
            episode: 0,
            frame: 0,
            recorded,
        };
        writer.write_rows([demo]).unwrap();
        writer.write_rows([frame]).unwrap();
        let artifact = writer.publish(ArtifactSummary::default()).unwrap();
        let error = SpatialEpisodes::open(&artifact).unwrap().next().unwrap().unwrap_err();
        assert!(
            crate::notes::fault_of(&error)
                .sentence()
                .ends_with("have no object poses, which this stage needs; ingest a dataset with object poses"),
            "{error}"
        );
    }
}

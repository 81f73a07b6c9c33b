//! Spatial demonstrations out of artifacts, one after the other, so that a dataset need not fit in memory.

use anyhow::{Context as _, Result};
use arrow::array::RecordBatch;
use arrow::compute::concat_batches;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use re4_artifact::{Artifact, Batches, TableSpec, col_f64, col_f64_or_null, col_text, col_u32, tables};
use re4_audit::SpatialDemo;
use re4_episode::{SpatialEpisode, SpatialFrame, episode_name};
use re4_fault::{OrFault as _, ensure, fault};
use re4_policy::DemoNames;
use re4_segment::{ModeRow, SegmentRow, SegmentedSpatial, SpatialEvidence, SpatialSegment};

use super::by_episode::ByEpisode;

/// Demonstrations that are worked on at a time.
const AT_A_TIME: usize = 64;

/// The rows of one demonstration after those of the other, of a table that is sorted by episode.
pub(crate) struct BatchesByEpisode {
    batches: Batches,
    /// Rows that were read and not yet given.
    rest: Option<RecordBatch>,
}

impl BatchesByEpisode {
    /// The table of this artifact.
    pub(crate) fn open(artifact: &Artifact, spec: &'static TableSpec) -> Result<Self> {
        Ok(Self {
            batches: artifact.table(spec)?.batches()?,
            rest: None,
        })
    }

    fn next_batch(&mut self) -> Result<Option<RecordBatch>> {
        let batch = match self.rest.take() {
            Some(rest) => Some(rest),
            None => self.batches.next().transpose()?,
        };
        Ok(batch.filter(|batch| batch.num_rows() > 0))
    }

    /// Rows of the next demonstration, with its number.
    fn advance(&mut self) -> Result<Option<(u32, RecordBatch)>> {
        let mut parts: Vec<RecordBatch> = Vec::new();
        let mut current = None;
        while let Some(batch) = self.next_batch()? {
            let episodes = col_u32(&batch, "episode")?;
            let first = episodes.first().copied().unwrap_or_default();
            if *current.get_or_insert(first) != first {
                self.rest = Some(batch);
                break;
            }
            let own = episodes.iter().take_while(|episode| **episode == first).count();
            parts.push(batch.slice(0, own));
            if own < batch.num_rows() {
                self.rest = Some(batch.slice(own, batch.num_rows() - own));
                break;
            }
        }
        let (Some(episode), Some(part)) = (current, parts.first()) else {
            return Ok(None);
        };
        Ok(Some((episode, concat_batches(&part.schema(), &parts)?)))
    }
}

impl Iterator for BatchesByEpisode {
    type Item = Result<(u32, RecordBatch)>;

    fn next(&mut self) -> Option<Self::Item> {
        self.advance().transpose()
    }
}

/// What the demonstrations of an `episodes` artifact are called in their source.
pub(crate) fn demo_names(episodes: &Artifact) -> Result<DemoNames> {
    if episodes.manifest().tables.contains_key(tables::DEMOS.name) {
        return Ok(DemoNames::new(group_names(episodes)?));
    }
    let rows = episodes.table(&tables::EPISODES)?.read_columns(&["source_episode"])?;
    let numbers = col_u32(&rows, "source_episode")?;
    Ok(DemoNames::new(
        numbers.iter().map(|number| episode_name(*number)).collect(),
    ))
}

/// Groups of the demonstrations in their HDF5 file.
fn group_names(episodes: &Artifact) -> Result<Vec<String>> {
    let rows = episodes.table(&tables::DEMOS)?.read_columns(&["demo"])?;
    let names = col_text(&rows, "demo")?;
    Ok(names
        .into_iter()
        .map(|name| name.unwrap_or_default().to_owned())
        .collect())
}

fn pose(batch: &RecordBatch, prefix: &str) -> Result<Vec<Isometry3<f64>>> {
    let part = |name: &str| col_f64(batch, &format!("{prefix}_{name}"));
    let (x, y, z) = (part("x")?, part("y")?, part("z")?);
    let (qx, qy, qz, qw) = (part("qx")?, part("qy")?, part("qz")?, part("qw")?);
    Ok((0..batch.num_rows())
        .map(|i| isometry([x[i], y[i], z[i]], [qx[i], qy[i], qz[i], qw[i]]))
        .collect())
}

/// The recorded quaternion is taken as it is, sign and all; ingest has checked that it is one of unit length.
fn isometry([x, y, z]: [f64; 3], [qx, qy, qz, qw]: [f64; 4]) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz)),
    )
}

/// A demonstration from its rows of table `spatial_frames`.
fn spatial_episode(name: String, rows: &RecordBatch) -> Result<SpatialEpisode> {
    let column = |name: &str| col_f64(rows, name);
    let six = |prefix: &str| -> Result<Vec<[f64; 6]>> {
        let parts = ["x", "y", "z", "rx", "ry", "rz"]
            .iter()
            .map(|part| column(&format!("{prefix}_{part}")))
            .collect::<Result<Vec<_>, _>>()?;
        Ok((0..rows.num_rows())
            .map(|i| std::array::from_fn(|k| parts[k][i]))
            .collect())
    };
    let (eef, object) = (pose(rows, "eef")?, pose(rows, "object")?);
    let (finger_0, finger_1) = (column("finger_0")?, column("finger_1")?);
    let (delta, goal) = (six("delta")?, six("goal")?);
    let gripper = column("gripper")?;
    let reward = col_f64_or_null(rows, "reward")?;
    let frames = (0..rows.num_rows())
        .map(|i| SpatialFrame {
            eef: eef[i],
            object: object[i],
            fingers: [finger_0[i], finger_1[i]],
            delta: delta[i],
            goal: goal[i],
            gripper: gripper[i],
            reward: reward[i],
        })
        .collect();
    Ok(SpatialEpisode { name, frames })
}

/// The demonstrations of an `episodes` artifact, in order.
pub(crate) struct SpatialEpisodes {
    rows: BatchesByEpisode,
    names: Vec<String>,
}

impl SpatialEpisodes {
    /// Those of this artifact.
    pub(crate) fn open(artifact: &Artifact) -> Result<Self> {
        Ok(Self {
            rows: BatchesByEpisode::open(artifact, &tables::SPATIAL_FRAMES)?,
            names: group_names(artifact)?,
        })
    }

    /// How many there are.
    pub(crate) fn demos(&self) -> usize {
        self.names.len()
    }

    fn read(&self, number: u32, rows: &RecordBatch) -> Result<(u32, SpatialEpisode)> {
        let name = self.names.get(number as usize).cloned().or_fault(|| {
            fault!(
                "table spatial_frames names demonstration {number} of the artifact, which table demos lacks";
                "ingest the dataset anew"
            )
        })?;
        Ok((number, spatial_episode(name, rows)?))
    }
}

impl Iterator for SpatialEpisodes {
    type Item = Result<(u32, SpatialEpisode)>;

    fn next(&mut self) -> Option<Self::Item> {
        let rows = self.rows.next()?;
        Some(rows.and_then(|(number, rows)| self.read(number, &rows)))
    }
}

/// The demonstrations of an `episodes` artifact with their segmentation from a `modes` artifact, in order.
pub(crate) struct SegmentedEpisodes {
    episodes: SpatialEpisodes,
    modes: ByEpisode<ModeRow<SpatialEvidence>>,
    segments: ByEpisode<SegmentRow<SpatialSegment>>,
}

impl SegmentedEpisodes {
    /// Those of these artifacts.
    pub(crate) fn open(episodes: &Artifact, modes: &Artifact) -> Result<Self> {
        Ok(Self {
            episodes: SpatialEpisodes::open(episodes)?,
            modes: ByEpisode::open(modes, |row: &ModeRow<_>| row.episode)?,
            segments: ByEpisode::open(modes, |row: &SegmentRow<_>| row.episode)?,
        })
    }

    fn join(&mut self, number: u32, episode: SpatialEpisode) -> Result<SpatialDemo> {
        let name = episode.name.clone();
        let missing = || fault!("{name} is not segmented"; "segment the dataset anew");
        let (modes_of, modes) = self.modes.next().with_context(missing)??;
        let (segments_of, segments) = self.segments.next().with_context(missing)??;
        let segmented = SegmentedSpatial::from_rows(modes, segments);
        let frames = segmented.modes.len();
        ensure!(
            segmented
                .segments
                .last()
                .is_some_and(|last| last.segment.frames.end == frames),
            "table segments does not end where modes does";
            "segment the dataset anew"
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

/// Takes items off an iterator, some at a time.
pub(crate) fn in_portions<T>(mut items: impl Iterator<Item = Result<T>>) -> impl Iterator<Item = Result<Vec<T>>> {
    std::iter::from_fn(move || {
        let portion: Result<Vec<T>> = items.by_ref().take(AT_A_TIME).collect();
        match portion {
            Ok(portion) if portion.is_empty() => None,
            portion => Some(portion),
        }
    })
}

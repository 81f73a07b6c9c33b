//! Spatial demonstrations out of artifacts, one after the other, so that a dataset need not fit in memory.

use anyhow::{Context as _, Result, ensure};
use arrow::array::{Array as _, BooleanArray, RecordBatch};
use arrow::compute::concat_batches;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use re4_artifact::{
    Artifact, Batches, TableSpec, col_bool, col_f64, col_f64_or_null, col_text, col_u32, col_u32_or_null, tables,
};
use re4_audit::SpatialDemo;
use re4_episode::{Mode, Segment, SpatialEpisode, SpatialFrame, episode_name};
use re4_policy::DemoNames;
use re4_segment::{Grasp, SegmentedSpatial, SpatialEvidence, SpatialSegment};

/// Demonstrations that are worked on at a time.
const AT_A_TIME: usize = 64;

/// The rows of one demonstration after those of the other, of a table that is sorted by episode.
pub(crate) struct ByEpisode {
    batches: Batches,
    /// Rows that were read and not yet given.
    rest: Option<RecordBatch>,
}

impl ByEpisode {
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

impl Iterator for ByEpisode {
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

fn flag(array: &BooleanArray, row: usize) -> Option<bool> {
    array.is_valid(row).then(|| array.value(row))
}

/// A segmentation from its rows of tables `spatial_modes` and `spatial_segments`.
fn segmented(modes: &RecordBatch, segments: &RecordBatch) -> Result<SegmentedSpatial> {
    let evidence = evidence(modes)?;
    let modes = read_modes(modes)?;
    let segments = read_segments(segments)?;
    ensure!(
        segments
            .last()
            .is_some_and(|last| last.segment.frames.end == modes.len()),
        "table spatial_segments does not end where spatial_modes does; segment the dataset anew"
    );
    Ok(SegmentedSpatial {
        grasp_frame: modes.iter().position(|mode| *mode == Mode::Transfer),
        modes,
        evidence,
        segments,
    })
}

fn read_modes(rows: &RecordBatch) -> Result<Vec<Mode>> {
    col_text(rows, "mode")?
        .into_iter()
        .map(|name| {
            name.and_then(Mode::from_name)
                .with_context(|| format!("{} is no mode", name.unwrap_or("null")))
        })
        .collect()
}

fn evidence(rows: &RecordBatch) -> Result<Vec<SpatialEvidence>> {
    let optional = |name: &str| col_f64_or_null(rows, name);
    let closes = col_bool(rows, "command_closes")?;
    let separation = col_f64(rows, "finger_separation")?;
    let speed = optional("finger_speed")?;
    let (eef_step, eef_turn) = (optional("eef_step")?, optional("eef_turn")?);
    let (object_step, object_turn) = (optional("object_step")?, optional("object_turn")?);
    let (translation, rotation) = (optional("relative_translation")?, optional("relative_rotation")?);
    let distance = col_f64(rows, "eef_object_distance")?;
    let (moving, holds) = (col_bool(rows, "object_moving")?, col_bool(rows, "holds")?);
    Ok((0..rows.num_rows())
        .map(|i| SpatialEvidence {
            command_closes: flag(closes, i) == Some(true),
            finger_separation: separation[i],
            finger_speed: speed[i],
            eef_step: eef_step[i],
            eef_turn: eef_turn[i],
            object_step: object_step[i],
            object_turn: object_turn[i],
            relative_translation: translation[i],
            relative_rotation: rotation[i],
            eef_object_distance: distance[i],
            object_moving: flag(moving, i),
            holds: flag(holds, i) == Some(true),
        })
        .collect())
}

fn read_segments(rows: &RecordBatch) -> Result<Vec<SpatialSegment>> {
    let optional = |name: &str| col_f64_or_null(rows, name);
    let poses = |prefix: &str| -> Result<Vec<Option<Isometry3<f64>>>> {
        let parts = ["x", "y", "z", "qx", "qy", "qz", "qw"]
            .iter()
            .map(|part| optional(&format!("{prefix}_{part}")))
            .collect::<Result<Vec<_>, _>>()?;
        Ok((0..rows.num_rows())
            .map(|i| {
                let part = |k: usize| parts[k][i];
                Some(isometry(
                    [part(0)?, part(1)?, part(2)?],
                    [part(3)?, part(4)?, part(5)?, part(6)?],
                ))
            })
            .collect())
    };
    let (first, end) = (col_u32(rows, "first_frame")?, col_u32(rows, "end_frame")?);
    let modes = read_modes(rows)?;
    let (anchors, grasps) = (poses("anchor")?, poses("grasp")?);
    let settled = col_u32_or_null(rows, "settled_frame")?;
    let separation = optional("finger_separation")?;
    let (residual, residual_rotation) = (optional("rigidity_residual")?, optional("rigidity_residual_rotation")?);
    let column = |name: &str| col_f64(rows, name);
    let (displacement, rise) = (column("object_displacement")?, column("object_rise")?);
    let (rotation, path) = (column("object_rotation")?, column("object_path")?);
    Ok((0..rows.num_rows())
        .map(|i| SpatialSegment {
            segment: Segment {
                mode: modes[i],
                frames: first[i] as usize..end[i] as usize,
            },
            anchor: anchors[i],
            settled_frame: settled[i].map(|frame| frame as usize),
            grasp: grasps[i].and_then(|transform| {
                Some(Grasp {
                    transform,
                    finger_separation: separation[i]?,
                    residual: residual[i]?,
                    residual_rotation: residual_rotation[i]?,
                })
            }),
            object_displacement: displacement[i],
            object_rise: rise[i],
            object_rotation: rotation[i],
            object_path: path[i],
        })
        .collect())
}

/// The demonstrations of an `episodes` artifact, in order.
pub(crate) struct SpatialEpisodes {
    rows: ByEpisode,
    names: Vec<String>,
}

impl SpatialEpisodes {
    /// Those of this artifact.
    pub(crate) fn open(artifact: &Artifact) -> Result<Self> {
        Ok(Self {
            rows: ByEpisode::open(artifact, &tables::SPATIAL_FRAMES)?,
            names: group_names(artifact)?,
        })
    }

    /// How many there are.
    pub(crate) fn demos(&self) -> usize {
        self.names.len()
    }

    fn read(&self, number: u32, rows: &RecordBatch) -> Result<(u32, SpatialEpisode)> {
        let name = self.names.get(number as usize).cloned().with_context(|| {
            format!(
                "table spatial_frames names demonstration {number} of the artifact, which table demos lacks; ingest the dataset anew"
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
    modes: ByEpisode,
    segments: ByEpisode,
}

impl SegmentedEpisodes {
    /// Those of these artifacts.
    pub(crate) fn open(episodes: &Artifact, modes: &Artifact) -> Result<Self> {
        Ok(Self {
            episodes: SpatialEpisodes::open(episodes)?,
            modes: ByEpisode::open(modes, &tables::SPATIAL_MODES)?,
            segments: ByEpisode::open(modes, &tables::SPATIAL_SEGMENTS)?,
        })
    }

    fn join(&mut self, number: u32, episode: SpatialEpisode) -> Result<SpatialDemo> {
        let name = episode.name.clone();
        let missing = || format!("{name} is not segmented; segment the dataset anew");
        let (modes_of, modes) = self.modes.next().with_context(missing)??;
        let (segments_of, segments) = self.segments.next().with_context(missing)??;
        let segmented = segmented(&modes, &segments)?;
        ensure!(
            modes_of == number && segments_of == number && segmented.modes.len() == episode.frames.len(),
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

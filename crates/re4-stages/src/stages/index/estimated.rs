//! Object poses of an index that come from pictures, and an audit that does without recorded ones.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use re4_artifact::{Artifact, col_u32, tables};
use re4_audit::{CHECKS, SpatialDemo};
use re4_episode::Mode;
use re4_segment::{SegmentConfig, segment_spatial};
use re4_stats::upper_median;

use super::spatial::{check_names, last_ends};
use crate::inputs::poses::{PARTS, read_poses};
use crate::pipeline::Estimates;
use crate::runner::Runner;

/// The object poses of a `poses` artifact.
pub(super) struct EstimatedPoses {
    poses: Vec<Isometry3<f64>>,
    /// Where the rows of a demonstration begin, and how many there are.
    rows: BTreeMap<u32, (usize, usize)>,
    path: String,
}

impl EstimatedPoses {
    /// Those of this artifact.
    ///
    /// # Errors
    /// When its rows are not sorted by episode and frame, or a frame is missing among them.
    pub(super) fn open(artifact: &Artifact) -> Result<Self> {
        let parts = PARTS.map(|part| format!("object_{part}"));
        let mut names = vec!["episode", "frame"];
        names.extend(parts.iter().map(String::as_str));
        let table = artifact.table(&tables::SPATIAL_POSES)?.read_columns(&names)?;
        let (episodes, frames) = (col_u32(&table, "episode")?, col_u32(&table, "frame")?);
        let mut rows: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
        for (row, (&episode, &frame)) in episodes.iter().zip(frames).enumerate() {
            let (start, count) = rows.entry(episode).or_insert((row, 0));
            ensure!(
                frame as usize == *count && *start + *count == row,
                "cannot index: table spatial_poses of {} is not sorted by episode and frame, or lacks a frame, in row {row} (episode {episode}, frame {frame}); train the encoder anew",
                artifact.path().display()
            );
            *count += 1;
        }
        Ok(Self {
            poses: read_poses(&table, "object")?,
            rows,
            path: artifact.path().display().to_string(),
        })
    }

    /// Puts the estimated poses in the place of the recorded ones.
    ///
    /// # Errors
    /// When the artifact was made of other demonstrations.
    pub(super) fn put_into(&self, demo: &mut SpatialDemo, estimates: Estimates) -> Result<()> {
        let frames = demo.episode.frames.len();
        let (start, count) = self.rows.get(&demo.number).copied().unwrap_or_default();
        ensure!(
            count == frames,
            "cannot index: table spatial_poses of {} has {count} rows of {}, which has {frames} frames; the poses are those of other demonstrations, so train the encoder on these",
            self.path,
            demo.episode.name
        );
        let own = &self.poses[start..start + count];
        let eef: Vec<Isometry3<f64>> = demo.episode.frames.iter().map(|frame| frame.eef).collect();
        let poses = match estimates {
            Estimates::EachFrame => own.to_vec(),
            Estimates::ByMode => by_mode(own, &eef, &demo.segmented.modes),
        };
        for (frame, pose) in demo.episode.frames.iter_mut().zip(poses) {
            frame.object = pose;
        }
        Ok(())
    }

    /// Refuses poses of more demonstrations than there are.
    pub(super) fn check_count(&self, demos: u64) -> Result<()> {
        ensure!(
            self.rows.len() as u64 == demos,
            "cannot index: table spatial_poses of {} has {} episodes, and there are {demos} demonstrations; the poses are those of other demonstrations, so train the encoder on these",
            self.path,
            self.rows.len()
        );
        Ok(())
    }
}

/// Most poses that a median is taken of.
const SAMPLE: usize = 64;

/// What modes make of estimates: see [`Estimates::ByMode`].
fn by_mode(own: &[Isometry3<f64>], eef: &[Isometry3<f64>], modes: &[Mode]) -> Vec<Isometry3<f64>> {
    let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(own.len());
    for run in modes.chunk_by(|a, b| a == b) {
        let frames = poses.len()..poses.len() + run.len();
        let last = poses.last().copied();
        match (run[0], last) {
            // From the frame before the mode changed on, the object and the gripper are one.
            (Mode::Transfer, Some(last)) => {
                let held = eef[frames.start].inv_mul(&last);
                poses.extend(frames.map(|frame| eef[frame] * held));
            }
            (Mode::Transit, Some(last)) if frames.end == own.len() => poses.extend(frames.map(|_| last)),
            (Mode::Transit, _) => {
                let rests = median(&own[frames.clone()]);
                poses.extend(frames.map(|_| rests));
            }
            // Held from the first frame on: nothing was seen of it before.
            (Mode::Transfer, None) => poses.extend_from_slice(&own[frames]),
        }
    }
    poses
}

/// The median of each coordinate, and of the orientations the one that the others are nearest to.
fn median(poses: &[Isometry3<f64>]) -> Isometry3<f64> {
    let coordinate = |k: usize| upper_median(poses.iter().map(|pose| pose.translation.vector[k])).unwrap_or_default();
    let step = poses.len().div_ceil(SAMPLE);
    let sample: Vec<_> = poses.iter().step_by(step).map(|pose| pose.rotation).collect();
    let away = |one: &UnitQuaternion<f64>| sample.iter().map(|other| one.angle_to(other)).sum::<f64>();
    let middle = sample
        .iter()
        .min_by(|a, b| away(a).total_cmp(&away(b)))
        .copied()
        .unwrap_or_default();
    Isometry3::from_parts(Translation3::new(coordinate(0), coordinate(1), coordinate(2)), middle)
}

/// A demonstration without the recorded pose of the object, which is said to be where the end effector is. What is left to
/// judge a grasp by are the fingers: an object that is said to be in the hand never leaves it.
fn without_object(mut demo: SpatialDemo, config: &SegmentConfig) -> Result<SpatialDemo> {
    for frame in &mut demo.episode.frames {
        frame.object = frame.eef;
    }
    demo.segmented = segment_spatial(&demo.episode, config)?;
    Ok(demo)
}

impl Runner {
    /// The end of the last finding of one of these checks, by demonstration, where recorded object poses are not to be read.
    pub(super) fn left_out_by_fingers(
        &self,
        episodes: &Artifact,
        modes: &Artifact,
        checks: &[String],
    ) -> Result<BTreeMap<u32, u32>> {
        let known = CHECKS.iter().filter(|check| check.applies_to(false));
        check_names(checks, known.map(|check| check.code))?;
        let findings = self.findings(episodes, modes, &|demo| without_object(demo, &self.pipeline.segment))?;
        let ends = findings
            .iter()
            .map(|finding| (finding.code, finding.episode, finding.frames.end));
        Ok(last_ends(checks, ends))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, turn: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(x, 0.0, 0.0),
            UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), turn),
        )
    }

    #[test]
    fn modes_hold_the_object_still_in_the_world_and_then_in_the_gripper() {
        let (transit, transfer) = (Mode::Transit, Mode::Transfer);
        let modes = [transit, transit, transit, transfer, transfer, transit];
        // The second estimate is far off, and turned half about; so are all that show the object in the hand or after it.
        let own = [
            at(1.0, 0.1),
            at(9.0, 3.1),
            at(1.2, 0.2),
            at(5.0, 1.0),
            at(6.0, 1.0),
            at(7.0, 1.0),
        ];
        let eef = [
            at(0.0, 0.0),
            at(0.5, 0.0),
            at(1.0, 0.0),
            at(1.0, 0.0),
            at(3.0, 0.5),
            at(3.0, 0.5),
        ];
        let poses = by_mode(&own, &eef, &modes);
        for pose in &poses[..4] {
            assert!((pose.translation.x - 1.2).abs() < 1e-12);
            assert!((pose.rotation.angle() - 0.2).abs() < 1e-12);
        }
        let held = |frame: usize| eef[frame].inv_mul(&poses[frame]);
        assert!((held(3).to_homogeneous() - held(4).to_homogeneous()).norm() < 1e-12);
        assert_eq!(poses[5], poses[4]);
    }

    #[test]
    fn an_object_that_is_held_from_the_first_frame_on_is_where_it_is_seen() {
        let own = [at(1.0, 0.0), at(2.0, 0.0), at(3.0, 0.0)];
        let modes = [Mode::Transfer, Mode::Transfer, Mode::Transit];
        let poses = by_mode(&own, &own, &modes);
        assert_eq!(poses, [own[0], own[1], own[1]]);
    }
}

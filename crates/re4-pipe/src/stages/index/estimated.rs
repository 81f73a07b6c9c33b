//! Object poses of an index that come from pictures, and an audit that does without recorded ones.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use nalgebra::Isometry3;
use re4_artifact::{Artifact, col_u32, tables};
use re4_audit::{CHECKS, SpatialDemo};
use re4_segment::{SegmentConfig, segment_spatial};

use super::super::Runner;
use super::spatial::{check_names, read_poses};
use crate::poses::PARTS;

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
    pub(super) fn put_into(&self, demo: &mut SpatialDemo) -> Result<()> {
        let frames = demo.episode.frames.len();
        let (start, count) = self.rows.get(&demo.number).copied().unwrap_or_default();
        ensure!(
            count == frames,
            "cannot index: table spatial_poses of {} has {count} rows of episode {}, which has {frames} frames; the poses are those of other demonstrations, so train the encoder on these",
            self.path,
            demo.number
        );
        for (frame, pose) in demo.episode.frames.iter_mut().zip(&self.poses[start..start + count]) {
            frame.object = *pose;
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
        let mut last: BTreeMap<u32, u32> = BTreeMap::new();
        for finding in findings
            .iter()
            .filter(|finding| checks.iter().any(|check| check == finding.code))
        {
            let entry = last.entry(finding.episode).or_default();
            *entry = (*entry).max(finding.frames.end);
        }
        Ok(last)
    }
}

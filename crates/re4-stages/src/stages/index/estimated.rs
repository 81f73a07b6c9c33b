//! Estimated object poses for the index, and an audit that does not read recorded object poses.

use std::collections::BTreeMap;

use anyhow::Result;
use nalgebra::Isometry3;
use re4_artifact::{Artifact, Row as _, columns};
use re4_audit::{CHECKS, SpatialDemo};
use re4_fault::ensure;
use re4_pose::{PoseRow, SpatialEstimate, by_mode};
use re4_segment::{SegmentConfig, segment_spatial};

use super::spatial::{check_names, last_ends};
use crate::pipeline::Estimates;
use crate::runner::Runner;

/// The object poses of a `poses` artifact.
pub(super) struct EstimatedPoses {
    poses: Vec<Isometry3<f64>>,
    /// First row and number of rows by demonstration.
    rows: BTreeMap<u32, (usize, usize)>,
    path: String,
}

impl EstimatedPoses {
    /// Reads the poses of this artifact.
    ///
    /// # Errors
    /// If the rows are not sorted by episode and frame, or a frame is missing.
    pub(super) fn open(artifact: &Artifact) -> Result<Self> {
        columns! {
            /// The columns of table `poses` that are read.
            pub struct Posed {
                /// Demonstration.
                pub episode: u32,
                /// Frame.
                pub frame: u32,
                /// Estimated object pose.
                pub object: Isometry3<f64>,
            }
        }
        let poses: Vec<Posed> = artifact.table(PoseRow::<SpatialEstimate>::table())?.read()?;
        let mut rows: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
        for (row, &Posed { episode, frame, .. }) in poses.iter().enumerate() {
            let (start, count) = rows.entry(episode).or_insert((row, 0));
            ensure!(
                frame as usize == *count && *start + *count == row,
                "cannot index: table poses of {} is not sorted by episode and frame, or lacks a frame, at row {row} (episode {episode}, frame {frame})",
                artifact.path().display();
                "delete the poses artifact and train the encoder again"
            );
            *count += 1;
        }
        Ok(Self {
            poses: poses.iter().map(|row| row.object).collect(),
            rows,
            path: artifact.path().display().to_string(),
        })
    }

    /// Replaces the recorded object poses of a demonstration by the estimated ones.
    ///
    /// # Errors
    /// If the artifact was made from other demonstrations.
    pub(super) fn put_into(&self, demo: &mut SpatialDemo, estimates: Estimates) -> Result<()> {
        let frames = demo.episode.frames.len();
        let (start, count) = self.rows.get(&demo.number).copied().unwrap_or_default();
        ensure!(
            count == frames,
            "cannot index: table poses of {} has {count} rows for {}, which has {frames} frames",
            self.path,
            demo.episode.name;
            "train the encoder on these demonstrations, because the poses belong to other ones"
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
}

/// Returns an error if a `poses` artifact does not have the poses of exactly `demos` demonstrations.
pub(super) fn check_count(poses: &Artifact, demos: u64) -> Result<()> {
    columns! {
        /// The column of table `poses` that is read.
        pub struct NumberOf {
            /// Demonstration.
            pub episode: u32,
        }
    }
    let (mut count, mut last) = (0, None);
    // A process that makes some parts has verified only theirs.
    poses.verify_table(PoseRow::<SpatialEstimate>::table())?;
    for row in poses.table(PoseRow::<SpatialEstimate>::table())?.stream::<NumberOf>()? {
        let NumberOf { episode } = row?;
        count += u64::from(last.replace(episode) != Some(episode));
    }
    ensure!(
        count == demos,
        "cannot index: table poses of {} has {count} episodes, but there are {demos} demonstrations",
        poses.path().display();
        "train the encoder on these demonstrations, because the poses belong to other ones"
    );
    Ok(())
}

/// Replaces the recorded object pose by the end effector's pose. An object that always is at the end effector never leaves it, so
/// the checks of grasps depend only on the fingers.
fn without_object(mut demo: SpatialDemo, config: &SegmentConfig) -> Result<SpatialDemo> {
    for frame in &mut demo.episode.frames {
        frame.object = frame.eef;
    }
    demo.segmented = segment_spatial(&demo.episode, config)?;
    Ok(demo)
}

impl Runner {
    /// The end frame of the last finding of these checks, by demonstration, without reading recorded object poses.
    pub(super) fn left_out_by_fingers(
        &self,
        episodes: &Artifact,
        modes: &Artifact,
        checks: &[String],
    ) -> Result<BTreeMap<u32, u32>> {
        let known = CHECKS.iter().filter(|check| check.applies_to(re4_task::Domain::Space));
        check_names(checks, known.map(|check| check.code))?;
        let findings = self.findings(episodes, modes, &|demo| without_object(demo, &self.pipeline.segment))?;
        let ends = findings
            .iter()
            .map(|finding| (finding.code, finding.episode, finding.frames.end));
        Ok(last_ends(checks, ends))
    }
}

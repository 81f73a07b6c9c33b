//! Reads demonstrations of an arm without an object from artifacts, one at a time.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use re4_artifact::{Artifact, ByEpisode};
use re4_audit::ArmDemo;
use re4_fault::{OrFault as _, ensure, fault};
use re4_ingest::{ArmColumns, Convention, FrameRow, SignalRole, SignalRow, SignalVector};
use re4_segment::{
    ArmEpisode, ArmEvidence, ArmSegment, Gripper, GripperObservation, Known, ModeRow, Rule, SegmentConfig,
    SegmentError, SegmentRow, SegmentedArm,
};

use super::demos::Names;

/// The demonstrations of an `episodes` artifact, in order.
pub(crate) struct ArmEpisodes {
    rows: ByEpisode<FrameRow<ArmColumns>>,
    names: Names,
    path: PathBuf,
}

impl ArmEpisodes {
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
}

impl Iterator for ArmEpisodes {
    type Item = Result<(u32, ArmEpisode)>;

    fn next(&mut self) -> Option<Self::Item> {
        let rows = self.rows.next()?;
        Some(rows.map_err(Into::into).and_then(|(number, rows)| {
            let name = self.names.of(number).or_fault(|| {
                fault!(
                    "cannot read {}: table frames refers to demonstration {number}, which table demos does not contain",
                    self.path.display();
                    "delete the artifact and ingest the dataset again"
                )
            })?;
            let frames = rows.into_iter().map(|row| row.recorded).collect();
            Ok((number, ArmEpisode { name, frames }))
        }))
    }
}

/// The demonstrations of an `episodes` artifact with their segmentation from a `modes` artifact, in order.
pub(crate) struct SegmentedArms {
    episodes: ArmEpisodes,
    modes: ByEpisode<ModeRow<ArmEvidence>>,
    segments: ByEpisode<SegmentRow<ArmSegment>>,
}

impl SegmentedArms {
    /// Opens the tables of both artifacts.
    pub(crate) fn open(episodes: &Artifact, modes: &Artifact) -> Result<Self> {
        Ok(Self {
            episodes: ArmEpisodes::open(episodes)?,
            modes: ByEpisode::open(modes, |row: &ModeRow<_>| row.episode)?,
            segments: ByEpisode::open(modes, |row: &SegmentRow<_>| row.episode)?,
        })
    }

    fn join(&mut self, number: u32, episode: ArmEpisode) -> Result<ArmDemo> {
        let name = episode.name.clone();
        let missing = || {
            fault!(
                "the modes artifact does not match the demonstrations: {name} is not segmented";
                "delete the modes artifact and segment the dataset again"
            )
        };
        let (modes_of, modes) = self.modes.next().with_context(missing)??;
        let (segments_of, segments) = self.segments.next().with_context(missing)??;
        ensure!(
            modes_of == number && segments_of == number && modes.len() == episode.frames.len(),
            "{}",
            missing()
        );
        Ok(ArmDemo {
            number,
            episode,
            segmented: SegmentedArm::from_rows(modes, segments),
        })
    }
}

impl Iterator for SegmentedArms {
    type Item = Result<ArmDemo>;

    fn next(&mut self) -> Option<Self::Item> {
        let episode = self.episodes.next()?;
        Some(episode.and_then(|(number, episode)| self.join(number, episode)))
    }
}

/// The elements of the vectors of the frames; empty in an artifact without table `signals`.
pub(crate) fn signals(episodes: &Artifact) -> Result<Vec<SignalRow>> {
    if episodes.has::<SignalRow>() {
        Ok(episodes.read()?)
    } else {
        Ok(Vec::new())
    }
}

/// Frames per second, if the dataset states them.
pub(crate) fn rate(episodes: &Artifact) -> Option<f64> {
    episodes.manifest().summary["rate"].as_f64()
}

/// The meaning of the gripper's numbers, proven from all demonstrations. `None` if the arm has no gripper and the rule of
/// segmentation needs none.
pub(crate) fn gripper(episodes: &Artifact, config: &SegmentConfig) -> Result<Option<Gripper>> {
    let mut known = Known {
        rate: rate(episodes),
        ..Known::default()
    };
    if episodes.has::<Convention>() {
        let rows: Vec<Convention> = episodes.read()?;
        known.finger_distance = rows.iter().any(|row| &*row.value == "finger_distance");
    }
    let of_gripper = |row: &SignalRow| row.vector == SignalVector::State && row.role == SignalRole::Gripper;
    let rows = signals(episodes)?.into_iter().filter(of_gripper);
    known.names = rows.map(|row| row.name).collect();
    let observations = ArmEpisodes::open(episodes)?
        .map(|episode| Ok(GripperObservation::of(&episode?.1)))
        .collect::<Result<Vec<_>>>()?;
    match Gripper::prove(&observations, &known, &config.opening) {
        Ok(gripper) => Ok(Some(gripper)),
        // Without modes, the audit still makes the checks that need no gripper.
        Err(SegmentError::NothingOfGripper | SegmentError::ClosingUnknown { .. }) if config.rule != Rule::Gripper => {
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

//! The stage `index`: makes `index` from `episodes`, `modes` and, if poses are estimated, `poses`.

mod estimated;
mod spatial;

use std::collections::BTreeSet;

use anyhow::Result;
use re4_artifact::{Artifact, ArtifactSummary, Recipe, Row as _, Stage, Writer, columns};
use re4_episode::{Mode, PlanarFrame};
use re4_fault::ensure;
use re4_geometry::Pose2;
use re4_index::{AngleMetric, IndexRow, IndexedFrame, Normalization, PlanarState, ScaleRow};
use re4_policy::{DemoSet, collect_chunks};
use re4_pose::{Estimate, Flag, PoseRow, between_clear};
use re4_segment::{Evidence, ModeRow};
use serde_json::json;

use crate::inputs::episodes::{read_episodes, read_frames};
use crate::runner::{Built, Runner};

/// Increase it whenever the same input gives different bytes.
const CODE_VERSION: u32 = 4;

impl Runner {
    /// Makes the `index` artifact of Push-T, or returns the existing one. Object poses come from `poses` if it is given,
    /// otherwise from `episodes`.
    ///
    /// # Errors
    /// If an input cannot be read, a setting does not fit the input, or the run is interrupted.
    pub fn index(&self, episodes: &Built, modes: &Built, poses: Option<&Built>) -> Result<Built> {
        let longest_chunk = self.pipeline.index()?.longest_chunk;
        let mut recipe = Recipe::new(Stage::Index, CODE_VERSION)
            .config(&json!({
                "longest_chunk": longest_chunk,
                "pose": { "source": self.pipeline.pose()?.source },
            }))?
            .input("episodes", episodes.artifact.key())
            .input("modes", modes.artifact.key());
        if let Some(poses) = poses {
            recipe = recipe.input("poses", poses.artifact.key());
        }
        self.build(&recipe, |writer| {
            let estimated = poses
                .map(|poses| poses.artifact.read::<PoseRow<Estimate>>())
                .transpose()?;
            let (demos, mut frames, blanks) = read_demos(&episodes.artifact, &modes.artifact, estimated)?;
            // The ranges do not depend on how angles are compared; the policy chooses that when it opens the index.
            let normalization = Normalization::over(&frames, AngleMetric::default());
            write_index(&demos, &frames, &blanks, &normalization, writer)?;
            // The outcome of a chunk is measured with the poses of its frames, so chunks with an interpolated pose are dropped.
            let mut chunks = collect_chunks(&demos, longest_chunk as usize);
            chunks.retain(|chunk| {
                blanks
                    .range((chunk.demo, chunk.start)..=(chunk.demo, chunk.end))
                    .next()
                    .is_none()
            });
            writer.write_rows(chunks.iter().copied())?;
            frames.retain(|frame| !blanks.contains(&(frame.episode, frame.frame)));
            let summary = json!({
                "episodes": demos.iter().count(),
                "frames": frames.len(),
                "chunks": chunks.len(),
            });
            Ok(ArtifactSummary {
                summary,
                warnings: Vec::new(),
            })
        })
    }
}

/// Frames without a clear estimated pose, as (episode, frame).
type Blanks = BTreeSet<(u32, u32)>;

columns! {
    /// The column of table `modes` that is read.
    pub struct ModeOf {
        /// Mode of the frame.
        pub mode: Mode,
    }
}

/// Reads demonstrations and the modes of their frames. Estimated poses replace the recorded ones if they are given; frames
/// without a clear estimate get an interpolated pose and are returned as blanks. Demonstrations without any clear estimate are
/// dropped.
fn read_demos(
    episodes: &Artifact,
    modes: &Artifact,
    estimated: Option<Vec<PoseRow<Estimate>>>,
) -> Result<(DemoSet<PlanarFrame>, Vec<IndexedFrame>, Blanks)> {
    let mut labels = modes.table(ModeRow::<Evidence>::table())?.stream::<ModeOf>()?;
    let mut poses = estimated.map(Vec::into_iter);
    let mut blanks = Blanks::new();
    let (mut demos, mut indexed) = (Vec::new(), Vec::new());
    let recorded = if poses.is_some() {
        read_frames(episodes)?
    } else {
        read_episodes(episodes)?
    };
    for (number, mut episode) in (0..).zip(recorded) {
        let count = episode.frames.len();
        let modes_of = labels
            .by_ref()
            .take(count)
            .map(|row| Ok(row?.mode))
            .collect::<Result<Vec<Mode>>>()?;
        ensure!(
            modes_of.len() == count,
            "cannot read {}: table modes has fewer frames than the episodes", modes.path().display();
            "delete the artifact and run again"
        );
        if let Some(poses) = &mut poses {
            let clear = |row: PoseRow<Estimate>| row.estimate.pose.filter(|_| row.estimate.flag == Flag::Clear);
            let known: Vec<Option<Pose2>> = poses.by_ref().take(count).map(clear).collect();
            ensure!(
                known.len() == count,
                "cannot index {}: it has more frames than the poses artifact", episodes.path().display();
                "delete the poses artifact and run again"
            );
            blanks.extend(
                (0..)
                    .zip(&known)
                    .filter(|(_, pose)| pose.is_none())
                    .map(|(frame, _)| (number, frame)),
            );
            let Some(filled) = between_clear(&known) else {
                continue;
            };
            for (frame, pose) in episode.frames.iter_mut().zip(filled) {
                frame.object = pose;
            }
        }
        let frames = (0..).zip(episode.frames.iter().zip(modes_of));
        indexed.extend(frames.map(|(frame, (row, mode))| IndexedFrame {
            episode: number,
            frame,
            mode,
            eef: row.eef,
            object: row.object,
        }));
        demos.push((number, episode.frames));
    }
    ensure!(
        !demos.is_empty(),
        "cannot index {}: no frame has a clear pose", episodes.path().display();
        "inspect the table poses with re4-pipe inspect"
    );
    Ok((DemoSet::new(demos), indexed, blanks))
}

fn write_index(
    demos: &DemoSet<PlanarFrame>,
    frames: &[IndexedFrame],
    blanks: &Blanks,
    normalization: &Normalization,
    writer: &Writer,
) -> Result<()> {
    let actions = demos.iter().flat_map(|(_, frames)| frames).map(|frame| frame.action);
    writer.write_rows(frames.iter().zip(actions).map(|(frame, action)| IndexRow {
        episode: frame.episode,
        frame: frame.frame,
        mode: frame.mode,
        state: PlanarState {
            eef: frame.eef,
            object: frame.object,
            action,
            q: normalization.frame(frame),
        },
        retrievable: Some(!blanks.contains(&(frame.episode, frame.frame))),
    }))?;
    let scales = Normalization::DIMENSIONS.into_iter().zip(normalization.ranges);
    writer.write_rows(scales.map(|(dimension, range)| ScaleRow {
        dimension: dimension.to_owned(),
        minimum: range.minimum,
        maximum: range.maximum,
    }))?;
    Ok(())
}

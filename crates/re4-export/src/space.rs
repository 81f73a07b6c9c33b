//! Reads episodes of robosuite's tasks.

use anyhow::Result;
use nalgebra::{Isometry3, Quaternion, Unit};
use re4_artifact::{ByEpisode, Row as _};
use re4_fault::ensure;
use re4_ingest::{FrameRow, SpatialColumns};
use re4_rollout::{SpaceDecisionRow, SpaceResultRow, SpaceStepRow};

use crate::inputs::{Inputs, Kind};
use crate::plane::followed;
use crate::take::{Rolled, Take, seed_name};

/// A frame of a robosuite task.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SpaceFrame {
    /// The state and the action that follows. Rollouts have no delta actions; theirs are zero.
    pub(crate) recorded: SpatialColumns,
    /// Whether the task succeeds after the action; only known in rollouts.
    pub(crate) success: Option<bool>,
}

/// Calls `take` with one kept episode after the other.
pub(crate) fn read(inputs: &Inputs, mut take: impl FnMut(Take<SpaceFrame>) -> Result<()>) -> Result<()> {
    match inputs.kind {
        Kind::Episodes => {
            let names = inputs.demo_names()?;
            for rows in ByEpisode::open(&inputs.artifact, |row: &FrameRow<SpatialColumns>| row.episode)? {
                let (number, rows) = rows?;
                let name = names.get(number as usize).cloned().unwrap_or_default();
                if !inputs.keeps(&name, None) {
                    continue;
                }
                let frame = |row: FrameRow<SpatialColumns>| SpaceFrame {
                    recorded: row.recorded,
                    success: None,
                };
                take(Take {
                    number,
                    name,
                    rolled: None,
                    frames: rows.into_iter().map(frame).collect(),
                })?;
            }
            Ok(())
        }
        Kind::Rollouts => rollouts(inputs, take),
    }
}

fn rollouts(inputs: &Inputs, mut take: impl FnMut(Take<SpaceFrame>) -> Result<()>) -> Result<()> {
    let artifact = &inputs.artifact;
    let mut steps = artifact.table(SpaceStepRow::table())?.stream::<SpaceStepRow>()?;
    let mut decisions = artifact
        .table(SpaceDecisionRow::table())?
        .stream::<SpaceDecisionRow>()?;
    for result in artifact.table(SpaceResultRow::table())?.stream::<SpaceResultRow>()? {
        let result = result?;
        let core = result.core;
        let steps: Vec<SpaceStepRow> = steps.by_ref().take(core.steps as usize).collect::<Result<_, _>>()?;
        let decided: Vec<SpaceDecisionRow> = decisions
            .by_ref()
            .take(core.decisions as usize)
            .collect::<Result<_, _>>()?;
        ensure!(
            steps.len() == core.steps as usize && steps.iter().all(|step| step.core.seed == core.seed),
            "table steps of {} does not have the {} steps of seed {}", artifact.path().display(), core.steps, core.seed;
            "delete the artifact and roll out again"
        );
        if !inputs.keeps(&seed_name(core.seed), Some(core.success)) {
            continue;
        }
        // The state after a reset has no pose of the grip site with an orientation, so the first frame is that after the first step.
        let frames: Vec<SpaceFrame> = steps
            .iter()
            .zip(steps.iter().skip(1))
            .map(|(before, step)| SpaceFrame {
                recorded: SpatialColumns {
                    eef: before.eef,
                    object: Some(before.object),
                    fingers: before.finger,
                    delta: re4_artifact::SixAxis::default(),
                    goal: step.action,
                    gripper: step.gripper,
                    reward: Some(f64::from(u8::from(step.success))),
                    done: Some(step.success),
                    raw_eef: None,
                    raw_gripper: None,
                },
                success: Some(step.success),
            })
            .collect();
        if frames.is_empty() {
            continue;
        }
        let followed = followed(
            steps.iter().skip(1).map(|step| step.core.decision),
            decided.iter().map(|row| &row.core),
        );
        take(Take {
            number: core.episode,
            name: seed_name(core.seed),
            rolled: Some(Rolled {
                seed: core.seed,
                success: core.success,
                followed,
            }),
            frames,
        })?;
    }
    Ok(())
}

/// Position and quaternion x, y, z, w of a pose.
pub(crate) fn seven(pose: &Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation, quaternion(&pose.rotation));
    [t.x, t.y, t.z, q[0], q[1], q[2], q[3]]
}

/// The quaternion x, y, z, w, bit for bit.
pub(crate) fn quaternion(rotation: &Unit<Quaternion<f64>>) -> [f64; 4] {
    let q = rotation.quaternion().coords;
    [q.x, q.y, q.z, q.w]
}

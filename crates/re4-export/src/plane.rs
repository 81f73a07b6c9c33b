//! Reads episodes of Push-T.

use anyhow::Result;
use re4_artifact::{Artifact, ByEpisode, Row as _, columns};
use re4_fault::ensure;
use re4_geometry::{Point2, Pose2};
use re4_ingest::{FrameRow, PlanarColumns};
use re4_rollout::{PlaneDecisionRow, PlaneResultRow, PlaneStepRow, ResultCore};

use crate::inputs::{Inputs, Kind};
use crate::take::{Followed, Rolled, Take, seed_name};

/// A frame of Push-T: the state and the action that follows. Positions and angles are in the world frame, px and rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlaneFrame {
    pub(crate) eef: Point2,
    pub(crate) object: Option<Pose2>,
    pub(crate) action: Point2,
    pub(crate) contacts: Option<f64>,
    /// Score and coverage after the action; only known in rollouts.
    pub(crate) after: Option<(f64, f64)>,
}

columns! {
    /// The columns of table `frames` that are exported.
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

columns! {
    /// The columns of table `results` that all tasks have.
    pub struct Seeds {
        /// Result of the rollout.
        #[prefix = ""]
        pub core: ResultCore,
    }
}

/// The seeds of all rollouts of any task, in their order.
pub(crate) fn seeds(rollouts: &Artifact) -> Result<Vec<u32>> {
    let table = match rollouts.table(PlaneResultRow::table()) {
        Ok(table) => table,
        Err(_) => rollouts.table(re4_rollout::SpaceResultRow::table())?,
    };
    Ok(table.read::<Seeds>()?.into_iter().map(|row| row.core.seed).collect())
}

/// Calls `take` with one kept episode after the other.
pub(crate) fn read(inputs: &Inputs, mut take: impl FnMut(Take<PlaneFrame>) -> Result<()>) -> Result<()> {
    match inputs.kind {
        Kind::Episodes => {
            let names = inputs.demo_names()?;
            let table = inputs.artifact.table(FrameRow::<PlanarColumns>::table())?;
            for rows in ByEpisode::of(&table, |row: &Recorded| row.episode)? {
                let (number, rows) = rows?;
                let name = names.get(number as usize).cloned().unwrap_or_default();
                if !inputs.keeps(&name, None) {
                    continue;
                }
                let frames = rows.iter().map(|row| PlaneFrame {
                    eef: row.eef,
                    object: row.object,
                    action: row.action,
                    contacts: row.contacts,
                    after: None,
                });
                take(Take {
                    number,
                    name,
                    rolled: None,
                    frames: frames.collect(),
                })?;
            }
            Ok(())
        }
        Kind::Rollouts => rollouts(inputs, take),
    }
}

fn rollouts(inputs: &Inputs, mut take: impl FnMut(Take<PlaneFrame>) -> Result<()>) -> Result<()> {
    let artifact = &inputs.artifact;
    let mut steps = artifact.table(PlaneStepRow::table())?.stream::<PlaneStepRow>()?;
    let mut decisions = artifact
        .table(PlaneDecisionRow::table())?
        .stream::<PlaneDecisionRow>()?;
    for result in artifact.table(PlaneResultRow::table())?.stream::<PlaneResultRow>()? {
        let result = result?;
        let core = result.core;
        let steps: Vec<PlaneStepRow> = steps.by_ref().take(core.steps as usize).collect::<Result<_, _>>()?;
        let decided: Vec<PlaneDecisionRow> = decisions
            .by_ref()
            .take(core.decisions as usize)
            .collect::<Result<_, _>>()?;
        ensure!(
            steps.len() == core.steps as usize && steps.iter().all(|step| step.core.seed == core.seed),
            "table steps of {} does not have the {} steps of seed {}", artifact.path().display(), core.steps, core.seed;
            "delete the artifact and roll out again"
        );
        if !inputs.keeps(&seed_name(core.seed), Some(core.success)) || steps.is_empty() {
            continue;
        }
        let mut before = (result.eef, result.object, result.contacts);
        let mut frames = Vec::with_capacity(steps.len());
        for step in &steps {
            frames.push(PlaneFrame {
                eef: before.0,
                object: Some(before.1),
                action: step.action,
                contacts: Some(before.2),
                after: Some((step.score, step.coverage)),
            });
            before = (step.eef, step.object, step.contacts);
        }
        let cores = decided.iter().map(|row| &row.core);
        let followed = followed(steps.iter().map(|step| step.core.decision), cores);
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

/// The decision of each step.
pub(crate) fn followed<'a>(
    steps: impl Iterator<Item = u32>,
    decisions: impl Iterator<Item = &'a re4_rollout::DecisionCore>,
) -> Vec<Followed> {
    let decisions: Vec<_> = decisions.collect();
    steps
        .map(|decision| Followed {
            decision,
            demo: decisions
                .get(decision as usize)
                .and_then(|core| core.demo.zip(core.demo_frame)),
        })
        .collect()
}

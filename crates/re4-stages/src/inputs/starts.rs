//! Reads the start scenes of rollouts from a `scenes` artifact.

use anyhow::Result;
use re4_artifact::Artifact;
use re4_rollout::{Plane, PlaneScene, Start};
use re4_scenes::SceneRow;
use re4_sim::{GOAL, ResetOrder, Scene};

/// The scenes of a `scenes` artifact. The number of a scene takes the place of a seed.
pub(crate) fn read_starts(artifact: &Artifact) -> Result<Vec<Start<Plane>>> {
    let starts = artifact.read::<SceneRow>()?.into_iter().map(|row| Start {
        seed: row.scene,
        scene: PlaneScene {
            state: Scene {
                agent: row.chosen.agent,
                block: row.chosen.block,
            },
            order: ResetOrder::PoseIsPose,
            goal: GOAL,
        },
    });
    Ok(starts.collect())
}

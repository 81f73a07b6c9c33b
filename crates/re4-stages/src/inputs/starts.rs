//! Where rollouts start, out of a `scenes` artifact.

use anyhow::Result;
use re4_artifact::{Artifact, col_f64, col_u32, tables};
use re4_geometry::{Point2, Pose2};
use re4_rollout::{Plane, PlaneScene, Start};
use re4_sim::{ResetOrder, Scene};

/// Where the rollouts of a `scenes` artifact start.
pub(crate) fn read_starts(artifact: &Artifact) -> Result<Vec<Start<Plane>>> {
    let table = artifact.table(&tables::SCENES)?.read_all()?;
    let column = |name| col_f64(&table, name);
    let (agent_x, agent_y) = (column("agent_x")?, column("agent_y")?);
    let (x, y, theta) = (column("block_x")?, column("block_y")?, column("block_theta")?);
    let starts = col_u32(&table, "scene")?.iter().enumerate().map(|(i, &seed)| Start {
        seed,
        scene: PlaneScene {
            state: Scene {
                agent: Point2::new(agent_x[i], agent_y[i]),
                block: Pose2::new(x[i], y[i], theta[i]),
            },
            order: ResetOrder::PoseIsPose,
        },
    });
    Ok(starts.collect())
}

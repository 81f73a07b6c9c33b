//! What the policy of robosuite's tasks searches, out of an `index` artifact.

use std::collections::BTreeSet;

use anyhow::Result;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::Row as _;
use re4_artifact::{Artifact, col_bool, col_f64, col_text, col_u32};
use re4_episode::Mode;
use re4_fault::{OrFault as _, fault};
use re4_geometry::spatial::Symmetry;
use re4_policy::DemoNames;
use re4_policy::spatial::{SpatialDemoFrame, SpatialDemoSet, SpatialKnowledge, SpatialRetrieveConfig};

use super::poses::read_poses;

/// What a policy needs of an `index` artifact, whose demonstrations have these names.
pub(crate) fn open_spatial_index(
    artifact: &Artifact,
    retrieve: &SpatialRetrieveConfig,
    symmetry: Symmetry,
    names: DemoNames,
) -> Result<SpatialKnowledge> {
    let table = artifact
        .table(re4_index::IndexRow::<re4_index::SpatialState>::table())?
        .read_all()?;
    let column = |name: &str| col_f64(&table, name);
    let (eef, object) = (read_poses(&table, "eef")?, read_poses(&table, "object")?);
    let goals = ["x", "y", "z", "rx", "ry", "rz"]
        .iter()
        .map(|part| column(&format!("goal_{part}")))
        .collect::<Result<Vec<_>, _>>()?;
    let gripper = column("gripper")?;
    let (episode, frame) = (col_u32(&table, "episode")?, col_u32(&table, "frame")?);
    let retrievable = col_bool(&table, "retrievable")?;
    let modes = col_text(&table, "mode")?;
    let mut demos: Vec<(u32, Vec<SpatialDemoFrame>)> = Vec::new();
    let mut excluded = BTreeSet::new();
    for i in 0..episode.len() {
        let mode = modes[i].and_then(Mode::from_name).or_fault(|| {
            fault!(
                "cannot read {}: table spatial_index has an unknown mode in row {i}", artifact.path().display();
                "build it again"
            )
        })?;
        if !retrievable.value(i) {
            excluded.insert((episode[i], frame[i]));
        }
        let row = SpatialDemoFrame {
            eef: eef[i],
            object: object[i],
            goal: Isometry3::from_parts(
                Translation3::new(goals[0][i], goals[1][i], goals[2][i]),
                UnitQuaternion::from_scaled_axis(Vector3::new(goals[3][i], goals[4][i], goals[5][i])),
            ),
            gripper: gripper[i],
            mode,
        };
        match demos.last_mut().filter(|(number, _)| *number == episode[i]) {
            Some((_, frames)) => frames.push(row),
            None => demos.push((episode[i], vec![row])),
        }
    }
    Ok(SpatialKnowledge::new(
        SpatialDemoSet::new(demos).with_names(names),
        retrieve,
        symmetry,
        |demo, frame| excluded.contains(&(demo, frame)),
    )?)
}

//! Poses in space as columns of tables.

use anyhow::Result;
use arrow::record_batch::RecordBatch;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use re4_artifact::{Columns, col_f64};

/// Parts of a pose, as the names of columns end: position in metres, then a unit quaternion.
pub(crate) const PARTS: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];

/// Numbers of a pose in the order of [`PARTS`].
pub(crate) fn numbers(pose: &Isometry3<f64>) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// The pose that [`numbers`] are of. The quaternion is taken as it is, sign and all.
pub(crate) fn from_numbers([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz)),
    )
}

/// Adds the seven columns of poses, whose names begin with `prefix`.
pub(crate) fn pose_columns(columns: Columns, prefix: &str, poses: &[Isometry3<f64>]) -> Columns {
    let mut columns = columns;
    for (k, part) in PARTS.into_iter().enumerate() {
        columns = columns.f64(
            &format!("{prefix}_{part}"),
            poses.iter().map(|pose| numbers(pose)[k]).collect(),
        );
    }
    columns
}

/// Poses of seven columns each, whose names begin with `prefix`.
pub(crate) fn read_poses(table: &RecordBatch, prefix: &str) -> Result<Vec<Isometry3<f64>>> {
    let parts = PARTS
        .iter()
        .map(|part| col_f64(table, &format!("{prefix}_{part}")))
        .collect::<Result<Vec<_>, _>>()?;
    Ok((0..table.num_rows())
        .map(|i| {
            let part = |k: usize| parts[k][i];
            from_numbers(std::array::from_fn(part))
        })
        .collect())
}

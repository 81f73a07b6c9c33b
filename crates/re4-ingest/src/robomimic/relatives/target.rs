//! How far an object's target moves between demonstrations.

use nalgebra::Isometry3;

use super::super::interpret::Prepared;

/// Differences between demonstrations (metres, radians) below which a target counts as fixed.
const FIXED: (f64, f64) = (2e-3, 0.02);

/// A warning if the target stands at different poses in the demonstrations. Reframe replays a transfer in the world frame.
pub(super) fn spread(first: &[Prepared], target: &str) -> Option<String> {
    let poses: Vec<Isometry3<f64>> = first.iter().filter_map(|prepared| of(prepared, target)).collect();
    let (mut distance, mut angle) = (0.0_f64, 0.0_f64);
    for (place, pose) in poses.iter().enumerate() {
        for other in &poses[place + 1..] {
            distance = distance.max((pose.translation.vector - other.translation.vector).norm());
            angle = angle.max(pose.rotation.angle_to(&other.rotation));
        }
    }
    (distance > FIXED.0 || angle > FIXED.1).then(|| {
        format!(
            "the target {target} stands up to {distance:.3} m and {:.1} degrees apart in the first {} demonstrations; the policies replay a transfer to where its demonstration ended in the world, so they do not follow a target that moves",
            angle.to_degrees(),
            poses.len()
        )
    })
}

/// Pose of the target in the first frame of a demonstration.
fn of(prepared: &Prepared, target: &str) -> Option<Isometry3<f64>> {
    let recorded = prepared
        .demo
        .datagen
        .as_ref()
        .and_then(|datagen| datagen.object(target));
    if let Some(poses) = recorded {
        return poses.first().copied();
    }
    let (model, states) = (prepared.model.as_deref()?, prepared.demo.states.as_ref()?);
    let row = states.values.get(..states.columns)?;
    let poses = model.body_poses(target, std::iter::once(row)).ok().flatten()?;
    poses.first().copied()
}

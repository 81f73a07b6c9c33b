//! Poses of a demonstration's frames from the estimates of all of its frames.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use re4_episode::Mode;
use re4_geometry::{Pose2, wrap_to_pi};
use re4_stats::upper_median;

/// Fills the gaps of a sequence of poses. Between two known poses, position and angle are interpolated linearly, the angle along
/// the shorter arc. Frames before the first known pose get that pose, frames after the last one get the last. Returns `None` if no
/// pose is known.
pub fn between_clear(known: &[Option<Pose2>]) -> Option<Vec<Pose2>> {
    let clear: Vec<(usize, Pose2)> = known
        .iter()
        .enumerate()
        .filter_map(|(i, pose)| Some((i, (*pose)?)))
        .collect();
    let (first, last) = (clear.first()?, clear.last()?);
    let at = |i: usize| {
        let after = clear.partition_point(|(frame, _)| *frame < i);
        match (
            after.checked_sub(1).and_then(|before| clear.get(before)),
            clear.get(after),
        ) {
            (_, Some((frame, pose))) if *frame == i => *pose,
            (Some((from, a)), Some((to, b))) => {
                let fraction = (i - from) as f64 / (to - from) as f64;
                let rotation = wrap_to_pi(b.theta - a.theta);
                let between = |a: f64, b: f64| a + fraction * (b - a);
                Pose2::new(between(a.x, b.x), between(a.y, b.y), a.theta + fraction * rotation).normalized()
            }
            (None, _) => first.1,
            (_, None) => last.1,
        }
    };
    Some((0..known.len()).map(at).collect())
}

/// Maximum number of orientations of a median, whose cost is quadratic.
const MEDIAN_SAMPLES: usize = 64;

/// Combines the estimates of a demonstration's frames by mode. Before a grasp the object is at rest, at the median of the
/// estimates of these frames. From the grasp on it moves with the gripper. After the last release it is at rest where it was
/// released.
///
/// `own` are the estimates, `eef` the end effector's poses, both in the world frame.
pub fn by_mode(own: &[Isometry3<f64>], eef: &[Isometry3<f64>], modes: &[Mode]) -> Vec<Isometry3<f64>> {
    let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(own.len());
    for run in modes.chunk_by(|a, b| a == b) {
        let frames = poses.len()..poses.len() + run.len();
        let last = poses.last().copied();
        match (run[0], last) {
            // The object moves rigidly with the gripper from the frame before the change of mode.
            (Mode::Transfer, Some(last)) => {
                let held = eef[frames.start].inv_mul(&last);
                poses.extend(frames.map(|frame| eef[frame] * held));
            }
            (Mode::Transit, Some(last)) if frames.end == own.len() => poses.extend(frames.map(|_| last)),
            (Mode::Transit, _) => {
                let rests = median(&own[frames.clone()]);
                poses.extend(frames.map(|_| rests));
            }
            // Grasped from the first frame: there is no earlier estimate to carry along, so the frames keep their own.
            (Mode::Transfer, None) => poses.extend_from_slice(&own[frames]),
        }
    }
    poses
}

/// The median of each coordinate, and the orientation with the minimum sum of angles to the others (a geodesic medoid).
fn median(poses: &[Isometry3<f64>]) -> Isometry3<f64> {
    let coordinate = |k: usize| upper_median(poses.iter().map(|pose| pose.translation.vector[k])).unwrap_or_default();
    let step = poses.len().div_ceil(MEDIAN_SAMPLES);
    let sample: Vec<_> = poses.iter().step_by(step).map(|pose| pose.rotation).collect();
    let total_angle = |one: &UnitQuaternion<f64>| sample.iter().map(|other| one.angle_to(other)).sum::<f64>();
    let medoid = sample
        .iter()
        .min_by(|a, b| total_angle(a).total_cmp(&total_angle(b)))
        .copied()
        .unwrap_or_default();
    Isometry3::from_parts(Translation3::new(coordinate(0), coordinate(1), coordinate(2)), medoid)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, yaw: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(x, 0.0, 0.0),
            UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), yaw),
        )
    }

    #[test]
    fn the_object_rests_before_the_grasp_and_then_moves_with_the_gripper() {
        let (transit, transfer) = (Mode::Transit, Mode::Transfer);
        let modes = [transit, transit, transit, transfer, transfer, transit];
        // The second estimate is an outlier, rotated by about pi; the estimates from the grasp on are wrong too.
        let own = [
            at(1.0, 0.1),
            at(9.0, 3.1),
            at(1.2, 0.2),
            at(5.0, 1.0),
            at(6.0, 1.0),
            at(7.0, 1.0),
        ];
        let eef = [
            at(0.0, 0.0),
            at(0.5, 0.0),
            at(1.0, 0.0),
            at(1.0, 0.0),
            at(3.0, 0.5),
            at(3.0, 0.5),
        ];
        let poses = by_mode(&own, &eef, &modes);
        for pose in &poses[..4] {
            assert!((pose.translation.x - 1.2).abs() < 1e-12);
            assert!((pose.rotation.angle() - 0.2).abs() < 1e-12);
        }
        let held = |frame: usize| eef[frame].inv_mul(&poses[frame]);
        assert!((held(3).to_homogeneous() - held(4).to_homogeneous()).norm() < 1e-12);
        assert_eq!(poses[5], poses[4]);
    }

    #[test]
    fn an_object_that_is_held_from_the_first_frame_keeps_its_estimates() {
        let own = [at(1.0, 0.0), at(2.0, 0.0), at(3.0, 0.0)];
        let modes = [Mode::Transfer, Mode::Transfer, Mode::Transit];
        let poses = by_mode(&own, &own, &modes);
        assert_eq!(poses, [own[0], own[1], own[1]]);
    }
}

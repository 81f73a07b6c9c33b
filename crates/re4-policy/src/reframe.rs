//! Reframe: transforms the retrieved chunk to the object pose of the query (paper, Algorithm 2).

use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};

/// The transformation of a chunk to the query: where it starts and how its actions are transformed.
#[derive(Debug, Clone, PartialEq)]
pub struct Reframed {
    /// δ = `o_q · o_j⁻¹`, the motion in the world frame from the demonstration's object pose to the query's.
    pub delta: Pose2,
    /// End-effector position at which the chunk starts, in the world frame, in pixels.
    pub near: Point2,
    /// Motion that transforms end-effector positions and actions of the demonstration to the query.
    pub carry: Pose2,
}

/// Reframes a chunk that starts with the object at `demo_object` and the end effector at `demo_eef`, for a query with the object
/// at `object` and the end effector at `eef`. World frame, pixels and radians.
///
/// * Transit: the object is fixed in the world. The chunk is transformed by δ, so that `o_q⁻¹ x_near = o_j⁻¹ x_j`, and every
///   action `a_k` becomes `δ a_k`.
/// * Transfer: the object is held and the goal is fixed in the world. The end effector moves by δ⁻¹ to the start, and the actions
///   stay unchanged.
pub fn reframe(mode: Mode, demo_object: Pose2, demo_eef: Point2, object: Pose2, eef: Point2) -> Reframed {
    let delta = object.delta_from(demo_object);
    match mode {
        Mode::Transit => Reframed {
            delta,
            near: delta.transform_point(demo_eef),
            carry: delta,
        },
        Mode::Transfer => Reframed {
            delta,
            near: delta.inverse().transform_point(eef),
            carry: Pose2::IDENTITY,
        },
    }
}

/// Returns the identity transformation, which is used if Reframe is disabled: the chunk is replayed where it was recorded.
pub fn without_reframe(demo_eef: Point2) -> Reframed {
    Reframed {
        delta: Pose2::IDENTITY,
        near: demo_eef,
        carry: Pose2::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (0.0..512.0f64, 0.0..512.0f64, -7.0..7.0f64).prop_map(|(x, y, t)| Pose2::new(x, y, t))
    }

    fn point() -> impl Strategy<Value = Point2> {
        (0.0..512.0f64, 0.0..512.0f64).prop_map(|(x, y)| Point2::new(x, y))
    }

    proptest! {
        #[test]
        fn transit_keeps_the_object_relative_position(oj in pose(), xj in point(), oq in pose(), xq in point()) {
            let r = reframe(Mode::Transit, oj, xj, oq, xq);
            let kept = oq.inverse_transform_point(r.near) - oj.inverse_transform_point(xj);
            prop_assert!(kept.norm() < 1e-8);
        }

        #[test]
        fn transfer_moves_the_held_object_to_the_pose_of_the_demonstration(oj in pose(), xj in point(), oq in pose(), xq in point()) {
            let r = reframe(Mode::Transfer, oj, xj, oq, xq);
            // The grasp is preserved: the end effector has the same pose relative to the demonstration's object as it has
            // relative to the query's.
            let kept = oj.inverse_transform_point(r.near) - oq.inverse_transform_point(xq);
            prop_assert!(kept.norm() < 1e-8);
            prop_assert_eq!(r.carry, Pose2::IDENTITY);
        }

        #[test]
        fn reframing_to_the_same_object_changes_nothing(oj in pose(), xj in point()) {
            let r = reframe(Mode::Transit, oj, xj, oj, xj);
            prop_assert!((r.near - xj).norm() < 1e-9);
        }
    }
}

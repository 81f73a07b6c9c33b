//! Reframe: the retrieved chunk, carried into the frame of the query's object (paper, Algorithm 2).

use re4_episode::Mode;
use re4_geometry::{Point2, Pose2};

/// A chunk carried to the query: where it starts and what it commands.
#[derive(Debug, Clone, PartialEq)]
pub struct Reframed {
    /// δ = `o_q · o_j⁻¹`, the world-frame motion from the demonstration's object to the query's.
    pub delta: Pose2,
    /// End-effector set-point at which the chunk starts, world frame, pixels.
    pub near: Point2,
    /// Motion that carries the demonstration's end-effector positions and actions into the query's world.
    pub carry: Pose2,
}

/// Reframes a chunk that starts with the object at `demo_object` and the end effector at `demo_eef`.
///
/// * Transit: the object is fixed in the world; the chunk is carried by δ, so that
///   `o_q⁻¹ x_near = o_j⁻¹ x_j` and every action becomes `δ a_k`.
/// * Transfer: the object is held and the goal is fixed in the world; the end effector is carried by δ⁻¹ and the chunk
///   replays unchanged.
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

/// What Reframe amounts to when it is switched off: the demonstration's own world is taken for the query's.
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
        fn transfer_carries_the_held_object_onto_the_demonstration(oj in pose(), xj in point(), oq in pose(), xq in point()) {
            let r = reframe(Mode::Transfer, oj, xj, oq, xq);
            // The grasp stays: seen from the demonstration's object, our end effector is where it is on our object.
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

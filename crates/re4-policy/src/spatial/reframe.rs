//! Reframe in SE(3): transforms the retrieved chunk to the object pose of the query (paper, Algorithm 2).

use nalgebra::Isometry3;
use re4_episode::Mode;

use crate::spatial::config::TransferReplay;

/// The transformation of a chunk to the query: where it starts and how its goals are transformed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carry {
    /// δ = `o_q o_j⁻¹`, the motion in the world frame from the demonstration's object pose to the query's.
    pub delta: Isometry3<f64>,
    /// End-effector pose at which the chunk starts, in the world frame.
    pub near: Isometry3<f64>,
    /// Left factor of a transformed goal.
    left: Isometry3<f64>,
    /// Right factor of a transformed goal.
    right: Isometry3<f64>,
}

impl Carry {
    /// Transforms a recorded goal to the goal to command.
    pub fn goal(&self, recorded: &Isometry3<f64>) -> Isometry3<f64> {
        self.left * recorded * self.right
    }
}

/// Reframes a chunk that starts with the object at `o_j` and the end effector at `x_j`, for a query with the object at `o_q` and
/// the end effector at `x_q`. For an object with a symmetry, `o_q` must be the symmetry-equivalent pose that is aligned with
/// `o_j` (`re4_geometry::spatial::SymmetryGroup::align`). All poses are in the world frame. Let `a_k` be a recorded goal:
///
/// * Transit: the object is fixed in the world, and the chunk is transformed by δ. `x_near = δ x_j`, so that
///   `o_q⁻¹ x_near = o_j⁻¹ x_j`, and `a_k` becomes `δ a_k`.
/// * Transfer: the object is held, and the goal is fixed in the world. `x_near = δ⁻¹ x_q` is the end-effector pose at which the
///   held object, in its current grasp, is at the object pose of the demonstration: `x_near x_q⁻¹ o_q = o_j`. Then `a_k` stays
///   unchanged (`verbatim`), or becomes `a_k (x_j⁻¹ o_j) (o_q⁻¹ x_q)` (`grasp_corrected`), which moves the held object to where
///   `a_k` moves the demonstration's object.
pub fn reframe_spatial(
    mode: Mode,
    transfer: TransferReplay,
    (o_j, x_j): (&Isometry3<f64>, &Isometry3<f64>),
    (o_q, x_q): (&Isometry3<f64>, &Isometry3<f64>),
) -> Carry {
    let identity = Isometry3::identity();
    let delta = o_q * o_j.inverse();
    match mode {
        Mode::Transit => Carry {
            delta,
            near: delta * x_j,
            left: delta,
            right: identity,
        },
        Mode::Transfer => Carry {
            delta,
            near: o_j * o_q.inv_mul(x_q),
            left: identity,
            right: match transfer {
                TransferReplay::Verbatim => identity,
                TransferReplay::GraspCorrected => x_j.inv_mul(o_j) * o_q.inv_mul(x_q),
            },
        },
    }
}

/// Returns the identity transformation, which is used if Reframe is disabled: the chunk is replayed where it was recorded.
pub fn without_reframe_spatial(x_j: &Isometry3<f64>) -> Carry {
    let identity = Isometry3::identity();
    Carry {
        delta: identity,
        near: *x_j,
        left: identity,
        right: identity,
    }
}

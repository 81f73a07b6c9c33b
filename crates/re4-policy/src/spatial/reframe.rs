//! Reframe in SE(3): the retrieved chunk, carried into the frame of the query's object (paper, Algorithm 2).

use nalgebra::Isometry3;
use re4_episode::Mode;

use crate::spatial::config::TransferReplay;

/// A chunk carried to the query: where it starts and what it commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carry {
    /// δ = `o_q o_j⁻¹`, the world-frame motion from the demonstration's object to the query's.
    pub delta: Isometry3<f64>,
    /// End-effector set-point at which the chunk starts, world frame.
    pub near: Isometry3<f64>,
    /// What a recorded goal is multiplied by from the left.
    left: Isometry3<f64>,
    /// What a recorded goal is multiplied by from the right.
    right: Isometry3<f64>,
}

impl Carry {
    /// The goal to command where the demonstration commanded `recorded`.
    pub fn goal(&self, recorded: &Isometry3<f64>) -> Isometry3<f64> {
        self.left * recorded * self.right
    }
}

/// Reframes a chunk that starts with the object at `o_j` and the end effector at `x_j`, for a query with the object at `o_q`
/// and the end effector at `x_q`. Where the object looks the same after some turns, `o_q` is its pose aligned with `o_j`
/// (`re4_geometry::spatial::SymmetryGroup::align`). With `a_k` a recorded goal:
///
/// * Transit: the object rests in the world, and the chunk is carried by δ. `x_near = δ x_j`, so that
///   `o_q⁻¹ x_near = o_j⁻¹ x_j`, and `a_k` becomes `δ a_k`.
/// * Transfer: the object is held and the goal rests in the world. `x_near = δ⁻¹ x_q` is where the end effector has, with the
///   grasp that it has, our object on the demonstration's: `x_near x_q⁻¹ o_q = o_j`. Then `a_k` stays (`verbatim`), or
///   becomes `a_k (x_j⁻¹ o_j) (o_q⁻¹ x_q)` (`grasp_corrected`), which puts our object where `a_k` puts the demonstration's.
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

/// What Reframe amounts to when it is switched off: the demonstration's own world is taken for the query's.
pub fn without_reframe_spatial(x_j: &Isometry3<f64>) -> Carry {
    let identity = Isometry3::identity();
    Carry {
        delta: identity,
        near: *x_j,
        left: identity,
        right: identity,
    }
}

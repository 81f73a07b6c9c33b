//! How good estimated poses of an object in space are: an offset that the estimator does not owe, phases, and errors.
//!
//! A self-supervised encoder learns the pose of the gripper as it holds the object (paper, appendix "Prehensile Pose
//! Estimation"). That frame is a constant rigid offset away from the recorded one at best, so one [`Offset`] is fitted and
//! taken away before errors are measured. Nothing here is for training: it reads recorded object poses.
//!
//! World frame, metres, radians.

mod evaluation;
mod offset;

use nalgebra::Isometry3;
use re4_geometry::spatial::{SymmetryGroup, pose_distance};

pub use evaluation::{Arrival, Demonstration, Evaluation, Measured, evaluate};
pub use offset::{FrameError, Offset};

/// When a frame is, seen from the grasps of its demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum GraspPhase {
    /// In transit, and a frame of transfer is still to come; so is transit between the grasps of a demonstration that needs
    /// several, and all of a demonstration that never grasps.
    BeforeGrasp,
    /// In transfer.
    Held,
    /// In transit after the last frame of transfer.
    AfterRelease,
}

impl GraspPhase {
    /// All, in the order of a demonstration.
    pub const ALL: [Self; 3] = [Self::BeforeGrasp, Self::Held, Self::AfterRelease];

    /// The word used in tables and summaries.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::BeforeGrasp => "before_grasp",
            Self::Held => "held",
            Self::AfterRelease => "after_release",
        }
    }

    /// Phases of a demonstration's frames, from whether each is in transfer.
    pub fn of(transfer: &[bool]) -> Vec<Self> {
        let end = transfer
            .iter()
            .rposition(|held| *held)
            .map_or(transfer.len(), |last| last + 1);
        let phase = |(frame, held): (usize, &bool)| match (held, frame < end) {
            (true, _) => Self::Held,
            (false, true) => Self::BeforeGrasp,
            (false, false) => Self::AfterRelease,
        };
        transfer.iter().enumerate().map(phase).collect()
    }
}

/// How far from where it should be the end effector would arrive, when a grasp is carried from a demonstration to a query by
/// Reframe's motion `δ = o_q o_j⁻¹` (paper, Algorithm 2) with estimated poses: distance in metres and angle in rad between
/// `δ x` with the estimated poses and `δ x` with the recorded ones, where `x` is the demonstration's end effector at its grasp.
///
/// `query` and `demo` are the estimated and the recorded pose of the object that asks and of the one that was retrieved. Turns
/// that do not show are chosen as a policy does, so that the estimated `o_q` is nearest to `o_j`; the recorded `o_q` is turned
/// so that its `δ` is nearest to the estimated one, for a grasp of the cube from another side is a grasp all the same.
pub fn arrival_error(
    symmetry: &SymmetryGroup,
    query: [&Isometry3<f64>; 2],
    demo: [&Isometry3<f64>; 2],
    grasp: &Isometry3<f64>,
) -> (f64, f64) {
    let (aligned, _) = symmetry.align(query[0], demo[0]);
    let estimated = aligned * demo[0].inverse();
    let (turned, _) = symmetry.align(query[1], &(estimated * demo[1]));
    let recorded = turned * demo[1].inverse();
    pose_distance(&(estimated * grasp), &(recorded * grasp))
}

/// The mean of poses: of their translations, and the rotation with the minimum sum of squared chordal distances, nearly, for
/// poses less than a quarter of a turn apart. `None` of nothing.
pub fn mean_pose<'a>(poses: impl IntoIterator<Item = &'a Isometry3<f64>>) -> Option<Isometry3<f64>> {
    let mut poses = poses.into_iter();
    let first = poses.next()?;
    let (mut translation, mut count) = (first.translation.vector, 1.0);
    let mut quaternion = first.rotation.into_inner();
    for pose in poses {
        translation += pose.translation.vector;
        // A quaternion and its negative are the same rotation.
        let q = pose.rotation.into_inner();
        quaternion += if q.dot(&quaternion) < 0.0 { -q } else { q };
        count += 1.0;
    }
    Some(Isometry3::from_parts(
        (translation / count).into(),
        nalgebra::UnitQuaternion::new_normalize(quaternion),
    ))
}

#[cfg(test)]
mod tests;

//! Evaluates estimated SE(3) poses of an object: calibration of a constant offset, phases of a grasp, and errors.
//!
//! A self-supervised encoder learns the pose of the gripper when it holds the object (paper, appendix "Prehensile Pose
//! Estimation"). That frame differs from the recorded one by a constant rigid offset at best. One [`Offset`] is therefore fitted
//! and removed before errors are measured. This module reads recorded object poses, so training must not use it.
//!
//! World frame, metres, radians.

mod evaluation;
mod offset;

use nalgebra::Isometry3;
use re4_geometry::spatial::{SymmetryGroup, pose_distance};

pub use evaluation::{Arrival, Demonstration, Evaluation, Measured, evaluate};
pub use offset::{FrameError, Offset};

/// The phase of a frame relative to the grasps of its demonstration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum GraspPhase {
    /// In transit, before a later frame of transfer. This includes transit between the grasps of a demonstration with
    /// several, and all frames of a demonstration without a grasp.
    BeforeGrasp,
    /// In transfer.
    Held,
    /// In transit after the last frame of transfer.
    AfterRelease,
}

impl GraspPhase {
    /// All phases, in the order of a demonstration.
    pub const ALL: [Self; 3] = [Self::BeforeGrasp, Self::Held, Self::AfterRelease];

    /// The name used in tables and summaries.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::BeforeGrasp => "before_grasp",
            Self::Held => "held",
            Self::AfterRelease => "after_release",
        }
    }

    /// The phases of a demonstration's frames, given whether each frame is in transfer.
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

/// The error in the end effector's pose when a grasp is transported from a demonstration to a query by Reframe's motion
/// `δ = o_q o_j⁻¹` (paper, Algorithm 2) with estimated poses: the distance in metres and the angle in rad between `δ x` with the
/// estimated poses and `δ x` with the recorded ones, where `x` is the demonstration's end effector at its grasp.
///
/// `query` and `demo` are each the estimated and the recorded pose of the object, of the query and of the retrieved demonstration.
/// The symmetry-equivalent pose is chosen as in a policy, so that the estimated `o_q` is nearest to `o_j`. For the recorded `o_q`,
/// it is chosen so that its `δ` is nearest to the estimated one, because grasping a cube from another side is correct too.
pub fn arrival_error(
    symmetry: &SymmetryGroup,
    query: [&Isometry3<f64>; 2],
    demo: [&Isometry3<f64>; 2],
    grasp: &Isometry3<f64>,
) -> (f64, f64) {
    let (aligned, _) = symmetry.align(query[0], demo[0]);
    let estimated = aligned * demo[0].inverse();
    let (equivalent, _) = symmetry.align(query[1], &(estimated * demo[1]));
    let recorded = equivalent * demo[1].inverse();
    pose_distance(&(estimated * grasp), &(recorded * grasp))
}

/// The mean of poses: the mean of their translations, and approximately the rotation with the minimum sum of squared chordal
/// distances, for poses less than pi / 2 apart. Returns `None` for no poses.
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

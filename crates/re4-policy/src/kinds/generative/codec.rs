//! Observations and actions as vectors of numbers.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use re4_artifact::Stage;
use re4_generative::{Demo, Kind};
use re4_geometry::{Point2, Pose2, wrap_to_two_pi};
use re4_index::{IndexRow, PlanarState, SpatialState};
use re4_rollout::{ArmAction, ArmState, Domain, Plane, Space};
use re4_sim::tee_vertices;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::kinds::{Inputs, OpenError};
use crate::lookup::read_fingers;

/// The meaning of the vectors that a network receives and generates.
pub trait Codec<D: Domain>: Send + Sync {
    /// Name of the observation in the key of the artifact.
    fn name(&self) -> &'static str;

    /// How the dimensions of an observation are normalised.
    fn observation_kinds(&self) -> Vec<Kind>;

    /// How the dimensions of an action are normalised.
    fn action_kinds(&self) -> Vec<Kind>;

    /// The observation vector.
    fn observe(&self, proprio: &D::Proprio, object: &D::Pose) -> Vec<f64>;

    /// The vector of the action that keeps the robot where it is, before the first action of an episode.
    fn rest(&self, proprio: &D::Proprio) -> Vec<f64>;

    /// The action of a vector.
    fn action(&self, vector: &[f64]) -> D::Action;

    /// Reads the demonstrations of an `index` artifact, in ascending order of their numbers.
    ///
    /// # Errors
    /// If a table cannot be read.
    fn read(&self, inputs: &Inputs<'_>) -> Result<Vec<Demo>, OpenError>;
}

/// Observations of Push-T.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PlaneCodec {
    /// Position of the pusher and pose of the block: x, y, x, y, theta in [0, 2 pi). 5 numbers.
    Pose,
    /// Position of the pusher and positions of the corners of the block's two rectangles. 18 numbers. Unlike an angle, they do
    /// not jump.
    Keypoints,
}

impl Codec<Plane> for PlaneCodec {
    fn name(&self) -> &'static str {
        match self {
            Self::Pose => "pose",
            Self::Keypoints => "keypoints",
        }
    }

    fn observation_kinds(&self) -> Vec<Kind> {
        let numbers = match self {
            Self::Pose => 5,
            Self::Keypoints => 18,
        };
        vec![Kind::Range; numbers]
    }

    fn action_kinds(&self) -> Vec<Kind> {
        vec![Kind::Range; 2]
    }

    fn observe(&self, proprio: &Point2, object: &Pose2) -> Vec<f64> {
        let mut all = vec![proprio.x, proprio.y];
        match self {
            Self::Pose => all.extend([object.x, object.y, wrap_to_two_pi(object.theta)]),
            Self::Keypoints => {
                let corners = tee_vertices(*object).into_iter().flatten();
                all.extend(corners.flat_map(|corner| [corner.x, corner.y]));
            }
        }
        all
    }

    fn rest(&self, proprio: &Point2) -> Vec<f64> {
        vec![proprio.x, proprio.y]
    }

    fn action(&self, vector: &[f64]) -> Point2 {
        Point2::new(vector[0], vector[1])
    }

    fn read(&self, inputs: &Inputs<'_>) -> Result<Vec<Demo>, OpenError> {
        let rows: Vec<IndexRow<PlanarState>> = inputs.of(Stage::Index)?.read()?;
        let demos = rows.chunk_by(|a, b| a.episode == b.episode).map(|rows| Demo {
            number: rows[0].episode,
            observations: rows
                .iter()
                .map(|row| self.observe(&row.state.eef, &row.state.object))
                .collect(),
            actions: rows
                .iter()
                .map(|row| vec![row.state.action.x, row.state.action.y])
                .collect(),
            rest: self.rest(&rows[0].state.eef),
        });
        Ok(demos.collect())
    }
}

/// Observations of a robosuite task: the pose of the end effector, the distance between the fingers, and the pose of the object in
/// the world frame and in that of the end effector. Rotations are the first two columns of their matrix. 28 numbers. Actions are
/// the goal pose in the same form and the gripper command, 10 numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SpaceCodec;

/// Appends a pose: the translation, then the first two columns of the rotation matrix.
fn push_pose(pose: &Isometry3<f64>, into: &mut Vec<f64>) {
    into.extend(pose.translation.vector.iter());
    let matrix = pose.rotation.to_rotation_matrix().into_inner();
    into.extend(matrix.column(0).iter());
    into.extend(matrix.column(1).iter());
}

/// The inverse of [`push_pose`], for columns that need not be orthonormal.
fn pose_of(vector: &[f64]) -> Isometry3<f64> {
    let at = |first: usize| Vector3::new(vector[first], vector[first + 1], vector[first + 2]);
    let first = at(3).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let second = at(6) - first * first.dot(&at(6));
    // Parallel columns determine no rotation; then any second axis is as good as another.
    let fallback = if first.x.abs() < 0.9 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let second = second
        .try_normalize(1e-9)
        .unwrap_or_else(|| (fallback - first * first.dot(&fallback)).normalize());
    let matrix = Matrix3::from_columns(&[first, second, first.cross(&second)]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Isometry3::from_parts(Translation3::from(at(0)), rotation)
}

/// Kinds of the numbers of a pose.
fn pose_kinds() -> impl Iterator<Item = Kind> {
    std::iter::repeat_n(Kind::Range, 3).chain(std::iter::repeat_n(Kind::Unchanged, 6))
}

impl Codec<Space> for SpaceCodec {
    fn name(&self) -> &'static str {
        "pose"
    }

    fn observation_kinds(&self) -> Vec<Kind> {
        let eef = pose_kinds().chain([Kind::Range]);
        eef.chain(pose_kinds()).chain(pose_kinds()).collect()
    }

    fn action_kinds(&self) -> Vec<Kind> {
        pose_kinds().chain([Kind::Unchanged]).collect()
    }

    fn observe(&self, arm: &ArmState, object: &Isometry3<f64>) -> Vec<f64> {
        let mut all = Vec::with_capacity(28);
        push_pose(&arm.eef, &mut all);
        all.push(arm.finger_separation());
        push_pose(object, &mut all);
        push_pose(&arm.eef.inv_mul(object), &mut all);
        all
    }

    fn rest(&self, arm: &ArmState) -> Vec<f64> {
        let mut all = Vec::with_capacity(10);
        push_pose(&arm.eef, &mut all);
        // The gripper is open at the beginning of an episode.
        all.push(-1.0);
        all
    }

    fn action(&self, vector: &[f64]) -> ArmAction {
        ArmAction {
            goal: pose_of(vector),
            gripper: vector[9],
        }
    }

    fn read(&self, inputs: &Inputs<'_>) -> Result<Vec<Demo>, OpenError> {
        let rows: Vec<IndexRow<SpatialState>> = inputs.of(Stage::Index)?.read()?;
        let fingers = read_fingers(inputs)?;
        let demos = rows.chunk_by(|a, b| a.episode == b.episode).map(|rows| {
            let arm = |row: &IndexRow<SpatialState>| ArmState {
                eef: row.state.eef,
                fingers: fingers.get(&(row.episode, row.frame)).copied().unwrap_or([f64::NAN; 2]),
            };
            Demo {
                number: rows[0].episode,
                observations: rows
                    .iter()
                    .map(|row| self.observe(&arm(row), &row.state.object))
                    .collect(),
                actions: rows
                    .iter()
                    .map(|row| {
                        let mut action = Vec::with_capacity(10);
                        push_pose(&row.state.goal.into(), &mut action);
                        // Only its sign matters.
                        action.push(if row.state.gripper > 0.0 { 1.0 } else { -1.0 });
                        action
                    })
                    .collect(),
                rest: self.rest(&arm(&rows[0])),
            }
        });
        Ok(demos.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_survive_the_vector() {
        let pose = Isometry3::new(Vector3::new(0.1, -0.2, 0.9), Vector3::new(1.0, -2.0, 0.5));
        let mut vector = Vec::new();
        push_pose(&pose, &mut vector);
        assert!((pose_of(&vector).to_homogeneous() - pose.to_homogeneous()).abs().max() < 1e-12);
        // A network's columns are neither unit vectors nor orthogonal.
        for number in &mut vector[3..9] {
            *number *= 1.3;
        }
        assert!((pose_of(&vector).to_homogeneous() - pose.to_homogeneous()).abs().max() < 1e-12);
        assert!(re4_geometry::spatial::is_valid_pose(&pose_of(&[0.0; 9])));
    }
}

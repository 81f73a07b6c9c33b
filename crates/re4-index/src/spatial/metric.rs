//! The scale-normalised distances of Retrieve in SE(3).

use nalgebra::Isometry3;
use re4_geometry::spatial::{Symmetry, SymmetryGroup, is_valid_pose, rotation_angle};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::IndexError;

/// The distance that ranks the demonstrations in stage 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage2 {
    /// `d_o`, the distance over the object pose only, as in the paper.
    #[default]
    Object,
    /// `d_q`, the distance over the full state. The two stages together then find the nearest state over all demonstrations.
    State,
}

/// Parameters of the distances between object-augmented states in SE(3) (paper, appendix "Robomimic": "scale-normalised Euclidean
/// translation" and "geodesic SO(3) rotation").
///
/// The distance between two poses is `|Δt| / translation_scale + angle / rotation_scale`, where the angle is the geodesic
/// distance of the rotations. Let `o` be the object pose, `x` the end-effector pose, `q` the query and `j` a frame:
///
/// * `d_o` is the distance between `o_q S` and `o_j`.
/// * `d_e` is the distance between `(o_q S)⁻¹ x_q` and `o_j⁻¹ x_j`, the end-effector poses in the object frames.
/// * `d_q = object_weight d_o + eef_weight d_e`.
///
/// S is a rotation of the object's symmetry group: the one that brings the rotation of `o_q S` nearest to that of `o_j`
/// ([`SymmetryGroup::nearest_rotation`]). S is determined by the object term only, for every frame, and is used in both terms.
/// Therefore `d_o` does not depend on which of its symmetry-equivalent poses an object is recorded in. For an object with full
/// rotational symmetry, the rotation term of `d_o` is the angle between the two axes, and `d_e` is measured with the smallest
/// rotation of the object about its own axis that aligns it with the demonstration's object.
///
/// The default scales, 0.1 m and 1 rad, make the two terms commensurate: a rotation of the gripper moves a point at 0.1 m from
/// the centre of rotation by 0.1 m per radian, and 0.1 m is about the distance from the fingertips of a Panda gripper to its
/// flange. Weights of 1 weight object and end effector equally.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialMetric {
    /// Translation that contributes a distance of 1, in metres.
    pub translation_scale: f64,
    /// Rotation that contributes a distance of 1, in rad.
    pub rotation_scale: f64,
    /// Weight of `d_o` in `d_q`.
    pub object_weight: f64,
    /// Weight of `d_e` in `d_q`.
    pub eef_weight: f64,
    /// Symmetry of the object.
    pub symmetry: Symmetry,
}

impl Default for SpatialMetric {
    fn default() -> Self {
        Self {
            translation_scale: 0.1,
            rotation_scale: 1.0,
            object_weight: 1.0,
            eef_weight: 1.0,
            symmetry: Symmetry::None,
        }
    }
}

/// Distances between a query and a frame, dimensionless.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialDistances {
    /// Distance over the full object-augmented state.
    pub d_q: f64,
    /// Distance over the object pose only.
    pub d_o: f64,
    /// Distance over the end-effector pose in the object frame.
    pub d_e: f64,
    /// Rotation S about the object's symmetry axis that was applied to the query's object, in rad, in `(-π, π]`.
    pub symmetry_rotation: f64,
}

/// A state in the form in which the distances compare it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    /// Object pose in the world frame.
    pub(crate) object: Isometry3<f64>,
    /// End-effector pose in the object frame.
    pub(crate) object_from_eef: Isometry3<f64>,
}

impl State {
    /// Returns `None` if a coordinate is not finite or is so large that squared differences could overflow.
    pub(crate) fn new(eef: &Isometry3<f64>, object: &Isometry3<f64>) -> Option<Self> {
        let near = |pose: &Isometry3<f64>| pose.translation.vector.amax() < 1e100;
        let valid = is_valid_pose(eef) && is_valid_pose(object) && near(eef) && near(object);
        valid.then(|| Self {
            object: *object,
            object_from_eef: object.inv_mul(eef),
        })
    }
}

/// A validated metric with the symmetry group of its object.
#[derive(Debug, Clone)]
pub(crate) struct Measure {
    pub(crate) metric: SpatialMetric,
    pub(crate) group: SymmetryGroup,
}

/// `d_o` and the symmetry rotation at which it is attained, in rad.
#[derive(Clone, Copy)]
pub(crate) struct ObjectTerm {
    pub(crate) d_o: f64,
    pub(crate) symmetry_rotation: f64,
}

impl Measure {
    pub(crate) fn new(metric: SpatialMetric) -> Result<Self, IndexError> {
        for (name, value) in [
            ("translation scale", metric.translation_scale),
            ("rotation scale", metric.rotation_scale),
        ] {
            // The bounds keep the quotients of all accepted coordinates finite.
            if !(1e-100..=1e100).contains(&value) {
                return Err(IndexError::Scale { name, value });
            }
        }
        for (name, value) in [
            ("weight of the object", metric.object_weight),
            ("weight of the end effector", metric.eef_weight),
        ] {
            if !(0.0..=1e100).contains(&value) {
                return Err(IndexError::Weight { name, value });
            }
        }
        Ok(Self {
            metric,
            group: metric.symmetry.group()?,
        })
    }

    #[inline]
    pub(crate) fn object_term(&self, q: &State, j: &State) -> ObjectTerm {
        let (symmetry_rotation, angle) = self.group.nearest_rotation(&q.object.rotation, &j.object.rotation);
        let distance = (q.object.translation.vector - j.object.translation.vector).norm();
        ObjectTerm {
            d_o: distance / self.metric.translation_scale + angle / self.metric.rotation_scale,
            symmetry_rotation,
        }
    }

    /// Returns all distances, or `None` if `d_q` is not below `limit`.
    ///
    /// The index and the linear scan both use this expression, so that equal distances are bit-identical and ties are resolved in
    /// the same way. A floating-point sum of non-negative numbers is never smaller than one of its terms, so the early returns do
    /// not change the answer.
    #[inline]
    pub(crate) fn distances_below(&self, q: &State, j: &State, limit: f64) -> Option<SpatialDistances> {
        let ObjectTerm { d_o, symmetry_rotation } = self.object_term(q, j);
        let object_part = self.metric.object_weight * d_o;
        if object_part >= limit {
            return None;
        }
        // (o_q S)⁻¹ x_q = S⁻¹ (o_q⁻¹ x_q)
        let (position, rotation) = if symmetry_rotation == 0.0 {
            (q.object_from_eef.translation.vector, q.object_from_eef.rotation)
        } else {
            let inverse = self.group.rotation(symmetry_rotation).inverse();
            (
                inverse * q.object_from_eef.translation.vector,
                inverse * q.object_from_eef.rotation,
            )
        };
        let distance = (position - j.object_from_eef.translation.vector).norm() / self.metric.translation_scale;
        if object_part + self.metric.eef_weight * distance >= limit {
            return None;
        }
        let d_e = distance + rotation_angle(&rotation, &j.object_from_eef.rotation) / self.metric.rotation_scale;
        let d_q = object_part + self.metric.eef_weight * d_e;
        (d_q < limit).then_some(SpatialDistances {
            d_q,
            d_o,
            d_e,
            symmetry_rotation,
        })
    }

    /// Returns the distance that ranks a demonstration in stage 2.
    pub(crate) fn key(stage2: Stage2, distances: &SpatialDistances) -> f64 {
        match stage2 {
            Stage2::Object => distances.d_o,
            Stage2::State => distances.d_q,
        }
    }
}

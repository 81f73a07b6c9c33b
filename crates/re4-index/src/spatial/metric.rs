//! The scale-normalised distances.

use nalgebra::Isometry3;
use re4_geometry::spatial::{Symmetry, SymmetryGroup, is_sound, rotation_angle};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::IndexError;

/// Which distance ranks the demonstrations in stage 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stage2 {
    /// `d_o`, the distance over the object's pose alone, as in the paper.
    #[default]
    Object,
    /// `d_q`, the distance over the full state: the two stages then give the nearest state of all.
    State,
}

/// Distances between object-augmented states in space (paper, appendix "Robomimic": "scale-normalised Euclidean translation"
/// and "geodesic SO(3) rotation").
///
/// Two poses are `|Δt| / translation_scale + angle / rotation_scale` apart, the angle being the geodesic one. With `o` the
/// object's pose, `x` the end effector's, `q` the query and `j` a frame:
///
/// * `d_o` is that distance between `o_q S` and `o_j`;
/// * `d_e` is that distance between `(o_q S)⁻¹ x_q` and `o_j⁻¹ x_j`, the end effectors as seen from the objects;
/// * `d_q = object_weight d_o + eef_weight d_e`.
///
/// S is the turn, among those after which the object looks the same, that makes the rotation of `o_q S` nearest to that of
/// `o_j` ([`SymmetryGroup::nearest_rotation`]): the same S in both terms, chosen by the object's term alone, frame by frame. So
/// `d_o` does not depend on which of its like poses an object is recorded in; for an object that looks the same after any
/// turn, its rotation term is the angle between the two axes, and `d_e` is measured with the object turned about its own axis
/// as little as possible from the demonstration's.
///
/// The default scales, 0.1 m and 1 rad, make the two terms commensurate: turning a gripper by an angle displaces what is 0.1 m
/// away from the centre of rotation, about the distance from the fingertips of a Panda's hand to its flange, by 0.1 m for every
/// radian. Weights of 1 leave object and end effector as they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialMetric {
    /// Translation, in metres, that counts as 1.
    pub translation_scale: f64,
    /// Rotation, in rad, that counts as 1.
    pub rotation_scale: f64,
    /// Weight of `d_o` in `d_q`.
    pub object_weight: f64,
    /// Weight of `d_e` in `d_q`.
    pub eef_weight: f64,
    /// Turns after which the object looks the same.
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

/// Distances, without unit, between a query and a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialDistances {
    /// Over the full object-augmented state.
    pub d_q: f64,
    /// Over the object pose alone.
    pub d_o: f64,
    /// Over the end effector's pose as seen from the object.
    pub d_e: f64,
    /// Turn S in rad, in `(-π, π]`, about the object's symmetry axis that was applied to the query's object.
    pub turn: f64,
}

/// A state as it is compared.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    pub(crate) object: Isometry3<f64>,
    /// End effector as seen from the object.
    pub(crate) seen: Isometry3<f64>,
}

impl State {
    /// None where a coordinate is not a finite number, or so large that squares of differences are not.
    pub(crate) fn new(eef: &Isometry3<f64>, object: &Isometry3<f64>) -> Option<Self> {
        let near = |pose: &Isometry3<f64>| pose.translation.vector.amax() < 1e100;
        let sound = is_sound(eef) && is_sound(object) && near(eef) && near(object);
        sound.then(|| Self {
            object: *object,
            seen: object.inv_mul(eef),
        })
    }
}

/// The metric, checked and ready for use.
#[derive(Debug, Clone)]
pub(crate) struct Measure {
    pub(crate) metric: SpatialMetric,
    pub(crate) group: SymmetryGroup,
}

/// `d_o` and the turn that gives it.
#[derive(Clone, Copy)]
pub(crate) struct ObjectTerm {
    pub(crate) d_o: f64,
    pub(crate) turn: f64,
}

impl Measure {
    pub(crate) fn new(metric: SpatialMetric) -> Result<Self, IndexError> {
        for (name, value) in [
            ("translation scale", metric.translation_scale),
            ("rotation scale", metric.rotation_scale),
        ] {
            // The bounds keep quotients of the coordinates that are accepted finite.
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
        let (turn, angle) = self.group.nearest_rotation(&q.object.rotation, &j.object.rotation);
        let distance = (q.object.translation.vector - j.object.translation.vector).norm();
        ObjectTerm {
            d_o: distance / self.metric.translation_scale + angle / self.metric.rotation_scale,
            turn,
        }
    }

    /// All distances, unless `d_q` is not below `limit`. Every path through the index uses this one expression, so that equal
    /// distances are equal to the bit and ties are decided the same way everywhere. Sums of numbers of one sign are never
    /// below their parts, rounded or not: leaving off early changes no answer.
    #[inline]
    pub(crate) fn distances_below(&self, q: &State, j: &State, limit: f64) -> Option<SpatialDistances> {
        let ObjectTerm { d_o, turn } = self.object_term(q, j);
        let object_part = self.metric.object_weight * d_o;
        if object_part >= limit {
            return None;
        }
        let (position, rotation) = if turn == 0.0 {
            (q.seen.translation.vector, q.seen.rotation)
        } else {
            let back = self.group.rotation(turn).inverse();
            (back * q.seen.translation.vector, back * q.seen.rotation)
        };
        let distance = (position - j.seen.translation.vector).norm() / self.metric.translation_scale;
        if object_part + self.metric.eef_weight * distance >= limit {
            return None;
        }
        let d_e = distance + rotation_angle(&rotation, &j.seen.rotation) / self.metric.rotation_scale;
        let d_q = object_part + self.metric.eef_weight * d_e;
        (d_q < limit).then_some(SpatialDistances { d_q, d_o, d_e, turn })
    }

    /// What ranks a demonstration in stage 2.
    pub(crate) fn key(stage2: Stage2, distances: &SpatialDistances) -> f64 {
        match stage2 {
            Stage2::Object => distances.d_o,
            Stage2::State => distances.d_q,
        }
    }
}

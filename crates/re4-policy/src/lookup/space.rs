//! States and actions of the robosuite tasks.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use re4_artifact::episodes::{FrameRow, SpatialColumns};
use re4_artifact::{Row as _, Stage, columns};
use re4_geometry::spatial::{rotation_angle, rotation_from_vector};
use re4_index::{IndexRow, SpatialState};
use re4_rollout::{ArmAction, ArmState, Space};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{ActionFrame, Entry, Field, Lookup, ranges, scaled};
use crate::kinds::{Inputs, OpenError, SettingError};

/// Weights of the parts of a state in distances. Positions and the separation of the fingers are scaled to `[-1, 1]`; angles are
/// in rad. The paper of GPI gives none, so all are 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SpaceWeights {
    /// Position of the grip site in the world.
    pub eef_position: f64,
    /// Orientation of the grip site.
    pub eef_rotation: f64,
    /// Position of the object in the world.
    pub object_position: f64,
    /// Orientation of the object.
    pub object_rotation: f64,
    /// Distance between the fingers.
    pub fingers: f64,
    /// Position of the grip site in the frame of the object.
    pub relative_position: f64,
}

impl Default for SpaceWeights {
    fn default() -> Self {
        Self {
            eef_position: 1.0,
            eef_rotation: 1.0,
            object_position: 1.0,
            object_rotation: 1.0,
            fingers: 1.0,
            relative_position: 0.0,
        }
    }
}

impl SpaceWeights {
    pub(crate) fn check(&self) -> Result<(), SettingError> {
        let all = [
            ("weights.eef_position", self.eef_position),
            ("weights.eef_rotation", self.eef_rotation),
            ("weights.object_position", self.object_position),
            ("weights.object_rotation", self.object_rotation),
            ("weights.fingers", self.fingers),
            ("weights.relative_position", self.relative_position),
        ];
        for (setting, value) in all {
            let valid = (0.0..=1e6).contains(&value);
            SettingError::unless(valid, setting, value, "give a number from 0 to 1000000")?;
        }
        let some = all.iter().any(|(_, value)| *value > 0.0);
        SettingError::unless(some, "weights.eef_position", 0, "give at least one weight above 0")
    }

    fn of_lines(&self) -> [f64; 10] {
        let Self {
            eef_position: e,
            object_position: o,
            relative_position: r,
            fingers: f,
            ..
        } = *self;
        [e, e, e, o, o, o, r, r, r, f]
    }
}

/// A normalised state in SE(3).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SpacePoint {
    /// Grip site, object, grip site in the object's frame (three coordinates each), separation of the fingers.
    line: [f64; 10],
    eef: UnitQuaternion<f64>,
    object: UnitQuaternion<f64>,
}

/// Ranges and weights of states in SE(3).
pub(crate) struct SpaceScales {
    ranges: [(f64, f64); 10],
    weights: SpaceWeights,
}

impl SpaceScales {
    fn over(rows: impl Iterator<Item = [f64; 10]>, weights: SpaceWeights) -> Self {
        Self {
            ranges: ranges(rows),
            weights,
        }
    }
}

fn raw(arm: &ArmState, object: &Isometry3<f64>) -> [f64; 10] {
    let (e, o) = (arm.eef.translation.vector, object.translation.vector);
    let r = object.inv_mul(&arm.eef).translation.vector;
    [e.x, e.y, e.z, o.x, o.y, o.z, r.x, r.y, r.z, arm.finger_separation()]
}

columns! {
    /// The columns of table `frames` that are read.
    pub struct GripperOf {
        /// Number of the demonstration.
        pub episode: u32,
        /// Number of the frame.
        pub frame: u32,
        /// Joint positions of the fingers.
        #[prefix = "finger"]
        pub fingers: [f64; 2],
    }
}

/// Reads the recorded joint positions of the fingers, by demonstration and frame. The index does not contain them.
pub(crate) fn read_fingers(inputs: &Inputs<'_>) -> Result<BTreeMap<(u32, u32), [f64; 2]>, OpenError> {
    let frames = inputs.episodes.table(FrameRow::<SpatialColumns>::table())?;
    let rows: Vec<GripperOf> = frames.read()?;
    Ok(rows
        .into_iter()
        .map(|row| ((row.episode, row.frame), row.fingers))
        .collect())
}

/// Transforms a pose from the world to the frame of actions.
fn local(frame: ActionFrame, object: &Isometry3<f64>, pose: &Isometry3<f64>) -> Isometry3<f64> {
    match frame {
        ActionFrame::Object => object.inv_mul(pose),
        ActionFrame::World => *pose,
    }
}

fn world(frame: ActionFrame, object: &Isometry3<f64>, pose: &Isometry3<f64>) -> Isometry3<f64> {
    match frame {
        ActionFrame::Object => object * pose,
        ActionFrame::World => *pose,
    }
}

/// Weighted mean of rotations: the normalised sum of their quaternions, each with the sign that brings it nearest to the first.
/// The result maximises the weighted sum of the squared cosines of half of the angles if the rotations are close together.
fn mean_rotation(parts: impl Iterator<Item = (f64, UnitQuaternion<f64>)>) -> Option<UnitQuaternion<f64>> {
    let mut first: Option<UnitQuaternion<f64>> = None;
    let mut sum = Quaternion::new(0.0, 0.0, 0.0, 0.0);
    for (weight, rotation) in parts {
        let reference = *first.get_or_insert(rotation);
        let sign = if reference.coords.dot(&rotation.coords) < 0.0 {
            -1.0
        } else {
            1.0
        };
        sum += rotation.into_inner() * (sign * weight);
    }
    UnitQuaternion::try_new(sum, 1e-12).or(first)
}

impl Lookup for Space {
    type State = SpacePoint;
    type Scales = SpaceScales;
    type Weights = SpaceWeights;

    fn read(inputs: &Inputs<'_>, weights: &SpaceWeights) -> Result<(Vec<Entry<Self>>, SpaceScales), OpenError> {
        let rows: Vec<IndexRow<SpatialState>> = inputs.of(Stage::Index)?.read()?;
        let fingers = read_fingers(inputs)?;
        let arm_of = |row: &IndexRow<SpatialState>| ArmState {
            eef: row.state.eef,
            fingers: fingers.get(&(row.episode, row.frame)).copied().unwrap_or([f64::NAN; 2]),
        };
        let all = rows.iter().map(|row| raw(&arm_of(row), &row.state.object));
        let scales = SpaceScales::over(all, *weights);
        let entries = rows.iter().map(|row| {
            let (proprio, object) = (arm_of(row), row.state.object);
            Entry {
                demo: row.episode,
                frame: row.frame,
                retrievable: row.retrievable.unwrap_or(true),
                proprio,
                object,
                action: ArmAction {
                    goal: row.state.goal.into(),
                    gripper: row.state.gripper,
                },
                state: Self::state(&scales, &proprio, &object),
            }
        });
        Ok((entries.collect(), scales))
    }

    fn state(scales: &SpaceScales, proprio: &ArmState, object: &Isometry3<f64>) -> SpacePoint {
        let raw = raw(proprio, object);
        SpacePoint {
            line: std::array::from_fn(|i| scaled(raw[i], scales.ranges[i])),
            eef: proprio.eef.rotation,
            object: object.rotation,
        }
    }

    fn is_finite(state: &SpacePoint) -> bool {
        let rotations = state.eef.coords.iter().chain(state.object.coords.iter());
        state.line.iter().chain(rotations).all(|number| number.is_finite())
    }

    fn squared(scales: &SpaceScales, a: &SpacePoint, b: &SpacePoint) -> f64 {
        let weights = scales.weights.of_lines();
        let lines: f64 = (0..10)
            .map(|i| weights[i] * (a.line[i] - b.line[i]) * (a.line[i] - b.line[i]))
            .sum();
        let turn = |weight: f64, a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>| {
            if weight == 0.0 {
                return 0.0;
            }
            let angle = rotation_angle(a, b);
            weight * angle * angle
        };
        let SpaceWeights {
            eef_rotation,
            object_rotation,
            ..
        } = scales.weights;
        lines + turn(eef_rotation, &a.eef, &b.eef) + turn(object_rotation, &a.object, &b.object)
    }

    fn perturb(state: &mut SpacePoint, normal: &mut dyn FnMut() -> f64) {
        for number in &mut state.line {
            *number = (*number + normal()).clamp(-1.0, 1.0);
        }
        // An error of sigma in each component of a quaternion is one of about 2 sigma rad in the rotation.
        for rotation in [&mut state.eef, &mut state.object] {
            let vector = Vector3::new(normal(), normal(), normal()) * 2.0;
            *rotation = rotation_from_vector(vector) * *rotation;
        }
    }

    fn features(scales: &SpaceScales, state: &SpacePoint) -> Vec<f64> {
        let weights = scales.weights.of_lines();
        let mut features: Vec<f64> = (0..10).map(|i| weights[i].sqrt() * state.line[i]).collect();
        let SpaceWeights {
            eef_rotation,
            object_rotation,
            ..
        } = scales.weights;
        for (weight, rotation) in [(eef_rotation, &state.eef), (object_rotation, &state.object)] {
            // The Frobenius distance of two rotation matrices is sqrt(2) times the angle between them, for small angles.
            let factor = (weight / 2.0).sqrt();
            features.extend(rotation.to_rotation_matrix().matrix().iter().map(|v| factor * v));
        }
        features
    }

    fn flow(
        neighbors: &[(f64, &Entry<Self>)],
        proprio: &ArmState,
        object: &Isometry3<f64>,
        field: &Field,
    ) -> ArmAction {
        let here = local(field.frame, object, &proprio.eef).translation.vector;
        let mut sum = Vector3::zeros();
        for (weight, entry) in neighbors {
            let there = local(field.frame, &entry.object, &entry.proprio.eef).translation.vector;
            let action = local(field.frame, &entry.object, &entry.action.goal).translation.vector;
            sum += ((action - there) * field.progression + (there - here) * field.attraction) * *weight;
        }
        let nearest = neighbors.first().map(|(_, entry)| *entry);
        let rotation = nearest.map_or(proprio.eef.rotation, |entry| {
            local(field.frame, &entry.object, &entry.action.goal).rotation
        });
        let goal = Isometry3::from_parts((here + sum).into(), rotation);
        ArmAction {
            goal: world(field.frame, object, &goal),
            gripper: nearest.map_or(0.0, |entry| entry.action.gripper),
        }
    }

    fn mean(neighbors: &[(f64, &Entry<Self>)], object: &Isometry3<f64>, frame: ActionFrame) -> ArmAction {
        let goals: Vec<(f64, Isometry3<f64>)> = neighbors
            .iter()
            .map(|(weight, entry)| (*weight, local(frame, &entry.object, &entry.action.goal)))
            .collect();
        let position = goals.iter().fold(Vector3::zeros(), |sum, (weight, goal)| {
            sum + goal.translation.vector * *weight
        });
        let rotation = mean_rotation(goals.iter().map(|(weight, goal)| (*weight, goal.rotation)));
        let goal = Isometry3::from_parts(position.into(), rotation.unwrap_or_else(UnitQuaternion::identity));
        ArmAction {
            goal: world(frame, object, &goal),
            gripper: neighbors
                .iter()
                .map(|(weight, entry)| weight * entry.action.gripper)
                .sum(),
        }
    }

    fn smooth(action: &mut ArmAction, previous: &ArmAction, smoothing: f64) {
        let (new, old) = (action.goal.translation.vector, previous.goal.translation.vector);
        action.goal.translation.vector = (new + old * smoothing) / (1.0 + smoothing);
    }
}

#[cfg(test)]
pub(super) fn mean_of_rotations(parts: &[(f64, UnitQuaternion<f64>)]) -> Option<UnitQuaternion<f64>> {
    mean_rotation(parts.iter().copied())
}

/// Scales that leave all coordinates as they are.
#[cfg(test)]
pub(super) fn unit_scales(weights: SpaceWeights) -> SpaceScales {
    SpaceScales {
        ranges: [(-1.0, 1.0); 10],
        weights,
    }
}

//! Frames, feature vectors and the space in which they are compared.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use re4_rollout::{ArmAction, ArmState};
use re4_stats::median;

use super::tuning::{BLOCKS, Rule, Tuning};
use crate::lookup::Latent;

/// A frame of a demonstration.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::struct_field_names, reason = "the number of a frame in its demonstration")]
pub(super) struct Frame {
    pub(super) demo: u32,
    pub(super) frame: u32,
    pub(super) retrievable: bool,
    pub(super) arm: ArmState,
    pub(super) object: Isometry3<f64>,
    pub(super) action: ArmAction,
}

impl Frame {
    /// Height of the object in metres.
    pub(super) fn height(&self) -> f64 {
        self.object.translation.z
    }

    /// Distance between grip site and object in metres.
    pub(super) fn apart(&self) -> f64 {
        apart(&self.arm, &self.object)
    }

    /// Horizontal distance of the object to the target in metres.
    pub(super) fn off_target(&self, target: &Vector3<f64>) -> f64 {
        off_target(&self.object, target)
    }
}

pub(super) fn apart(arm: &ArmState, object: &Isometry3<f64>) -> f64 {
    (arm.eef.translation.vector - object.translation.vector).norm()
}

pub(super) fn off_target(object: &Isometry3<f64>, target: &Vector3<f64>) -> f64 {
    (object.translation.vector - target).xy().norm()
}

/// Position of the grip site in the frame of the object.
pub(super) fn in_object_frame(arm: &ArmState, object: &Isometry3<f64>) -> Vector3<f64> {
    object.inv_mul(&arm.eef).translation.vector
}

/// The space in which states are compared: standardised, weighted blocks, rotated to their principal components, each divided
/// by the fourth root of its variance.
pub(super) struct Space {
    rule: Rule,
    pub(super) target: Vector3<f64>,
    /// Mean, factor of each number of the feature vector.
    scales: Vec<(f64, f64)>,
    /// Quaternions get the sign that makes their scalar product with these positive.
    references: [UnitQuaternion<f64>; 3],
    latent: Latent,
}

impl Space {
    pub(super) fn fit(tuning: &Tuning, frames: &[Frame]) -> Self {
        let target = tuning.target.map_or_else(|| last_position(frames), Vector3::from);
        let references = frames.first().map_or([UnitQuaternion::identity(); 3], |first| {
            rotations(tuning.rule, &first.arm, &first.object)
        });
        let mut space = Self {
            rule: tuning.rule,
            target,
            scales: Vec::new(),
            references,
            latent: Latent::default(),
        };
        let rows: Vec<Vec<f64>> = frames
            .iter()
            .map(|frame| space.raw(&frame.arm, &frame.object))
            .collect();
        space.scales = scales(&rows, &tuning.weights);
        let rows: Vec<Vec<f64>> = rows.iter().map(|row| space.standardised(row)).collect();
        space.latent = Latent::fit(&rows, tuning.components, 0.25);
        space
    }

    /// The coordinates of a state.
    pub(super) fn code(&self, arm: &ArmState, object: &Isometry3<f64>) -> Vec<f64> {
        self.latent.of(&self.standardised(&self.raw(arm, object)))
    }

    fn standardised(&self, raw: &[f64]) -> Vec<f64> {
        raw.iter()
            .zip(&self.scales)
            .map(|(value, (mean, factor))| (value - mean) * factor)
            .collect()
    }

    fn raw(&self, arm: &ArmState, object: &Isometry3<f64>) -> Vec<f64> {
        let (e, o) = (arm.eef.translation.vector, object.translation.vector);
        let relative = match self.rule {
            Rule::Lift => e - o,
            Rule::Can | Rule::Square => arm.eef.rotation.inverse() * (o - e),
        };
        let [relative_quat, eef_quat, object_quat] = rotations(self.rule, arm, object);
        let signed = |rotation: UnitQuaternion<f64>, reference: &UnitQuaternion<f64>| {
            let sign = if reference.coords.dot(&rotation.coords) < 0.0 {
                -1.0
            } else {
                1.0
            };
            rotation.coords * sign
        };
        let mut row = Vec::with_capacity(30);
        row.extend(relative.iter());
        row.extend(signed(relative_quat, &self.references[0]).iter());
        row.extend(arm.fingers);
        row.extend(in_object_frame(arm, object).iter());
        row.push(o.z);
        row.extend(o.iter());
        row.extend(e.iter());
        row.extend(signed(eef_quat, &self.references[1]).iter());
        row.extend((self.target - o).iter());
        row.extend(signed(object_quat, &self.references[2]).iter());
        row
    }
}

fn rotations(rule: Rule, arm: &ArmState, object: &Isometry3<f64>) -> [UnitQuaternion<f64>; 3] {
    let relative = match rule {
        Rule::Lift => object.rotation.inverse() * arm.eef.rotation,
        Rule::Can | Rule::Square => arm.eef.rotation.inverse() * object.rotation,
    };
    [relative, arm.eef.rotation, object.rotation]
}

/// Per-axis median of the last object positions of the demonstrations.
fn last_position(frames: &[Frame]) -> Vector3<f64> {
    let last: Vec<Vector3<f64>> = frames
        .chunk_by(|a, b| a.demo == b.demo)
        .filter_map(|demo| demo.last())
        .map(|frame| frame.object.translation.vector)
        .collect();
    Vector3::from_fn(|axis, _| {
        let values: Vec<f64> = last.iter().map(|position| position[axis]).collect();
        median(&values).unwrap_or(0.0)
    })
}

/// Mean and factor of each number: 1 / (standard deviation + 1e-8) except for quaternions, times the root of the block's weight.
fn scales(rows: &[Vec<f64>], weights: &[f64; 10]) -> Vec<(f64, f64)> {
    let count = rows.len().max(1) as f64;
    let blocks = BLOCKS.iter().zip(weights);
    let of_numbers = blocks.flat_map(|((name, length), weight)| std::iter::repeat_n((*name, *weight), *length));
    of_numbers
        .enumerate()
        .map(|(i, (name, weight))| {
            if name.ends_with("quat") {
                return (0.0, weight.sqrt());
            }
            let mean = rows.iter().map(|row| row[i]).sum::<f64>() / count;
            let variance = rows.iter().map(|row| (row[i] - mean) * (row[i] - mean)).sum::<f64>() / count;
            (mean, weight.sqrt() / (variance.sqrt() + 1e-8))
        })
        .collect()
}

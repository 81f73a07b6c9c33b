//! The losses of the paper's appendix "Prehensile Pose Estimation", on batches of poses.
//!
//! Everything is in the world frame, in metres and radians. Batches have a fixed layout, so that pairs need no search: groups of
//! [`GROUP`] images, which are two demonstrations with [`BEFORE`] images before the grasp and then [`HELD`] that hold the object.

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Isometry3;

use crate::config::LossConfig;

/// Images before the grasp per demonstration in a group.
pub const BEFORE: usize = 2;

/// Images that hold the object per demonstration in a group.
pub const HELD: usize = 2;

/// Images per group.
pub const GROUP: usize = 2 * (BEFORE + HELD);

/// Added to squares before the square root, so that the gradient is finite at 0.
const EPSILON: f64 = 1e-12;

/// A batch of poses: translations `[n, 3]`, and the columns of the rotation matrices, `[n, 3]` each.
#[derive(Debug, Clone)]
pub struct Poses {
    /// Translation, in metres.
    pub translation: Tensor<2>,
    /// Columns of the rotation matrix.
    pub columns: [Tensor<2>; 3],
}

fn dot(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<2> {
    (a.clone() * b.clone()).sum_dim(1)
}

fn cross(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<2> {
    let part = |v: &Tensor<2>, k: usize| v.clone().narrow(1, k, 1);
    let one = |i: usize, j: usize| part(a, i) * part(b, j) - part(a, j) * part(b, i);
    Tensor::cat(vec![one(1, 2), one(2, 0), one(0, 1)], 1)
}

/// The vector scaled to length 1; finite, but shorter, if the vector is 0.
fn unit(v: Tensor<2>) -> Tensor<2> {
    let length = (dot(&v, &v) + EPSILON).sqrt();
    v / length
}

impl Poses {
    /// Converts nine numbers per pose: the translation in units of `scale` metres, then two vectors that are orthonormalised by
    /// Gram-Schmidt, the first one first (the 6-D rotation representation of Zhou et al. 2019).
    pub fn from_raw(raw: &Tensor<2>, scale: f64) -> Self {
        let first = unit(raw.clone().narrow(1, 3, 3));
        let second = raw.clone().narrow(1, 6, 3);
        let second = unit(second.clone() - first.clone() * dot(&first, &second));
        let third = cross(&first, &second);
        Self {
            translation: raw.clone().narrow(1, 0, 3) * scale,
            columns: [first, second, third],
        }
    }

    /// Converts known poses, such as targets.
    pub fn from_known(poses: &[Isometry3<f64>], device: &Device) -> Self {
        let tensor = |part: &dyn Fn(&Isometry3<f64>) -> [f64; 3]| {
            let flat: Vec<f32> = poses.iter().flat_map(part).map(|x| x as f32).collect();
            Tensor::<2>::from_data(TensorData::new(flat, [poses.len(), 3]), device)
        };
        let column = |k: usize| {
            tensor(&move |pose| {
                let matrix = pose.rotation.to_rotation_matrix();
                let column = matrix.matrix().column(k).into_owned();
                [column[0], column[1], column[2]]
            })
        };
        Self {
            translation: tensor(&|pose| [pose.translation.x, pose.translation.y, pose.translation.z]),
            columns: [column(0), column(1), column(2)],
        }
    }

    /// The row `start` of every group of `step` rows.
    fn every(&self, start: usize, step: usize) -> Self {
        let pick = |tensor: &Tensor<2>| {
            let [n, width] = tensor.dims();
            tensor
                .clone()
                .reshape([n / step, step, width])
                .narrow(1, start, 1)
                .reshape([n / step, width])
        };
        Self {
            translation: pick(&self.translation),
            columns: [pick(&self.columns[0]), pick(&self.columns[1]), pick(&self.columns[2])],
        }
    }

    /// `self^-1 other`, row by row.
    fn to(&self, other: &Self) -> Self {
        let translation = other.translation.clone() - self.translation.clone();
        let rotated = |v: &Tensor<2>| Tensor::cat(self.columns.iter().map(|column| dot(column, v)).collect(), 1);
        Self {
            translation: rotated(&translation),
            columns: [
                rotated(&other.columns[0]),
                rotated(&other.columns[1]),
                rotated(&other.columns[2]),
            ],
        }
    }

    /// Squared distance in square metres and angle in rad, row by row, `[n, 1]` each. The angle's gradient is finite at 0 and at
    /// pi, where it vanishes.
    pub fn distance(&self, other: &Self) -> (Tensor<2>, Tensor<2>) {
        let difference = self.translation.clone() - other.translation.clone();
        let [a, b] = [&self.columns, &other.columns];
        let twice_cosine = dot(&a[0], &b[0]) + dot(&a[1], &b[1]) + dot(&a[2], &b[2]) - 1.0;
        // The sum of a_k x b_k is the rotation axis times twice the sine of the angle.
        let axis = cross(&a[0], &b[0]) + cross(&a[1], &b[1]) + cross(&a[2], &b[2]);
        let twice_sine = (dot(&axis, &axis) + EPSILON).sqrt();
        (dot(&difference, &difference), twice_sine.atan2(twice_cosine))
    }

    /// The paper's pose metric l, row by row, `[n, 1]`: squared translation distance times `translation`, plus the angle.
    pub fn metric(&self, other: &Self, translation: f64) -> Tensor<2> {
        let (square, angle) = self.distance(other);
        square * translation + angle
    }
}

/// The losses of a batch; the single losses are before their weights.
#[derive(Debug, Clone)]
pub struct Losses {
    /// The weighted sum of the losses, `[1]`.
    pub sum: Tensor<1>,
    /// L_abs, `[1]`.
    pub absolute: Tensor<1>,
    /// L_rel, `[1]`.
    pub relative: Tensor<1>,
    /// L_cross, `[1]`.
    pub cross: Tensor<1>,
}

/// The losses of a batch of estimates. `targets` are the anchor before the grasp and the end effector's pose while the object
/// is held. `near`, `[groups, 1]`, is 1 if the two anchors of a group are the same pose for L_cross, and 0 otherwise.
pub fn losses(estimates: &Poses, targets: &Poses, near: &Tensor<2>, config: &LossConfig) -> Losses {
    let metric = |a: &Poses, b: &Poses| a.metric(b, config.translation);
    let per_demo = BEFORE + HELD;
    let of = |poses: &Poses, k: usize| poses.every(k, per_demo);
    let absolute_of = |k: usize| metric(&of(estimates, k), &of(targets, k)).mean();
    let held = (absolute_of(2) + absolute_of(3)) * 0.5;
    let before = (absolute_of(0) + absolute_of(1)) * 0.5;
    let absolute = held * config.absolute_held + before * (1.0 - config.absolute_held);

    let estimated_motion = of(estimates, 2).to(&of(estimates, 3));
    let eef_motion = of(targets, 2).to(&of(targets, 3));
    let motion_before = of(estimates, 0).to(&of(estimates, 1));
    let no_motion = {
        let [n, _] = motion_before.translation.dims();
        Poses::from_known(&vec![Isometry3::identity(); n], &motion_before.translation.device())
    };
    let relative = metric(&estimated_motion, &eef_motion).mean() * config.relative_held
        + metric(&motion_before, &no_motion).mean() * config.relative_before;

    let other = |k: usize| estimates.every(per_demo + k, GROUP);
    let pairs = (metric(&estimates.every(0, GROUP), &other(0)) + metric(&estimates.every(1, GROUP), &other(1))) * 0.5;
    let cross = (pairs * near.clone()).mean();
    let sum = absolute.clone() * config.absolute + relative.clone() * config.relative + cross.clone() * config.cross;
    Losses {
        sum,
        absolute,
        relative,
        cross,
    }
}

//! The losses of the paper's appendix "Prehensile Pose Estimation", on batches of poses.
//!
//! Everything is in the world frame, in metres and radians. A batch has one layout, so that pairs need no search: groups of
//! [`GROUP`] images, two demonstrations with [`BEFORE`] images before the grasp and then [`HELD`] that hold the object.

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Isometry3;

use crate::config::LossConfig;

/// Images before the grasp of each demonstration in a batch.
pub const BEFORE: usize = 2;

/// Images that hold the object of each demonstration in a batch.
pub const HELD: usize = 2;

/// Images of a group.
pub const GROUP: usize = 2 * (BEFORE + HELD);

/// Where the losses' root of a square is cut off: gradients are finite from there on down to 0.
const TINY: f64 = 1e-12;

/// Translation and rotation of a batch: `[n, 3]`, and the columns of the rotation matrices, `[n, 3]` each.
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

/// A vector of length 1; finite, though not of length 1, where it is 0.
fn unit(v: Tensor<2>) -> Tensor<2> {
    let length = (dot(&v, &v) + TINY).sqrt();
    v / length
}

impl Poses {
    /// Poses from nine numbers each: translation in units of `scale` metres, then two vectors that are made orthonormal, first
    /// one first (Zhou et al. 2019).
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

    /// Poses that are known.
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

    /// Rows `start..start + 1`, then every `step`-th.
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
        let way = other.translation.clone() - self.translation.clone();
        let turned = |v: &Tensor<2>| Tensor::cat(self.columns.iter().map(|column| dot(column, v)).collect(), 1);
        Self {
            translation: turned(&way),
            columns: [
                turned(&other.columns[0]),
                turned(&other.columns[1]),
                turned(&other.columns[2]),
            ],
        }
    }

    /// Squared distance in square metres and angle in rad, row by row, `[n, 1]` each. The angle's gradient is finite at 0 and at
    /// pi, where it vanishes.
    pub fn distance(&self, other: &Self) -> (Tensor<2>, Tensor<2>) {
        let way = self.translation.clone() - other.translation.clone();
        let [a, b] = [&self.columns, &other.columns];
        let twice_cosine = dot(&a[0], &b[0]) + dot(&a[1], &b[1]) + dot(&a[2], &b[2]) - 1.0;
        // The sum of a_k x b_k is twice the sine times the axis.
        let axis = cross(&a[0], &b[0]) + cross(&a[1], &b[1]) + cross(&a[2], &b[2]);
        let twice_sine = (dot(&axis, &axis) + TINY).sqrt();
        (dot(&way, &way), twice_sine.atan2(twice_cosine))
    }

    /// The metric l of the paper, row by row, `[n, 1]`.
    pub fn metric(&self, other: &Self, translation: f64) -> Tensor<2> {
        let (square, angle) = self.distance(other);
        square * translation + angle
    }
}

/// The losses of a batch, each before its weight.
#[derive(Debug, Clone)]
pub struct Losses {
    /// Their weighted sum, `[1]`.
    pub sum: Tensor<1>,
    /// L_abs, `[1]`.
    pub absolute: Tensor<1>,
    /// L_rel, `[1]`.
    pub relative: Tensor<1>,
    /// L_cross, `[1]`.
    pub cross: Tensor<1>,
}

/// The losses of estimates of a batch. `targets` are the anchor before the grasp and the end effector's pose while the object
/// is held; `near`, `[groups, 1]`, is 1 where the two anchors of a group belong to one place and 0 elsewhere.
pub fn losses(estimates: &Poses, targets: &Poses, near: &Tensor<2>, config: &LossConfig) -> Losses {
    let metric = |a: &Poses, b: &Poses| a.metric(b, config.translation);
    let each = BEFORE + HELD;
    let of = |poses: &Poses, k: usize| poses.every(k, each);
    let absolute_of = |k: usize| metric(&of(estimates, k), &of(targets, k)).mean();
    let held = (absolute_of(2) + absolute_of(3)) * 0.5;
    let before = (absolute_of(0) + absolute_of(1)) * 0.5;
    let absolute = held * config.absolute_held + before * (1.0 - config.absolute_held);

    let estimated = of(estimates, 2).to(&of(estimates, 3));
    let moved = of(targets, 2).to(&of(targets, 3));
    let still = of(estimates, 0).to(&of(estimates, 1));
    let at_rest = {
        let [n, _] = still.translation.dims();
        Poses::from_known(&vec![Isometry3::identity(); n], &still.translation.device())
    };
    let relative = metric(&estimated, &moved).mean() * config.relative_held
        + metric(&still, &at_rest).mean() * config.relative_before;

    let other = |k: usize| estimates.every(each + k, GROUP);
    let tied = (metric(&estimates.every(0, GROUP), &other(0)) + metric(&estimates.every(1, GROUP), &other(1))) * 0.5;
    let cross = (tied * near.clone()).mean();
    let sum = absolute.clone() * config.absolute + relative.clone() * config.relative + cross.clone() * config.cross;
    Losses {
        sum,
        absolute,
        relative,
        cross,
    }
}

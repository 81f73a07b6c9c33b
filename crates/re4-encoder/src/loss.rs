//! The losses of the paper's appendix "Prehensile Pose Estimation", on batches of poses.
//!
//! Everything is in the world frame, in metres and radians. Batches have a fixed layout, so that pairs need no search: groups of
//! [`GROUP`] images, which are two demonstrations with [`PER_DEMO`] images each, first those before the grasp and then those that
//! hold the object.

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Isometry3;

use crate::config::{LossConfig, PoseDistance};

/// Images per demonstration in a group.
pub const PER_DEMO: usize = 4;

/// Images per group.
pub const GROUP: usize = 2 * PER_DEMO;

/// Added to squares before the square root, so that the gradient is finite at 0.
const EPSILON: f64 = 1e-12;

/// Below this translation distance, in metres, the robust distance is nearly quadratic, so that its gradient is continuous.
const ROUNDED: f64 = 1e-3;

/// Rotations of the gripper about its axis of approach (z) after which it grasps the object equally well. A label is known only
/// up to these.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Alternatives {
    /// Rotations by multiples of 2π / n.
    Fold(u32),
    /// All rotations.
    Axis,
}

impl Alternatives {
    /// No rotation but the identity.
    pub const NONE: Self = Self::Fold(1);

    /// Those of a label: the object's symmetry, and the rotation by π after which a two-finger gripper is the same.
    #[must_use]
    pub fn of_label(self) -> Self {
        match self {
            Self::Fold(n) if n % 2 == 1 => Self::Fold(2 * n),
            other => other,
        }
    }

    /// Their angles, for a fold.
    pub(crate) fn angles(self) -> impl Iterator<Item = f64> {
        let n = match self {
            Self::Fold(n) => n.max(1),
            Self::Axis => 1,
        };
        (0..n).map(move |k| std::f64::consts::TAU * f64::from(k) / f64::from(n))
    }
}

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

    /// The distance of two poses that the losses minimise, row by row, `[n, 1]`.
    ///
    /// * `squared`, the paper's: the squared translation distance times `translation`, plus the angle times `rotation`.
    /// * `robust`: the translation distance, rounded off below [`ROUNDED`], times `translation`, plus the squared chordal distance
    ///   of the rotations times `rotation`. The rotation is the nearest of those that `alternatives` makes equivalent.
    pub fn metric(&self, other: &Self, config: &LossConfig, alternatives: Alternatives) -> Tensor<2> {
        let (square, angle) = match config.distance {
            PoseDistance::Squared => self.distance(other),
            PoseDistance::Robust => {
                let difference = self.translation.clone() - other.translation.clone();
                let square = dot(&difference, &difference);
                let distance = (square + ROUNDED * ROUNDED).sqrt() - ROUNDED;
                (distance, self.chordal(other, alternatives))
            }
        };
        square * config.translation + angle * config.rotation
    }

    /// Squared chordal distance of the rotations: the sum of the squared differences of their matrices.
    pub(crate) fn chordal(&self, other: &Self, alternatives: Alternatives) -> Tensor<2> {
        let [a, b] = [&self.columns, &other.columns];
        let axes = dot(&a[2], &b[2]);
        if alternatives == Alternatives::Axis {
            return axes * -2.0 + 2.0;
        }
        // Rotating `other` about its z axis by t changes the sum of the first two products to cos(t) along + sin(t) across.
        let along = dot(&a[0], &b[0]) + dot(&a[1], &b[1]);
        let across = dot(&a[0], &b[1]) - dot(&a[1], &b[0]);
        let nearest = alternatives
            .angles()
            .map(|angle| along.clone() * angle.cos() + across.clone() * angle.sin())
            .reduce(Tensor::max_pair)
            .unwrap_or(along);
        (axes + nearest) * -2.0 + 6.0
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

/// What the losses need to know besides the estimates and their targets.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// Weights and distance.
    pub config: &'a LossConfig,
    /// Rotations after which the object looks the same, about the gripper's axis of approach.
    pub symmetry: Alternatives,
    /// Images of each demonstration in a group that hold the object, at most 2.
    pub held: usize,
}

/// The losses of a batch of estimates. `targets` are the anchor before the grasp and the end effector's pose while the object
/// is held. `near`, `[groups, 1]`, is 1 if the two anchors of a group are the same pose for L_cross, and 0 otherwise.
pub fn losses(estimates: &Poses, targets: &Poses, near: &Tensor<2>, setting: Setting<'_>) -> Losses {
    let Setting { config, symmetry, held } = setting;
    let metric = |a: &Poses, b: &Poses, alternatives| a.metric(b, config, alternatives);
    let of = |poses: &Poses, k: usize| poses.every(k, PER_DEMO);
    let before = PER_DEMO - held;
    // The mean over these images of every demonstration.
    let absolute_of = |images: std::ops::Range<usize>| {
        let count = images.len() as f64;
        let each = images.map(|k| metric(&of(estimates, k), &of(targets, k), symmetry.of_label()).mean());
        each.reduce(|a, b| a + b).map(|sum| sum / count)
    };
    let absolute = match (absolute_of(0..before), absolute_of(before..PER_DEMO)) {
        (Some(before), Some(held)) => held * config.absolute_held + before * (1.0 - config.absolute_held),
        (Some(one), None) | (None, Some(one)) => one,
        (None, None) => Tensor::zeros([1], &estimates.translation.device()),
    };

    let motion_before = of(estimates, 0).to(&of(estimates, 1));
    let no_motion = {
        let [n, _] = motion_before.translation.dims();
        Poses::from_known(&vec![Isometry3::identity(); n], &motion_before.translation.device())
    };
    let mut relative = metric(&motion_before, &no_motion, symmetry).mean() * config.relative_before;
    if held == 2 {
        let estimated_motion = of(estimates, 2).to(&of(estimates, 3));
        let eef_motion = of(targets, 2).to(&of(targets, 3));
        relative = metric(&estimated_motion, &eef_motion, symmetry).mean() * config.relative_held + relative;
    }

    let other = |k: usize| estimates.every(PER_DEMO + k, GROUP);
    let pair = |k: usize| metric(&estimates.every(k, GROUP), &other(k), symmetry.of_label());
    let pairs = (pair(0) + pair(1)) * 0.5;
    let cross = (pairs * near.clone()).mean();
    let sum = absolute.clone() * config.absolute + relative.clone() * config.relative + cross.clone() * config.cross;
    Losses {
        sum,
        absolute,
        relative,
        cross,
    }
}

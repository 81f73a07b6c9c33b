//! Compares the losses with a simple f64 reference and their gradients with finite differences, and tests the angle at 0 and pi.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_encoder::loss::{Alternatives, GROUP, Poses, Setting, losses};
use re4_encoder::{EncoderConfig, LossConfig, Preset};

/// Number of head outputs per pose.
const NUMBERS: usize = 9;

/// Converts nine numbers to a pose in a simple way: Gram-Schmidt on two vectors.
fn pose(raw: &[f64]) -> Isometry3<f64> {
    let vector = |k: usize| Vector3::new(raw[k], raw[k + 1], raw[k + 2]);
    let first = vector(3).normalize();
    let second = vector(6);
    let second = (second - first * first.dot(&second)).normalize();
    let matrix = Matrix3::from_columns(&[first, second, first.cross(&second)]);
    Isometry3::from_parts(
        Translation3::from(vector(0) * 0.1),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)),
    )
}

/// The paper's pose metric l, computed with quaternions.
fn metric(a: &Isometry3<f64>, b: &Isometry3<f64>, weight: f64) -> f64 {
    let difference = a.translation.vector - b.translation.vector;
    weight * difference.norm_squared() + a.rotation.angle_to(&b.rotation)
}

/// The losses of the paper's appendix, with means over frames and pairs instead of sums. Estimates and targets are in groups of
/// two demonstrations, each with two frames before the grasp and two that hold the object.
fn reference(estimates: &[Isometry3<f64>], targets: &[Isometry3<f64>], near: &[bool], c: &LossConfig) -> [f64; 4] {
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let l = |a: &Isometry3<f64>, b: &Isometry3<f64>| metric(a, b, c.translation);
    let is_held = |i: usize| i % 4 >= 2;
    let each = |held: bool| {
        mean(
            (0..estimates.len())
                .filter(|&i| is_held(i) == held)
                .map(|i| l(&estimates[i], &targets[i]))
                .collect(),
        )
    };
    let absolute = c.absolute_held * each(true) + (1.0 - c.absolute_held) * each(false);
    let pairs = |first: usize, wanted: &dyn Fn(usize) -> Isometry3<f64>| {
        mean(
            (0..estimates.len() / 4)
                .map(|demo| {
                    let i = 4 * demo + first;
                    l(&(estimates[i].inverse() * estimates[i + 1]), &wanted(i))
                })
                .collect(),
        )
    };
    let relative = c.relative_held * pairs(2, &|i| targets[i].inverse() * targets[i + 1])
        + c.relative_before * pairs(0, &|_| Isometry3::identity());
    let cross = mean(
        near.iter()
            .enumerate()
            .map(|(group, near)| {
                let i = GROUP * group;
                let sum = l(&estimates[i], &estimates[i + 4]) + l(&estimates[i + 1], &estimates[i + 5]);
                if *near { sum / 2.0 } else { 0.0 }
            })
            .collect(),
    );
    [
        c.absolute * absolute + c.relative * relative + c.cross * cross,
        absolute,
        relative,
        cross,
    ]
}

fn tensor(values: &[f64], device: &Device) -> Tensor<2> {
    let values: Vec<f32> = values.iter().map(|x| *x as f32).collect();
    let rows = values.len() / NUMBERS;
    Tensor::from_data(TensorData::new(values, [rows, NUMBERS]), device)
}

fn number(tensor: Tensor<1>) -> f64 {
    f64::from(tensor.into_scalar::<f32>())
}

fn near_tensor(near: &[bool], device: &Device) -> Tensor<2> {
    let values: Vec<f32> = near.iter().map(|near| f32::from(u8::from(*near))).collect();
    Tensor::from_data(TensorData::new(values, [near.len(), 1]), device)
}

/// Head outputs and targets of two groups, with rotation vectors that are not nearly parallel.
fn batch() -> impl Strategy<Value = (Vec<f64>, Vec<f64>, Vec<bool>)> {
    let rows = || prop::collection::vec(-2.0..2.0_f64, 2 * GROUP * NUMBERS);
    (rows(), rows(), prop::collection::vec(any::<bool>(), 2)).prop_filter("degenerate", |(a, b, _)| {
        a.chunks_exact(NUMBERS).chain(b.chunks_exact(NUMBERS)).all(|raw| {
            let (u, v) = (
                Vector3::from_column_slice(&raw[3..6]),
                Vector3::from_column_slice(&raw[6..9]),
            );
            u.norm() > 0.3 && v.norm() > 0.3 && u.normalize().cross(&v.normalize()).norm() > 0.3
        })
    })
}

/// Two images of each demonstration that hold the object, and no symmetry.
fn setting(config: &LossConfig) -> Setting<'_> {
    Setting {
        config,
        symmetry: Alternatives::NONE,
        held: 2,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn losses_equal_those_of_the_reference((raw, wanted, near) in batch()) {
        let device = Device::flex();
        let config = EncoderConfig::preset(Preset::Paper).losses;
        let poses: Vec<_> = raw.chunks_exact(NUMBERS).map(pose).collect();
        let targets: Vec<_> = wanted.chunks_exact(NUMBERS).map(pose).collect();
        let fast = losses(
            &Poses::from_raw(&tensor(&raw, &device), 0.1),
            &Poses::from_known(&targets, &device),
            &near_tensor(&near, &device),
            setting(&config),
        );
        let slow = reference(&poses, &targets, &near, &config);
        for (fast, slow) in [fast.sum, fast.absolute, fast.relative, fast.cross].into_iter().zip(slow) {
            let fast = number(fast);
            prop_assert!((fast - slow).abs() < 1e-4 * (1.0 + slow.abs()), "{fast} and {slow}");
        }
    }

    #[test]
    fn gradients_equal_finite_differences((raw, wanted, near) in batch()) {
        let device = Device::flex().autodiff();
        let config = EncoderConfig::preset(Preset::Paper).losses;
        let targets: Vec<_> = wanted.chunks_exact(NUMBERS).map(pose).collect();
        let leaf = tensor(&raw, &device).require_grad();
        let sum = losses(
            &Poses::from_raw(&leaf, 0.1),
            &Poses::from_known(&targets, &device),
            &near_tensor(&near, &device),
            setting(&config),
        ).sum;
        let gradient: Vec<f32> = leaf.grad(&sum.backward()).unwrap().into_data().iter::<f32>().collect();
        let value = |raw: &[f64]| {
            let poses: Vec<_> = raw.chunks_exact(NUMBERS).map(pose).collect();
            reference(&poses, &targets, &near, &config)[0]
        };
        for k in 0..raw.len() {
            let moved = |by: f64| {
                let mut raw = raw.clone();
                raw[k] += by;
                value(&raw)
            };
            let slope = |by: f64| (moved(by) - moved(-by)) / (2.0 * by);
            let (fine, coarse) = (slope(1e-6), slope(1e-4));
            // Finite differences are meaningless where the angle passes pi between the two points.
            if (fine - coarse).abs() < 1e-3 {
                prop_assert!(
                    (f64::from(gradient[k]) - fine).abs() < 2e-3 * (1.0 + fine.abs()),
                    "number {k}: {} and {fine}", gradient[k]
                );
            }
        }
    }
}

#[test]
fn the_angle_and_its_gradient_are_finite_at_zero_and_at_pi() {
    let device = Device::flex().autodiff();
    for (angle, axis) in [
        (0.0, Vector3::x()),
        (1e-9, Vector3::y()),
        (std::f64::consts::PI, Vector3::x()),
        (std::f64::consts::PI, Vector3::z()),
        (std::f64::consts::PI - 1e-7, Vector3::new(1.0, 2.0, 3.0)),
    ] {
        let rotation = UnitQuaternion::from_scaled_axis(axis.normalize() * angle);
        let raw = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let leaf = tensor(&raw, &device).require_grad();
        let target = Isometry3::from_parts(Translation3::identity(), rotation);
        let (square, estimated) = Poses::from_raw(&leaf, 0.1).distance(&Poses::from_known(&[target], &device));
        let value = number(estimated.clone().sum());
        assert!((value - angle).abs() < 1e-3, "{value} for {angle}");
        let gradient = leaf.grad(&(square + estimated).sum().backward()).unwrap();
        let gradient: Vec<f32> = gradient.into_data().iter::<f32>().collect();
        assert!(
            gradient.iter().all(|x| x.is_finite() && x.abs() < 10.0),
            "{gradient:?} for {angle}"
        );
    }
}

#[test]
fn zero_vectors_give_finite_poses() {
    let device = Device::flex().autodiff();
    let leaf = tensor(&[0.0; NUMBERS], &device).require_grad();
    let poses = Poses::from_raw(&leaf, 0.1);
    let (square, angle) = poses.distance(&Poses::from_known(&[Isometry3::identity()], &device));
    let sum = (square + angle).sum();
    let gradient: Vec<f32> = leaf
        .grad(&sum.clone().backward())
        .unwrap()
        .into_data()
        .iter::<f32>()
        .collect();
    assert!(
        number(sum).is_finite() && gradient.iter().all(|x| x.is_finite()),
        "{gradient:?}"
    );
}

/// The robust distance, computed with rotation matrices: the smallest over the rotations of the second pose about its own z axis.
fn robust(a: &Isometry3<f64>, b: &Isometry3<f64>, angles: &[f64], c: &LossConfig) -> f64 {
    let distance = (a.translation.vector - b.translation.vector).norm();
    let chordal = |angle: &f64| {
        let rotated = b.rotation * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *angle);
        let difference = a.rotation.to_rotation_matrix().matrix() - rotated.to_rotation_matrix().matrix();
        difference.norm_squared()
    };
    let rotation = angles.iter().map(chordal).fold(f64::INFINITY, f64::min);
    c.translation * ((distance * distance + 1e-6).sqrt() - 1e-3) + c.rotation * rotation
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_robust_distance_is_that_of_the_nearest_alternative((raw, wanted, _) in batch(), n in 1_u32..6) {
        let device = Device::flex();
        let config = EncoderConfig::preset(Preset::Re4).losses;
        let poses: Vec<_> = raw.chunks_exact(NUMBERS).map(pose).collect();
        let targets: Vec<_> = wanted.chunks_exact(NUMBERS).map(pose).collect();
        let metric = |alternatives| -> Vec<f32> {
            let of = (Poses::from_raw(&tensor(&raw, &device), 0.1), Poses::from_known(&targets, &device));
            of.0.metric(&of.1, &config, alternatives).into_data().iter::<f32>().collect()
        };
        let fold = metric(Alternatives::Fold(n));
        let angles: Vec<f64> = (0..n).map(|k| std::f64::consts::TAU * f64::from(k) / f64::from(n)).collect();
        for ((fast, a), b) in fold.iter().zip(&poses).zip(&targets) {
            let slow = robust(a, b, &angles, &config);
            prop_assert!((f64::from(*fast) - slow).abs() < 1e-4 * (1.0 + slow), "{fast} and {slow}");
        }
        // Only the direction of the axis matters.
        for ((fast, a), b) in metric(Alternatives::Axis).iter().zip(&poses).zip(&targets) {
            let apart = (a.rotation * Vector3::z() - b.rotation * Vector3::z()).norm_squared();
            let distance = (a.translation.vector - b.translation.vector).norm();
            let slow = config.translation * ((distance * distance + 1e-6).sqrt() - 1e-3) + config.rotation * apart;
            prop_assert!((f64::from(*fast) - slow).abs() < 1e-4 * (1.0 + slow), "{fast} and {slow}");
        }
    }
}

#[test]
fn a_label_is_known_up_to_a_rotation_of_the_gripper_by_pi() {
    assert_eq!(Alternatives::NONE.of_label(), Alternatives::Fold(2));
    assert_eq!(Alternatives::Fold(3).of_label(), Alternatives::Fold(6));
    assert_eq!(Alternatives::Fold(4).of_label(), Alternatives::Fold(4));
    assert_eq!(Alternatives::Axis.of_label(), Alternatives::Axis);
}

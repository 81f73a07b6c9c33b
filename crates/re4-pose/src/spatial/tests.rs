use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_geometry::spatial::Symmetry;

use super::*;

const CUBE: Symmetry = Symmetry::Fold {
    axis: [0.0, 0.0, 1.0],
    n: 4,
};
const CAN: Symmetry = Symmetry::Full { axis: [0.0, 0.0, 1.0] };

fn rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
    (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64, 0.0..PI)
        .prop_map(|(x, y, z, angle)| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z + 1e-9).normalize() * angle))
}

fn pose() -> impl Strategy<Value = Isometry3<f64>> {
    (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64, rotation())
        .prop_map(|(x, y, z, r)| Isometry3::from_parts(Translation3::new(x, y, z), r))
}

fn about_z(angle: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
}

fn rotated(pose: &Isometry3<f64>, rotation: UnitQuaternion<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(pose.translation, pose.rotation * rotation)
}

/// A rotation in the object's symmetry, selected by a number.
fn symmetry_rotation(symmetry: Symmetry, number: u32) -> UnitQuaternion<f64> {
    match symmetry {
        Symmetry::None => UnitQuaternion::identity(),
        Symmetry::Fold { n, .. } => about_z(f64::from(number % n) * TAU / f64::from(n)),
        Symmetry::Full { .. } => about_z(f64::from(number % 97) * 0.31),
    }
}

fn symmetry() -> impl Strategy<Value = Symmetry> {
    prop_oneof![
        Just(Symmetry::None),
        Just(CUBE),
        Just(CAN),
        Just(Symmetry::Fold {
            axis: [0.0, 0.0, 1.0],
            n: 3
        }),
    ]
}

/// An offset that a gripper can have: for symmetric objects, on their axis, so that symmetry rotations do not move its lever arm.
fn grasped(symmetry: Symmetry, offset: &Isometry3<f64>) -> Isometry3<f64> {
    if symmetry == Symmetry::None {
        return *offset;
    }
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Isometry3::from_parts(Translation3::new(0.0, 0.0, offset.translation.z), down * about_z(0.3))
}

/// Pairs of estimates that are exact except for an offset, symmetry rotations, and rotations of the gripper by pi.
fn exact(
    estimates: &[Isometry3<f64>],
    offset: &Isometry3<f64>,
    symmetry: Symmetry,
    rotations: &[(u32, bool)],
) -> Vec<[Isometry3<f64>; 2]> {
    let recorded = |(estimate, (number, by_pi)): (&Isometry3<f64>, &(u32, bool))| {
        let gripper = if *by_pi {
            about_z(PI)
        } else {
            UnitQuaternion::identity()
        };
        let object = rotated(estimate, gripper) * offset;
        [*estimate, rotated(&object, symmetry_rotation(symmetry, *number))]
    };
    estimates.iter().zip(rotations).map(recorded).collect()
}

#[test]
fn phases_follow_the_grasps() {
    let phases = |word: &str| {
        GraspPhase::of(&word.chars().map(|mode| mode == 'h').collect::<Vec<_>>())
            .iter()
            .map(|phase| &phase.as_str()[..1])
            .collect::<String>()
    };
    assert_eq!(phases("..hh.hh.."), "bbhhbhhaa");
    assert_eq!(phases("..."), "bbb");
    assert_eq!(phases("h"), "h");
    assert_eq!(phases(""), "");
}

#[test]
fn the_error_equals_a_known_disturbance() {
    let offset = Isometry3::from_parts(
        Translation3::new(0.0, 0.06, 0.008),
        UnitQuaternion::from_euler_angles(PI, 0.0, 1.5),
    );
    let estimates: Vec<_> = (0..60)
        .map(|i| {
            let i = f64::from(i);
            Isometry3::from_parts(
                Translation3::new(0.01 * i, 0.2, 0.9),
                UnitQuaternion::from_euler_angles(3.1, 0.01 * i, i),
            )
        })
        .collect();
    let pairs = exact(&estimates, &offset, Symmetry::None, &[(0, false); 60]);
    let fitted = Offset::fit(&pairs, Symmetry::None).unwrap().unwrap();
    assert!(fitted.allows_pi());
    let [estimated, recorded] = &pairs[7];
    // Translated by 3 mm.
    let mut moved = *estimated;
    moved.translation.vector += Vector3::new(0.0, 0.003, 0.0);
    let error = fitted.error(&moved, recorded);
    assert!((error.translation - 0.003).abs() < 1e-9 && (error.translation_at_grasp - 0.003).abs() < 1e-9);
    assert!(error.rotation < 1e-9);
    // Rotated by 0.1 rad about the axis of approach: the grasp does not move, the nut's origin does, by the lever arm of 6 cm.
    let spun = rotated(estimated, about_z(0.1));
    let error = fitted.error(&spun, recorded);
    assert!((error.rotation - 0.1).abs() < 1e-9, "{error:?}");
    assert!((error.translation - 0.12 * 0.05_f64.sin()).abs() < 1e-9, "{error:?}");
    assert!(error.translation_at_grasp < 1e-9, "{error:?}");
}

#[test]
fn outliers_do_not_move_the_offset() {
    let offset = Isometry3::from_parts(Translation3::new(0.001, 0.002, 0.01), about_z(0.4));
    let estimates: Vec<_> = (0..100)
        .map(|i| {
            Isometry3::from_parts(
                Translation3::new(0.0, 0.01 * f64::from(i), 0.9),
                about_z(0.07 * f64::from(i)),
            )
        })
        .collect();
    let mut pairs = exact(&estimates, &offset, Symmetry::None, &[(0, false); 100]);
    for (i, [_, recorded]) in pairs.iter_mut().enumerate().filter(|(i, _)| i % 3 == 0) {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 0.5 + 0.01 * i as f64);
        *recorded = rotated(recorded, rotation);
        recorded.translation.vector += Vector3::new(0.3, 0.1 * i as f64, -0.2);
    }
    let fitted = Offset::fit(&pairs, Symmetry::None).unwrap().unwrap();
    let (translation, angle) = pose_distance(fitted.pose(), &offset);
    assert!(translation < 1e-9, "{translation}");
    assert!(angle < 1e-3, "{angle}");
}

#[test]
fn no_pairs_give_no_offset() {
    assert_eq!(Offset::fit(&[], CUBE).unwrap(), None);
    assert!(Offset::fit(&[], Symmetry::Full { axis: [0.0; 3] }).is_err());
    assert_eq!(mean_pose([]), None);
}

#[test]
fn a_transported_grasp_arrives_with_the_error_of_the_estimate() {
    let cube = CUBE.group().unwrap();
    let at = |x: f64, y: f64, yaw: f64| Isometry3::from_parts(Translation3::new(x, y, 0.82), about_z(yaw));
    let (query, demo, grasp) = (at(0.02, 0.01, 0.3), at(-0.01, 0.0, 0.1), at(-0.01, 0.004, 0.1));
    // The estimator's own frame and symmetry-equivalent estimates are no error.
    let offset = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.01), about_z(1.0));
    for quarter in 0..4 {
        let estimated = query
            * offset.inverse()
            * Isometry3::from_parts(Translation3::identity(), about_z(f64::from(quarter) * FRAC_PI_2));
        let (distance, angle) = arrival_error(&cube, [&estimated, &query], [&(demo * offset.inverse()), &demo], &grasp);
        assert!(distance < 1e-12 && angle < 1e-9, "{quarter}: {distance} {angle}");
    }
    let aside = at(0.025, 0.01, 0.3);
    let (distance, angle) = arrival_error(&cube, [&aside, &query], [&demo, &demo], &grasp);
    assert!((distance - 0.005).abs() < 1e-12 && angle < 1e-9);
    // Without the symmetry, a rotation by pi / 2 is an error.
    let none = Symmetry::None.group().unwrap();
    let (_, angle) = arrival_error(
        &none,
        [&at(0.02, 0.01, 0.3 + FRAC_PI_2), &query],
        [&demo, &demo],
        &grasp,
    );
    assert!((angle - FRAC_PI_2).abs() < 1e-9);
}

#[test]
fn the_mean_pose_is_in_the_middle() {
    let at = |x: f64, yaw: f64| Isometry3::from_parts(Translation3::new(x, 0.0, 0.8), about_z(yaw));
    let negated = Isometry3::from_parts(
        at(2.0, 0.3).translation,
        UnitQuaternion::new_unchecked(-about_z(0.3).into_inner()),
    );
    let mean = mean_pose([&at(0.0, -0.3), &at(1.0, 0.0), &negated]).unwrap();
    let (translation, angle) = pose_distance(&mean, &at(1.0, 0.0));
    assert!(translation < 1e-12 && angle < 1e-9, "{translation} {angle}");
}

/// A demonstration of 12 frames: 6 before the grasp, 4 held, 2 after the release. The object moves with the gripper while held.
fn demonstration(number: u32, trained_on: bool, estimate: impl Fn(&Isometry3<f64>) -> Isometry3<f64>) -> Demonstration {
    let n = f64::from(number);
    let start = Isometry3::from_parts(Translation3::new(0.01 * n, -0.007 * n, 0.83), about_z(0.4 * n));
    let modes: Vec<bool> = (0..12).map(|frame| (6..10).contains(&frame)).collect();
    let (mut recorded, mut eef) = (Vec::new(), Vec::new());
    for frame in 0..12 {
        let moved = f64::from((frame - 6).clamp(0, 4)) * 0.02;
        let lift = Translation3::new(0.0, 0.0, moved);
        recorded.push(lift * start);
        let away = f64::from((6 - frame).max(0)) * 0.03;
        eef.push(Translation3::new(0.0, 0.0, away) * recorded[recorded.len() - 1]);
    }
    Demonstration {
        trained_on,
        phases: GraspPhase::of(&modes),
        estimated: recorded.iter().map(estimate).collect(),
        recorded,
        eef,
    }
}

fn worst(measured: &Measured, demo: usize) -> f64 {
    let errors = measured.errors[demo].iter().flatten();
    errors
        .map(|error| error.translation.max(error.rotation))
        .fold(0.0, f64::max)
}

#[test]
fn held_out_frames_do_not_move_the_offset() {
    let offset = Isometry3::from_parts(Translation3::new(0.0, 0.055, 0.01), about_z(1.2));
    let good = |pose: &Isometry3<f64>| pose * offset.inverse();
    let bad = |pose: &Isometry3<f64>| Translation3::new(0.3, 0.0, 0.0) * pose * offset;
    let trained: Vec<_> = (0..4).map(|number| demonstration(number, true, good)).collect();
    let held_out = (4..40).map(|number| demonstration(number, false, bad));
    let all: Vec<_> = trained.iter().cloned().chain(held_out).collect();
    let alone = evaluate(&trained, Symmetry::None).unwrap();
    let together = evaluate(&all, Symmetry::None).unwrap();
    let offset_of = |evaluation: &Evaluation| evaluation.estimates.as_ref().unwrap().offset.clone();
    assert_eq!(offset_of(&alone), offset_of(&together));
    assert_eq!(
        alone.mean.as_ref().unwrap().offset,
        together.mean.as_ref().unwrap().offset
    );
    let estimates = together.estimates.unwrap();
    assert!((0..4).all(|demo| worst(&estimates, demo) < 1e-9) && (4..40).all(|demo| worst(&estimates, demo) > 0.1));
    assert!(alone.arrivals.is_empty() && together.arrivals.len() == 36 * 6);
}

#[test]
fn labels_and_mean_are_measured_like_estimates() {
    let demos: Vec<_> = (0..9)
        .map(|number| demonstration(number, number < 6, |pose| *pose))
        .collect();
    let Evaluation {
        estimates,
        labels,
        mean,
        arrivals,
    } = evaluate(&demos, CUBE).unwrap();
    // The object is held at its origin, so the labels are exact; there are none after the release.
    let labels = labels.unwrap();
    assert!((0..9).all(|demo| worst(&labels, demo) < 1e-9));
    assert!(labels.errors[0][9].is_some() && labels.errors[0][10].is_none());
    assert!((0..9).all(|demo| worst(estimates.as_ref().unwrap(), demo) < 1e-9));
    assert!(
        arrivals
            .iter()
            .all(|arrival| arrival.distance < 1e-9 && arrival.angle < 1e-9)
    );
    // Trained on numbers 0 to 5: the mean pose is that of number 2.5, and the median offset is exactly there.
    let mean = mean.unwrap();
    let expected = |demo: f64| (demo - 2.5).abs() * 0.01_f64.hypot(0.007);
    for (demo, error) in mean.errors.iter().enumerate() {
        let found = error[0].unwrap().translation;
        assert!((found - expected(demo as f64)).abs() < 1e-9, "{demo}: {found}");
    }
}

#[test]
fn a_demonstration_without_a_grasp_has_no_labels_and_no_arrivals() {
    let mut never = demonstration(1, true, |pose| *pose);
    never.phases = GraspPhase::of(&[false; 12]);
    let query = demonstration(2, false, |pose| *pose);
    let evaluation = evaluate(&[never.clone(), query], CUBE).unwrap();
    assert!(evaluation.estimates.is_some() && evaluation.labels.is_none() && evaluation.mean.is_none());
    assert!(evaluation.arrivals.is_empty());
    never.trained_on = false;
    assert_eq!(evaluate(&[never], CUBE).unwrap().estimates, None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn a_constant_offset_is_no_error(
        symmetry in symmetry(),
        offset in pose(),
        estimates in prop::collection::vec(pose(), 1..40),
        rotations in prop::collection::vec((0..97u32, any::<bool>()), 40),
    ) {
        let offset = grasped(symmetry, &offset);
        let pairs = exact(&estimates, &offset, symmetry, &rotations);
        let fitted = Offset::fit(&pairs, symmetry).unwrap().unwrap();
        for [estimated, recorded] in &pairs {
            let error = fitted.error(estimated, recorded);
            prop_assert!(error.translation < 1e-6, "{:?}", error);
            prop_assert!(error.translation_at_grasp < 1e-6, "{:?}", error);
            prop_assert!(error.rotation < 1e-6, "{:?}", error);
        }
    }

    #[test]
    fn an_offset_depends_on_neither_the_world_frame_nor_the_order(
        offset in pose(), world in pose(), estimates in prop::collection::vec(pose(), 2..20),
    ) {
        let rotations = vec![(0, false); estimates.len()];
        let pairs = exact(&estimates, &offset, Symmetry::None, &rotations);
        let mut moved: Vec<_> = pairs.iter().map(|pair| pair.map(|pose| world * pose)).collect();
        moved.reverse();
        let [a, b] = [&pairs, &moved].map(|pairs| Offset::fit(pairs, Symmetry::None).unwrap().unwrap());
        for ([estimated, recorded], again) in pairs.iter().zip(moved.iter().rev()) {
            let (a, b) = (a.error(estimated, recorded), b.error(&again[0], &again[1]));
            prop_assert!((a.translation - b.translation).abs() < 1e-6 && (a.rotation - b.rotation).abs() < 1e-6);
        }
    }
}

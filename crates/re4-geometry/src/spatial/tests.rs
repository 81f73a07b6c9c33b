use std::f64::consts::{FRAC_PI_2, PI, TAU};

use proptest::prelude::*;

use super::*;

fn rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
    (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64, 0.0..PI).prop_map(|(x, y, z, angle)| {
        let axis = Vector3::new(x, y, z + 1e-9);
        UnitQuaternion::from_scaled_axis(axis.normalize() * angle)
    })
}

fn pose() -> impl Strategy<Value = Isometry3<f64>> {
    (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64, rotation())
        .prop_map(|(x, y, z, r)| Isometry3::from_parts(Translation3::new(x, y, z), r))
}

fn symmetry() -> impl Strategy<Value = Symmetry> {
    let axis = || (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| [x, y, z + 1e-9]);
    prop_oneof![
        Just(Symmetry::None),
        (axis(), 2u32..9).prop_map(|(axis, n)| Symmetry::Fold { axis, n }),
        axis().prop_map(|axis| Symmetry::Full { axis }),
    ]
}

fn negated(q: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(-q.into_inner())
}

#[test]
fn angles_near_zero_and_near_pi_are_accurate() {
    for angle in [0.0, 1e-12, 1e-9, 1e-5, 1.0, PI - 1e-5, PI - 1e-9, PI] {
        let rotated = UnitQuaternion::from_scaled_axis(Vector3::new(0.6, 0.0, 0.8) * angle);
        let found = rotation_angle(&UnitQuaternion::identity(), &rotated);
        assert!((found - angle).abs() <= 4e-16 * angle.max(1e-3), "{angle}: {found}");
        assert_eq!(rotation_angle(&UnitQuaternion::identity(), &negated(rotated)), found);
    }
}

#[test]
fn rotations_that_differ_by_pi_can_be_interpolated() {
    let flip = UnitQuaternion::from_scaled_axis(Vector3::x() * PI);
    let middle = rotation_between(&UnitQuaternion::identity(), &flip, 0.5);
    assert!((rotation_angle(&UnitQuaternion::identity(), &middle) - FRAC_PI_2).abs() < 1e-12);
    assert!((rotation_angle(&flip, &middle) - FRAC_PI_2).abs() < 1e-12);
}

#[test]
fn a_can_upside_down_is_pi_away_for_every_yaw() {
    let can = Symmetry::Full { axis: [0.0, 0.0, 1.0] }.group().unwrap();
    let upright = UnitQuaternion::identity();
    for yaw in [0.0, 0.3, 2.0, PI] {
        let over =
            UnitQuaternion::from_scaled_axis(Vector3::x() * PI) * UnitQuaternion::from_scaled_axis(Vector3::z() * yaw);
        let (nearest, angle) = can.nearest_rotation(&over, &upright);
        assert!((angle - PI).abs() < 1e-12, "{yaw}: {angle}");
        assert_eq!(nearest, 0.0, "{yaw}");
    }
}

#[test]
fn a_cube_rotated_by_90_degrees_looks_the_same() {
    let cube = Symmetry::Fold {
        axis: [0.0, 0.0, 2.0],
        n: 4,
    }
    .group()
    .unwrap();
    let about_z = |angle: f64| UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
    for quarter in -4..=4 {
        let rotated = about_z(f64::from(quarter) * FRAC_PI_2 + 0.2);
        let (nearest, angle) = cube.nearest_rotation(&rotated, &about_z(0.0));
        assert!((angle - 0.2).abs() < 1e-12, "{quarter}: {angle}");
        assert!((-PI..=PI).contains(&nearest));
        assert!(rotation_angle(&(rotated * cube.rotation(nearest)), &about_z(0.2)) < 1e-12);
    }
    // Midway between two rotations of the group either is acceptable, so the angle is compared modulo 90 degrees.
    assert_eq!(
        cube.nearest_rotation(&about_z(TAU / 8.0), &about_z(0.0)).0.abs() % FRAC_PI_2,
        0.0
    );
}

#[test]
fn valid_symmetries_are_read_and_invalid_ones_refused() {
    #[derive(serde::Deserialize, Debug)]
    struct Task {
        symmetry: Symmetry,
    }
    let read = |text: &str| toml::from_str::<Task>(&format!("symmetry = {text}")).map(|task| task.symmetry);
    let z = [0.0, 0.0, 1.0];
    assert_eq!(read(r#"{ kind = "none" }"#).unwrap(), Symmetry::None);
    assert_eq!(
        read(r#"{ kind = "fold", axis = [0.0, 0.0, 1.0], n = 4 }"#).unwrap(),
        Symmetry::Fold { axis: z, n: 4 }
    );
    assert_eq!(
        read(r#"{ kind = "full", axis = [0, 0, 1] }"#).unwrap(),
        Symmetry::Full { axis: z }
    );
    for (text, expected) in [
        (r#"{ kind = "fold", axis = [0, 0, 1], n = 1 }"#, "from 2 to 360"),
        (r#"{ kind = "full", axis = [0, 0, 0] }"#, "no direction"),
        (r#"{ kind = "full" }"#, "missing field `axis`"),
        (r#"{ kind = "none", axis = [0, 0, 1] }"#, "unknown field `axis`"),
        (r#"{ kind = "mirror" }"#, "unknown variant `mirror`"),
    ] {
        let refused = read(text).unwrap_err().to_string();
        assert!(refused.contains(expected), "{text}: {refused}");
    }
    for symmetry in [
        Symmetry::None,
        Symmetry::Fold { axis: z, n: 4 },
        Symmetry::Full { axis: z },
    ] {
        let text = toml::to_string(&symmetry).unwrap();
        assert_eq!(toml::from_str::<Symmetry>(&text).unwrap(), symmetry);
    }
}

#[test]
fn invalid_axes_and_orders_are_refused() {
    let axis = |axis| Symmetry::Full { axis }.group().unwrap_err().to_string();
    assert!(axis([0.0; 3]).contains("no direction"));
    assert!(axis([f64::NAN, 0.0, 1.0]).contains("no direction"));
    for n in [0, 1, LARGEST_FOLD + 1] {
        let refused = Symmetry::Fold {
            axis: [0.0, 0.0, 1.0],
            n,
        }
        .group()
        .unwrap_err();
        assert_eq!(refused, SymmetryError::Fold { n });
    }
    assert!(
        Symmetry::Full {
            axis: [0.0, 1e-300, 0.0]
        }
        .group()
        .is_ok()
    );
    assert!(
        Symmetry::Full {
            axis: [0.0, 1e300, 1e300]
        }
        .group()
        .is_ok()
    );
}

proptest! {
    #[test]
    fn rotation_vectors_represent_their_rotations(q in rotation()) {
        let vector = rotation_vector(&q);
        prop_assert!(vector.norm() <= PI + 1e-12);
        prop_assert!(rotation_angle(&rotation_from_vector(vector), &q) < 1e-9);
        prop_assert!((rotation_vector(&negated(q)) - vector).norm() < 1e-9 || vector.norm() > PI - 1e-6);
    }

    #[test]
    fn steps_respect_their_limits_and_reach_the_target(a in pose(), b in pose(), length in 0.001..0.5f64, angle in 0.01..1.0f64) {
        let mut at = a;
        let mut steps = 0;
        while at != b {
            let next = step_toward(&at, &b, length, angle);
            let (moved, rotated) = pose_distance(&at, &next);
            prop_assert!(moved <= length + 1e-9 && rotated <= angle + 1e-9);
            let (before, after) = (pose_distance(&at, &b), pose_distance(&next, &b));
            prop_assert!((before.0 - moved - after.0).abs() < 1e-9, "not along the straight line");
            prop_assert!((before.1 - rotated - after.1).abs() < 1e-8, "not along the geodesic");
            at = next;
            steps += 1;
            prop_assert!(steps < 5000);
        }
    }

    #[test]
    fn no_other_symmetry_rotation_is_nearer(s in symmetry(), q in rotation(), j in rotation(), other in 0..64u32) {
        let group = s.group().unwrap();
        let (nearest, angle) = group.nearest_rotation(&q, &j);
        prop_assert!(nearest > -PI - 1e-12 && nearest <= PI + 1e-12);
        prop_assert!((rotation_angle(&(q * group.rotation(nearest)), &j) - angle).abs() < 1e-9);
        let (count, all) = match s {
            Symmetry::None => (1, false),
            Symmetry::Fold { n, .. } => (n, false),
            Symmetry::Full { .. } => (64, true),
        };
        let another = f64::from(other % count) * TAU / f64::from(count);
        let equivalent = q * group.rotation(another);
        prop_assert!(angle <= rotation_angle(&equivalent, &j) + 1e-9);
        // The angle is the same for all symmetry-equivalent orientations.
        prop_assert!((group.angle(&equivalent, &j) - angle).abs() < 1e-9);
        prop_assert!((group.angle(&negated(q), &j) - angle).abs() < 1e-9);
        if all && let Symmetry::Full { axis } = s {
            let axis = Vector3::from(axis).normalize();
            prop_assert!(((q * axis).angle(&(j * axis)) - angle).abs() < 1e-6, "angle between the axes");
        }
    }

    #[test]
    fn the_angle_is_a_metric(s in symmetry(), a in rotation(), b in rotation(), c in rotation()) {
        let group = s.group().unwrap();
        prop_assert!(group.angle(&a, &a) < 1e-12);
        prop_assert!((group.angle(&a, &b) - group.angle(&b, &a)).abs() < 1e-9);
        prop_assert!(group.angle(&a, &c) <= group.angle(&a, &b) + group.angle(&b, &c) + 1e-9);
    }

    #[test]
    fn an_aligned_pose_is_symmetry_equivalent(s in symmetry(), q in pose(), j in pose()) {
        let group = s.group().unwrap();
        let (aligned, nearest) = group.align(&q, &j);
        prop_assert_eq!(aligned.translation, q.translation);
        prop_assert_eq!(aligned, group.rotated(&q, nearest));
        prop_assert!(group.angle(&aligned.rotation, &q.rotation) < 1e-7);
    }
}

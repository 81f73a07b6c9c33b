//! Conversion of delta actions to absolute actions and back.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_robosuite::actions::{Action, ActionError, Osc, distance, rotation};
use re4_robosuite::env_args::EnvArgs;

fn osc() -> Osc {
    Osc::symmetric(0.05, 0.5).unwrap()
}

fn pose(x: f64, axis: [f64; 3]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(axis));
    Isometry3::from_parts(Translation3::new(x, 0.1, 1.0), rotation)
}

#[test]
fn a_delta_is_scaled_and_rotates_about_world_axes() {
    // The site is rotated by 90 degrees about x, so a rotation about the world's z axis differs from one about its own.
    let site = pose(0.2, [std::f64::consts::FRAC_PI_2, 0.0, 0.0]);
    let delta = [1.0, -0.5, 0.0, 0.0, 0.0, 1.0, -1.0];
    let [absolute] = osc().to_absolute(&[delta], &[site], None).unwrap()[..] else {
        panic!()
    };
    assert!((absolute[0] - 0.25).abs() < 1e-15 && (absolute[1] - 0.075).abs() < 1e-15);
    assert_eq!((absolute[2], absolute[6]), (1.0, -1.0));
    let expected = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.5)) * site.rotation;
    assert!(rotation(&absolute).angle_to(&expected) < 1e-12);
}

#[test]
fn a_delta_without_rotation_keeps_the_last_goal_orientation() {
    let sites = [
        pose(0.0, [0.0; 3]),
        pose(0.1, [0.1, 0.0, 0.0]),
        pose(0.2, [0.3, 0.2, 0.0]),
    ];
    let still = [0.0; 7];
    let rotating = [0.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0];
    let reset = pose(-0.3, [0.0, 0.0, 0.7]);
    let goals = osc()
        .to_absolute(&[still, rotating, still], &sites, Some(&reset))
        .unwrap();
    // The position of the first goal is also relative to the initial pose.
    assert_eq!(goals[0][..3], [-0.3, 0.1, 1.0]);
    assert!(rotation(&goals[0]).angle_to(&reset.rotation) < 1e-12);
    assert_eq!(goals[2][3..6], goals[1][3..6]);
    assert_eq!(goals[2][0], 0.2);
    let own = osc().to_absolute(&[still], &sites[..1], None).unwrap();
    assert_eq!(own[0][..6], [0.0, 0.1, 1.0, 0.0, 0.0, 0.0]);
    let back = osc().to_delta(&goals, &sites, Some(&reset)).unwrap();
    assert_eq!(
        (back[0][3..6].to_vec(), back[2][3..6].to_vec()),
        (vec![0.0; 3], vec![0.0; 3])
    );
    assert!((back[1][4] - 0.4).abs() < 1e-12);
    // A goal with the current orientation of the site differs from the last goal, so its delta needs a rotation other than zero.
    let at_site = [goals[1], [0.2, 0.1, 1.0, 0.3, 0.2, 0.0, 0.0]];
    let back = osc().to_delta(&at_site, &sites[1..], None).unwrap();
    assert_ne!(back[1][3..6], [0.0; 3]);
    let again = osc().to_absolute(&back, &sites[1..], None).unwrap();
    assert!(distance(&again[1], &at_site[1]).1 < 1e-8);
}

#[test]
fn commands_outside_the_range_are_clipped() {
    let site = pose(0.0, [0.0; 3]);
    let goals = osc()
        .to_absolute(&[[3.0, -3.0, 0.0, 0.0, 0.0, 0.0, 5.0]], &[site], None)
        .unwrap();
    assert!((goals[0][0] - 0.05).abs() < 1e-15 && (goals[0][1] - 0.05).abs() < 1e-15);
    assert_eq!(goals[0][6], 5.0);
    // Ranges may be asymmetric: here [0, 2] is scaled to [-0.1, 0.3].
    let env = EnvArgs::parse(
        r#"{"env_name": "Lift", "env_kwargs": {"controller_configs": {"type": "OSC_POSE", "input_min": 0,
            "input_max": 2, "output_min": -0.1, "output_max": 0.3}}}"#,
    )
    .unwrap();
    let motion = Osc::from_env(&env)
        .unwrap()
        .motion(&[0.0, 1.0, 2.0, 9.0, 0.5, 1.5, 0.0]);
    for (got, expected) in motion.iter().zip([-0.1, 0.1, 0.3, 0.3, 0.0, 0.2]) {
        assert!((got - expected).abs() < 1e-15, "{motion:?}");
    }
}

#[test]
fn errors_name_what_cannot_be_converted() {
    let site = pose(0.0, [0.0; 3]);
    let error = osc().to_absolute(&[[0.0; 7]], &[site, site], None).unwrap_err();
    assert_eq!(error, ActionError::Lengths { actions: 1, poses: 2 });
    let mut bad = [0.0; 7];
    bad[4] = f64::NAN;
    for error in [
        osc().to_absolute(&[bad], &[site], None),
        osc().to_delta(&[bad], &[site], None),
    ] {
        assert!(error.unwrap_err().to_string().contains("actions[0, 4] is NaN"));
    }
    assert!(matches!(
        Osc::symmetric(0.0, 0.5),
        Err(ActionError::Range { axis: 0, .. })
    ));
    assert!(matches!(
        Osc::symmetric(0.05, f64::NAN),
        Err(ActionError::Range { axis: 3, .. })
    ));
    let env = |config: &str| {
        EnvArgs::parse(&format!(
            r#"{{"env_name": "Lift", "env_kwargs": {{"controller_configs": {config}}}}}"#
        ))
        .unwrap()
    };
    assert!(matches!(
        Osc::from_env(&env("null")),
        Err(ActionError::NoScale("controller_configs"))
    ));
    assert!(matches!(
        Osc::from_env(&env(r#"{"type": "OSC_POSE"}"#)),
        Err(ActionError::NoScale("output_max"))
    ));
    let joints = r#"{"type": "JOINT_VELOCITY", "output_max": [1, 1, 1, 1, 1, 1, 1]}"#;
    assert!(matches!(Osc::from_env(&env(joints)), Err(ActionError::Kind(kind)) if kind == "JOINT_VELOCITY"));
    assert_eq!(osc().to_absolute(&[], &[], None).unwrap(), Vec::<Action>::new());
}

fn step() -> impl Strategy<Value = (Action, Isometry3<f64>)> {
    let action = prop::array::uniform7(-1.0_f64..=1.0);
    // Up to pi and more: end effectors that point down have rotation vectors near pi.
    let place = (
        prop::array::uniform3(-1.0_f64..1.0),
        prop::array::uniform3(-2.5_f64..2.5),
    );
    (action, any::<bool>(), place).prop_map(|(mut action, still, (position, axis))| {
        if still {
            action[3..6].fill(0.0);
        }
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(axis));
        (
            action,
            Isometry3::from_parts(Translation3::from(Vector3::from(position)), rotation),
        )
    })
}

proptest! {
    #[test]
    fn round_trips_are_exact_up_to_rounding(steps in prop::collection::vec(step(), 1..40), reset in prop::option::of(step())) {
        let (actions, sites): (Vec<Action>, Vec<_>) = steps.into_iter().unzip();
        let reset = reset.map(|(_, pose)| pose);
        let absolute = osc().to_absolute(&actions, &sites, reset.as_ref()).unwrap();
        let back = osc().to_delta(&absolute, &sites, reset.as_ref()).unwrap();
        for (t, (ours, theirs)) in back.iter().zip(&actions).enumerate() {
            for (ours, theirs) in ours.iter().zip(theirs) {
                prop_assert!((ours - theirs).abs() < 1e-12, "step {}: {} {}", t, ours, theirs);
            }
        }
        let again = osc().to_absolute(&back, &sites, reset.as_ref()).unwrap();
        for (ours, theirs) in again.iter().zip(&absolute) {
            let (metres, radians) = distance(ours, theirs);
            prop_assert!(metres < 1e-12 && radians < 1e-12);
        }
    }
}

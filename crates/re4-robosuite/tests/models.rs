//! Kinematics of a small model with poses that were computed by hand, and of broken models.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_robosuite::kinematics::{KinematicsError, Model, PANDA_RESET};

/// A robot with one arm joint, a cube and a door. Angles are in degrees, which is MJCF's default.
const SMALL: &str = r#"<mujoco>
  <compiler eulerseq="xyz"/>
  <default>
    <joint axis="0 1 0"/>
    <default class="finger"><joint type="slide" axis="2 0 0"/></default>
  </default>
  <worldbody>
    <body name="robot0_base" pos="1 0 0" euler="0 0 90">
      <body name="robot0_right_hand" pos="0 0 1">
        <joint name="robot0_joint1" pos="0 0 -1" ref="0"/>
        <body name="gripper0_right_gripper" axisangle="0 0 2 -90" childclass="finger">
          <site name="gripper0_right_grip_site" pos="0 0 0.1"/>
          <body name="left"><joint name="l"/><site name="tip" pos="0 0.01 0"/></body>
          <body name="right"><joint name="r" ref="0.5" axis="0 1 0"/></body>
        </body>
      </body>
    </body>
    <body name="cube_main"><site name="cube_site" pos="0 0 1"/><freejoint name="cube"/></body>
    <body name="door" pos="0 0 2"><joint name="hinge" ref="90" axis="0 0 1"/><joint name="ball" type="ball"/></body>
  </worldbody>
</mujoco>"#;

fn near(a: Vector3<f64>, b: [f64; 3]) {
    assert!((a - Vector3::from(b)).norm() < 1e-12, "{a:?} {b:?}");
}

#[test]
fn poses_match_a_computation_by_hand() {
    let model = Model::parse(SMALL).unwrap();
    assert_eq!(
        (model.positions(), model.velocities(), model.state_width()),
        (15, 13, 29)
    );
    let robot = model.robot(0).unwrap();
    assert_eq!(robot.fingers, Some([1, 2]));
    let cube = model.object("cube").unwrap();
    let mut qpos = [0.0; 15];
    // The arm is rotated by 90 degrees about the base's y axis (the world's -x axis), at the lower end of the hand's link.
    qpos[0] = FRAC_PI_2;
    qpos[1] = 0.02;
    qpos[2] = 0.5;
    // The quaternion is not normalised and has w first.
    qpos[3..10].copy_from_slice(&[1.0, 2.0, 3.0, 2.0, 2.0, 0.0, 0.0]);
    qpos[10] = FRAC_PI_2;
    let poses = model.forward(&qpos).unwrap();
    let hand = poses.body(robot.hand);
    near(hand.translation.vector, [1.0, 1.0, 0.0]);
    // The hand's z axis is the world's y axis; its x axis points down.
    near(hand.rotation * Vector3::z(), [0.0, 1.0, 0.0]);
    near(hand.rotation * Vector3::x(), [0.0, 0.0, -1.0]);
    let site = poses.site(robot.grip_site);
    near(site.translation.vector, [1.0, 1.1, 0.0]);
    assert!(
        site.rotation
            .angle_to(&(hand.rotation * re4_robosuite::hand_from_site()))
            < 1e-12
    );
    near(poses.body(cube).translation.vector, [1.0, 2.0, 3.0]);
    near(poses.body(cube).rotation * Vector3::y(), [0.0, 0.0, 1.0]);
    // The door's hinge is at its reference of 90 degrees, and its ball joint is all zeros, so both rotations are zero.
    let names: Vec<&str> = model.free_bodies().map(|(_, name)| name).collect();
    assert_eq!(names, ["cube_main"]);
    assert_eq!(robot.gripper_qpos(&qpos), Some([0.02, 0.5]));
    let joints: Vec<(&str, usize)> = model
        .joints()
        .map(|joint| (joint.name.as_str(), joint.address))
        .collect();
    let expected = [
        ("robot0_joint1", 0),
        ("l", 1),
        ("r", 2),
        ("cube", 3),
        ("hinge", 10),
        ("ball", 11),
    ];
    assert_eq!(joints, expected);
}

#[test]
fn slides_use_the_normalised_axis_and_hinges_rotate_from_their_reference() {
    let mut text = SMALL.replace(r#"<body name="door""#, r#"<body name="door_main""#);
    // The pose of any body can be queried by giving it the hand body's name.
    text = text
        .replace("robot0_right_hand", "link")
        .replace("door_main", "robot0_right_hand");
    let model = Model::parse(&text).unwrap();
    let robot = model.robot(0).unwrap();
    let mut qpos = [0.0; 15];
    qpos[6] = 1.0;
    qpos[10] = FRAC_PI_2;
    let rotation = |qpos: &[f64; 15]| model.forward(qpos).unwrap().body(robot.hand).rotation;
    assert!(rotation(&qpos).angle() < 1e-12);
    qpos[10] = PI;
    let by_hinge = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2);
    assert!(rotation(&qpos).angle_to(&by_hinge) < 1e-12);
    // The ball joint then rotates about the axes that the hinge has rotated.
    qpos[11..15].copy_from_slice(&[0.0, 3.0, 0.0, 0.0]);
    let by_ball = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    assert!(rotation(&qpos).angle_to(&(by_hinge * by_ball)) < 1e-12);

    let moved = SMALL
        .replace("gripper0_right_grip_site", "other")
        .replace(r#"name="tip""#, r#"name="gripper0_grip_site""#);
    let model = Model::parse(&moved).unwrap();
    let robot = model.robot(0).unwrap();
    let mut qpos = [0.0; 15];
    qpos[6] = 1.0;
    let at = |qpos: &[f64; 15]| model.forward(qpos).unwrap().site(robot.grip_site).translation.vector;
    let before = at(&qpos);
    qpos[1] = 0.02;
    // The axis "2 0 0" is only a direction, so the motion is 0.02 m, not 0.04 m. The rotations of the base (+90 degrees about
    // z) and of the gripper (-90 degrees) cancel.
    near(at(&qpos) - before, [0.02, 0.0, 0.0]);
}

#[test]
fn unusable_models_are_refused_with_a_message_of_one_line() {
    let broken = |from: &str, to: &str| {
        assert!(SMALL.contains(from));
        Model::parse(&SMALL.replace(from, to)).unwrap_err().to_string()
    };
    let body = |inner: &str| format!("<mujoco><worldbody>{inner}</worldbody></mujoco>");
    let cases = [
        (Model::parse("").unwrap_err().to_string(), "not valid XML"),
        (
            Model::parse("<robot/>").unwrap_err().to_string(),
            "<robot>, not <mujoco>",
        ),
        (Model::parse("<mujoco/>").unwrap_err().to_string(), "no <worldbody>"),
        (
            broken("pos=\"1 0 0\"", "pos=\"1 0\""),
            "<body> robot0_base has pos=\"1 0\", not 3",
        ),
        (broken("pos=\"1 0 0\"", "pos=\"1 0 0 0\""), "not 3 finite numbers"),
        (broken("pos=\"1 0 0\"", "pos=\"1 0 inf\""), "not 3 finite numbers"),
        (broken("euler=\"0 0 90\"", "quat=\"0 0 0 0\""), "which is zero"),
        (
            broken("euler=\"0 0 90\"", "zaxis=\"0 0 1\""),
            "zaxis, which is not supported",
        ),
        (broken("axis=\"2 0 0\"", "axis=\"0 0 0\""), "a zero vector as axis"),
        (broken("type=\"ball\"", "type=\"screw\""), "type=\"screw\", not free"),
        (
            broken("childclass=\"finger\"", "childclass=\"thumb\""),
            "class thumb, which no <default>",
        ),
        (broken("eulerseq=\"xyz\"", "angle=\"turns\""), "angle=\"turns\""),
        (broken("eulerseq=\"xyz\"", "eulerseq=\"xy\""), "eulerseq=\"xy\""),
        (
            broken("eulerseq=\"xyz\"", "coordinate=\"global\""),
            "global coordinates",
        ),
        (
            broken("<freejoint name=\"cube\"/>", "<body><freejoint/></body>"),
            "not the only joint",
        ),
        (
            Model::parse(&body("<frame><body/></frame>")).unwrap_err().to_string(),
            "<frame>, which is not supported",
        ),
        (
            Model::parse(&body("<joint/>")).unwrap_err().to_string(),
            "joint of the world",
        ),
    ];
    for (sentence, part) in cases {
        assert!(sentence.contains(part), "{sentence:?} does not contain {part:?}");
        assert!(!sentence.contains('\n'), "{sentence}");
    }
    let deep = format!("{}{}", "<body>".repeat(100_000), "</body>".repeat(100_000));
    assert!(matches!(
        Model::parse(&body(&deep)),
        Err(KinematicsError::Model(_) | KinematicsError::Xml(_))
    ));
    let nested = format!("{}{}", "<default class=\"a\">".repeat(1000), "</default>".repeat(1000));
    assert!(Model::parse(&format!("<mujoco>{nested}<worldbody/></mujoco>")).is_err());
}

#[test]
fn errors_about_missing_parts_list_the_existing_names() {
    let model = Model::parse(SMALL).unwrap();
    let error = model.object("Can").unwrap_err().to_string();
    assert!(
        error.contains("Can_main, Can and Can0") && error.contains("cube_main"),
        "{error}"
    );
    let without = Model::parse(&SMALL.replace("gripper0_right_grip_site", "nothing")).unwrap();
    let error = without.robot(0).unwrap_err().to_string();
    assert!(
        error.contains("gripper0_grip_site, gripper0_right_grip_site") && error.contains("cube_site"),
        "{error}"
    );
    // A single name with the right suffix is accepted, two are ambiguous.
    let other = SMALL.replace("gripper0_right_grip_site", "right_hand_grip_site");
    assert!(Model::parse(&other).unwrap().robot(0).is_ok());
    let two = other.replace("cube_site", "left_grip_site");
    assert!(Model::parse(&two).unwrap().robot(0).is_err());
    let error = model.site_at(&PANDA_RESET).unwrap_err().to_string();
    assert!(error.contains("robot0_joint2"), "{error}");
}

#[test]
fn states_of_another_model_are_refused() {
    let model = Model::parse(SMALL).unwrap();
    let state: Vec<f64> = (0..29).map(f64::from).collect();
    let parts = model.split(&state).unwrap();
    assert_eq!((parts.time, parts.qpos[0], parts.qvel[0]), (0.0, 1.0, 16.0));
    assert_eq!((parts.qpos.len(), parts.qvel.len()), (15, 13));
    assert!(
        model
            .split(&state[1..])
            .unwrap_err()
            .to_string()
            .contains("28 numbers, but the model needs 29")
    );
    assert!(
        model
            .forward(&state[..14])
            .unwrap_err()
            .to_string()
            .contains("14 numbers, but the model needs 15")
    );
    let mut qpos = [0.0; 15];
    qpos[4] = f64::NAN;
    assert!(model.forward(&qpos).unwrap_err().to_string().contains("qpos[4] is NaN"));
}

proptest! {
    #[test]
    fn corrupted_models_never_panic(edits in prop::collection::vec((0..SMALL.len(), any::<u8>()), 1..8), cut in 0..SMALL.len()) {
        let mut bytes = SMALL.as_bytes().to_vec();
        for (index, byte) in edits {
            bytes[index] = byte;
        }
        for text in [String::from_utf8_lossy(&bytes), String::from_utf8_lossy(&bytes[..cut])] {
            if let Ok(model) = Model::parse(&text) {
                let _ = model.robot(0);
                let _ = model.forward(&vec![0.3; model.positions()]);
            }
        }
    }

    #[test]
    fn poses_are_rigid_motions(qpos in prop::collection::vec(-3.0_f64..3.0, 15)) {
        let model = Model::parse(SMALL).unwrap();
        let robot = model.robot(0).unwrap();
        let poses = model.forward(&qpos).unwrap();
        let between = poses.body(robot.hand).inverse() * poses.site(robot.grip_site);
        prop_assert!((between.translation.vector - Vector3::new(0.0, 0.0, 0.1)).norm() < 1e-12);
        prop_assert!(between.rotation.angle_to(&re4_robosuite::hand_from_site()) < 1e-12);
        for pose in [poses.body(robot.hand), poses.site(robot.grip_site)] {
            prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-12);
        }
    }
}

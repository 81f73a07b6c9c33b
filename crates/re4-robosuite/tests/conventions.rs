//! Detection of all combinations of conventions from synthetic demonstrations.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_robosuite::conventions::{
    ActionKind, ActionReading, Basis, Contradiction, Conventions, DemoArrays, EefOrientation, GripperSign, InitialGoal,
    ObjectLayout, QuaternionOrder, RelativeLag, RobosuiteTask, Rows, Settings, Unproven,
};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::hand_from_site;

const FRAMES: usize = 60;

#[derive(Debug, Clone)]
struct Demo {
    eef_pos: Vec<[f64; 3]>,
    eef_quat: Vec<[f64; 4]>,
    object: Vec<f64>,
    gripper_qpos: Vec<[f64; 2]>,
    actions: Vec<[f64; 7]>,
}

fn stored(rotation: UnitQuaternion<f64>, order: QuaternionOrder) -> [f64; 4] {
    let [x, y, z, w] = rotation.coords.into();
    match order {
        QuaternionOrder::Xyzw => [x, y, z, w],
        QuaternionOrder::Wxyz => [w, x, y, z],
    }
}

/// An end effector that moves around and closes its gripper on an object, recorded with these conventions.
fn demo(conventions: &Conventions, phase: f64) -> Demo {
    let mut demo = Demo {
        eef_pos: vec![],
        eef_quat: vec![],
        object: vec![],
        gripper_qpos: vec![],
        actions: vec![],
    };
    let hand_at = |t: f64| {
        let s = t / 9.0 + phase;
        let down = UnitQuaternion::from_scaled_axis(Vector3::new(3.0, 0.2, 0.1));
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.3 * s.sin(), 0.2 * s.cos(), 0.5 * s));
        let position = Translation3::new(0.1 * s.sin(), 0.1 * (1.3 * s).cos(), 1.0 + 0.05 * (0.7 * s).sin());
        Isometry3::from_parts(position, rotation * down)
    };
    let object_at = |t: f64| {
        let yaw = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, phase + 0.02 * t));
        Isometry3::from_parts(Translation3::new(0.05 + 0.002 * t, -0.02, 0.83), yaw)
    };
    let layout = conventions.object_layout.unwrap();
    let order = conventions.object_quaternion.unwrap();
    for frame in 0..FRAMES {
        let t = frame as f64;
        let (hand, object) = (hand_at(t), object_at(t));
        let before = match conventions.relative_lag {
            RelativeLag::Current => (hand, object),
            RelativeLag::ObjectOneLate => (hand, object_at(t - 1.0)),
            RelativeLag::BothOneLate => (hand_at(t - 1.0), object_at(t - 1.0)),
        };
        demo.eef_pos.push(hand.translation.vector.into());
        let orientation = match conventions.eef_orientation {
            EefOrientation::HandBody => hand.rotation,
            EefOrientation::GripSite => hand.rotation * hand_from_site(),
        };
        demo.eef_quat.push(stored(orientation, conventions.eef_quaternion));
        let mut pose = object.translation.vector.as_slice().to_vec();
        pose.extend(stored(object.rotation, order));
        let difference = before.0.translation.vector - before.1.translation.vector;
        let relative = before.0.inverse() * before.1;
        let mut relative_part = relative.translation.vector.as_slice().to_vec();
        relative_part.extend(stored(relative.rotation, order));
        match layout {
            ObjectLayout::LiftEefMinusCube => demo.object.extend(pose.iter().chain(difference.as_slice())),
            ObjectLayout::LiftCubeMinusEef => demo.object.extend(pose.iter().chain((-difference).as_slice())),
            ObjectLayout::PoseFirst => demo.object.extend(pose.iter().chain(&relative_part)),
            ObjectLayout::RelativeFirst => demo.object.extend(relative_part.iter().chain(&pose)),
        }
        // The gripper opens from half to full, then closes.
        let opening = (0.02 + 0.004 * t).min(0.04).min(0.2 - 0.004 * t).max(0.01);
        demo.gripper_qpos.push([opening, -opening]);
        let closes = if frame < 30 { -1.0 } else { 1.0 };
        let command = match conventions.gripper_sign {
            GripperSign::PositiveCloses => closes,
            GripperSign::PositiveOpens => -closes,
        };
        let motion = (hand_at(t + 1.0).translation.vector - hand.translation.vector) * 4.0;
        let [x, y, z]: [f64; 3] = match conventions.action_kind {
            ActionKind::Delta => (motion / 0.05).map(|command| command.clamp(-1.0, 1.0)).into(),
            ActionKind::Absolute => (hand.translation.vector + motion).into(),
        };
        let goal = (hand.rotation * hand_from_site()).scaled_axis();
        demo.actions.push(match conventions.action_kind {
            ActionKind::Delta => [x, y, z, 0.0, 0.0, 0.1, command],
            ActionKind::Absolute => [x, y, z, goal.x, goal.y, goal.z, command],
        });
    }
    demo
}

impl Demo {
    fn arrays(&self, columns: usize) -> DemoArrays<'_> {
        DemoArrays {
            name: "demo_0",
            eef_pos: &self.eef_pos,
            eef_quat: &self.eef_quat,
            object: Rows::new(&self.object, columns),
            gripper_qpos: &self.gripper_qpos,
            actions: &self.actions,
            eef_vel_ang: None,
            states: None,
            model: None,
        }
    }
}

fn standard() -> Conventions {
    Conventions {
        task: RobosuiteTask::named("can"),
        object_layout: Some(ObjectLayout::PoseFirst),
        relative_lag: RelativeLag::Current,
        eef_orientation: EefOrientation::HandBody,
        eef_quaternion: QuaternionOrder::Xyzw,
        object_quaternion: Some(QuaternionOrder::Xyzw),
        action_kind: ActionKind::Delta,
        gripper_sign: GripperSign::PositiveCloses,
        eef_proven: true,
        object_proven: true,
        allow_actions_beyond_range: false,
        actions: ActionReading::default(),
        initial_goal: InitialGoal::FirstPose,
        controls: None,
    }
}

fn env(version: Option<&str>) -> EnvArgs {
    EnvArgs {
        env_name: "PickPlaceCan".to_owned(),
        env_version: version.map(str::to_owned),
        robots: vec![],
        control_freq: None,
        controller: None,
        kind: None,
    }
}

/// Settings that agree with these conventions.
fn settings_of(conventions: &Conventions) -> Settings {
    Settings {
        object_layout: conventions.object_layout,
        eef_orientation: Some(conventions.eef_orientation),
        eef_quaternion: Some(conventions.eef_quaternion),
        object_quaternion: conventions.object_quaternion,
        action_kind: Some(conventions.action_kind),
        gripper_sign: Some(conventions.gripper_sign),
        ..Settings::default()
    }
}

fn any_conventions() -> impl Strategy<Value = Conventions> {
    use QuaternionOrder::{Wxyz, Xyzw};
    let order = || prop::sample::select(vec![Xyzw, Wxyz]);
    let layout = prop::sample::select(vec![ObjectLayout::PoseFirst, ObjectLayout::RelativeFirst]);
    let lag = prop::sample::select(vec![
        RelativeLag::Current,
        RelativeLag::ObjectOneLate,
        RelativeLag::BothOneLate,
    ]);
    let flags = (any::<bool>(), any::<bool>(), any::<bool>());
    (layout, lag, order(), order(), flags).prop_map(|(layout, lag, eef, object, (site, absolute, opens))| Conventions {
        object_layout: Some(layout),
        relative_lag: lag,
        eef_quaternion: eef,
        object_quaternion: Some(object),
        eef_orientation: if site {
            EefOrientation::GripSite
        } else {
            EefOrientation::HandBody
        },
        action_kind: if absolute {
            ActionKind::Absolute
        } else {
            ActionKind::Delta
        },
        gripper_sign: if opens {
            GripperSign::PositiveOpens
        } else {
            GripperSign::PositiveCloses
        },
        ..standard()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_combination_is_proven_from_the_data(conventions in any_conventions(), phase in 0.2_f64..1.2) {
        let demos = [demo(&conventions, phase), demo(&conventions, phase + 2.0)];
        let arrays = [demos[0].arrays(14), demos[1].arrays(14)];
        let (proven, proofs) = Conventions::detect(&arrays, &env(None), &settings_of(&conventions)).unwrap();
        prop_assert_eq!(proven, conventions);
        prop_assert!(proofs[..7].iter().all(|proof| proof.basis == Basis::Data));
        let residuals = proven.check(&arrays[0]).unwrap();
        prop_assert!(residuals.relative.unwrap() < 1e-12);
        // Any other convention is contradicted by the demo.
        let others = [
            Conventions { object_layout: standard().object_layout, ..proven },
            Conventions { object_layout: Some(ObjectLayout::RelativeFirst), ..proven },
            Conventions { eef_quaternion: QuaternionOrder::Xyzw, ..proven },
            Conventions { eef_quaternion: QuaternionOrder::Wxyz, ..proven },
            Conventions { object_quaternion: Some(QuaternionOrder::Xyzw), ..proven },
            Conventions { object_quaternion: Some(QuaternionOrder::Wxyz), ..proven },
            Conventions { eef_orientation: EefOrientation::HandBody, ..proven },
            Conventions { eef_orientation: EefOrientation::GripSite, ..proven },
            Conventions { action_kind: ActionKind::Delta, ..proven },
            Conventions { action_kind: ActionKind::Absolute, ..proven },
            Conventions { gripper_sign: GripperSign::PositiveCloses, ..proven },
            Conventions { gripper_sign: GripperSign::PositiveOpens, ..proven },
        ];
        for other in others {
            prop_assert_eq!(other.check(&arrays[0]).is_ok(), other == proven, "{:?}", other);
        }
    }
}

#[test]
fn layouts_of_lift_are_distinguished_by_their_sign() {
    for (layout, version) in [
        (ObjectLayout::LiftEefMinusCube, "1.2.0"),
        (ObjectLayout::LiftCubeMinusEef, "1.5.0"),
    ] {
        let conventions = Conventions {
            task: RobosuiteTask::named("lift"),
            object_layout: Some(layout),
            ..standard()
        };
        let demos: Vec<Demo> = (0..6).map(|i| demo(&conventions, 0.3 + f64::from(i))).collect();
        let arrays: Vec<_> = demos.iter().map(|demo| demo.arrays(10)).collect();
        let lift = EnvArgs {
            env_name: "Lift".to_owned(),
            ..env(Some(version))
        };
        // Without states and velocities the data does not determine the order of the end effector's quaternion.
        let error = Conventions::detect(&arrays, &lift, &Settings::default()).unwrap_err();
        assert!(
            matches!(
                error,
                Unproven::Undecided {
                    convention: "eef_quaternion",
                    ..
                }
            ),
            "{error}"
        );
        let settings = Settings {
            eef_quaternion: Some(QuaternionOrder::Xyzw),
            eef_orientation: Some(EefOrientation::HandBody),
            ..Settings::default()
        };
        let (proven, _) = Conventions::detect(&arrays, &lift, &settings).unwrap();
        assert_eq!(
            (proven.object_layout, proven.eef_proven, proven.object_proven),
            (Some(layout), false, true)
        );
        let row = proven.decompose(arrays[0].object.unwrap().row(3)).unwrap();
        assert_eq!((row.relative_quaternion, row.position[2]), (None, 0.83));
        assert!(proven.decompose(&[0.0; 14]).is_none());
    }
}

#[test]
fn object_rows_are_decomposed_without_changes() {
    let conventions = Conventions {
        object_layout: Some(ObjectLayout::RelativeFirst),
        object_quaternion: Some(QuaternionOrder::Wxyz),
        ..standard()
    };
    let values: [f64; 14] = [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0, 4.0, 5.0, 6.0, 0.0, 2.0, 0.0, 0.0];
    let row = conventions.decompose(&values).unwrap();
    assert_eq!((row.position, row.quaternion), ([4.0, 5.0, 6.0], [0.0, 2.0, 0.0, 0.0]));
    assert_eq!(
        (row.relative_position, row.relative_quaternion),
        ([0.1, 0.2, 0.3], Some([1.0, 0.0, 0.0, 0.0]))
    );
    assert_eq!(row.pose.translation.vector, Vector3::new(4.0, 5.0, 6.0));
    assert_eq!(row.pose.rotation.coords.as_slice(), [1.0, 0.0, 0.0, 0.0]);
    for broken in [f64::NAN, 0.0] {
        let mut values = values;
        values[11] = broken;
        assert_eq!(conventions.decompose(&values), None);
    }
    assert_eq!(conventions.decompose(&values[..10]), None);
    // Both frames have the same position and differ by a rotation of 90 degrees.
    let hand = conventions.hand_pose([1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 2.0]).unwrap();
    let site = conventions.site_pose([1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 2.0]).unwrap();
    assert_eq!(hand.translation, site.translation);
    assert!((hand.rotation.inverse() * site.rotation * Vector3::x() + Vector3::y()).norm() < 1e-12);
}

#[test]
fn arrays_of_inconsistent_shapes_are_refused() {
    let good = demo(&standard(), 0.5);
    let detect = |demo: &Demo, columns: usize| {
        let error = Conventions::detect(&[demo.arrays(columns)], &env(Some("1.4.1")), &Settings::default());
        match error.unwrap_err() {
            Unproven::Demo(contradiction) => contradiction,
            error => panic!("{error}"),
        }
    };
    let mut short = good.clone();
    short.gripper_qpos.pop();
    let error = detect(&short, 14);
    assert!(matches!(
        error,
        Contradiction::Length {
            dataset: "obs/robot0_gripper_qpos",
            rows: 59,
            need: 60,
            ..
        }
    ));
    let mut infinite = good.clone();
    infinite.object[14 * 3 + 5] = f64::INFINITY;
    assert_eq!(
        detect(&infinite, 14).to_string(),
        "demo_0: obs/object[3, 5] is inf, not a finite number"
    );
    let mut wide = good.clone();
    wide.object = vec![0.5; FRAMES * 15];
    assert!(
        detect(&wide, 15)
            .to_string()
            .contains("15 columns, but the task needs 14")
    );
    assert!(Rows::new(&[0.0; 5], 2).is_none() && Rows::new(&[], 0).is_none());
    let nothing = Conventions::detect(&[], &env(None), &Settings::default()).unwrap_err();
    assert!(matches!(nothing, Unproven::Undecided { .. }), "{nothing}");
}

/// Keyboard teleoperation records commands far outside the range. The controller clips them, and so does the test.
#[test]
fn commands_outside_the_range_are_clipped() {
    let mut clipped = demo(&standard(), 0.5);
    for action in &mut clipped.actions {
        action[..3]
            .iter_mut()
            .for_each(|command| *command = (4.0 * *command).clamp(-1.0, 1.0));
    }
    let mut beyond = clipped.clone();
    for (index, action) in beyond.actions.iter_mut().enumerate() {
        let factor = if index.is_multiple_of(5) { 40.0 } else { 1.0 };
        let maximum = action[..3].iter_mut().filter(|command| command.abs() == 1.0);
        maximum.for_each(|command| *command *= factor);
    }
    let (clipped, beyond) = (clipped.arrays(14), beyond.arrays(14));
    let allowed = Conventions {
        allow_actions_beyond_range: true,
        ..standard()
    };
    let residuals = allowed.check(&beyond).unwrap();
    assert_eq!(
        residuals.motion_unexplained,
        allowed.check(&clipped).unwrap().motion_unexplained
    );
    assert_eq!(residuals.beyond_range, Some(39.0));
    let error = standard().check(&beyond).unwrap_err().to_string();
    assert!(error.contains("allow_actions_beyond_range"), "{error}");
}

/// If half of the demonstrations have one layout and half have the other, no layout is proven.
#[test]
fn mixed_layouts_are_not_proven() {
    let other = Conventions {
        object_layout: Some(ObjectLayout::RelativeFirst),
        ..standard()
    };
    let demos = [demo(&standard(), 0.5), demo(&other, 1.5)];
    let arrays = [demos[0].arrays(14), demos[1].arrays(14)];
    let settings = Settings {
        eef_quaternion: Some(QuaternionOrder::Xyzw),
        eef_orientation: Some(EefOrientation::HandBody),
        ..Settings::default()
    };
    let error = Conventions::detect(&arrays, &env(Some("1.4.1")), &settings).unwrap_err();
    assert!(
        matches!(
            error,
            Unproven::Undecided {
                convention: "object_layout",
                ..
            }
        ),
        "{error}"
    );
    assert!(
        error.to_string().contains("no hypothesis has a residual of at most"),
        "{error}"
    );
}

#[test]
fn proofs_and_settings_are_serialised() {
    let demos = [demo(&standard(), 0.5)];
    let (conventions, proofs) =
        Conventions::detect(&[demos[0].arrays(14)], &env(Some("1.4.1")), &Settings::default()).unwrap();
    let names: Vec<&str> = proofs.iter().map(|proof| proof.convention.as_str()).collect();
    let expected = [
        "action_kind",
        "gripper_sign",
        "eef_quaternion",
        "eef_orientation",
        "object_layout",
        "object_quaternion",
        "gripper_range",
        "action_scale",
        "initial_goal",
    ];
    assert_eq!(names, expected);
    let values: Vec<&str> = proofs.iter().map(|proof| proof.value.as_str()).collect();
    let expected = [
        "delta",
        "positive_closes",
        "xyzw",
        "hand_body",
        "pose_first",
        "xyzw",
        "minus_one_one",
        "controller",
        "first_pose",
    ];
    assert_eq!(values, expected);
    // These conventions need a declared controller or models, and there are none.
    assert!(proofs[7..].iter().all(|proof| proof.basis == Basis::Declared));
    for proof in &proofs[..7] {
        let evidence = &proof.evidence;
        assert!(evidence.frames >= evidence.frames_needed && evidence.candidates.len() == 2);
        assert!(evidence.candidates[0].residual <= evidence.threshold);
        assert!(evidence.candidates[1].median >= evidence.rival_threshold);
        assert_eq!(evidence.candidates[0].value, proof.value);
    }
    // The name and value of each proof form a setting that agrees with it.
    let settings: serde_json::Value = proofs[..6]
        .iter()
        .map(|proof| (proof.convention.clone(), serde_json::json!(proof.value)))
        .collect();
    let settings: Settings = serde_json::from_value(settings).unwrap();
    assert_eq!(settings, settings_of(&conventions));
    // The other proofs have infinite residuals (not measured), which JSON cannot represent.
    let proofs = proofs[..7].to_vec();
    let text = serde_json::to_string(&(conventions, &proofs)).unwrap();
    assert_eq!(
        serde_json::from_str::<(Conventions, Vec<_>)>(&text).unwrap(),
        (conventions, proofs)
    );
    assert!(serde_json::from_str::<Settings>(r#"{"layout": "pose_first"}"#).is_err());
}

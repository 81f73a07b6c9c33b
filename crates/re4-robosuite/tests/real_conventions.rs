//! Detection of conventions on real files and on changed copies of them.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may panic")]

mod common;

use common::{Demo, Source, TASKS, scripted};
use re4_robosuite::conventions::{
    ActionKind, ActionReading, Basis, Contradiction, Conventions, DemoArrays, EefOrientation, GripperSign, InitialGoal,
    ObjectLayout, Proof, QuaternionOrder, RelativeLag, Settings, Unproven,
};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::hand_from_site;

type Outcome = Result<(Conventions, Vec<Proof>), Unproven>;

/// Detects the conventions with and without states.
fn detect_both(demos: &[Demo], env: &EnvArgs, settings: Settings) -> [Outcome; 2] {
    let full: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
    let alone: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays_alone).collect();
    [full, alone].map(|arrays| Conventions::detect(&arrays, env, &settings))
}

/// Without states, deltas and a cube do not determine the frame of the end effector's orientation, so it is set for Lift.
fn known_frame(task: &str) -> Settings {
    Settings {
        eef_orientation: (task == "lift").then_some(EefOrientation::HandBody),
        ..Settings::default()
    }
}

fn declare(env: &EnvArgs, version: &str) -> EnvArgs {
    EnvArgs {
        env_version: Some(version.to_owned()),
        ..env.clone()
    }
}

/// The observations that robosuite 1.5 would have recorded: the relative part is first and delayed by one observation, or (Lift)
/// has the opposite sign.
fn as_written_by_1_5(demo: &Demo) -> Demo {
    let mut new = demo.clone();
    let columns = demo.object_columns;
    if columns == 10 {
        new.object
            .chunks_exact_mut(10)
            .for_each(|row| row[7..].iter_mut().for_each(|value| *value = -*value));
        return new;
    }
    let standard = Conventions {
        task: re4_robosuite::conventions::RobosuiteTask::named("can"),
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
        initial_goal: InitialGoal::ResetPose,
        controls: None,
    };
    for t in 0..demo.frames() {
        let row = &demo.object[t * 14..(t + 1) * 14];
        let mut relative = [0.0; 7];
        if t > 0 {
            let before = standard.decompose(&demo.object[(t - 1) * 14..t * 14]).unwrap().pose;
            let late = standard.hand_pose(demo.eef_pos[t], demo.eef_quat[t]).unwrap().inverse() * before;
            relative[..3].copy_from_slice(late.translation.vector.as_slice());
            relative[3..].copy_from_slice(late.rotation.coords.as_slice());
        }
        new.object[t * 14..t * 14 + 7].copy_from_slice(&relative);
        new.object[t * 14 + 7..(t + 1) * 14].copy_from_slice(&row[..7]);
    }
    new
}

fn changed(demos: &[Demo], change: impl Fn(&Demo) -> Demo) -> Vec<Demo> {
    demos.iter().map(change).collect()
}

fn proof<'a>(proofs: &'a [Proof], convention: &str) -> &'a Proof {
    proofs.iter().find(|proof| proof.convention == convention).unwrap()
}

#[test]
fn conventions_of_scripted_files_are_proven_and_fit_all_demonstrations() {
    for task in TASKS {
        for (file, kind) in [
            ("low_dim.hdf5", ActionKind::Delta),
            ("low_dim_abs.hdf5", ActionKind::Absolute),
        ] {
            let Some(source) = scripted(task, file) else { return };
            let demos = source.demos(10);
            for (states, outcome) in [true, false]
                .into_iter()
                .zip(detect_both(&demos, &source.env, known_frame(task)))
            {
                let (conventions, proofs) = outcome.unwrap();
                for proof in &proofs {
                    let candidates = proof.evidence.candidates.iter();
                    let residuals: Vec<String> =
                        candidates.map(|c| format!("{} {:.1e}", c.value, c.residual)).collect();
                    println!(
                        "{task} {file} states {states}: {} {}",
                        proof.convention,
                        residuals.join(", ")
                    );
                }
                assert_eq!(conventions.action_kind, kind);
                assert_eq!(conventions.gripper_sign, GripperSign::PositiveCloses);
                assert_eq!(conventions.eef_orientation, EefOrientation::HandBody);
                assert_eq!(conventions.eef_quaternion, QuaternionOrder::Xyzw);
                assert_eq!(conventions.object_quaternion, Some(QuaternionOrder::Xyzw));
                assert_eq!(conventions.relative_lag, RelativeLag::Current);
                let layout = if task == "lift" {
                    ObjectLayout::LiftEefMinusCube
                } else {
                    ObjectLayout::PoseFirst
                };
                assert_eq!(conventions.object_layout, Some(layout));
                // Converters leave control_delta unchanged, which causes a warning.
                let warned = proof(&proofs, "action_kind").warning.is_some();
                assert_eq!(warned, kind == ActionKind::Absolute);
                let set = |proof: &&Proof| proof.basis == Basis::Setting;
                let by_setting: Vec<&str> = proofs
                    .iter()
                    .filter(set)
                    .map(|proof| proof.convention.as_str())
                    .collect();
                let unknown = task == "lift" && !states && kind == ActionKind::Delta;
                assert_eq!(by_setting, if unknown { vec!["eef_orientation"] } else { vec![] });
            }
            let arrays: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
            let (conventions, _) = Conventions::detect(&arrays, &source.env, &Settings::default()).unwrap();
            let mut worst = [0.0_f64; 2];
            for name in source.names() {
                let demo = source.demo(&name);
                let residuals = conventions.check(&demo.arrays()).unwrap();
                assert_eq!(residuals.frames, demo.frames());
                let exact = [
                    residuals.relative,
                    residuals.eef_kinematics,
                    residuals.object_kinematics,
                ];
                worst[0] = exact
                    .into_iter()
                    .fold(worst[0], |worst, residual| worst.max(residual.unwrap()));
                worst[1] = worst[1].max(residuals.motion_unexplained.unwrap());
            }
            println!(
                "{task} {file}: maximum residual {:.1e}, motion left unexplained {:.2}",
                worst[0], worst[1]
            );
            assert!(worst[0] < 1e-5);
        }
    }
}

#[test]
fn the_1_5_layout_is_proven_if_declared_and_refused_otherwise() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim.hdf5") else {
            return;
        };
        let demos = changed(&source.demos(10), as_written_by_1_5);
        let (layout, lag, name) = match task {
            "lift" => (
                ObjectLayout::LiftCubeMinusEef,
                RelativeLag::Current,
                "lift_cube_minus_eef",
            ),
            _ => (
                ObjectLayout::RelativeFirst,
                RelativeLag::ObjectOneLate,
                "relative_first",
            ),
        };
        for outcome in detect_both(&demos, &declare(&source.env, "1.5.1"), known_frame(task)) {
            let (conventions, proofs) = outcome.unwrap();
            assert_eq!(
                (conventions.object_layout, conventions.relative_lag),
                (Some(layout), lag)
            );
            assert_eq!(proof(&proofs, "object_layout").warning, None);
            for demo in &demos {
                conventions.check(&demo.arrays()).unwrap();
                let row = conventions.decompose(demo.arrays().object.unwrap().row(7)).unwrap();
                let known = demo.model.observe(
                    demo.arrays().states.unwrap().rows(),
                    conventions.task.map(|task| task.object),
                );
                let known = known.unwrap()[7].object.unwrap();
                assert!((row.pose.translation.vector - known.translation.vector).norm() < 1e-12);
                assert!(row.pose.rotation.angle_to(&known.rotation) < 1e-9);
            }
        }
        for outcome in detect_both(&demos, &source.env, known_frame(task)) {
            let error = outcome.unwrap_err();
            println!("{error}");
            assert!(matches!(
                &error,
                Unproven::Declared {
                    convention: "object_layout",
                    ..
                }
            ));
            assert!(error.to_string().contains(&format!("object_layout = \"{name}\"")));
            assert!(error.to_string().contains("1.4.1"));
        }
        let accept = Settings {
            object_layout: Some(layout),
            ..known_frame(task)
        };
        for outcome in detect_both(&demos, &source.env, accept) {
            let (conventions, proofs) = outcome.unwrap();
            assert_eq!(conventions.object_layout, Some(layout));
            let proof = proof(&proofs, "object_layout");
            assert_eq!(proof.basis, Basis::Data);
            assert!(proof.warning.as_ref().unwrap().contains("1.4.1"));
        }
        // A single demonstration with the layout of another file.
        let arrays: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
        let (conventions, _) =
            Conventions::detect(&arrays, &declare(&source.env, "1.5.1"), &Settings::default()).unwrap();
        let old = source.demo("demo_3");
        let error = conventions.check(&old.arrays()).unwrap_err().to_string();
        assert!(error.starts_with("demo_3: obs/object["), "{error}");
    }
}

/// If observations were computed twice at each state, the relative part is current and only the first row contains zeros.
#[test]
fn relative_parts_of_1_5_may_be_current() {
    let Some(source) = scripted("square", "low_dim.hdf5") else {
        return;
    };
    let demos = changed(&source.demos(4), |demo| {
        let mut demo = demo.clone();
        demo.object.chunks_exact_mut(14).for_each(|row| row.rotate_left(7));
        demo.object[..7].fill(0.0);
        demo
    });
    let declared = declare(&source.env, "1.5.1");
    for outcome in detect_both(&demos, &declared, Settings::default()) {
        let (conventions, _) = outcome.unwrap();
        assert_eq!(conventions.object_layout, Some(ObjectLayout::RelativeFirst));
        assert_eq!(conventions.relative_lag, RelativeLag::Current);
        conventions.check(&demos[0].arrays()).unwrap();
        // Zeros in any other row are not a valid orientation.
        let mut later = demos[1].clone();
        later.object[14 * 5..14 * 5 + 7].fill(0.0);
        let error = conventions.check(&later.arrays()).unwrap_err().to_string();
        assert!(error.starts_with("demo_1: obs/object[3:7], row 5: the norm"), "{error}");
        let mut stale = demos[1].clone();
        stale.object[14 * 5] += 0.01;
        let error = conventions.check(&stale.arrays()).unwrap_err().to_string();
        assert!(
            error.starts_with("demo_1: obs/object[0:7], row 5: the relative part"),
            "{error}"
        );
    }
}

/// A relative part that fits no hypothesis is accepted only with a setting. It is then measured, but no demonstration is refused.
#[test]
fn conventions_from_settings_are_measured_but_refuse_no_demonstration() {
    let Some(source) = scripted("can", "low_dim.hdf5") else {
        return;
    };
    let demos = changed(&source.demos(4), |demo| {
        let mut demo = demo.clone();
        demo.object.chunks_exact_mut(14).for_each(|row| row[7] += 0.004);
        demo
    });
    for outcome in detect_both(&demos, &source.env, Settings::default()) {
        let error = outcome.unwrap_err();
        println!("{error}");
        assert!(matches!(error, Unproven::Undecided { .. }));
    }
    let settings = Settings {
        object_layout: Some(ObjectLayout::PoseFirst),
        object_quaternion: Some(QuaternionOrder::Xyzw),
        ..Settings::default()
    };
    let [outcome, _] = detect_both(&demos, &source.env, settings);
    let (conventions, proofs) = outcome.unwrap();
    assert!(conventions.eef_proven && !conventions.object_proven);
    assert_eq!(proof(&proofs, "object_layout").basis, Basis::Setting);
    let residuals = conventions.check(&demos[0].arrays()).unwrap();
    assert!((residuals.relative.unwrap() - 0.004).abs() < 1e-5);
    let wrong = Settings {
        object_layout: Some(ObjectLayout::RelativeFirst),
        ..settings
    };
    let [outcome, _] = detect_both(&demos, &source.env, wrong);
    assert!(matches!(outcome, Err(Unproven::Setting { .. })));
}

#[test]
fn scalar_first_quaternions_are_detected() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim.hdf5") else {
            return;
        };
        let demos = source.demos(10);
        let hand = changed(&demos, |demo| {
            let mut demo = demo.clone();
            demo.eef_quat
                .iter_mut()
                .for_each(|quaternion| quaternion.rotate_right(1));
            demo
        });
        let object = changed(&demos, |demo| {
            let mut demo = demo.clone();
            let columns = demo.object_columns;
            for row in demo.object.chunks_exact_mut(columns) {
                row[3..7].rotate_right(1);
                if columns == 14 {
                    row[10..14].rotate_right(1);
                }
            }
            demo
        });
        for (demos, convention) in [(hand, "eef_quaternion"), (object, "object_quaternion")] {
            for outcome in detect_both(&demos, &source.env, known_frame(task)) {
                let error = outcome.unwrap_err();
                println!("{task}: {error}");
                let Unproven::Declared {
                    convention: found,
                    proven,
                    ..
                } = &error
                else {
                    panic!("{error}")
                };
                assert_eq!((*found, proven.as_str()), (convention, "wxyz"));
                assert!(error.to_string().contains(&format!("set {convention} = \"wxyz\"")));
            }
            let wxyz = |name: &str| (convention == name).then_some(QuaternionOrder::Wxyz);
            let settings = Settings {
                eef_quaternion: wxyz("eef_quaternion"),
                object_quaternion: wxyz("object_quaternion"),
                ..known_frame(task)
            };
            for outcome in detect_both(&demos, &source.env, settings) {
                let (conventions, _) = outcome.unwrap();
                for demo in &demos {
                    conventions.check(&demo.arrays()).unwrap();
                }
            }
        }
    }
}

#[test]
fn orientations_of_site_and_hand_body_are_distinguished() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim_abs.hdf5") else {
            return;
        };
        let demos = changed(&source.demos(10), |demo| {
            let mut demo = demo.clone();
            for stored in &mut demo.eef_quat {
                let site = QuaternionOrder::Xyzw.rotation(*stored).unwrap() * hand_from_site();
                *stored = site.coords.as_slice().try_into().unwrap();
            }
            demo
        });
        for outcome in detect_both(&demos, &source.env, Settings::default()) {
            let (conventions, proofs) = outcome.unwrap();
            assert_eq!(conventions.eef_orientation, EefOrientation::GripSite, "{task}");
            assert!(proof(&proofs, "eef_orientation").warning.is_some());
            conventions.check(&demos[0].arrays()).unwrap();
        }
    }
}

#[test]
fn the_opposite_gripper_sign_is_detected() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim.hdf5") else {
            return;
        };
        let demos = changed(&source.demos(10), |demo| {
            let mut demo = demo.clone();
            demo.actions.iter_mut().for_each(|action| action[6] = -action[6]);
            demo
        });
        for outcome in detect_both(&demos, &source.env, known_frame(task)) {
            let error = outcome.unwrap_err();
            println!("{task}: {error}");
            assert!(
                matches!(&error, Unproven::Declared { convention: "gripper_sign", proven, .. } if proven == "positive_opens")
            );
        }
        let settings = Settings {
            gripper_sign: Some(GripperSign::PositiveOpens),
            ..known_frame(task)
        };
        for outcome in detect_both(&demos, &source.env, settings) {
            let (conventions, _) = outcome.unwrap();
            conventions.check(&demos[0].arrays()).unwrap();
            let error = conventions.check(&source.demo("demo_0").arrays()).unwrap_err();
            assert!(
                matches!(
                    error,
                    Contradiction::Whole {
                        dataset: "actions[:, 6]",
                        ..
                    }
                ),
                "{error}"
            );
        }
    }
}

#[test]
fn settings_that_contradict_the_data_are_refused() {
    let Some(source) = scripted("can", "low_dim.hdf5") else {
        return;
    };
    let demos = source.demos(5);
    let none = Settings::default();
    let wrong = [
        (
            "object_layout",
            Settings {
                object_layout: Some(ObjectLayout::RelativeFirst),
                ..none
            },
        ),
        (
            "eef_orientation",
            Settings {
                eef_orientation: Some(EefOrientation::GripSite),
                ..none
            },
        ),
        (
            "eef_quaternion",
            Settings {
                eef_quaternion: Some(QuaternionOrder::Wxyz),
                ..none
            },
        ),
        (
            "object_quaternion",
            Settings {
                object_quaternion: Some(QuaternionOrder::Wxyz),
                ..none
            },
        ),
        (
            "action_kind",
            Settings {
                action_kind: Some(ActionKind::Absolute),
                ..none
            },
        ),
        (
            "gripper_sign",
            Settings {
                gripper_sign: Some(GripperSign::PositiveOpens),
                ..none
            },
        ),
    ];
    for (name, settings) in wrong {
        for outcome in detect_both(&demos, &source.env, settings) {
            let error = outcome.unwrap_err();
            assert!(
                matches!(&error, Unproven::Setting { convention, .. } if *convention == name),
                "{error}"
            );
        }
    }
}

#[test]
fn a_demonstration_without_motion_proves_nothing() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim.hdf5") else {
            return;
        };
        let mut demo = source.demo("demo_0");
        demo.cut(3);
        let demos = [demo];
        let mut settings = Settings::default();
        // Each error asks for one more convention, until all are set.
        let mut asked = Vec::new();
        loop {
            let [outcome, _] = detect_both(&demos, &source.env, settings);
            match outcome {
                Err(Unproven::Undecided {
                    convention, setting, ..
                }) => {
                    assert!(setting.contains(convention));
                    asked.push(convention);
                    match convention {
                        "action_kind" => settings.action_kind = Some(ActionKind::Delta),
                        "gripper_sign" => settings.gripper_sign = Some(GripperSign::PositiveCloses),
                        "eef_quaternion" => settings.eef_quaternion = Some(QuaternionOrder::Xyzw),
                        "eef_orientation" => settings.eef_orientation = Some(EefOrientation::HandBody),
                        "object_layout" => {
                            settings.object_layout = Some(match task {
                                "lift" => ObjectLayout::LiftEefMinusCube,
                                _ => ObjectLayout::PoseFirst,
                            });
                        }
                        _ => settings.object_quaternion = Some(QuaternionOrder::Xyzw),
                    }
                }
                Err(error) => panic!("{error}"),
                Ok((_, proofs)) => {
                    assert!(
                        proofs[..6]
                            .iter()
                            .all(|proof| proof.basis == Basis::Setting && proof.warning.is_some())
                    );
                    assert!(proofs[6..8].iter().all(|proof| proof.basis == Basis::Declared));
                    break;
                }
            }
        }
        assert_eq!(asked.len(), 6, "{asked:?}");
    }
}

#[test]
fn errors_name_the_faulty_demonstration() {
    let Some(source) = Source::open("malformed/ok_3demos.hdf5") else {
        return;
    };
    let demos = source.demos(3);
    let arrays: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
    let (conventions, _) = Conventions::detect(&arrays, &source.env, &Settings::default()).unwrap();
    for demo in &demos {
        conventions.check(&demo.arrays()).unwrap();
    }
    let faults = [
        ("quat_not_normalised", "demo_1", "obs/robot0_eef_quat, row"),
        ("quat_not_normalised", "demo_2", "obs/object[3:7], row 20:"),
        ("nan_actions", "demo_1", "actions[10, 2] is NaN"),
        ("length_mismatch", "demo_1", "obs/robot0_eef_pos has"),
        ("actions_out_of_range", "demo_1", "actions, row 6:"),
        (
            "object_9_columns",
            "demo_0",
            "obs/object has 9 columns, but the task needs 10",
        ),
    ];
    for (file, name, sentence) in faults {
        let broken = Source::open(&format!("malformed/{file}.hdf5")).unwrap();
        let error = conventions.check(&broken.demo(name).arrays()).unwrap_err().to_string();
        println!("{error}");
        assert!(error.starts_with(&format!("{name}: {sentence}")), "{error}");
    }
    // The states are shifted by a row, so they do not match the observations.
    let mut shifted = demos[0].clone();
    let columns = shifted.state_columns;
    shifted.states.rotate_left(columns);
    let error = conventions.check(&shifted.arrays()).unwrap_err();
    assert!(matches!(error, Contradiction::Residual { .. }), "{error}");
}

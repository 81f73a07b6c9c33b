//! Detection of the unit, offset, direction and frame of actions on real files, on changed copies of them, and on files from other
//! tools.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may panic")]

mod common;

use std::collections::BTreeSet;

use common::{Demo, Source, TASKS, raw, scripted};
use nalgebra::{UnitQuaternion, Vector3};
use re4_robosuite::conventions::{
    ActionFrame, ActionKind, ActionRotation, ActionScale, Basis, Conventions, DemoArrays, GripperRange, GripperSign,
    InitialGoal, Proof, Settings, Unproven,
};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::hand_from_site;

/// A change of each action.
type Change = fn(&[f64; 7]) -> [f64; 7];
type Boxed<'a> = Box<dyn Fn(&[f64; 7]) -> [f64; 7] + 'a>;

const OUTPUT: [f64; 6] = [0.05, 0.05, 0.05, 0.5, 0.5, 0.5];

fn detect(demos: &[Demo], env: &EnvArgs, settings: &Settings) -> Result<(Conventions, Vec<Proof>), Unproven> {
    let arrays: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
    Conventions::detect(&arrays, env, settings)
}

fn row<'a>(proofs: &'a [Proof], convention: &str) -> &'a Proof {
    proofs.iter().find(|proof| proof.convention == convention).unwrap()
}

fn print(what: &str, proofs: &[Proof]) {
    for name in [
        "gripper_range",
        "action_scale",
        "action_rotation",
        "action_frame",
        "goal_rotation",
        "initial_goal",
    ] {
        let Some(proof) = proofs.iter().find(|proof| proof.convention == name) else {
            continue;
        };
        let each: Vec<String> = proof
            .evidence
            .candidates
            .iter()
            .map(|candidate| format!("{} {:.3}", candidate.value, candidate.residual))
            .collect();
        println!(
            "{what}: {name} {:?} {}, {} frames",
            proof.basis,
            each.join(", "),
            proof.evidence.frames
        );
    }
}

fn foreign(name: &str) -> Option<Source> {
    Source::open(&format!("foreign/{name}/{name}.hdf5"))
}

fn with(demos: &[Demo], change: impl Fn(&[f64; 7]) -> [f64; 7]) -> Vec<Demo> {
    let changed = demos.iter().map(|demo| Demo {
        actions: demo.actions.iter().map(&change).collect(),
        ..demo.clone()
    });
    changed.collect()
}

fn arm(action: &[f64; 7], change: impl Fn(usize, f64) -> f64) -> [f64; 7] {
    std::array::from_fn(|i| if i < 6 { change(i, action[i]) } else { action[i] })
}

#[test]
fn all_conventions_of_scripted_files_are_proven() {
    for task in TASKS {
        for (file, count) in [
            ("low_dim.hdf5", 10),
            ("low_dim.hdf5", 4),
            ("low_dim_abs.hdf5", 10),
            ("low_dim_abs.hdf5", 4),
        ] {
            let Some(source) = scripted(task, file) else { return };
            let (conventions, proofs) = detect(&source.demos(count), &source.env, &Settings::default()).unwrap();
            print(&format!("{task} {file} {count}"), &proofs);
            let names: &[&str] = match conventions.action_kind {
                ActionKind::Delta => &["gripper_range", "action_scale", "action_rotation", "initial_goal"],
                ActionKind::Absolute => &["gripper_range", "action_frame", "goal_rotation", "initial_goal"],
            };
            for name in names {
                assert_eq!(row(&proofs, name).basis, Basis::Data, "{task} {file} {name}");
            }
            assert_eq!(conventions.initial_goal, InitialGoal::ResetPose);
            assert!(conventions.actions.is_plain());
        }
    }
    let Some(mixed) = Source::open("robomimic-mixed/can_mixed.hdf5") else {
        return;
    };
    let (conventions, proofs) = detect(&mixed.demos(10), &mixed.env, &Settings::default()).unwrap();
    print("mixed", &proofs);
    for name in mixed.names() {
        conventions.check(&mixed.demo(&name).arrays()).unwrap();
    }
}

/// Human demonstrations have many idle frames, saturated keyboard commands and pushing contacts. Those of robosuite 1.0 have
/// reversed rotations.
#[test]
fn all_conventions_of_human_files_are_proven() {
    let folders = [
        ("1.4.1-demos/lift", ActionRotation::Forward),
        ("1.0.1-demos/lift/panda", ActionRotation::Reversed),
        ("1.0.1-demos/stack/panda", ActionRotation::Reversed),
        ("1.0.1-demos/nut-assembly/panda", ActionRotation::Reversed),
        ("1.0.1-demos/pick-place/panda", ActionRotation::Reversed),
        ("1.0.1-demos/door/panda", ActionRotation::Reversed),
    ];
    for (folder, rotation) in folders {
        let Some((env, demos)) = raw(folder) else { return };
        let settings = Settings {
            allow_actions_beyond_range: true,
            gripper_sign: folder.contains("door").then_some(GripperSign::PositiveCloses),
            ..Settings::default()
        };
        let (conventions, proofs) = detect(&demos, &env, &settings).unwrap();
        print(folder, &proofs);
        assert_eq!(row(&proofs, "action_scale").basis, Basis::Data, "{folder}");
        assert_eq!(conventions.actions.rotation, rotation, "{folder}");
        // The end effector's motion shows that the controller starts from the reset pose here as well.
        assert_eq!(conventions.initial_goal, InitialGoal::ResetPose, "{folder}");
        assert_eq!(row(&proofs, "initial_goal").basis, Basis::Data, "{folder}");
        for demo in &demos {
            conventions.check(&demo.arrays()).unwrap();
        }
    }
}

/// A file with live observations has the same initial goal as the raw file with the same states.
#[test]
fn live_observations_have_the_same_initial_goal_as_the_raw_file() {
    let (Some(live), Some((env, demos))) = (foreign("h76_live_observations"), raw("1.4.1-demos/lift")) else {
        return;
    };
    let settings = Settings {
        allow_actions_beyond_range: true,
        ..Settings::default()
    };
    let (of_live, proofs) = detect(&live.demos(3), &live.env, &settings).unwrap();
    print("live", &proofs);
    let (of_raw, _) = detect(&demos, &env, &settings).unwrap();
    assert_eq!(of_live.initial_goal, of_raw.initial_goal);
    let set = Settings {
        initial_goal: Some(InitialGoal::FirstPose),
        ..settings
    };
    let error = detect(&demos, &env, &set).unwrap_err();
    assert!(
        matches!(
            error,
            Unproven::Setting {
                convention: "initial_goal",
                ..
            }
        ),
        "{error}"
    );
}

#[test]
fn exactly_the_planted_faults_are_found() {
    let Some(source) = Source::open("audit-truth/lift_faults.hdf5") else {
        return;
    };
    // Three of the first ten demonstrations have frozen rows although their states continue.
    let demos = source.demos(10);
    let arrays: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
    let learned = Conventions::detect_excluding(&arrays, &source.env, &Settings::default()).unwrap();
    let odd: Vec<&str> = learned.odd.iter().map(|odd| odd.demo.as_str()).collect();
    println!("{:?}", learned.odd);
    let conventions = learned.conventions;
    print("faults", &learned.proofs);
    let mut refused = BTreeSet::new();
    for name in source.names() {
        if let Err(error) = conventions.check(&source.demo(&name).arrays()) {
            println!("{error}");
            refused.insert(name);
        }
    }
    assert!(odd.iter().all(|odd| refused.contains(*odd)));
    // Frozen pose (0, 1, 9), frozen object pose (25, 49), reversed rows (28), halved actions (41), gripper sign (59).
    let planted = [0, 1, 9, 25, 28, 41, 49, 59].map(|number| format!("demo_{number}"));
    assert_eq!(refused, BTreeSet::from(planted));
}

#[test]
fn errors_describe_changed_actions() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim.hdf5") else {
            return;
        };
        for count in [4, 10] {
            let demos = source.demos(count);
            let all: Vec<[f64; 7]> = demos.iter().flat_map(|demo| demo.actions.clone()).collect();
            let bounds: Vec<(f64, f64)> = (0..6)
                .map(|i| {
                    all.iter()
                        .fold((0.0_f64, 0.0_f64), |(low, high), a| (low.min(a[i]), high.max(a[i])))
                })
                .collect();
            let mean: Vec<f64> = (0..6)
                .map(|i| all.iter().map(|a| a[i]).sum::<f64>() / all.len() as f64)
                .collect();
            let deviation: Vec<f64> = (0..6)
                .map(|i| (all.iter().map(|a| (a[i] - mean[i]).powi(2)).sum::<f64>() / all.len() as f64).sqrt())
                .collect();
            let changes: [(&str, Boxed<'_>, &str); 7] = [
                (
                    "metres",
                    Box::new(|a| arm(a, |i, v| v * OUTPUT[i])),
                    "set action_scale = \"metres\"",
                ),
                ("ten times", Box::new(|a| arm(a, |_, v| 10.0 * v)), "another unit"),
                ("a tenth", Box::new(|a| arm(a, |_, v| 0.1 * v)), "another unit"),
                (
                    "rotation a tenth",
                    Box::new(|a| arm(a, |i, v| if i < 3 { v } else { 0.1 * v })),
                    "the end effector rotates",
                ),
                (
                    "radians only",
                    Box::new(|a| arm(a, |i, v| if i < 3 { v } else { 0.5 * v })),
                    "the end effector rotates",
                ),
                (
                    "its own range",
                    Box::new(|a| arm(a, |i, v| 2.0 * (v - bounds[i].0) / (bounds[i].1 - bounds[i].0) - 1.0)),
                    "action_gain and action_offset",
                ),
                (
                    "mean and deviation",
                    Box::new(|a| arm(a, |i, v| (v - mean[i]) / deviation[i])),
                    "action_gain and action_offset",
                ),
            ];
            for (what, change, sentence) in &changes {
                let error = detect(&with(&demos, change), &source.env, &Settings::default()).unwrap_err();
                println!("{task} {count} {what}: {error}");
                assert!(error.to_string().contains(sentence), "{task} {count} {what}: {error}");
            }
            let undo = Settings {
                action_gain: Some(std::array::from_fn(|i| (bounds[i].1 - bounds[i].0) / 2.0)),
                action_offset: Some(std::array::from_fn(|i| f64::midpoint(bounds[i].0, bounds[i].1))),
                ..Settings::default()
            };
            let normalised = with(&demos, &changes[5].1);
            let (conventions, proofs) = detect(&normalised, &source.env, &undo).unwrap();
            assert_eq!(row(&proofs, "action_scale").basis, Basis::Data);
            for (normalised, demo) in normalised.iter().zip(&demos) {
                for (recorded, action) in normalised.actions.iter().zip(&demo.actions) {
                    let read = conventions.actions.read(recorded);
                    assert!(
                        read.iter()
                            .zip(action)
                            .all(|(read, action)| (read - action).abs() < 1e-12)
                    );
                }
            }
        }
    }
}

#[test]
fn errors_describe_changed_goals() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim_abs.hdf5") else {
            return;
        };
        let demos = source.demos(10);
        let base = demos[0].model.base().unwrap();
        let goal = |a: &[f64; 7]| UnitQuaternion::from_scaled_axis(Vector3::new(a[3], a[4], a[5]));
        let with_rotation =
            |a: &[f64; 7], rotation: Vector3<f64>| [a[0], a[1], a[2], rotation.x, rotation.y, rotation.z, a[6]];
        let in_base = with(&demos, |a| {
            arm(a, |i, v| if i < 3 { v - base.translation.vector[i] } else { v })
        });
        for kind in [None, Some(ActionKind::Absolute)] {
            let settings = Settings {
                action_kind: kind,
                ..Settings::default()
            };
            let error = detect(&in_base, &source.env, &settings).unwrap_err().to_string();
            println!("{task}: {error}");
            assert!(error.contains("action_frame = \"base\""), "{error}");
            assert!(error.contains("fit in the frame of the robot's base"), "{error}");
            let shifted = with(&demos, |a| arm(a, |i, v| if i == 0 { v + 0.15 } else { v }));
            let error = detect(&shifted, &source.env, &settings).unwrap_err().to_string();
            assert!(
                error.contains("(0.15") && error.contains("they are not in the world frame"),
                "{error}"
            );
        }
        let settings = Settings {
            action_frame: Some(ActionFrame::Base),
            ..Settings::default()
        };
        let (conventions, proofs) = detect(&in_base, &source.env, &settings).unwrap();
        assert_eq!(row(&proofs, "action_frame").basis, Basis::Data);
        for (in_base, demo) in in_base.iter().zip(&demos) {
            conventions.check(&in_base.arrays()).unwrap();
            assert!(conventions.check(&demo.arrays()).is_err());
            for (recorded, action) in in_base.actions.iter().zip(&demo.actions) {
                let read = conventions.actions.read(recorded);
                assert!(
                    read.iter()
                        .zip(action)
                        .all(|(read, action)| (read - action).abs() < 1e-12)
                );
            }
        }
        let error = detect(&demos, &source.env, &settings).unwrap_err().to_string();
        assert!(error.contains("contradicted by the data"), "{error}");
        let hand = with(&demos, |a| {
            with_rotation(a, (goal(a) * hand_from_site().inverse()).scaled_axis())
        });
        let error = detect(&hand, &source.env, &Settings::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains("rotation vectors of the hand body"), "{error}");
        let angles = with(&demos, |a| {
            let (roll, pitch, yaw) = goal(a).euler_angles();
            with_rotation(a, Vector3::new(roll, pitch, yaw))
        });
        let error = detect(&angles, &source.env, &Settings::default())
            .unwrap_err()
            .to_string();
        println!("{task}: {error}");
        assert!(error.contains("roll, pitch and yaw"), "{error}");
    }
}

#[test]
fn files_from_other_tools_are_recognised_and_accepted_by_a_setting() {
    let cases: [(&str, &str, &str, Settings); 3] = [
        (
            "h26_deltas_in_metres",
            "h00_control_can",
            "output_max 0.05: the actions are deltas in metres and radians",
            Settings {
                action_scale: Some(ActionScale::Metres),
                ..Settings::default()
            },
        ),
        (
            "h28_gripper_zero_one",
            "h00_control_lift",
            "the fingers open under command 0 and close under 1",
            Settings {
                gripper_range: Some(GripperRange::ZeroOne),
                ..Settings::default()
            },
        ),
        (
            "h24_absolute_in_base_frame",
            "",
            "fit in the frame of the robot's base",
            Settings {
                action_frame: Some(ActionFrame::Base),
                ..Settings::default()
            },
        ),
    ];
    for (name, control, sentence, settings) in cases {
        let Some(source) = foreign(name) else { return };
        let demos = source.demos(4);
        let error = detect(&demos, &source.env, &Settings::default())
            .unwrap_err()
            .to_string();
        println!("{name}: {error}");
        assert!(error.contains(sentence), "{error}");
        let (conventions, proofs) = detect(&demos, &source.env, &settings).unwrap();
        print(name, &proofs);
        for demo in &demos {
            conventions.check(&demo.arrays()).unwrap();
        }
        let Some(control) = (!control.is_empty()).then(|| foreign(control).unwrap()) else {
            continue;
        };
        for demo in &demos {
            for (recorded, action) in demo.actions.iter().zip(&control.actions(&demo.name)) {
                let read = conventions.actions.read(recorded);
                assert!(
                    read.iter()
                        .zip(action)
                        .all(|(read, action)| (read - action).abs() < 1e-9)
                );
            }
        }
    }
    // A setting for the kind of action is refused if it contradicts most of the motion.
    let Some(source) = foreign("h24_absolute_in_base_frame") else {
        return;
    };
    let settings = Settings {
        action_kind: Some(ActionKind::Absolute),
        ..Settings::default()
    };
    let error = detect(&source.demos(4), &source.env, &settings)
        .unwrap_err()
        .to_string();
    assert!(error.contains("action_frame = \"base\""), "{error}");
    let Some(joints) = foreign("h23_joint_deltas_7_declared_osc") else {
        return;
    };
    for kind in [ActionKind::Delta, ActionKind::Absolute] {
        let settings = Settings {
            action_kind: Some(kind),
            ..Settings::default()
        };
        let error = detect(&joints.demos(4), &joints.env, &settings)
            .unwrap_err()
            .to_string();
        println!("h23: {error}");
        assert!(
            error.contains("leaves most of the end effector's motion unexplained") || error.contains("contradicted"),
            "{error}"
        );
    }
    let Some(cut_off) = foreign("h64_preallocated_rows_counted") else {
        return;
    };
    let error = detect(&cut_off.demos(4), &cut_off.env, &Settings::default())
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("demo_2: rows 53 to 79 contain only zeros"), "{error}");
    let Some(square) = foreign("h01_mimicgen_square_d0") else {
        return;
    };
    let (conventions, _) = detect(&square.demos(3), &square.env, &Settings::default()).unwrap();
    assert!(conventions.object_layout.is_some());
}

/// A single demonstration with other conventions, among correct ones.
#[test]
fn a_demonstration_with_other_conventions_is_named() {
    for task in TASKS {
        let Some(source) = scripted(task, "low_dim.hdf5") else {
            return;
        };
        let demos = source.demos(5);
        let changes: [(&str, Change); 5] = [
            ("metres", |a| arm(a, |i, v| v * OUTPUT[i])),
            ("a tenth", |a| arm(a, |_, v| 0.1 * v)),
            ("reversed rotations", |a| arm(a, |i, v| if i < 3 { v } else { -v })),
            ("gripper from 0", |a| {
                let mut a = *a;
                a[6] = f64::midpoint(a[6], 1.0);
                a
            }),
            ("gripper negated", |a| {
                let mut a = *a;
                a[6] = -a[6];
                a
            }),
        ];
        for (what, change) in changes {
            let mut mixed = demos.clone();
            mixed[1] = with(&demos[1..2], change).remove(0);
            let named = match detect(&mixed, &source.env, &Settings::default()) {
                Err(error) => error.to_string(),
                Ok((conventions, _)) => match conventions.check(&mixed[1].arrays()) {
                    Err(error) => error.to_string(),
                    Ok(_) => panic!("{task} {what}"),
                },
            };
            println!("{task} {what}: {named}");
            assert!(named.starts_with("demo_1: "), "{task} {what}: {named}");
            let arrays: Vec<DemoArrays<'_>> = mixed.iter().map(Demo::arrays).collect();
            let learned = Conventions::detect_excluding(&arrays, &source.env, &Settings::default()).unwrap();
            assert!(learned.odd.iter().all(|odd| odd.demo == "demo_1"), "{:?}", learned.odd);
        }
    }
}

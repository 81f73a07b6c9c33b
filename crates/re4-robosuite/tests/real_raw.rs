//! Conventions of human demonstrations in robosuite's raw layout: observations are computed from the states.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may panic")]

mod common;

use common::{Demo, raw};
use re4_robosuite::conventions::{ActionKind, Basis, Contradiction, Conventions, GripperSign, Settings, Unproven};

/// The gripper stays fully open while it opens the door by its handle. Three frames of opening at the start are too few.
#[test]
fn a_gripper_that_hardly_moves_does_not_prove_the_sign() {
    let Some((env, demos)) = raw("1.0.1-demos/door/panda") else {
        return;
    };
    let arrays: Vec<_> = demos.iter().map(Demo::arrays).collect();
    let error = Conventions::detect(&arrays, &env, &Settings::default()).unwrap_err();
    println!("{error}");
    assert!(matches!(
        error,
        Unproven::Undecided {
            convention: "gripper_sign",
            ..
        }
    ));
    let settings = Settings {
        gripper_sign: Some(GripperSign::PositiveCloses),
        ..Settings::default()
    };
    let (_, proofs) = Conventions::detect(&arrays, &env, &settings).unwrap();
    assert_eq!(proofs[1].basis, Basis::Setting);
}

#[test]
fn actions_of_human_demonstrations_are_proven_from_states_only() {
    let folders = [
        "1.4.1-demos/lift",
        "1.0.1-demos/lift/panda",
        "1.0.1-demos/stack/panda",
        "1.0.1-demos/nut-assembly/panda",
        "1.0.1-demos/pick-place/panda",
    ];
    for folder in folders {
        let Some((env, demos)) = raw(folder) else { return };
        let arrays: Vec<_> = demos.iter().map(Demo::arrays).collect();
        let (conventions, proofs) = Conventions::detect(&arrays, &env, &Settings::default()).unwrap();
        for proof in &proofs[..2] {
            let candidates = proof.evidence.candidates.iter();
            let residuals: Vec<String> = candidates.map(|c| format!("{} {:.3}", c.value, c.residual)).collect();
            println!(
                "{folder}: {} {}, {} frames",
                proof.convention,
                residuals.join(", "),
                proof.evidence.frames
            );
        }
        assert_eq!(
            (conventions.action_kind, conventions.gripper_sign),
            (ActionKind::Delta, GripperSign::PositiveCloses)
        );
        assert_eq!(conventions.object_layout, None);
        for demo in &demos {
            match conventions.check(&demo.arrays()) {
                Ok(residuals) => assert!(residuals.fingers_against.unwrap() < 0.1),
                // Keyboard teleoperation recorded commands of 3.75.
                Err(error) => {
                    println!("{folder}: {error}");
                    assert_eq!(folder, "1.4.1-demos/lift");
                    assert!(matches!(error, Contradiction::Residual { measured, .. } if measured > 2.0));
                    let allowed = Conventions {
                        allow_actions_beyond_range: true,
                        ..conventions
                    };
                    let beyond = allowed.check(&demo.arrays()).unwrap().beyond_range;
                    assert!((beyond.unwrap() - 2.75).abs() < 1e-9);
                }
            }
        }
    }
}

//! Tests the audit without an object on constructed motions with exactly one fault.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::collections::BTreeSet;

use nalgebra::Vector3;
use re4_artifact::episodes::{ArmColumns, SignalRole, SignalRow, SignalVector};
use re4_audit::{
    ArmDemo, ArmFacts, ArmSurvey, AuditConfig, FingerUnit, GraspLimits, Thresholds, audit_arm, audit_copies,
    observe_arm,
};
use re4_segment::{ArmEpisode, Gripper, GripperObservation, Known, OpeningConfig, Rule, segment_arm};

const FRAMES: usize = 80;

/// A reach, a grasp of an object as wide as half of the opening, and a lift. `number` makes it different from the others. Joint
/// positions follow the displacements that are commanded in the step before.
fn flawless(number: u32, eef: bool) -> ArmEpisode {
    let own = f64::from(number);
    let mut position = Vector3::new(0.02 * own, 0.03 * own, 0.3);
    let mut opening = 1.0_f64;
    let mut before = Vector3::zeros();
    let frames = (0..FRAMES).map(|frame| {
        let t = frame as f64;
        let command = Vector3::new((0.3 * t + own).sin(), (0.2 * t).cos(), (0.25 * t + 0.5 * own).cos());
        let closes = (20..60).contains(&frame);
        let row = ArmColumns {
            time: Some(0.05 * t),
            state: position.iter().copied().chain([opening]).collect(),
            action: command
                .iter()
                .copied()
                .chain([if closes { 1.0 } else { -1.0 }])
                .collect(),
            eef: eef.then_some(position),
            eef_orientation: None,
            opening: Some(opening),
            gripper: Some(if closes { 1.0 } else { -1.0 }),
            reward: None,
            done: None,
        };
        position += 0.01 * before;
        before = command;
        opening = if closes {
            (opening - 0.1).max(0.5)
        } else {
            (opening + 0.1).min(1.0)
        };
        row
    });
    ArmEpisode {
        name: format!("demo_{number}"),
        frames: frames.collect(),
    }
}

fn signals(eef: bool) -> Vec<SignalRow> {
    let role = |index: u32| match index {
        3 => SignalRole::Gripper,
        _ if eef => SignalRole::EefPosition,
        _ => SignalRole::Joint,
    };
    let row = |vector: SignalVector, index: u32| SignalRow {
        vector,
        index,
        name: format!("j{index}"),
        role: role(index),
        unit: None,
        basis: "name".into(),
    };
    let of = |vector: SignalVector| (0..4).map(move |index| row(vector, index));
    of(SignalVector::State).chain(of(SignalVector::Action)).collect()
}

const LIMITS: GraspLimits = GraspLimits {
    closed: 0.125,
    lost: 0.02,
    flicker: 5,
    frozen: 3,
    swapped: 0.03,
    fingers: FingerUnit::Travel,
};

struct Audited {
    facts: ArmFacts,
    thresholds: Thresholds,
    /// Demonstration and code of each finding.
    found: BTreeSet<(u32, &'static str)>,
}

fn audit(episodes: &[ArmEpisode], eef: bool) -> Audited {
    let known = Known {
        finger_distance: true,
        ..Known::default()
    };
    let observed: Vec<_> = episodes.iter().map(GripperObservation::of).collect();
    let gripper = Gripper::prove(&observed, &known, &OpeningConfig::default()).ok();
    let demos: Vec<ArmDemo> = (0..)
        .zip(episodes)
        .map(|(number, episode)| ArmDemo {
            number,
            segmented: segment_arm(episode, Rule::Gripper, gripper.as_ref()).unwrap(),
            episode: episode.clone(),
        })
        .collect();
    let survey = ArmSurvey::new(signals(eef), eef);
    let surveyed: Vec<_> = episodes.iter().map(|episode| survey.observe(episode)).collect();
    let facts = survey.facts(&surveyed, gripper, Rule::Gripper, Some(20.0));
    let observations: Vec<_> = demos.iter().map(|demo| observe_arm(demo, &facts, &LIMITS)).collect();
    let thresholds = Thresholds::of(&observations, &AuditConfig::default(), &facts.dataset());
    let own = demos
        .iter()
        .flat_map(|demo| audit_arm(demo, &facts, &thresholds, &LIMITS));
    let found = audit_copies(&observations, &thresholds).into_iter().chain(own);
    Audited {
        found: found.map(|finding| (finding.episode, finding.code)).collect(),
        facts,
        thresholds,
    }
}

/// Audits twelve demonstrations of which the last one has a fault.
fn with_fault(eef: bool, fault: impl Fn(&mut ArmEpisode)) -> Vec<&'static str> {
    let mut episodes: Vec<_> = (0..12).map(|number| flawless(number, eef)).collect();
    fault(episodes.last_mut().unwrap());
    let audited = audit(&episodes, eef);
    assert!(audited.found.iter().all(|(demo, _)| *demo == 11), "{:?}", audited.found);
    audited.found.into_iter().map(|(_, code)| code).collect()
}

#[test]
fn flawless_demonstrations_have_no_findings() {
    for eef in [true, false] {
        assert_eq!(with_fault(eef, |_| ()), [""; 0]);
    }
}

#[test]
fn every_fault_is_named() {
    for eef in [true, false] {
        let actions = |factor: f64| {
            with_fault(eef, |own| {
                for frame in &mut own.frames {
                    frame.action.iter_mut().take(3).for_each(|part| *part *= factor);
                }
            })
        };
        assert_eq!(actions(-1.0), ["actions_opposed"]);
        assert_eq!(actions(2.0), ["actions_scaled"]);
        let shifted = with_fault(eef, |own| {
            let actions: Vec<_> = own.frames.iter().map(|frame| frame.action.clone()).collect();
            for (frame, action) in own.frames.iter_mut().skip(2).zip(actions) {
                frame.action[..3].copy_from_slice(&action[..3]);
            }
        });
        assert_eq!(shifted, ["actions_shifted"]);
        let gap = with_fault(eef, |own| {
            for frame in own.frames.iter_mut().skip(40) {
                frame.time = frame.time.map(|time| time + 0.2);
            }
        });
        assert_eq!(gap, ["timestamps"]);
        let missed = with_fault(eef, |own| {
            for frame in &mut own.frames {
                frame.opening = frame.opening.map(|opening| 2.0 * opening - 1.0);
            }
        });
        assert!(missed.contains(&"missed_grasp"), "{missed:?}");
        let against = with_fault(eef, |own| {
            for frame in &mut own.frames {
                frame.gripper = frame.gripper.map(|command| -command);
            }
        });
        assert!(against.contains(&"gripper_reversed"), "{against:?}");
        let copy = with_fault(eef, |own| own.frames = flawless(3, eef).frames);
        assert_eq!(copy, ["duplicate"]);
        let near = with_fault(eef, |own| {
            own.frames = flawless(3, eef).frames;
            for (place, frame) in own.frames.iter_mut().enumerate() {
                let noise = 1e-5 * (7.0 * place as f64).sin();
                frame.state.iter_mut().take(3).for_each(|part| *part += noise);
                frame.eef = frame.eef.map(|eef| eef.add_scalar(noise));
            }
        });
        assert!(near.contains(&"near_duplicate"), "{near:?}");
    }
    let frozen = with_fault(false, |own| {
        let kept = own.frames[20].state[1];
        own.frames
            .iter_mut()
            .skip(20)
            .take(25)
            .for_each(|frame| frame.state[1] = kept);
    });
    assert!(frozen.contains(&"frozen_signal"), "{frozen:?}");
}

#[test]
fn units_of_joints_do_not_matter() {
    let scaled = |factor: f64| {
        let mut episodes: Vec<_> = (0..12).map(|number| flawless(number, false)).collect();
        for frame in &mut episodes[11].frames {
            frame.action.iter_mut().take(3).for_each(|part| *part *= -1.0);
        }
        for frame in episodes.iter_mut().flat_map(|own| &mut own.frames) {
            frame.state.iter_mut().take(3).for_each(|part| *part *= factor);
        }
        audit(&episodes, false).found
    };
    assert_eq!(scaled(1.0), BTreeSet::from([(11, "actions_opposed")]));
    assert_eq!(scaled(57.3), scaled(1.0));
}

#[test]
fn targets_and_displacements_are_distinguished() {
    let mut episodes: Vec<_> = (0..12).map(|number| flawless(number, false)).collect();
    assert!(!audit(&episodes, false).facts.absolute);
    for own in &mut episodes {
        for frame in &mut own.frames {
            for axis in 0..3 {
                frame.action[axis] = frame.state[axis] + 0.01 * frame.action[axis];
            }
        }
    }
    let audited = audit(&episodes, false);
    assert!(audited.facts.absolute);
    assert_eq!(audited.found, BTreeSet::new());
}

#[test]
fn checks_that_cannot_be_made_have_a_reason() {
    let mut episodes: Vec<_> = (0..12).map(|number| flawless(number, false)).collect();
    for frame in episodes.iter_mut().flat_map(|own| &mut own.frames) {
        (frame.opening, frame.gripper, frame.time) = (None, None, None);
    }
    let audited = audit(&episodes, false);
    let reason = |code: &str| {
        let found = audited
            .thresholds
            .iter()
            .find(|(check, _)| check.code == code)
            .unwrap()
            .1;
        (!found.made).then(|| found.derivation.clone())
    };
    for (code, why) in [
        ("dropped", "not made: the dataset has no pose of an object"),
        (
            "discontinuity_eef",
            "not made: the dataset has no position of the end effector",
        ),
        ("missed_grasp", "not made: the opening of the gripper was not recorded"),
        ("timestamps", "not made: the dataset has no times of frames"),
        ("ends_before_success", "not made: the dataset has no rewards"),
    ] {
        assert_eq!(reason(code).as_deref(), Some(why), "{code}");
    }
    assert_eq!(reason("actions_opposed"), None);
    assert_eq!(reason("idle"), None);
}

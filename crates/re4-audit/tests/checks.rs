//! Tests every check on constructed motions with exactly one fault, and on motions without faults.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::collections::BTreeSet;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use re4_audit::{
    AuditConfig, CHECKS, Finding, FingerUnit, GraspLimits, GraspOutcome, Observation, Origin, PlanarDemo, SpatialDemo,
    Thresholds, audit_copies, audit_planar, audit_spatial, observe_planar, observe_spatial,
};
use re4_episode::{PlanarEpisode, PlanarFrame, SpatialEpisode, SpatialFrame};
use re4_geometry::{Point2, Pose2};
use re4_segment::{SegmentConfig, segment_planar, segment_spatial};

const LIMITS: GraspLimits = GraspLimits {
    closed: 0.01,
    lost: 0.02,
    flicker: 5,
    frozen: 3,
    swapped: 0.03,
    fingers: FingerUnit::Metres,
};

/// A flawless demonstration: reach for 10 frames, close in 8, carry for 20, open in 8, retreat for 6. `number` makes it different
/// from the others, so that it is not reported as a copy.
fn flawless(number: u32) -> Vec<SpatialFrame> {
    let mut frames = Vec::new();
    let own = 1e-4 * f64::from(number);
    let place = 0.005 * f64::from(number);
    let mut eef = Vector3::new(0.2 + place, 0.0, 0.9);
    let mut object = Vector3::new(0.2 + place, 0.0, 0.8);
    for t in 0..52 {
        let closes = (9..37).contains(&t);
        let separation = match t {
            0..10 => 0.08,
            10..18 => (0.08 - 0.005 * f64::from(t - 9)).max(0.05),
            18..38 => 0.05,
            _ => (0.05 + 0.005 * f64::from(t - 37)).min(0.08),
        };
        frames.push(SpatialFrame {
            eef: Isometry3::new(eef, Vector3::new(3.0, 0.0, 0.0)),
            object: Isometry3::translation(object.x, object.y, object.z),
            fingers: [separation / 2.0, -separation / 2.0],
            delta: [0.1 + own, 0.0, 0.1, 0.0, 0.0, 0.0],
            goal: [eef.x, eef.y, eef.z, 2.0, 0.0, 0.0],
            gripper: if closes { 1.0 } else { -1.0 },
            reward: Some(if t > 45 { 1.0 } else { 0.0 }),
        });
        let step = match t {
            0..9 => Vector3::new(0.0, 0.0, -0.01),
            18..38 => Vector3::new(0.0, 0.01, 0.0),
            46.. => Vector3::new(0.0, 0.0, 0.01),
            _ => Vector3::new(1e-6, 0.0, 0.0),
        };
        eef += step;
        if (18..38).contains(&t) {
            object += step;
        }
    }
    frames
}

fn demo(number: u32, frames: Vec<SpatialFrame>) -> SpatialDemo {
    let episode = SpatialEpisode {
        name: format!("demo_{}", 2 * number),
        frames,
    };
    SpatialDemo {
        number,
        segmented: segment_spatial(&episode, &SegmentConfig::spatial()).unwrap(),
        episode,
    }
}

fn audit(faulty: Vec<SpatialFrame>, config: &AuditConfig) -> (Vec<Finding>, Vec<GraspOutcome>) {
    let mut demos: Vec<SpatialDemo> = (0..10).map(|number| demo(number, flawless(number))).collect();
    demos.push(demo(10, faulty));
    let observations: Vec<Observation> = demos.iter().map(|demo| observe_spatial(demo, &LIMITS)).collect();
    let thresholds = Thresholds::derive(&observations, config, false, LIMITS.closed);
    let mut findings = audit_copies(&observations, &thresholds);
    let mut outcomes = Vec::new();
    for demo in &demos {
        let audit = audit_spatial(demo, &thresholds, &LIMITS);
        if demo.number < 10 {
            assert_eq!(audit.findings, [], "a flawless demonstration");
        } else {
            outcomes = audit.grasps.iter().map(|grasp| grasp.outcome).collect();
        }
        findings.extend(audit.findings);
    }
    (findings, outcomes)
}

fn codes(findings: &[Finding]) -> BTreeSet<&'static str> {
    findings.iter().map(|finding| finding.code).collect()
}

/// Codes of the findings on a flawless demonstration after `change`.
fn found(change: impl FnOnce(&mut Vec<SpatialFrame>)) -> BTreeSet<&'static str> {
    let mut frames = flawless(10);
    change(&mut frames);
    codes(&audit(frames, &AuditConfig::default()).0)
}

#[test]
fn flawless_demonstrations_have_no_findings() {
    let (findings, outcomes) = audit(flawless(10), &AuditConfig::default());
    assert_eq!(findings, []);
    assert_eq!(outcomes, [GraspOutcome::Held]);
}

#[test]
fn fingers_that_do_not_move_disagree_with_the_command() {
    let stuck = found(|frames| {
        for frame in frames {
            frame.fingers = [0.04, -0.04];
        }
    });
    assert!(stuck.contains("command_fingers_disagree"), "{stuck:?}");
    let shut = found(|frames| {
        for frame in &mut frames[38..] {
            frame.fingers = [0.025, -0.025];
        }
    });
    assert_eq!(shut, BTreeSet::from(["command_fingers_disagree"]));
}

#[test]
fn closing_on_another_object_is_a_missed_grasp() {
    let mut faulty = flawless(10);
    let rests = faulty[0].object;
    for frame in &mut faulty {
        frame.object = rests;
    }
    let (findings, outcomes) = audit(faulty, &AuditConfig::default());
    assert_eq!(outcomes, [GraspOutcome::Missed]);
    let missed = findings.iter().find(|finding| finding.code == "missed_grasp").unwrap();
    assert!(missed.message.contains("does not follow"), "{}", missed.message);
    assert_eq!(missed.frames, 10..38);
}

#[test]
fn an_object_that_leaves_the_gripper_is_lost_from_that_frame() {
    let mut faulty = flawless(10);
    let left = Isometry3::translation(0.0, -0.005, 0.0) * faulty[28].object;
    for (frame, closer) in faulty[28..].iter_mut().zip(1..) {
        frame.object = left;
        // With nothing between them, the fingers close.
        let separation = (0.05 - 0.006 * f64::from(closer)).max(0.002);
        frame.fingers = [separation / 2.0, -separation / 2.0];
    }
    let (findings, outcomes) = audit(faulty, &AuditConfig::default());
    // The object is 0.5 cm off at frame 28, and the end effector moves away by 1 cm per frame: 2.5 cm at frame 30.
    assert_eq!(outcomes, [GraspOutcome::Lost(30)]);
    let lost = findings.iter().find(|finding| finding.code == "lost_grasp").unwrap();
    assert_eq!((lost.frames.clone(), lost.threshold), (28..38, Some(0.02)));
}

#[test]
fn a_grasp_continues_across_flickers_of_the_command() {
    let mut faulty = flawless(10);
    for t in [24, 27] {
        faulty[t].gripper = -1.0;
    }
    let (findings, outcomes) = audit(faulty, &AuditConfig::default());
    assert_eq!(outcomes, [GraspOutcome::Held, GraspOutcome::Brief, GraspOutcome::Held]);
    let frames: Vec<_> = findings
        .iter()
        .map(|finding| (finding.code, finding.frames.clone()))
        .collect();
    assert_eq!(frames, [("flicker", 25..29)]);
}

#[test]
fn slipping_and_rotating_in_the_gripper_are_distinguished() {
    let slips = found(|frames| {
        for frame in &mut frames[28..] {
            frame.object = Isometry3::translation(0.008, 0.0, 0.0) * frame.object;
        }
    });
    assert_eq!(slips, BTreeSet::from(["non_rigid_transfer"]));
    let rotates = found(|frames| {
        for (t, frame) in frames.iter_mut().enumerate().skip(20) {
            // About the vertical axis through the grip site, so that the object's position in the gripper stays the same.
            frame.object.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.01 * (t.min(38) - 20) as f64);
        }
    });
    assert_eq!(rotates, BTreeSet::from(["non_rigid_rotation"]));
}

#[test]
fn jumps_of_object_and_end_effector_are_discontinuities() {
    let jump = found(|frames| {
        for frame in &mut frames[4..] {
            frame.object = Isometry3::translation(0.3, 0.0, 0.0) * frame.object;
            frame.eef = Isometry3::translation(0.3, 0.0, 0.0) * frame.eef;
        }
    });
    assert!(
        jump.is_superset(&BTreeSet::from(["discontinuity_eef", "discontinuity_object"])),
        "{jump:?}"
    );
    let spin = found(|frames| {
        frames[5].eef.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7) * frames[5].eef.rotation;
    });
    assert_eq!(spin, BTreeSet::from(["discontinuity_rotation"]));
}

#[test]
fn idle_frames_and_sign_flips_are_notes() {
    let idle = found(|frames| frames[20..33].iter_mut().for_each(|frame| frame.delta = [0.0; 6]));
    assert_eq!(idle, BTreeSet::from(["idle"]));
    let flip = found(|frames| {
        for frame in &mut frames[20..] {
            frame.eef.rotation = UnitQuaternion::new_unchecked(-frame.eef.rotation.into_inner());
        }
    });
    assert_eq!(flip, BTreeSet::from(["seam"]));
}

#[test]
fn identical_recordings_and_identical_actions_are_found() {
    assert_eq!(found(|frames| *frames = flawless(3)), BTreeSet::from(["duplicate"]));
    let moved = found(|frames| {
        *frames = flawless(3);
        for frame in frames {
            let shift = Isometry3::translation(0.0, 0.01, 0.0);
            (frame.eef, frame.object) = (shift * frame.eef, shift * frame.object);
        }
    });
    assert_eq!(moved, BTreeSet::from(["same_actions"]));
    let near = found(|frames| {
        for (frame, copied) in frames.iter_mut().zip(flawless(3)) {
            (frame.eef, frame.object) = (copied.eef, Isometry3::translation(0.0, 0.0003, 0.0) * copied.object);
        }
    });
    assert_eq!(near, BTreeSet::from(["near_duplicate"]));
}

#[test]
fn wrong_object_poses_are_not_lost_grasps() {
    let fault = |change: &dyn Fn(&mut [SpatialFrame])| {
        let mut frames = flawless(10);
        change(&mut frames);
        let (findings, outcomes) = audit(frames, &AuditConfig::default());
        assert_eq!(outcomes, [GraspOutcome::Held]);
        let found: Vec<_> = findings
            .into_iter()
            .map(|finding| (finding.code, finding.frames))
            .collect();
        found
    };
    let frozen = fault(&|frames| {
        let last = frames[24].object;
        frames[24..31].iter_mut().for_each(|frame| frame.object = last);
    });
    assert_eq!(frozen, [("frozen_object", 24..31)]);
    let swapped = fault(&|frames| {
        for frame in &mut frames[24..31] {
            frame.object = Isometry3::translation(0.05, 0.0, 0.0) * frame.object;
        }
    });
    assert_eq!(swapped, [("swapped_object", 24..31)]);
}

#[test]
fn repeated_end_effector_poses_are_one_finding_without_their_jump() {
    let frozen = found(|frames| {
        let last = frames[2].eef;
        for (frame, number) in frames[2..8].iter_mut().zip(0..) {
            frame.eef = last;
            frame.fingers[0] += 1e-6 * f64::from(number);
        }
    });
    assert_eq!(frozen, BTreeSet::from(["frozen_eef"]));
}

#[test]
fn a_single_fast_step_is_a_gap_in_time() {
    let gap = found(|frames| {
        for frame in &mut frames[42..] {
            frame.eef = Isometry3::translation(0.02, 0.0, 0.0) * frame.eef;
        }
    });
    assert_eq!(gap, BTreeSet::from(["time_gap"]));
}

#[test]
fn a_release_is_judged_by_its_height_and_by_what_follows() {
    let falls = |frames: &mut Vec<SpatialFrame>| {
        for frame in &mut frames[41..] {
            frame.object = Isometry3::translation(0.0, 0.0, -0.1) * frame.object;
        }
    };
    assert_eq!(found(falls), BTreeSet::from(["early_release", "released_high"]));
    let fails = found(|frames| {
        falls(frames);
        frames[48..].iter_mut().for_each(|frame| frame.reward = Some(0.0));
    });
    assert_eq!(
        fails,
        BTreeSet::from(["dropped", "early_release", "released_high", "success_lost"])
    );
}

/// A demonstration whose end effector answers 0.6 of each action in the step after it, and 0.4 in the same step.
fn responsive(number: u32, change: impl FnOnce(&mut Vec<SpatialFrame>)) -> SpatialDemo {
    let action = |t: i32| {
        let phase = f64::from(number);
        let t = f64::from(t);
        [
            0.8 * (0.31 * t + phase).sin(),
            0.5 * (0.53 * t + 2.0 * phase).cos(),
            0.6 * (0.41 * t - phase).sin(),
        ]
    };
    let mut eef = Vector3::new(0.2, 0.0, 0.9);
    let mut frames = Vec::new();
    for t in 0..80 {
        let [x, y, z] = action(t);
        frames.push(SpatialFrame {
            eef: Isometry3::translation(eef.x, eef.y, eef.z),
            delta: [x, y, z, 0.0, 0.0, 0.0],
            ..flawless(number)[0]
        });
        let (now, before) = (Vector3::from(action(t)), Vector3::from(action(t - 1)));
        eef += 0.012 * (0.4 * now + 0.6 * before);
    }
    change(&mut frames);
    demo(number, frames)
}

#[test]
fn actions_that_differ_from_those_of_the_others_are_found() {
    let faults = |change: &dyn Fn(&mut Vec<SpatialFrame>)| {
        let mut demos: Vec<SpatialDemo> = (0..11).map(|number| responsive(number, |_| ())).collect();
        demos.push(responsive(11, change));
        let observations: Vec<Observation> = demos.iter().map(|demo| observe_spatial(demo, &LIMITS)).collect();
        let thresholds = Thresholds::derive(&observations, &AuditConfig::default(), false, LIMITS.closed);
        let findings = demos
            .iter()
            .flat_map(|demo| audit_spatial(demo, &thresholds, &LIMITS).findings);
        let about_actions: Vec<Finding> = findings
            .filter(|finding| finding.code.starts_with("actions") || finding.code == "reversed")
            .collect();
        assert!(
            about_actions.iter().all(|finding| finding.episode == 11),
            "{about_actions:?}"
        );
        codes(&about_actions)
    };
    let only = |code| BTreeSet::from([code]);
    assert_eq!(faults(&|_| ()), BTreeSet::new());
    let shifted = |by: usize| {
        move |frames: &mut Vec<SpatialFrame>| {
            let actions: Vec<[f64; 6]> = frames.iter().map(|frame| frame.delta).collect();
            for (t, frame) in frames.iter_mut().enumerate() {
                frame.delta = actions[(t + by).saturating_sub(1).min(79)];
            }
        }
    };
    assert_eq!(faults(&shifted(0)), only("actions_shifted"));
    assert_eq!(faults(&shifted(2)), only("actions_shifted"));
    for factor in [0.5, 2.0] {
        let scaled = faults(&|frames| {
            for part in frames.iter_mut().flat_map(|frame| &mut frame.delta) {
                *part *= factor;
            }
        });
        assert_eq!(scaled, only("actions_scaled"));
    }
    assert_eq!(
        faults(&|frames| frames.iter_mut().for_each(|frame| frame.delta[1] *= -1.0)),
        only("actions_opposed")
    );
    assert_eq!(faults(&|frames| frames.reverse()), only("reversed"));
    let foreign = faults(&|frames| {
        for (t, frame) in frames.iter_mut().enumerate() {
            let t = t as f64;
            frame.delta = [(1.3 * t).sin(), (1.7 * t).cos(), (2.1 * t).sin(), 0.0, 0.0, 0.0];
        }
    });
    assert_eq!(foreign, only("actions_unrelated"));
}

#[test]
fn a_fence_of_shares_is_below_one_or_not_made() {
    let derive = |shares: [f64; 12]| {
        let observations: Vec<Observation> = shares
            .into_iter()
            .zip(0..)
            .map(|(share, number)| {
                let mut frames = flawless(number);
                let saturated = (share * frames.len() as f64).round() as usize;
                frames.iter_mut().take(saturated).for_each(|frame| frame.delta[0] = 1.0);
                observe_spatial(&demo(number, frames), &LIMITS)
            })
            .collect();
        let thresholds = Thresholds::derive(&observations, &AuditConfig::default(), false, LIMITS.closed);
        let found = thresholds.iter().find(|(check, _)| check.code == "saturated");
        found.unwrap().1.clone()
    };
    let usual = derive([0.2, 0.2, 0.25, 0.25, 0.3, 0.3, 0.35, 0.35, 0.4, 0.4, 0.4, 0.4]);
    assert!(usual.value.is_some_and(|value| value > 0.4 && value < 1.0), "{usual:?}");
    let wide = derive([0.0, 0.0, 0.1, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0, 1.0]);
    assert!(!wide.made && wide.derivation.contains("above 1"), "{wide:?}");
}

#[test]
fn an_object_may_fall_before_it_is_touched() {
    let settles = found(|frames| {
        for (t, height) in [(0, 0.05), (1, 0.03), (2, 0.01)] {
            frames[t].object = Isometry3::translation(0.0, 0.0, height) * frames[t].object;
        }
    });
    assert_eq!(settles, BTreeSet::new());
}

#[test]
fn a_set_threshold_replaces_the_derived_one() {
    let config = AuditConfig {
        idle: Some(3.0),
        ..AuditConfig::default()
    };
    let mut frames = flawless(10);
    for frame in &mut frames[20..25] {
        frame.delta = [0.0; 6];
    }
    let (findings, _) = audit(frames, &config);
    assert_eq!(findings.len(), 1);
    assert_eq!(
        (findings[0].code, findings[0].threshold, findings[0].value),
        ("idle", Some(3.0), Some(5.0))
    );
    let error = AuditConfig {
        idle: Some(f64::NAN),
        ..AuditConfig::default()
    };
    assert!(error.check().unwrap_err().to_string().contains("audit.idle is NaN"));
}

#[test]
fn thresholds_state_their_origin() {
    let observations: Vec<Observation> = (0..10)
        .map(|n| observe_spatial(&demo(n, flawless(n)), &LIMITS))
        .collect();
    let all = Thresholds::derive(&observations, &AuditConfig::default(), false, 0.01);
    let few = Thresholds::derive(&observations[..3], &AuditConfig::default(), false, 0.01);
    let of = |thresholds: &Thresholds, code: &str| {
        let (_, threshold) = thresholds.iter().find(|(check, _)| check.code == code).unwrap();
        threshold.clone()
    };
    assert_eq!(
        all.iter().count() + 4,
        CHECKS.len(),
        "all checks but the two of Push-T and the two of the task arm"
    );
    let step = of(&all, "discontinuity_eef").value.unwrap();
    assert!((step - 0.03).abs() < 1e-9, "three steps of a centimetre: {step}");
    assert_eq!(of(&few, "discontinuity_eef").value, Some(0.06));
    assert_eq!(of(&all, "missed_grasp").origin, Origin::Default);
    let wider = Thresholds::derive(&observations, &AuditConfig::default(), false, 0.02);
    assert_eq!(of(&wider, "missed_grasp").origin, Origin::Setting);
    let early = of(&few, "early_release");
    assert!(!early.made && early.value.is_none() && early.derivation.starts_with("not made"));
    assert!(of(&all, "early_release").made);
}

fn push(number: u32) -> Vec<PlanarFrame> {
    (0..60)
        .map(|t| {
            let x = 100.0 + 5.0 * f64::from(t);
            let y = 200.0 + 3.0 * f64::from(number);
            let pushed = (f64::from(t) - 20.0).max(0.0);
            PlanarFrame {
                eef: Point2::new(x, y),
                object: Pose2::new(215.0 + 5.0 * pushed, y, 0.5),
                action: Point2::new(x + 5.0, y),
                contacts: if t >= 20 { 1.0 } else { 0.0 },
            }
        })
        .collect()
}

/// Codes of the findings on a flawless push after `change`, which can edit its frames and their coverage.
fn found_planar(change: impl FnOnce(&mut Vec<PlanarFrame>, &mut Vec<f64>)) -> BTreeSet<&'static str> {
    let mut demos: Vec<(Vec<PlanarFrame>, Vec<f64>)> = (0..10).map(|n| (push(n), vec![0.99; 60])).collect();
    let (frames, coverage) = demos.last_mut().unwrap();
    change(frames, coverage);
    let demos: Vec<PlanarDemo> = demos
        .into_iter()
        .zip(0..)
        .map(|((frames, coverage), number)| {
            let episode = PlanarEpisode { source: number, frames };
            PlanarDemo {
                number,
                segmented: segment_planar(&episode, &SegmentConfig::default()).unwrap(),
                episode,
                coverage,
            }
        })
        .collect();
    let observations: Vec<Observation> = demos.iter().map(observe_planar).collect();
    let thresholds = Thresholds::derive(&observations, &AuditConfig::default(), true, 0.0);
    let mut findings = audit_copies(&observations, &thresholds);
    findings.extend(demos.iter().flat_map(|demo| audit_planar(demo, &thresholds)));
    assert!(findings.iter().all(|finding| finding.episode == 9), "{findings:?}");
    codes(&findings)
}

#[test]
fn faults_of_pushes_are_found() {
    let only = |code| BTreeSet::from([code]);
    assert_eq!(found_planar(|_, _| ()), BTreeSet::new());
    assert_eq!(found_planar(|_, c| c[59] = 0.8), only("ends_before_success"));
    assert_eq!(
        found_planar(|f, _| f[2..12].iter_mut().for_each(|f| f.contacts = 1.0)),
        only("contact_without_motion")
    );
    assert_eq!(
        found_planar(|f, _| f[30..34].iter_mut().for_each(|f| f.contacts = 0.0)),
        only("motion_without_contact")
    );
    assert_eq!(
        found_planar(|f, _| f[40..].iter_mut().for_each(|f| f.object.theta += 6.0)),
        only("seam")
    );
    assert_eq!(found_planar(|f, _| f[5].eef.y += 90.0), only("discontinuity_eef"));
    assert_eq!(
        found_planar(|f, _| f[25..].iter_mut().for_each(|f| f.object.y += 200.0)),
        only("discontinuity_object")
    );
    let waits = found_planar(|f, _| {
        let held = f[10].action;
        f[10..30].iter_mut().for_each(|f| f.action = held);
    });
    assert_eq!(waits, only("idle"));
    let frozen = found_planar(|f, _| {
        let still = f[30];
        for frame in &mut f[30..37] {
            (frame.eef, frame.object) = (still.eef, still.object);
        }
    });
    assert!(frozen.contains("frozen"), "{frozen:?}");
}

//! What `index.trim` cuts, and what it never cuts.

use nalgebra::{Isometry3, Vector3};
use proptest::prelude::*;
use re4_episode::SpatialFrame;
use re4_episode::pace::{IDLE_FRACTION, fast_step, reach};
use re4_index::trim::{Trim, kept};

const BOTH: [Trim; 2] = [Trim::Idle, Trim::Detours];

fn frame(x: f64, y: f64, object: f64, separation: f64, gripper: f64) -> SpatialFrame {
    SpatialFrame {
        eef: Isometry3::new(Vector3::new(x, y, 0.9), Vector3::zeros()),
        object: Isometry3::new(Vector3::new(object, 0.0, 0.82), Vector3::zeros()),
        fingers: [separation / 2.0, -separation / 2.0],
        delta: [0.0; 6],
        goal: [0.0; 6],
        gripper,
        reward: None,
    }
}

/// Moves along x from `from` to `to` in steps of 1 cm, with the gripper open and the object at 1 m.
fn reach_along(from: i32, to: i32) -> Vec<SpatialFrame> {
    let steps: Vec<i32> = if from <= to {
        (from..to).collect()
    } else {
        (to + 1..=from).rev().collect()
    };
    steps
        .into_iter()
        .map(|step| frame(f64::from(step) * 0.01, 0.0, 1.0, 0.08, -1.0))
        .collect()
}

fn cut(kept: &[bool]) -> Vec<usize> {
    (0..kept.len()).filter(|&at| !kept[at]).collect()
}

#[test]
fn nothing_is_cut_without_the_setting_or_without_idleness() {
    let frames = reach_along(0, 40);
    assert!(cut(&kept(&frames, &[])).is_empty());
    assert!(cut(&kept(&frames, &BOTH)).is_empty());
    assert!(kept(&[], &BOTH).is_empty());
    assert_eq!(kept(&frames[..1], &BOTH), [true]);
}

#[test]
fn an_idle_stretch_is_cut_to_its_first_frame() {
    let mut frames = reach_along(0, 20);
    frames.extend(vec![frames[19]; 30]);
    frames.extend(reach_along(20, 40));
    assert_eq!(cut(&kept(&frames, &[Trim::Idle])), (20..50).collect::<Vec<_>>());
    // An idle stretch is no detour.
    assert!(cut(&kept(&frames, &[Trim::Detours])).is_empty());
}

#[test]
fn slow_progress_is_thinned_but_not_jumped() {
    let mut frames = reach_along(0, 20);
    // 20 mm in steps of 0.1 mm, while the fast step is 10 mm: a frame is kept as soon as the arm has moved by more than 0.5 mm.
    frames.extend((1..=200).map(|at| frame(0.19 + f64::from(at) * 1e-4, 0.0, 1.0, 0.08, -1.0)));
    let kept = kept(&frames, &[Trim::Idle]);
    let shown: Vec<usize> = (0..frames.len()).filter(|&at| kept[at]).collect();
    assert!(shown.len() < 65);
    for pair in shown.windows(2) {
        assert!(reach(&frames[pair[0]].eef, &frames[pair[1]].eef) <= 0.010_01);
    }
}

#[test]
fn idle_frames_around_a_change_of_the_gripper_are_kept() {
    let mut frames = reach_along(0, 20);
    frames.extend(vec![frames[19]; 30]);
    let closed = SpatialFrame {
        gripper: 1.0,
        fingers: [0.02, -0.02],
        ..frames[19]
    };
    frames.extend(vec![closed; 30]);
    let kept = kept(&frames, &BOTH);
    // The command changes at frame 50.
    assert!((40..=59).all(|at| kept[at]), "{:?}", cut(&kept));
    assert!(
        (21..39).all(|at| !kept[at]) && (61..79).all(|at| !kept[at]),
        "{:?}",
        cut(&kept)
    );
}

#[test]
fn moving_fingers_and_a_moving_object_are_not_idle() {
    let mut frames = reach_along(0, 20);
    frames.extend((1..=8).map(|at| frame(0.19, 0.0, 1.0, 0.08 - f64::from(at) * 0.005, -1.0)));
    frames.extend((1..=8).map(|at| frame(0.19, 0.0, 1.0 + f64::from(at) * 0.001, 0.04, -1.0)));
    frames.push(frames[35]);
    assert!(cut(&kept(&frames, &BOTH)).is_empty());
}

#[test]
fn a_detour_is_cut_if_the_state_is_the_same_after_it() {
    let mut frames = reach_along(0, 20);
    frames.extend((1..=15).map(|at| frame(0.19, f64::from(at) * 0.01, 1.0, 0.08, -1.0)));
    frames.extend(
        (0..15)
            .rev()
            .map(|at| frame(0.19, f64::from(at) * 0.01, 1.0, 0.08, -1.0)),
    );
    frames.extend(reach_along(20, 40));
    let kept_frames = kept(&frames, &[Trim::Detours]);
    let gone = cut(&kept_frames);
    assert!(
        gone.len() >= 28 && gone.iter().all(|&at| (18..=51).contains(&at)),
        "{gone:?}"
    );
    // If the arm has moved the object meanwhile, it was no detour.
    for frame in &mut frames[35..] {
        frame.object.translation.vector.x += 0.002;
    }
    assert!(cut(&kept(&frames, &[Trim::Detours])).is_empty());
}

/// Down to the object, fingers closed beside it, up again, then a grasp: the miss is cut, the grasp is not.
#[test]
fn a_missed_grasp_that_moves_nothing_is_a_detour() {
    let down = |frames: &mut Vec<SpatialFrame>, x: f64| {
        frames.extend((0..15).map(|at| frame(x, f64::from(at) * 0.01, 1.0, 0.08, -1.0)));
    };
    let close = |frames: &mut Vec<SpatialFrame>, x: f64, end: f64| {
        frames.extend((0..12).map(|at| frame(x, 0.14, 1.0, (0.08 - f64::from(at) * 0.01).max(end), 1.0)));
    };
    let mut frames = reach_along(-20, 0);
    down(&mut frames, 0.0);
    close(&mut frames, 0.0, 0.0);
    frames.extend((0..9).map(|at| frame(0.0, 0.14, 1.0, f64::from(at) * 0.01, -1.0)));
    frames.extend(
        (0..15)
            .rev()
            .map(|at| frame(0.0, f64::from(at) * 0.01, 1.0, 0.08, -1.0)),
    );
    let missed = 20..frames.len() - 1;
    frames.extend(reach_along(0, 5));
    let grasp = frames.len();
    down(&mut frames, 0.05);
    close(&mut frames, 0.05, 0.04);
    frames.extend(
        (0..15)
            .rev()
            .map(|at| frame(0.05, f64::from(at) * 0.01, 1.0 + 0.01 * f64::from(15 - at), 0.04, 1.0)),
    );
    let kept = kept(&frames, &[Trim::Detours]);
    let gone = cut(&kept);
    assert!(gone.iter().all(|at| missed.contains(at) || *at < grasp), "{gone:?}");
    let closings = (1..frames.len()).filter(|&at| kept[at] && frames[at].closes() && !frames[at - 1].closes());
    assert_eq!(closings.count(), 1);
}

/// Random motion with pauses, small loops and changes of the gripper.
fn motion() -> impl Strategy<Value = Vec<SpatialFrame>> {
    let part = (0..5_u8, 1..25_usize, -1.0..1.0_f64, -1.0..1.0_f64);
    proptest::collection::vec(part, 1..12).prop_map(|parts| {
        let (mut x, mut y, mut separation, mut gripper) = (0.0, 0.0, 0.08, -1.0);
        let mut frames = vec![frame(x, y, 1.0, separation, gripper)];
        for (kind, count, dx, dy) in parts {
            if kind == 4 {
                gripper = -gripper;
            }
            for at in 0..count {
                match kind {
                    0 | 1 => (x, y) = (x + 0.01 * dx, y + 0.01 * dy),
                    2 => x += if 2 * at < count { 0.01 } else { -0.01 },
                    _ => {}
                }
                separation = f64::clamp(separation - 0.01 * gripper, 0.0, 0.08);
                frames.push(frame(x, y, 1.0, separation, gripper));
            }
        }
        frames
    })
}

proptest! {
    #[test]
    fn what_is_kept_starts_and_ends_as_recorded_and_never_jumps(frames in motion()) {
        let kept = kept(&frames, &BOTH);
        prop_assert_eq!(kept.len(), frames.len());
        prop_assert!(kept[0] && kept[frames.len() - 1]);
        let shown: Vec<usize> = (0..frames.len()).filter(|&at| kept[at]).collect();
        let fast = fast_step(frames.windows(2).map(|pair| reach(&pair[0].eef, &pair[1].eef)));
        for pair in shown.windows(2) {
            let (now, next) = (pair[0], pair[1]);
            if next == now + 1 {
                continue;
            }
            // After a cut, the state is that of an earlier frame, one recorded step later.
            let recorded = reach(&frames[next - 1].eef, &frames[next].eef);
            let jump = reach(&frames[now].eef, &frames[next].eef);
            prop_assert!(jump <= fast * (1.0 + IDLE_FRACTION) + recorded + 1e-9, "{now} to {next}: {jump}");
            prop_assert_eq!(frames[now].closes(), frames[next - 1].closes());
        }
    }

    /// Every change of the gripper command that is kept has its guard.
    #[test]
    fn idle_cuts_keep_the_guard(frames in motion()) {
        let kept = kept(&frames, &[Trim::Idle]);
        for at in 1..frames.len() {
            if frames[at].closes() != frames[at - 1].closes() {
                let (first, end) = (at.saturating_sub(10), (at + 10).min(frames.len()));
                prop_assert!(kept[first..end].iter().all(|kept| *kept), "change at {at}");
            }
        }
    }
}

//! Tests of the tuned GPI on small demonstrations.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use re4_rollout::{ArmAction, ArmState};

use super::choose::How;
use super::frames::Frame;
use super::library::{Library, Switches};
use super::phases::{Live, Stage};
use super::tuning::{CAN, LIFT, SQUARE, Tuning, cap};

const ALL: Switches = Switches {
    gate: true,
    vote: true,
    rerank: true,
    flow: true,
    reach: false,
};
const NONE: Switches = Switches {
    gate: false,
    vote: false,
    rerank: false,
    flow: false,
    reach: false,
};

fn pose(x: f64, y: f64, z: f64, turn: f64) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, turn));
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

/// A demonstration in which the gripper approaches for 20 frames, closes at frame 20, lifts from frame 25 on by 5 mm per frame
/// for 30 frames and then carries the object by 5 mm per frame along x to the target.
fn demo(number: u32, y: f64) -> Vec<Frame> {
    let start = Vector3::new(-0.1, y, 0.83);
    let frame = |t: u32| {
        let steps = f64::from;
        let lift = steps(t.saturating_sub(25).min(30)) * 0.005;
        let carry = steps(t.saturating_sub(55)) * 0.005;
        let lower = steps(t.saturating_sub(110)) * 0.005;
        let object = pose(start.x + carry.min(0.33), start.y, start.z + lift - lower, 0.3);
        let above = 0.2 - 0.01 * steps(t.min(20));
        let closed = t > 20;
        let gap = if closed { 0.02 } else { 0.04 };
        Frame {
            demo: number,
            frame: t,
            retrievable: true,
            arm: ArmState {
                eef: pose(
                    object.translation.x,
                    object.translation.y,
                    object.translation.z + above,
                    0.1,
                ),
                fingers: [gap, -gap],
            },
            object,
            action: ArmAction {
                goal: pose(
                    object.translation.x + 0.005,
                    object.translation.y,
                    object.translation.z + above + 0.005,
                    0.12,
                ),
                gripper: if t >= 20 { 1.0 } else { -1.0 },
            },
        }
    };
    (0..130).map(frame).collect()
}

fn library(tuning: Tuning, switches: Switches) -> Library {
    let frames = [demo(0, 0.1), demo(1, 0.12), demo(2, 0.09)].concat();
    Library::build(frames, tuning, switches)
}

#[test]
fn demonstrations_are_labelled_in_the_order_of_their_phases() {
    let library = library(SQUARE, ALL);
    let labels = &library.phases.labels[..130];
    let start = |stage| labels.iter().position(|label| label.stage == stage);
    // The object is 3 cm above the table at frame 31; the gripper closes at frame 21, four frames before is 17.
    assert_eq!(start(Stage::Lift), Some(17));
    assert!(labels[17].lift_start && labels[42].lift_start && !labels[43].lift_start && !labels[16].lift_start);
    // Transport begins 24 frames after the lift or when the object is within the threshold, whichever is later.
    let transport = start(Stage::Transport).unwrap();
    let limits = library.phases.thresholds;
    assert!(transport >= 31 + 24);
    assert!(library.frames[transport].off_target(&library.space.target) <= limits.transport);
    assert!(start(Stage::PreInsert) > start(Stage::Transport));
    assert!(start(Stage::Insert) > start(Stage::PreInsert));
    assert!(limits.transport >= limits.pre_insert && limits.pre_insert >= limits.insert);
    for (a, b) in labels.iter().zip(&labels[1..]) {
        assert!(b.stage >= a.stage);
        let since = if a.stage == b.stage { a.since + 1 } else { 0 };
        assert_eq!(b.since, since);
    }
    let can = self::library(CAN, ALL);
    let transport = can.phases.labels[..130]
        .iter()
        .position(|label| label.stage == Stage::Transport);
    // With Can's threshold of 28 mm, the lift is at frame 31 as well.
    assert_eq!(transport, Some(31 + 24));
    let lift = self::library(LIFT, ALL);
    assert!(lift.phases.labels.iter().all(|label| label.stage <= Stage::Lift));
}

#[test]
fn a_rollout_passes_through_the_phases_and_returns_to_pick_if_the_object_falls() {
    let library = library(SQUARE, ALL);
    let mut live = Live::new();
    let mut seen = vec![live.stage];
    for frame in &library.frames[..130] {
        live.observe(&library.phases, &frame.arm, &frame.object);
        if *seen.last().unwrap() != live.stage {
            seen.push(live.stage);
        }
    }
    assert_eq!(
        seen,
        [
            Stage::Pick,
            Stage::Lift,
            Stage::Transport,
            Stage::PreInsert,
            Stage::Insert
        ]
    );
    live.observe(&library.phases, &library.frames[0].arm, &library.frames[0].object);
    assert_eq!(live.stage, Stage::Pick);
}

#[test]
fn a_recorded_state_is_its_own_nearest_frame_and_its_action_is_the_recorded_one() {
    for tuning in [LIFT, CAN, SQUARE] {
        let library = library(tuning, NONE);
        for at in [3, 60, 140] {
            let Frame { arm, object, .. } = library.frames[at].clone();
            let code = library.space.code(&arm, &object);
            let distances = library.distances(&code, &Live::new(), arm.fingers[0], None, &|_| false);
            let (distance, found, how) = library.choose(&distances, Stage::Pick).unwrap();
            assert!(distance < 1e-12 && how == How::Nearest);
            assert_eq!(library.codes[found], library.codes[at]);
            for stage in [Stage::Pick, Stage::Transport] {
                let action = library.action(at, stage, &arm, &object, &distances);
                let recorded = library.frames[at].action;
                let (shift, turn) = re4_geometry::spatial::pose_distance(&action.goal, &recorded.goal);
                assert!(shift < 1e-9 && turn < 1e-7, "{}", tuning.name);
                assert_eq!(action.gripper, recorded.gripper);
            }
        }
    }
}

#[test]
fn square_picks_in_the_frame_of_the_nut_and_can_by_displacements() {
    let square = library(SQUARE, NONE);
    let motion = pose(0.05, -0.02, 0.0, 0.7);
    let Frame {
        arm, object, action, ..
    } = square.frames[5].clone();
    let moved = square.action(5, Stage::Pick, &arm, &(motion * object), &[]);
    assert!((moved.goal.translation.vector - (motion * action.goal).translation.vector).norm() < 1e-12);
    let can = library(CAN, NONE);
    let displaced = ArmState {
        eef: Translation3::new(0.1, 0.0, 0.0) * arm.eef,
        ..arm
    };
    let moved = can.action(5, Stage::Pick, &displaced, &object, &[]);
    let expected = action.goal.translation.vector + Vector3::new(0.1, 0.0, 0.0);
    assert!((moved.goal.translation.vector - expected).norm() < 1e-12);
    assert_eq!(moved.goal.rotation, action.goal.rotation);
    let reaching = library(CAN, Switches { reach: true, ..NONE });
    let moved = reaching.action(5, Stage::Pick, &displaced, &(motion * object), &[]);
    let shift = (motion * object).translation.vector - object.translation.vector;
    assert!((moved.goal.translation.vector - action.goal.translation.vector - shift).norm() < 1e-12);
    let carried = reaching.action(5, Stage::Lift, &displaced, &(motion * object), &[]);
    assert!((carried.goal.translation.vector - expected).norm() < 1e-12);
}

#[test]
fn the_gate_keeps_the_present_and_the_next_phase_unless_nothing_remains() {
    let library = library(SQUARE, ALL);
    let frame = library.frames[60].clone();
    let code = library.space.code(&frame.arm, &frame.object);
    let mut live = Live::new();
    live.stage = Stage::Transport;
    let distances = library.distances(&code, &live, 0.04, None, &|_| false);
    for (distance, label) in distances.iter().zip(&library.phases.labels) {
        let kept = label.stage == Stage::Transport || label.stage == Stage::PreInsert;
        assert_eq!(distance.is_some(), kept);
    }
    // Frames of the phase pick remain if all others were used.
    let picks = |at: usize| library.phases.labels[at].stage != Stage::Pick;
    let distances = library.distances(&code, &live, 0.04, None, &picks);
    assert_eq!(
        distances.iter().flatten().count(),
        library
            .phases
            .labels
            .iter()
            .filter(|label| label.stage == Stage::Pick)
            .count()
    );
}

#[test]
fn a_vote_prefers_a_supported_demonstration() {
    let library = library(SQUARE, ALL);
    let mut distances = vec![None; library.frames.len()];
    // The nearest frame is alone, a run of another demonstration is almost as near.
    distances[10] = Some(0.010);
    distances[140..150].fill(Some(0.011));
    let (distance, at, how) = library.choose(&distances, Stage::Pick).unwrap();
    assert_eq!((distance, at, how), (0.011, 140, How::Vote));
    let without = self::library(SQUARE, NONE);
    assert_eq!(without.choose(&distances, Stage::Pick).unwrap().1, 10);
    // Far support does not count.
    distances[140..150].fill(Some(1.0));
    assert_eq!(library.choose(&distances, Stage::Pick).unwrap().1, 10);
}

#[test]
fn ranking_by_progress_prefers_frames_that_approach_the_target() {
    let library = library(SQUARE, ALL);
    let mut distances = vec![None; library.frames.len()];
    // In the 24 frames after frame 40, the object moves 45 mm towards the target; after frame 80, 120 mm.
    distances[40] = Some(0.0100);
    distances[130 + 80] = Some(0.0101);
    let (_, at, how) = library.choose(&distances, Stage::Transport).unwrap();
    assert_eq!((at, how), (130 + 80, How::Rerank));
    assert_eq!(library.choose(&distances, Stage::Pick).unwrap().1, 40);
}

#[test]
fn vectors_are_limited_in_length() {
    let long = cap(Vector3::new(3.0, 4.0, 0.0), 1.0);
    assert!((long - Vector3::new(0.6, 0.8, 0.0)).norm() < 1e-12);
    assert_eq!(cap(Vector3::new(0.1, 0.0, 0.0), 1.0), Vector3::new(0.1, 0.0, 0.0));
}

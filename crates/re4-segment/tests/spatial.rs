//! Tests the segmentation on constructed motions of a gripper and an object, whose measurements are known.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::f64::consts::PI;

use Mode::{Transfer, Transit};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_episode::{Mode, SpatialEpisode, SpatialFrame};
use re4_fault::Remedy as _;
use re4_segment::{
    AnchorAt, Command, GripperConfig, Rule, SegmentConfig, SegmentError, SegmentedSpatial, segment_spatial,
};

/// Width of the object between the fingers.
const WIDTH: f64 = 0.05;

/// A gripper that is moved frame by frame; the object moves with it while `carried`.
#[derive(Debug)]
struct Scene {
    frames: Vec<SpatialFrame>,
    carried: bool,
}

impl Scene {
    fn new(eef: Isometry3<f64>, object: Isometry3<f64>) -> Self {
        let frame = SpatialFrame {
            eef,
            object,
            fingers: [0.04, -0.04],
            delta: [0.0; 6],
            goal: [0.0; 6],
            gripper: -1.0,
            reward: None,
        };
        Self {
            frames: vec![frame],
            carried: false,
        }
    }

    /// Sets the command at the last frame, and appends the frame that it leads to.
    fn step(&mut self, closes: bool, motion: Isometry3<f64>, separation: f64) -> &mut Self {
        let last = self.frames.last_mut().unwrap();
        last.gripper = if closes { 1.0 } else { -1.0 };
        let mut next = *last;
        next.eef = motion * last.eef;
        if self.carried {
            next.object = motion * last.object;
        }
        next.fingers = [separation / 2.0, -separation / 2.0];
        self.frames.push(next);
        self
    }

    fn episode(&self) -> SpatialEpisode {
        SpatialEpisode {
            name: "demo_7".to_owned(),
            frames: self.frames.clone(),
        }
    }
}

fn moved(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

fn rotated(angle: f64) -> Isometry3<f64> {
    Isometry3::rotation(Vector3::z() * angle)
}

/// Reaches down (3 frames), closes (3), lifts by 0.02 m with a rotation (4), opens (3) and moves up (2).
fn pick_and_place() -> Scene {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let object = Isometry3::from_parts(
        Translation3::new(0.3, 0.1, 0.8),
        UnitQuaternion::from_euler_angles(0.0, 0.0, 0.4),
    );
    let eef = Isometry3::from_parts(Translation3::new(0.3, 0.1, 0.86), down);
    let mut scene = Scene::new(eef, object);
    for _ in 0..3 {
        scene.step(false, moved(0.0, 0.0, -0.015), 0.08);
    }
    for separation in [0.07, 0.06, WIDTH] {
        scene.step(true, Isometry3::identity(), separation);
    }
    scene.carried = true;
    for _ in 0..4 {
        scene.step(true, moved(0.003, 0.0, 0.005) * rotated(0.01), WIDTH);
    }
    scene.carried = false;
    for separation in [0.06, 0.07, 0.08] {
        scene.step(false, Isometry3::identity(), separation);
    }
    for _ in 0..2 {
        scene.step(false, moved(0.0, 0.0, 0.02), 0.08);
    }
    scene
}

fn segmented(scene: &Scene, config: &SegmentConfig) -> SegmentedSpatial {
    segment_spatial(&scene.episode(), config).unwrap()
}

fn near(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-12, "{a} is not {b}");
}

#[test]
fn a_frame_has_the_mode_of_the_command_before_it() {
    let segmented = segmented(&pick_and_place(), &SegmentConfig::spatial());
    let mut expected = vec![Transit; 4];
    expected.extend([Transfer; 7]);
    expected.extend([Transit; 5]);
    assert_eq!(segmented.modes, expected);
    assert_eq!(segmented.grasp_frame, Some(4));
}

#[test]
fn the_current_command_is_one_frame_ahead() {
    let mut config = SegmentConfig::spatial();
    config.gripper = Some(GripperConfig {
        command: Command::Current,
        ..GripperConfig::default()
    });
    let scene = pick_and_place();
    let current = segmented(&scene, &config).modes;
    let last = segmented(&scene, &SegmentConfig::spatial()).modes;
    assert_eq!(current[..current.len() - 1], last[1..]);
}

fn by(rule: Rule) -> SegmentConfig {
    SegmentConfig {
        rule,
        ..SegmentConfig::spatial()
    }
}

/// Frames in transfer.
fn transfer(segmented: &SegmentedSpatial) -> Vec<usize> {
    let modes = segmented.modes.iter().enumerate();
    modes
        .filter(|(_, mode)| **mode == Transfer)
        .map(|(frame, _)| frame)
        .collect()
}

#[test]
fn fingers_hold_from_the_contact_until_they_let_go() {
    // The fingers touch the object at frame 6, and are 1 cm further apart at frame 11.
    for rule in [Rule::Grasp, Rule::Evidence] {
        let segmented = segmented(&pick_and_place(), &by(rule));
        assert_eq!(transfer(&segmented), (6..11).collect::<Vec<_>>(), "{rule:?}");
        assert_eq!(segmented.grasp_frame, Some(6));
        assert_eq!(segmented.segments[0].anchor, Some(pick_and_place().frames[6].eef));
    }
}

#[test]
fn an_object_that_leaves_is_not_held_by_the_evidence() {
    let mut scene = pick_and_place();
    // From frame 9 on, the object is 3 cm off, but the fingers keep their distance.
    for frame in &mut scene.frames[9..] {
        frame.object = moved(0.03, 0.0, 0.0) * frame.object;
    }
    assert_eq!(transfer(&segmented(&scene, &by(Rule::Grasp))), [6, 7, 8, 9, 10]);
    assert_eq!(transfer(&segmented(&scene, &by(Rule::Evidence))), [6, 7, 8]);
    // A pose that is repeated was not recorded, and is no evidence.
    let mut scene = pick_and_place();
    let last = scene.frames[8].object;
    scene.frames[9..11].iter_mut().for_each(|frame| {
        frame.object = last;
        frame.eef = moved(0.03, 0.0, 0.0) * frame.eef;
    });
    assert_eq!(transfer(&segmented(&scene, &by(Rule::Evidence))), [6, 7, 8, 9, 10]);
}

#[test]
fn a_missed_grasp_is_not_the_anchor_of_the_first_hold() {
    let grasp = pick_and_place();
    // Before the grasp, the fingers close on nothing and open again.
    let mut scene = Scene::new(grasp.frames[0].eef, grasp.frames[0].object);
    for separation in [0.06, 0.04, 0.02, 0.002, 0.002, 0.002] {
        scene.step(true, Isometry3::identity(), separation);
    }
    for separation in [0.02, 0.04, 0.06, 0.08] {
        scene.step(false, Isometry3::identity(), separation);
    }
    let missed = scene.frames.len() - 1;
    scene.frames.pop();
    scene.frames.extend(grasp.frames);
    let config = |anchor| {
        let mut config = SegmentConfig::spatial();
        config.gripper = Some(GripperConfig {
            anchor,
            ..GripperConfig::default()
        });
        config
    };
    let first = segmented(&scene, &config(AnchorAt::FirstTransfer));
    assert_eq!(first.grasp_frame, Some(1));
    let held = segmented(&scene, &config(AnchorAt::FirstHold));
    assert_eq!(held.modes, first.modes, "the anchor does not change the modes");
    assert_eq!(held.grasp_frame, Some(missed + 6));
    assert_eq!(held.segments[1].anchor, Some(scene.frames[missed + 6].eef));
    assert_eq!(
        transfer(&segmented(&scene, &by(Rule::Grasp))),
        (missed + 6..missed + 11).collect::<Vec<_>>()
    );
}

#[test]
fn default_settings_serialize_as_before() {
    let text = serde_json::to_value(SegmentConfig::spatial()).unwrap();
    assert_eq!(text["rule"], "gripper_command");
    assert!(text["gripper"].get("anchor").is_none());
}

#[test]
fn measurements_match_the_constructed_motion() {
    let scene = pick_and_place();
    let segmented = segmented(&scene, &SegmentConfig::spatial());
    let evidence = &segmented.evidence;
    near(evidence[0].eef_step.unwrap(), 0.015);
    near(evidence[0].relative_translation.unwrap(), 0.015);
    near(evidence[0].object_step.unwrap(), 0.0);
    near(evidence[0].eef_object_distance, 0.06);
    near(evidence[3].finger_speed.unwrap(), -0.01);
    near(evidence[7].relative_translation.unwrap(), 0.0);
    near(evidence[7].relative_rotation.unwrap(), 0.0);
    near(evidence[7].eef_rotation.unwrap(), 0.01);
    near(evidence[7].object_rotation.unwrap(), 0.01);
    assert_eq!(evidence.last().unwrap().eef_step, None);
    let holds: Vec<usize> = (0..evidence.len()).filter(|&i| evidence[i].holds).collect();
    assert_eq!(
        holds,
        [6, 7, 8, 9],
        "stopped by the object, until the fingers move again"
    );

    let [reach, transfer, leave] = segmented.segments.as_slice() else {
        panic_on(&segmented)
    };
    assert_eq!(transfer.settled_frame, Some(6));
    let grasp = transfer.grasp.unwrap();
    near(grasp.finger_separation, WIDTH);
    near(grasp.residual, 0.0);
    near(grasp.residual_rotation, 0.0);
    let expected = scene.frames[6].object.inv_mul(&scene.frames[6].eef);
    assert!((grasp.transform.translation.vector - expected.translation.vector).norm() < 1e-15);
    near(transfer.object_rise, 0.02);
    near(transfer.object_rotation, 0.04);
    let distance = (scene.frames[10].object.translation.vector - scene.frames[6].object.translation.vector).norm();
    near(transfer.object_displacement, distance);
    assert!(transfer.object_path >= distance);
    near(reach.object_path, 0.0);
    assert_eq!(reach.anchor, Some(scene.frames[4].eef));
    assert_eq!(transfer.anchor, reach.anchor);
    assert_eq!((leave.anchor, leave.grasp), (None, None));
}

#[allow(clippy::panic, reason = "a test stops where it fails")]
fn panic_on(segmented: &SegmentedSpatial) -> ! {
    panic!("expected three segments, found {:?}", segmented.segments)
}

#[test]
fn an_object_that_slips_shows_in_the_residual() {
    let mut scene = pick_and_place();
    for frame in &mut scene.frames[9..] {
        frame.object *= moved(0.004, 0.0, 0.0);
    }
    let segmented = segmented(&scene, &SegmentConfig::spatial());
    near(segmented.segments[1].grasp.unwrap().residual, 0.004);
    assert!(!segmented.evidence[8].holds, "the object slips in this step");
}

#[test]
fn fingers_that_never_stop_have_no_settled_frame() {
    let mut scene = Scene::new(Isometry3::identity(), Isometry3::translation(1.0, 0.0, 0.0));
    for (closes, separation) in [(true, 0.07), (true, 0.06), (false, 0.05), (false, 0.06)] {
        scene.step(closes, Isometry3::identity(), separation);
    }
    let segmented = segmented(&scene, &SegmentConfig::spatial());
    assert_eq!(segmented.segments[1].settled_frame, None);
    assert!(segmented.evidence.iter().all(|evidence| !evidence.holds));
}

#[test]
fn rigid_motion_finds_only_the_carrying() {
    let config = SegmentConfig {
        rule: Rule::RigidMotion,
        ..SegmentConfig::spatial()
    };
    let modes = segmented(&pick_and_place(), &config).modes;
    let carried: Vec<usize> = (0..modes.len()).filter(|&i| modes[i] == Transfer).collect();
    assert_eq!(carried, [6, 7, 8, 9]);
}

#[test]
fn invalid_episodes_are_refused() {
    let empty = SpatialEpisode {
        name: "demo_3".to_owned(),
        frames: Vec::new(),
    };
    assert_eq!(
        segment_spatial(&empty, &SegmentConfig::spatial()),
        Err(SegmentError::Empty {
            demo: "demo_3".to_owned()
        })
    );
    let mut broken = pick_and_place().episode();
    broken.frames[5].fingers[1] = f64::NAN;
    assert_eq!(
        segment_spatial(&broken, &SegmentConfig::spatial())
            .unwrap_err()
            .sentence(),
        "cannot segment demo_7: finger position is NaN at frame 5; repair that frame, or leave demo_7 out with ingest.select"
    );
}

/// Arbitrary motions of a gripper, with an object that is carried in some of the steps.
fn motions() -> impl Strategy<Value = Scene> {
    let part = -0.02..0.02f64;
    let step = (
        [part.clone(), part.clone(), part],
        [-0.1..0.1f64, -0.1..0.1, -0.1..0.1],
        any::<bool>(),
        any::<bool>(),
        0.0..0.08f64,
    );
    proptest::collection::vec(step, 1..30).prop_map(|steps| {
        let mut scene = Scene::new(moved(0.1, 0.2, 0.9), moved(0.15, 0.2, 0.8) * rotated(0.3));
        for (by, rotation, closes, carried, separation) in steps {
            scene.carried = carried;
            let about = scene.frames.last().unwrap().eef.translation;
            let rotation = about * Isometry3::rotation(Vector3::from(rotation)) * about.inverse();
            scene.step(closes, moved(by[0], by[1], by[2]) * rotation, separation);
        }
        scene
    })
}

fn close(a: Option<f64>, b: Option<f64>) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() < 1e-6,
        (a, b) => a == b,
    }
}

proptest! {
    /// Measurements do not depend on the position or the orientation of the world frame. Heights are only invariant to rotations
    /// about the vertical axis.
    #[test]
    fn measurements_do_not_depend_on_the_world_frame(
        scene in motions(),
        shift in [-2.0..2.0f64, -2.0..2.0, -2.0..2.0],
        yaw in -3.0..3.0f64,
        tilt in -3.0..3.0f64,
    ) {
        let config = SegmentConfig::spatial();
        let before = segmented(&scene, &config);
        for tilt in [0.0, tilt] {
            let world = moved(shift[0], shift[1], shift[2]) * rotated(yaw) * Isometry3::rotation(Vector3::x() * tilt);
            let mut other = scene.episode();
            for frame in &mut other.frames {
                frame.eef = world * frame.eef;
                frame.object = world * frame.object;
            }
            let after = segment_spatial(&other, &config).unwrap();
            prop_assert_eq!(&before.modes, &after.modes);
            for (a, b) in before.evidence.iter().zip(&after.evidence) {
                prop_assert!(close(a.eef_step, b.eef_step) && close(a.eef_rotation, b.eef_rotation));
                prop_assert!(close(a.object_step, b.object_step) && close(a.object_rotation, b.object_rotation));
                prop_assert!(close(a.relative_translation, b.relative_translation));
                prop_assert!(close(a.relative_rotation, b.relative_rotation));
                prop_assert!(close(Some(a.eef_object_distance), Some(b.eef_object_distance)));
                prop_assert_eq!((a.finger_separation, a.finger_speed), (b.finger_separation, b.finger_speed));
            }
            for (a, b) in before.segments.iter().zip(&after.segments) {
                prop_assert_eq!(&a.segment, &b.segment);
                prop_assert_eq!(a.settled_frame, b.settled_frame);
                prop_assert!(close(Some(a.object_displacement), Some(b.object_displacement)));
                prop_assert!(close(Some(a.object_path), Some(b.object_path)));
                prop_assert!(close(Some(a.object_rotation), Some(b.object_rotation)));
                prop_assert!(tilt != 0.0 || close(Some(a.object_rise), Some(b.object_rise)));
                let (a, b) = (a.grasp, b.grasp);
                prop_assert_eq!(a.is_some(), b.is_some());
                prop_assert!(close(a.map(|g| g.residual), b.map(|g| g.residual)));
                prop_assert!(close(a.map(|g| g.residual_rotation), b.map(|g| g.residual_rotation)));
                let position = |g: re4_segment::Grasp| g.transform.translation.vector;
                if let (Some(a), Some(b)) = (a, b) {
                    prop_assert!((position(a) - position(b)).norm() < 1e-6);
                }
            }
        }
    }

    /// The measurements of a segment are consistent: the displacement is at most the length of the path, and the rise at most the
    /// displacement.
    #[test]
    fn segment_summaries_are_consistent(scene in motions()) {
        let segmented = segmented(&scene, &SegmentConfig::spatial());
        for summary in &segmented.segments {
            prop_assert!(summary.object_displacement <= summary.object_path + 1e-9);
            prop_assert!(summary.object_rise.abs() <= summary.object_displacement + 1e-9);
            prop_assert_eq!(summary.grasp.is_some(), summary.segment.mode == Transfer);
            prop_assert!(summary.settled_frame.is_none_or(|frame| summary.segment.frames.contains(&frame)));
        }
    }
}

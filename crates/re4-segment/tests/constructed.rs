//! Tests the segmentation on constructed planar motions, whose modes are known.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use Mode::{Transfer, Transit};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_episode::{Mode, PlanarEpisode, PlanarFrame};
use re4_fault::Remedy as _;
use re4_geometry::{Point2, Pose2};
use re4_segment::{
    ObjectDistance, Pair, Rule, SegmentConfig, SegmentError, SegmentedEpisode, SpatialPair, rigid_motion_modes,
    segment_planar,
};

fn rigid() -> SegmentConfig {
    SegmentConfig {
        rule: Rule::RigidMotion,
        ..SegmentConfig::default()
    }
}

/// A demonstration that is constructed step by step.
struct Scene {
    frames: Vec<PlanarFrame>,
    /// The mode that every step is constructed to have.
    built: Vec<Mode>,
}

impl Scene {
    fn new(eef: Point2, object: Pose2) -> Self {
        let mut scene = Self {
            frames: Vec::new(),
            built: Vec::new(),
        };
        scene.push(eef, object);
        scene
    }

    fn push(&mut self, eef: Point2, object: Pose2) {
        self.frames.push(PlanarFrame {
            eef,
            object,
            action: eef,
            contacts: 0.0,
        });
    }

    fn last(&self) -> PlanarFrame {
        *self.frames.last().unwrap()
    }

    /// Moves the end effector, but not the object.
    fn reach(&mut self, dx: f64, dy: f64, steps: usize) -> &mut Self {
        for _ in 0..steps {
            let PlanarFrame { eef, object, .. } = self.last();
            self.push(eef + Point2::new(dx, dy), object);
            self.built.push(Transit);
        }
        self
    }

    /// Moves both by one rigid motion in the world frame: rotates them about `centre` by `angle`, then translates them by `(dx,
    /// dy)`.
    fn carry(&mut self, centre: Point2, angle: f64, dx: f64, dy: f64, steps: usize) -> &mut Self {
        for _ in 0..steps {
            let PlanarFrame { eef, object, .. } = self.last();
            let about = Pose2::new(centre.x, centre.y, 0.0);
            let motion = Pose2::new(dx, dy, 0.0)
                .compose(about)
                .compose(Pose2::new(0.0, 0.0, angle))
                .compose(about.inverse());
            self.push(motion.transform_point(eef), motion.compose(object).normalized());
            self.built.push(Transfer);
        }
        self
    }

    /// Moves nothing.
    fn rest(&mut self, steps: usize) -> &mut Self {
        self.reach(0.0, 0.0, steps)
    }

    /// Pushes the object in the direction of y while the end effector slides along it.
    fn push_sliding(&mut self, steps: usize) -> &mut Self {
        for _ in 0..steps {
            let PlanarFrame { eef, object, .. } = self.last();
            self.push(
                eef + Point2::new(2.0, 3.0),
                Pose2::new(object.x, object.y + 3.0, object.theta),
            );
            self.built.push(Transit);
        }
        self
    }

    fn episode(&self) -> PlanarEpisode {
        PlanarEpisode {
            source: 3,
            frames: self.frames.clone(),
        }
    }

    fn segment(&self, config: &SegmentConfig) -> SegmentedEpisode {
        segment_planar(&self.episode(), config).unwrap()
    }

    /// The constructed modes, one per frame: the last frame has the mode of the step before it.
    fn expected(&self) -> Vec<Mode> {
        let last = self.built.last().copied().unwrap_or(Transit);
        self.built.iter().copied().chain([last]).collect()
    }

    fn assert_recovered(&self) {
        assert_eq!(self.segment(&rigid()).modes, self.expected());
    }
}

fn scene() -> Scene {
    Scene::new(Point2::new(100.0, 120.0), Pose2::new(200.0, 220.0, 6.0))
}

#[test]
fn pure_transit_and_resting_are_transit() {
    scene().reach(5.0, -2.0, 20).assert_recovered();
    scene().rest(20).assert_recovered();
    scene().push_sliding(20).assert_recovered();
}

#[test]
fn carrying_along_a_line_about_the_end_effector_and_along_an_arc_is_transfer() {
    scene().carry(Point2::zeros(), 0.0, 3.0, -4.0, 20).assert_recovered();
    let eef = scene().last().eef;
    scene().carry(eef, 0.1, 0.0, 0.0, 100).assert_recovered();
    scene().carry(eef, -0.05, 0.0, 0.0, 200).assert_recovered();
    scene()
        .carry(Point2::new(300.0, 0.0), 0.02, 0.0, 0.0, 60)
        .assert_recovered();
    scene()
        .carry(Point2::new(150.0, 150.0), 0.03, 1.0, 2.0, 60)
        .assert_recovered();
}

#[test]
fn at_origin_treats_a_rotation_about_the_end_effector_as_transit() {
    let config = SegmentConfig {
        object_distance: ObjectDistance::AtOrigin,
        ..rigid()
    };
    let mut rotated = scene();
    let eef = rotated.last().eef;
    rotated.carry(eef, 0.1, 0.0, 0.0, 10);
    assert_eq!(rotated.segment(&config).modes, [Transit; 11]);
    let mut carried = scene();
    carried.carry(eef, 0.0, 3.0, 0.0, 10);
    assert_eq!(carried.segment(&config).modes, [Transfer; 11]);
}

#[test]
fn alternating_segments_are_recovered_exactly() {
    let mut s = scene();
    s.reach(5.0, 5.0, 7).carry(Point2::zeros(), 0.01, 2.0, 1.0, 9);
    s.rest(2).reach(-4.0, 0.0, 5).push_sliding(4);
    s.carry(Point2::new(10.0, 20.0), -0.02, 0.0, 3.0, 6).reach(1.0, 1.0, 1);
    s.carry(Point2::zeros(), 0.0, 0.0, 3.0, 1).reach(1.0, 1.0, 2);
    s.assert_recovered();
    let segmented = s.segment(&rigid());
    let runs: Vec<_> = segmented
        .segments
        .iter()
        .map(|f| (f.segment.mode, f.segment.frames.clone()))
        .collect();
    assert_eq!(
        runs,
        [
            (Transit, 0..7),
            (Transfer, 7..16),
            (Transit, 16..27),
            (Transfer, 27..33),
            (Transit, 33..34),
            (Transfer, 34..35),
            (Transit, 35..38),
        ]
    );
    assert_eq!(segmented.grasp_frame, Some(7));
    let grasp = s.frames[7];
    let anchors: Vec<_> = segmented.segments.iter().map(|f| f.anchor).collect();
    assert_eq!(anchors[..2], [Some(grasp.eef); 2]);
    assert!(anchors[2..].iter().all(Option::is_none));
    for summary in &segmented.segments {
        let transfer = summary.segment.mode == Transfer;
        assert_eq!(
            (summary.grasp.is_some(), summary.rigidity_residual.is_some()),
            (transfer, transfer)
        );
        assert!(summary.rigidity_residual.is_none_or(|residual| residual < 1e-9));
    }
    let held = segmented.segments[1].grasp.unwrap();
    assert!((grasp.object.transform_point(held) - grasp.eef).norm() < 1e-9);
    // The segments together contain all motion of the object.
    let (first, last) = (s.frames[0].object, s.last().object);
    let rotation: f64 = segmented.segments.iter().filter_map(|f| f.object_rotation).sum();
    assert!((rotation - (9.0 * 0.01 - 6.0 * 0.02)).abs() < 1e-9);
    assert!((re4_geometry::signed_difference(first.theta, last.theta) - rotation).abs() < 1e-9);
    assert_eq!(segmented.segments[0].object_displacement, Some(0.0));
    assert!((segmented.segments[2].object_displacement.unwrap() - 12.0).abs() < 1e-9);
    assert!((segmented.segments[5].object_displacement.unwrap() - 3.0).abs() < 1e-9);
}

#[test]
fn rotations_of_more_than_pi_are_not_wrapped() {
    let mut s = scene();
    let eef = s.last().eef;
    s.carry(eef, 0.1, 0.0, 0.0, 100);
    let summary = &s.segment(&rigid()).segments[0];
    let rotation = summary.object_rotation.unwrap();
    assert!((rotation - 10.0).abs() < 1e-9, "{rotation}");
}

#[test]
fn always_transit_keeps_the_evidence() {
    let mut s = scene();
    s.reach(3.0, 4.0, 2).carry(Point2::zeros(), 0.0, 6.0, 8.0, 2);
    s.frames[2].contacts = 2.0;
    s.frames[3].contacts = f64::NAN;
    let segmented = s.segment(&SegmentConfig::default());
    assert_eq!(segmented.modes, [Transit; 5]);
    assert_eq!((segmented.segments.len(), segmented.grasp_frame), (1, None));
    assert_eq!(segmented.segments[0].anchor, None);
    let column = |f: fn(&re4_segment::Evidence) -> Option<f64>| segmented.evidence.iter().map(f).collect::<Vec<_>>();
    let close = |found: Vec<Option<f64>>, expected: [Option<f64>; 5]| {
        for (found, expected) in found.iter().zip(expected) {
            assert_eq!(found.is_some(), expected.is_some());
            assert!(
                found.zip(expected).is_none_or(|(a, b)| (a - b).abs() < 1e-9),
                "{found:?} {expected:?}"
            );
        }
    };
    close(
        column(|e| e.eef_step),
        [Some(5.0), Some(5.0), Some(10.0), Some(10.0), None],
    );
    close(
        column(|e| e.object_step),
        [Some(0.0), Some(0.0), Some(10.0), Some(10.0), None],
    );
    close(
        column(|e| e.object_rotation),
        [Some(0.0), Some(0.0), Some(0.0), Some(0.0), None],
    );
    close(
        column(|e| e.relative_translation),
        [Some(5.0), Some(5.0), Some(0.0), Some(0.0), None],
    );
    assert_eq!(column(|e| e.relative_rotation), [None; 5]);
    assert_eq!(
        column(|e| e.contacts),
        [Some(0.0), Some(0.0), Some(2.0), None, Some(0.0)]
    );
    let contact: Vec<_> = segmented.evidence.iter().map(|e| e.contact).collect();
    assert_eq!(contact, [Some(false), Some(false), Some(true), None, Some(false)]);
    let moving: Vec<_> = segmented.evidence.iter().map(|e| e.object_moving).collect();
    assert_eq!(moving, [Some(false), Some(false), Some(true), Some(true), None]);
    assert!((segmented.evidence[0].eef_object_distance.unwrap() - 20_000_f64.sqrt()).abs() < 1e-9);
}

#[test]
fn thresholds_are_exact() {
    let config = rigid();
    // Relative motion of exactly epsilon is not smaller than epsilon.
    let step = |slip: f64| {
        let mut s = Scene::new(Point2::zeros(), Pose2::IDENTITY);
        s.push(Point2::new(8.0, slip), Pose2::new(8.0, 0.0, 0.0));
        s.segment(&config).modes[0]
    };
    assert_eq!(step(config.translation_epsilon), Transit);
    assert_eq!(step(config.translation_epsilon.next_down()), Transfer);
    // An object moves when it moves further than the minimum motion.
    let creep = |by: f64| {
        let mut s = Scene::new(Point2::zeros(), Pose2::IDENTITY);
        s.push(Point2::new(by, 0.0), Pose2::new(by, 0.0, 0.0));
        s.segment(&config).modes[0]
    };
    assert_eq!(creep(config.minimum_motion), Transit);
    assert_eq!(creep(config.minimum_motion.next_up()), Transfer);
    let spin = |by: f64| {
        let mut s = Scene::new(Point2::zeros(), Pose2::IDENTITY);
        s.push(Point2::zeros(), Pose2::new(0.0, 0.0, by));
        s.segment(&config).modes[0]
    };
    assert_eq!(spin(config.minimum_rotation * 0.999), Transit);
    assert_eq!(spin(config.minimum_rotation * 1.001), Transfer);
}

#[test]
fn short_episodes() {
    let one = scene();
    let segmented = one.segment(&rigid());
    assert_eq!(segmented.modes, [Transit]);
    assert_eq!(segmented.segments[0].segment.frames, 0..1);
    assert_eq!(
        (segmented.evidence[0].eef_step, segmented.evidence[0].object_moving),
        (None, None)
    );
    let mut two = scene();
    two.carry(Point2::zeros(), 0.0, 3.0, 0.0, 1);
    assert_eq!(two.segment(&rigid()).modes, [Transfer; 2]);
}

#[test]
fn invalid_episodes_and_settings_are_named() {
    let empty = PlanarEpisode {
        source: 5,
        frames: Vec::new(),
    };
    assert_eq!(
        segment_planar(&empty, &rigid()).unwrap_err().sentence(),
        "cannot segment episode 5: it has no frames; leave it out with ingest.select"
    );
    let mut s = scene();
    s.reach(1.0, 1.0, 4);
    s.frames[2].object.theta = f64::NAN;
    assert_eq!(
        segment_planar(&s.episode(), &rigid()).unwrap_err().sentence(),
        "cannot segment episode 3: object_theta is NaN at frame 2; repair that frame, or leave episode 3 out with ingest.select"
    );
    for (field, config) in [
        (
            "translation_epsilon",
            SegmentConfig {
                translation_epsilon: 0.0,
                ..rigid()
            },
        ),
        (
            "rotation_epsilon",
            SegmentConfig {
                rotation_epsilon: f64::NAN,
                ..rigid()
            },
        ),
        (
            "minimum_motion",
            SegmentConfig {
                minimum_motion: -0.1,
                ..rigid()
            },
        ),
        (
            "minimum_rotation",
            SegmentConfig {
                minimum_rotation: f64::INFINITY,
                ..rigid()
            },
        ),
    ] {
        let error = segment_planar(&scene().episode(), &config).unwrap_err();
        assert!(
            matches!(error, SegmentError::Config { field: named, .. } if named == field),
            "{error}"
        );
        assert!(
            error
                .sentence()
                .starts_with(&format!("cannot segment: segment.{field} is ")),
            "{error}"
        );
    }
}

#[test]
fn configuration_refuses_unknown_fields_by_name() {
    let config: SegmentConfig =
        serde_json::from_str(r#"{"rule": "rigid_motion", "translation_epsilon": 2.0}"#).unwrap();
    assert_eq!((config.rule, config.translation_epsilon), (Rule::RigidMotion, 2.0));
    assert_eq!(config.minimum_motion, SegmentConfig::default().minimum_motion);
    let refused = serde_json::from_str::<SegmentConfig>(r#"{"epsilon": 2.0}"#)
        .unwrap_err()
        .to_string();
    assert!(refused.contains("unknown field `epsilon`"), "{refused}");
    assert!(serde_json::from_str::<SegmentConfig>(r#"{"rule": "grippers"}"#).is_err());
}

/// One step of a random demonstration.
#[derive(Debug, Clone)]
enum Motion {
    /// Translation of the end effector.
    Reach(f64, f64),
    /// Angle and translation of both.
    Carry(f64, f64, f64),
    Rest,
    Slide,
}

fn motions() -> impl Strategy<Value = Vec<Motion>> {
    let motion = prop_oneof![
        (1.0..20.0f64, 0.0..TAU).prop_map(|(r, a)| Motion::Reach(r * a.cos(), r * a.sin())),
        (-0.3..0.3f64, 1.0..20.0f64, 0.0..TAU).prop_map(|(angle, r, a)| Motion::Carry(angle, r * a.cos(), r * a.sin())),
        Just(Motion::Rest),
        Just(Motion::Slide),
    ];
    proptest::collection::vec(motion, 1..40)
}

fn performed(motions: &[Motion]) -> Scene {
    let mut s = scene();
    for motion in motions {
        match *motion {
            Motion::Reach(dx, dy) => s.reach(dx, dy, 1),
            // Rotates about the object's origin, so that the origin moves exactly by the translation.
            Motion::Carry(angle, dx, dy) => {
                let centre = s.last().object.translation();
                s.carry(centre, angle, dx, dy, 1)
            }
            Motion::Rest => s.rest(1),
            Motion::Slide => s.push_sliding(1),
        };
    }
    s
}

proptest! {
    #[test]
    fn random_demonstrations_are_recovered_in_any_world_frame(
        motions in motions(), x in -500.0..500.0f64, y in -500.0..500.0f64, theta in -10.0..10.0f64,
    ) {
        let here = performed(&motions);
        let world = Pose2::new(x, y, theta);
        let mut there = Scene { frames: Vec::new(), built: here.built.clone() };
        for frame in &here.frames {
            there.push(world.transform_point(frame.eef), world.compose(frame.object).normalized());
        }
        let (a, b) = (here.segment(&rigid()), there.segment(&rigid()));
        prop_assert_eq!(&a.modes, &here.expected());
        prop_assert_eq!(&b.modes, &a.modes);
        prop_assert_eq!(b.grasp_frame, a.grasp_frame);
        let near = |p: Option<f64>, q: Option<f64>| {
            p.is_some() == q.is_some() && p.zip(q).is_none_or(|(p, q)| (p - q).abs() < 1e-8)
        };
        for (p, q) in a.evidence.iter().zip(&b.evidence) {
            prop_assert!(near(p.eef_step, q.eef_step) && near(p.object_step, q.object_step));
            prop_assert!(near(p.object_rotation, q.object_rotation) && near(p.relative_translation, q.relative_translation));
            prop_assert!(near(p.eef_object_distance, q.eef_object_distance));
        }
        for (p, q) in a.segments.iter().zip(&b.segments) {
            prop_assert_eq!(&p.segment, &q.segment);
            prop_assert!(near(p.rigidity_residual, q.rigidity_residual));
            prop_assert!(near(p.object_displacement, q.object_displacement));
            prop_assert!(near(p.object_rotation, q.object_rotation));
            prop_assert!(p.grasp.zip(q.grasp).is_none_or(|(p, q)| (p - q).norm() < 1e-8));
            prop_assert!(p.anchor.zip(q.anchor).is_none_or(|(p, q)| (world.transform_point(p) - q).norm() < 1e-8));
        }
    }

    #[test]
    fn noise_below_epsilon_does_not_matter(
        motions in motions(), noise in proptest::collection::vec((-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64), 120),
    ) {
        let mut s = performed(&motions);
        let config = rigid();
        let farthest = s.frames.iter().map(|f| (f.eef - f.object.translation()).norm()).fold(0.0, f64::max);
        // A step has the noise of two frames: two coordinates each of end effector and object, and the object's angle times its
        // lever arm. All of it together stays below epsilon, and below the minimum motion.
        let (shift, rotation) = (0.01, 0.0005_f64.min(0.1 * config.translation_epsilon / (farthest + 1.0)));
        for (i, frame) in s.frames.iter_mut().enumerate() {
            let wiggle = |k: usize| noise[(3 * i + k) % noise.len()];
            frame.eef += Point2::new(wiggle(0).0, wiggle(0).1) * shift;
            frame.object.x += wiggle(1).0 * shift;
            frame.object.y += wiggle(1).1 * shift;
            frame.object.theta += wiggle(2).2 * rotation;
        }
        s.assert_recovered();
    }

    #[test]
    fn the_rule_in_se3_agrees_with_the_rule_in_se2(motions in motions(), tilt in -PI..PI) {
        let s = performed(&motions);
        let lift = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(tilt, 0.3, -0.2));
        let flat = |x: f64, y: f64, theta: f64| lift * Isometry3::new(Vector3::new(x, y, 0.0), Vector3::z() * theta);
        // The end effector has the orientation of the object, so that their relative orientation is fixed, as in a grasp.
        let pairs: Vec<SpatialPair> = s
            .frames
            .iter()
            .map(|f| SpatialPair {
                eef: flat(f.eef.x, f.eef.y, f.object.theta),
                object: flat(f.object.x, f.object.y, f.object.theta),
            })
            .collect();
        prop_assert_eq!(rigid_motion_modes(&pairs, &rigid()), s.expected());
    }
}

#[test]
fn noise_above_epsilon_is_transit() {
    let mut s = scene();
    s.carry(Point2::zeros(), 0.0, 5.0, 0.0, 20);
    s.frames[10].eef.y += 2.0 * rigid().translation_epsilon;
    let modes = s.segment(&rigid()).modes;
    assert_eq!((modes[9], modes[10]), (Transit, Transit));
    assert_eq!(modes.iter().filter(|&&m| m == Transit).count(), 2);
}

#[test]
fn an_end_effector_that_rotates_relative_to_the_object_is_transit_in_se3() {
    let pair = |x: f64, angle: f64| SpatialPair {
        eef: Isometry3::from_parts(
            Vector3::new(x, 0.0, 0.1).into(),
            UnitQuaternion::from_euler_angles(0.0, 0.0, angle),
        ),
        object: Isometry3::translation(x, 0.0, 0.0),
    };
    let config = SegmentConfig {
        translation_epsilon: 0.001,
        minimum_motion: 0.001,
        ..rigid()
    };
    assert_eq!(pair(0.0, 0.0).step_to(&pair(0.02, 0.0)).mode(&config), Transfer);
    let rotated = pair(0.0, 0.0).step_to(&pair(0.02, 0.05));
    assert_eq!(rotated.mode(&config), Transit);
    assert!((rotated.relative_rotation.unwrap() - 0.05).abs() < 1e-12);
    let about_x = SpatialPair {
        eef: Isometry3::rotation(Vector3::x() * FRAC_PI_2) * pair(0.02, 0.0).eef,
        object: Isometry3::rotation(Vector3::x() * FRAC_PI_2) * pair(0.02, 0.0).object,
    };
    let carried = pair(0.0, 0.0).step_to(&about_x);
    assert_eq!(carried.mode(&config), Transfer);
    assert!((carried.object_rotation - FRAC_PI_2).abs() < 1e-12);
}

#[test]
fn a_block_of_unknown_pose_has_no_evidence() {
    let mut scene = Scene::new(Point2::new(100.0, 100.0), PlanarFrame::UNKNOWN);
    scene.reach(3.0, 4.0, 5);
    let episode = PlanarEpisode {
        source: 7,
        frames: scene.frames,
    };
    let config = SegmentConfig {
        rule: Rule::AlwaysTransit,
        ..SegmentConfig::default()
    };
    let segmented = segment_planar(&episode, &config).unwrap();
    assert_eq!(segmented.modes, [Transit; 6]);
    for (frame, evidence) in segmented.evidence.iter().enumerate() {
        assert_eq!(evidence.eef_step, (frame < 5).then_some(5.0));
        assert_eq!(
            (
                evidence.object_step,
                evidence.object_rotation,
                evidence.relative_translation
            ),
            (None, None, None)
        );
        assert_eq!((evidence.eef_object_distance, evidence.object_moving), (None, None));
    }
    let [segment] = segmented.segments.as_slice() else {
        panic!("{:?}", segmented.segments)
    };
    assert_eq!((segment.object_displacement, segment.object_rotation), (None, None));
    let refused = segment_planar(&episode, &rigid()).unwrap_err();
    assert_eq!(
        refused.sentence(),
        "cannot segment episode 7 by rigid motion: the pose of the block was not recorded; set segment.rule to always_transit"
    );
    // A single coordinate that is NaN is a fault, not an unknown pose.
    let mut broken = episode;
    broken.frames[2].object = Pose2::new(f64::NAN, 1.0, 0.0);
    assert!(matches!(
        segment_planar(&broken, &config).unwrap_err(),
        SegmentError::NotFinite { frame: 2, .. }
    ));
}

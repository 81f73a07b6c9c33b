//! Detection of the unit, offset, direction and frame of actions. The data comes from a simple simulation of an end effector that
//! follows robosuite's controller.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;
use re4_robosuite::conventions::{
    ActionFrame, ActionKind, ActionRotation, ActionScale, Basis, Contradiction, Conventions, DemoArrays,
    EefOrientation, GripperRange, GripperSign, Proof, QuaternionOrder, Settings, Unproven,
};
use re4_robosuite::env_args::EnvArgs;
use re4_robosuite::hand_from_site;

/// A change of each action.
type Change = fn(&[f64; 7]) -> [f64; 7];

const FRAMES: usize = 90;
const OUTPUT: [f64; 6] = [0.05, 0.05, 0.05, 0.5, 0.5, 0.5];

#[derive(Debug, Clone)]
struct Demo {
    name: String,
    eef_pos: Vec<[f64; 3]>,
    eef_quat: Vec<[f64; 4]>,
    fingers: Vec<[f64; 2]>,
    actions: Vec<[f64; 7]>,
    /// The controller's goals.
    goals: Vec<[f64; 7]>,
}

/// Parameters of the simulation: the end effector moves freely or is held back to some degree.
#[derive(Debug, Clone, Copy)]
struct World {
    seed: u64,
    /// Fraction of the controller's forces that remains after friction, for translations and rotations.
    strength: (f64, f64),
    /// Fraction of the frames with a command of 0.
    idle: f64,
}

/// A generator of random numbers in [0, 1) that depend only on the seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Simulates robosuite's controller. The goal is set once per step, and the forces are computed 25 times per step.
fn demo(world: World, number: u64) -> Demo {
    let mut random = Random(world.seed.wrapping_mul(1_000_003).wrapping_add(number * 7919 + 17));
    random.next();
    let mut demo = Demo {
        name: format!("demo_{number}"),
        eef_pos: vec![],
        eef_quat: vec![],
        fingers: vec![],
        actions: vec![],
        goals: vec![],
    };
    let phases: [f64; 12] = std::array::from_fn(|_| 6.3 * random.next());
    let mut position = Vector3::new(0.1 * random.next(), 0.1 * random.next(), 1.0);
    let mut site = UnitQuaternion::from_scaled_axis(Vector3::new(3.1, 0.1 * random.next(), 0.1));
    let (mut speed, mut angular_velocity) = (Vector3::zeros(), Vector3::zeros());
    let mut held = site;
    let mut opening = 0.02_f64;
    let mut idle = 0;
    for t in 0..FRAMES {
        demo.eef_pos.push(position.into());
        demo.eef_quat.push((site * hand_from_site().inverse()).coords.into());
        demo.fingers.push([opening, -opening]);
        if idle == 0 && random.next() < world.idle / 8.0 {
            idle = 8;
        }
        let s = t as f64 / 7.0;
        let mut arm: [f64; 6] = std::array::from_fn(|axis| {
            let size = if axis < 3 { 0.7 } else { 0.3 };
            size * ((1.0 + 0.1 * axis as f64) * s + phases[axis]).sin() + 0.1 * (random.next() - 0.5)
        });
        if idle > 0 {
            arm = [0.0; 6];
            idle -= 1;
        }
        let closes = (t / 22) % 2 == 1;
        demo.actions.push([
            arm[0],
            arm[1],
            arm[2],
            arm[3],
            arm[4],
            arm[5],
            if closes { 1.0 } else { -1.0 },
        ]);
        let goal = position + Vector3::new(arm[0], arm[1], arm[2]) * OUTPUT[0];
        if arm[3..] != [0.0; 3] {
            held = UnitQuaternion::from_scaled_axis(Vector3::new(arm[3], arm[4], arm[5]) * OUTPUT[3]) * site;
        }
        let rotation = held.scaled_axis();
        demo.goals.push([
            goal.x,
            goal.y,
            goal.z,
            rotation.x,
            rotation.y,
            rotation.z,
            demo.actions[t][6],
        ]);
        for _ in 0..25 {
            let force = (goal - position) * 150.0 - speed * 2.0 * 150.0_f64.sqrt();
            speed += force * (world.strength.0 * 0.002);
            position += speed * 0.002;
            let torque = (held * site.inverse()).scaled_axis() * 150.0 - angular_velocity * 2.0 * 150.0_f64.sqrt();
            angular_velocity += torque * (world.strength.1 * 0.002);
            site = UnitQuaternion::from_scaled_axis(angular_velocity * 0.002) * site;
            opening = (opening + if closes { -2e-4 } else { 2e-4 }).clamp(0.0, 0.04);
        }
    }
    demo
}

fn demos(world: World) -> Vec<Demo> {
    (0..4).map(|number| demo(world, number)).collect()
}

impl Demo {
    fn arrays(&self) -> DemoArrays<'_> {
        DemoArrays {
            name: &self.name,
            eef_pos: &self.eef_pos,
            eef_quat: &self.eef_quat,
            object: None,
            gripper_qpos: &self.fingers,
            actions: &self.actions,
            eef_vel_ang: None,
            states: None,
            model: None,
        }
    }

    /// A copy with changed actions.
    fn with(&self, change: impl Fn(&[f64; 7]) -> [f64; 7]) -> Self {
        Self {
            actions: self.actions.iter().map(change).collect(),
            ..self.clone()
        }
    }

    fn absolute(&self) -> Self {
        Self {
            actions: self.goals.clone(),
            ..self.clone()
        }
    }
}

fn env(version: &str) -> EnvArgs {
    let text = format!(
        r#"{{"env_name": "Stack", "env_version": "{version}", "type": 1, "env_kwargs": {{"control_freq": 20,
            "controller_configs": {{"type": "OSC_POSE", "input_max": 1, "input_min": -1, "kp": 150, "damping_ratio": 1,
            "output_max": [0.05, 0.05, 0.05, 0.5, 0.5, 0.5], "output_min": [-0.05, -0.05, -0.05, -0.5, -0.5, -0.5]}}}}}}"#
    );
    EnvArgs::parse(&text).unwrap()
}

/// Settings for the conventions that cannot be detected without states and object.
fn known() -> Settings {
    Settings {
        eef_quaternion: Some(QuaternionOrder::Xyzw),
        eef_orientation: Some(EefOrientation::HandBody),
        ..Settings::default()
    }
}

fn detect(demos: &[Demo], settings: &Settings) -> Result<(Conventions, Vec<Proof>), Unproven> {
    let arrays: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
    Conventions::detect(&arrays, &env("1.4.1"), settings)
}

/// The convention and the message of the error.
fn refused(demos: &[Demo], settings: &Settings) -> (String, String) {
    let error = detect(demos, settings).unwrap_err();
    let convention = match &error {
        Unproven::Actions { convention, .. }
        | Unproven::Setting { convention, .. }
        | Unproven::Declared { convention, .. }
        | Unproven::Undecided { convention, .. } => (*convention).to_owned(),
        Unproven::RefusedDemo(odd) => odd[0].demo.clone(),
        _ => String::new(),
    };
    (convention, error.to_string())
}

fn basis(proofs: &[Proof], convention: &str) -> Basis {
    proofs
        .iter()
        .find(|proof| proof.convention == convention)
        .unwrap()
        .basis
}

fn worlds() -> impl Strategy<Value = World> {
    (any::<u64>(), 0.75_f64..1.0, 0.65_f64..1.0, 0.0_f64..0.6).prop_map(|(seed, translation, rotation, idle)| World {
        seed,
        strength: (translation, rotation),
        idle,
    })
}

/// Factors that are not near 1, in either direction. In a single demonstration, an end effector that is held back may move only
/// a third of the commanded distance or rotate by a sixth of the commanded angle. It never moves further than commanded.
fn factors() -> impl Strategy<Value = f64> {
    prop_oneof![6.5_f64..40.0, (2.5_f64..40.0).prop_map(|factor| 1.0 / factor)]
}

fn scaled(action: &[f64; 7], factors: [f64; 6], offset: [f64; 6]) -> [f64; 7] {
    std::array::from_fn(|i| {
        if i < 6 {
            action[i] * factors[i] + offset[i]
        } else {
            action[i]
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn actions_of_the_controller_are_proven(world in worlds()) {
        let demos = demos(world);
        let (conventions, proofs) = detect(&demos, &known()).unwrap();
        prop_assert!(conventions.actions.is_plain());
        for name in ["action_scale", "action_rotation", "gripper_range"] {
            prop_assert_eq!(basis(&proofs, name), Basis::Data, "{}", name);
        }
        for demo in &demos {
            conventions.check(&demo.arrays()).unwrap();
        }
        let absolute: Vec<Demo> = demos.iter().map(Demo::absolute).collect();
        let settings = Settings { eef_orientation: None, ..known() };
        let (conventions, proofs) = detect(&absolute, &settings).unwrap();
        prop_assert_eq!(conventions.action_kind, ActionKind::Absolute);
        for name in ["action_frame", "goal_rotation"] {
            prop_assert_eq!(basis(&proofs, name), Basis::Data, "{}", name);
        }
        for demo in &absolute {
            conventions.check(&demo.arrays()).unwrap();
        }
    }

    #[test]
    fn deltas_in_metres_are_recognised_and_accepted_by_a_setting(world in worlds()) {
        let right = demos(world);
        let metres: Vec<Demo> = right.iter().map(|demo| demo.with(|action| scaled(action, OUTPUT, [0.0; 6]))).collect();
        let (convention, sentence) = refused(&metres, &known());
        prop_assert_eq!(&convention, "action_scale", "{}", sentence);
        prop_assert!(sentence.contains("metres and radians") && sentence.contains("set action_scale = \"metres\""), "{}", sentence);
        let settings = Settings { action_scale: Some(ActionScale::Metres), ..known() };
        let (conventions, proofs) = detect(&metres, &settings).unwrap();
        prop_assert_eq!(basis(&proofs, "action_scale"), Basis::Data);
        for (metres, right) in metres.iter().zip(&right) {
            for (recorded, action) in metres.actions.iter().zip(&right.actions) {
                let read = conventions.actions.read(recorded);
                prop_assert!(read.iter().zip(action).all(|(read, action)| (read - action).abs() < 1e-12));
            }
            conventions.check(&metres.arrays()).unwrap();
            // A single demonstration in the other unit.
            prop_assert!(conventions.check(&right.arrays()).is_err());
        }
        // The setting for a file in the controller's own unit.
        let (convention, sentence) = refused(&right, &settings);
        prop_assert_eq!(&convention, "action_scale", "{}", sentence);
        prop_assert!(sentence.contains("action_scale = \"controller\" fits"), "{}", sentence);
    }

    #[test]
    fn deltas_of_any_other_unit_are_refused(world in worlds(), factor in factors(), rotation in factors()) {
        let right = demos(world);
        let (conventions, _) = detect(&right, &known()).unwrap();
        let settings = Settings { allow_actions_beyond_range: true, ..known() };
        for (factors, named) in [
            // A weak arm follows commands of another unit plausibly far in translation; then only the rotation shows the unit.
            ([factor; 6], &["moves", "rotates"][..]),
            ([1.0, 1.0, 1.0, rotation, rotation, rotation], &["rotates"][..]),
        ] {
            let other: Vec<Demo> = right.iter().map(|demo| demo.with(|action| scaled(action, factors, [0.0; 6]))).collect();
            let (convention, sentence) = refused(&other, &settings);
            prop_assert_eq!(&convention, "action_scale", "{}", sentence);
            prop_assert!(named.iter().any(|word| sentence.contains(word)), "{}", sentence);
            let undo = Settings { action_gain: Some(factors.map(|factor| 1.0 / factor)), ..known() };
            let (read, proofs) = detect(&other, &undo).unwrap();
            prop_assert_eq!(basis(&proofs, "action_scale"), Basis::Data);
            prop_assert_eq!(read.actions.scale, ActionScale::Numbers);
            let outcome = conventions.check(&other[2].arrays());
            prop_assert!(outcome.is_err(), "{:?} {:?}", factors, outcome);
        }
    }

    #[test]
    fn shifted_deltas_are_refused(world in worlds(), axis in 0..6_usize, shift in 0.25_f64..0.6, below in any::<bool>()) {
        let mut offset = [0.0; 6];
        offset[axis] = if below { -shift } else { shift };
        let gain = 0.6;
        let right = demos(world);
        let other: Vec<Demo> = right.iter().map(|demo| demo.with(|action| scaled(action, [gain; 6], offset))).collect();
        let settings = Settings { allow_actions_beyond_range: true, ..known() };
        let (convention, sentence) = refused(&other, &settings);
        prop_assert_eq!(&convention, "action_scale", "{}", sentence);
        prop_assert!(sentence.contains("shifted") || sentence.contains("another unit"), "{}", sentence);
        let undo = Settings {
            action_gain: Some([1.0 / gain; 6]),
            action_offset: Some(offset.map(|offset| -offset / gain)),
            ..known()
        };
        let (conventions, _) = detect(&other, &undo).unwrap();
        for demo in &other {
            conventions.check(&demo.arrays()).unwrap();
        }
    }

    #[test]
    fn reversed_rotations_are_recognised(world in worlds()) {
        let other: Vec<Demo> = demos(world)
            .iter()
            .map(|demo| demo.with(|action| scaled(action, [1.0, 1.0, 1.0, -1.0, -1.0, -1.0], [0.0; 6])))
            .collect();
        let (convention, sentence) = refused(&other, &known());
        prop_assert_eq!(&convention, "action_rotation", "{}", sentence);
        prop_assert!(sentence.contains("set action_rotation = \"reversed\""), "{}", sentence);
        let settings = Settings { action_rotation: Some(ActionRotation::Reversed), ..known() };
        let (conventions, _) = detect(&other, &settings).unwrap();
        prop_assert_eq!(conventions.actions.rotation, ActionRotation::Reversed);
        for demo in &other {
            conventions.check(&demo.arrays()).unwrap();
        }
        // robosuite 1.0 rotated in this direction.
        let arrays: Vec<DemoArrays<'_>> = other.iter().map(Demo::arrays).collect();
        let (conventions, proofs) = Conventions::detect(&arrays, &env("1.0.0"), &known()).unwrap();
        prop_assert_eq!(conventions.actions.rotation, ActionRotation::Reversed);
        prop_assert_eq!(basis(&proofs, "action_rotation"), Basis::Data);
    }

    #[test]
    fn goals_in_another_frame_are_refused(world in worlds(), shift in prop::array::uniform3(-1.0_f64..1.0)) {
        let shift = Vector3::from(shift);
        prop_assume!(shift.norm() > 0.1);
        let right: Vec<Demo> = demos(world).iter().map(Demo::absolute).collect();
        let other: Vec<Demo> = right
            .iter()
            .map(|demo| demo.with(|action| scaled(action, [1.0; 6], [shift.x, shift.y, shift.z, 0.0, 0.0, 0.0])))
            .collect();
        for kind in [None, Some(ActionKind::Absolute)] {
            let settings = Settings { action_kind: kind, ..known() };
            let (convention, sentence) = refused(&other, &settings);
            prop_assert_eq!(&convention, "action_frame", "{}", sentence);
            prop_assert!(sentence.contains("from the end effector's motion"), "{}", sentence);
        }
        let (conventions, _) = detect(&right, &known()).unwrap();
        let error = conventions.check(&other[1].arrays()).unwrap_err();
        prop_assert!(error.to_string().contains("demonstration with another frame"), "{}", error);
        // Without a model the pose of the base is not known.
        let settings = Settings { action_frame: Some(ActionFrame::Base), ..known() };
        prop_assert!(matches!(detect(&other, &settings), Err(Unproven::Settings(_))));
    }

    #[test]
    fn orientations_as_euler_angles_are_refused(world in worlds()) {
        let other: Vec<Demo> = demos(world)
            .iter()
            .map(Demo::absolute)
            .map(|demo| demo.with(|action| {
                let goal = UnitQuaternion::from_scaled_axis(Vector3::new(action[3], action[4], action[5]));
                let (roll, pitch, yaw) = goal.euler_angles();
                [action[0], action[1], action[2], roll, pitch, yaw, action[6]]
            }))
            .collect();
        // If the site points nearly straight down all the time, both representations have nearly the same numbers.
        match detect(&other, &known()) {
            Err(error) => prop_assert!(error.to_string().contains("roll, pitch and yaw"), "{}", error),
            Ok((_, proofs)) => {
                let row = proofs.iter().find(|proof| proof.convention == "goal_rotation").unwrap();
                let own = row.evidence.candidates.iter().find(|candidate| candidate.value == "rotation_vector");
                prop_assert!(own.unwrap().residual < 0.4, "{:?}", row);
            }
        }
    }

    #[test]
    fn gripper_commands_from_0_to_1_are_recognised(world in worlds(), opens in any::<bool>()) {
        let right = demos(world);
        let other: Vec<Demo> = right
            .iter()
            .map(|demo| demo.with(|action| {
                let mut action = *action;
                let closes = f64::midpoint(action[6], 1.0);
                action[6] = if opens { 1.0 - closes } else { closes };
                action
            }))
            .collect();
        let (convention, sentence) = refused(&other, &known());
        prop_assert_eq!(&convention, "gripper_range", "{}", sentence);
        prop_assert!(sentence.contains("set gripper_range = \"zero_one\""), "{}", sentence);
        prop_assert_eq!(sentence.contains("positive_opens"), opens, "{}", sentence);
        let settings = Settings {
            gripper_range: Some(GripperRange::ZeroOne),
            gripper_sign: opens.then_some(GripperSign::PositiveOpens),
            ..known()
        };
        let (conventions, proofs) = detect(&other, &settings).unwrap();
        prop_assert_eq!(basis(&proofs, "gripper_range"), Basis::Data);
        let sign = if opens { -1.0 } else { 1.0 };
        for (other, right) in other.iter().zip(&right) {
            conventions.check(&other.arrays()).unwrap();
            let rows = other.actions.iter().zip(&right.actions);
            let same = |(other, right): (&[f64; 7], &[f64; 7])| conventions.actions.read(other)[6] == sign * right[6];
            prop_assert!(rows.into_iter().all(same));
        }
        // A demonstration with either range is refused among demonstrations with the other one.
        let (plain, _) = detect(&right, &known()).unwrap();
        prop_assert!(plain.check(&other[0].arrays()).is_err());
        prop_assert!(conventions.check(&right[0].arrays()).is_err());
        let (convention, sentence) = refused(&right, &settings);
        prop_assert_eq!(&convention, "gripper_range", "{}", sentence);
    }

    /// robosuite uses only the sign.
    #[test]
    fn gripper_commands_of_any_magnitude_are_accepted(world in worlds(), size in 0.05_f64..3.0) {
        let other: Vec<Demo> = demos(world)
            .iter()
            .map(|demo| demo.with(|action| {
                let mut action = *action;
                action[6] *= size;
                action
            }))
            .collect();
        let settings = Settings { allow_actions_beyond_range: true, ..known() };
        let (conventions, _) = detect(&other, &settings).unwrap();
        prop_assert_eq!(conventions.actions.gripper, GripperRange::MinusOneOne);
        for demo in &other {
            conventions.check(&demo.arrays()).unwrap();
        }
    }
}

const PLAIN: World = World {
    seed: 3,
    strength: (0.95, 0.8),
    idle: 0.2,
};

/// One demonstration is wrong, and its numbers are large enough to dominate a proof from all demonstrations.
#[test]
fn a_single_wrong_demonstration_is_named_and_can_be_left_out() {
    let right: Vec<Demo> = (0..5).map(|number| demo(PLAIN, number)).collect();
    let changes: [(Change, &str); 3] = [
        (
            |action| scaled(action, [-0.9; 6], [0.0; 6]),
            "the end effector moves opposite to its commands",
        ),
        (
            |action| scaled(action, [0.02; 6], [0.0; 6]),
            "further than its commands ask for",
        ),
        (
            |action| {
                let mut action = *action;
                action[6] = -action[6];
                action
            },
            "the fingers move against the gripper command",
        ),
    ];
    for (change, sentence) in changes {
        let mut mixed = right.clone();
        mixed[3] = mixed[3].with(change);
        let arrays: Vec<DemoArrays<'_>> = mixed.iter().map(Demo::arrays).collect();
        let learned = Conventions::detect_excluding(&arrays, &env("1.4.1"), &known()).unwrap();
        match Conventions::detect(&arrays, &env("1.4.1"), &known()) {
            // Either the detection names it,
            Err(Unproven::RefusedDemo(odd)) => {
                assert_eq!((odd.len(), odd[0].place, odd[0].demo.as_str()), (1, 3, "demo_3"));
                assert!(odd[0].why.contains(sentence), "{}", odd[0].why);
                assert_eq!(learned.odd, odd);
            }
            // or it contradicts the conventions that the others prove.
            Ok((conventions, _)) => {
                assert!(learned.odd.is_empty());
                let error = conventions.check(&arrays[3]).unwrap_err();
                assert!(error.to_string().contains(sentence), "{error}");
            }
            Err(error) => panic!("{error}"),
        }
        for at in [0, 1, 2, 4] {
            learned.conventions.check(&arrays[at]).unwrap();
        }
    }
    // With only two demonstrations, it is not possible to decide which one is wrong.
    let pair = [
        right[0].clone(),
        right[1].with(|action| scaled(action, [-30.0; 6], [0.0; 6])),
    ];
    let (convention, sentence) = refused(&pair, &known());
    assert_ne!(convention, "demo_1", "{sentence}");
}

#[test]
fn rows_that_were_never_recorded_are_reported_first() {
    let mut demos = demos(PLAIN);
    for t in 70..FRAMES {
        demos[2].actions[t] = [0.0; 7];
        demos[2].eef_pos[t] = [0.0; 3];
        demos[2].eef_quat[t] = [0.0; 4];
        demos[2].fingers[t] = [0.0; 2];
    }
    let error = detect(&demos, &known()).unwrap_err();
    assert!(
        matches!(
            &error,
            Unproven::Demo(Contradiction::Zeros {
                first: 70,
                last: 89,
                ..
            })
        ),
        "{error}"
    );
    assert!(
        error
            .to_string()
            .starts_with("demo_2: rows 70 to 89 contain only zeros"),
        "{error}"
    );
    let arrays: Vec<DemoArrays<'_>> = demos.iter().map(Demo::arrays).collect();
    let learned = Conventions::detect_excluding(&arrays, &env("1.4.1"), &known()).unwrap();
    assert_eq!(learned.odd.len(), 1);
    assert_eq!((learned.odd[0].place, learned.odd[0].demo.as_str()), (2, "demo_2"));
    assert!(
        learned.odd[0].why.starts_with("rows 70 to 89 contain only zeros"),
        "{}",
        learned.odd[0].why
    );
    let mut frozen = demo(PLAIN, 0);
    frozen.eef_pos = vec![frozen.eef_pos[0]; FRAMES];
    let error = learned.conventions.check(&frozen.arrays()).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("all 90 rows of obs/robot0_eef_pos are the same"),
        "{error}"
    );
}

#[test]
fn settings_that_exclude_each_other_are_refused() {
    let demos = demos(PLAIN);
    let excluded = [
        Settings {
            action_scale: Some(ActionScale::Metres),
            action_kind: Some(ActionKind::Absolute),
            ..known()
        },
        Settings {
            action_scale: Some(ActionScale::Metres),
            action_gain: Some([2.0; 6]),
            ..known()
        },
        Settings {
            action_scale: Some(ActionScale::Numbers),
            ..known()
        },
        Settings {
            action_gain: Some([0.0; 6]),
            ..known()
        },
        Settings {
            action_offset: Some([f64::NAN; 6]),
            ..known()
        },
        Settings {
            action_frame: Some(ActionFrame::Base),
            action_kind: Some(ActionKind::Delta),
            ..known()
        },
    ];
    for settings in excluded {
        assert!(
            matches!(detect(&demos, &settings), Err(Unproven::Settings(_))),
            "{settings:?}"
        );
    }
}

/// Keys of artifacts that are older than a setting must stay the same.
#[test]
fn newer_settings_are_serialised_only_if_given() {
    let text = serde_json::to_string(&Settings::default()).unwrap();
    assert_eq!(
        text,
        r#"{"object_layout":null,"eef_orientation":null,"eef_quaternion":null,"object_quaternion":null,"action_kind":null,"gripper_sign":null,"allow_actions_beyond_range":false}"#
    );
    let given: Settings = serde_json::from_str(
        r#"{"action_scale": "metres", "action_frame": "base", "gripper_range": "zero_one", "initial_goal": "first_pose",
            "action_rotation": "reversed", "action_gain": [1, 1, 1, 2, 2, 2]}"#,
    )
    .unwrap();
    assert_eq!(given.action_gain, Some([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]));
    assert!(serde_json::from_str::<Settings>(r#"{"action_gain": [1, 1]}"#).is_err());
}

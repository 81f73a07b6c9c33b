//! Tests the segmentation by the gripper on constructed openings, whose modes are known.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use proptest::prelude::*;
use re4_artifact::episodes::ArmColumns;
use re4_episode::Mode;
use re4_fault::Remedy as _;
use re4_segment::{
    ArmEpisode, Closes, Gripper, GripperObservation, Known, OpeningConfig, Proof, Rule, SegmentError, segment_arm,
};

/// A grasp of an object of a width (fraction of the travel): open for 20 frames, close, hold for 30, open. Returns openings from 0
/// (shut) to 1, commands from 0 (close) to 1, and the frames in which the object is held.
fn grasp(width: f64) -> (Vec<f64>, Vec<f64>, std::ops::Range<usize>) {
    let (mut openings, mut commands) = (Vec::new(), Vec::new());
    let mut opening = 1.0_f64;
    for frame in 0..90 {
        let closes = (20..60).contains(&frame);
        openings.push(opening);
        commands.push(if closes { 0.0 } else { 1.0 });
        opening = if closes {
            (opening - 0.1).max(width)
        } else {
            (opening + 0.1).min(1.0)
        };
    }
    let held =
        openings.iter().position(|o| *o <= width).unwrap()..openings.iter().rposition(|o| *o <= width).unwrap() + 1;
    (openings, commands, held)
}

fn episode(openings: &[f64], commands: Option<&[f64]>) -> ArmEpisode {
    let frame = |place: usize, opening: f64| ArmColumns {
        time: None,
        state: vec![opening],
        action: Vec::new(),
        eef: None,
        eef_orientation: None,
        opening: Some(opening),
        gripper: commands.map(|commands| commands[place]),
        reward: None,
        done: None,
    };
    ArmEpisode {
        name: "demo_0".to_owned(),
        frames: openings
            .iter()
            .enumerate()
            .map(|(place, opening)| frame(place, *opening))
            .collect(),
    }
}

fn prove(episodes: &[ArmEpisode], known: &Known, config: &OpeningConfig) -> Result<Gripper, SegmentError> {
    let observations: Vec<_> = episodes.iter().map(GripperObservation::of).collect();
    Gripper::prove(&observations, known, config)
}

fn closes(closes: Closes, shut: f64) -> OpeningConfig {
    OpeningConfig {
        closes: Some(closes),
        shut: Some(shut),
    }
}

fn modes(episodes: &[ArmEpisode], gripper: &Gripper) -> Vec<Vec<Mode>> {
    let of = |episode| segment_arm(episode, Rule::Gripper, Some(gripper)).unwrap().modes;
    episodes.iter().map(of).collect()
}

fn fingers() -> Known {
    Known {
        finger_distance: true,
        ..Known::default()
    }
}

#[test]
fn frames_with_an_object_between_the_fingers_are_transfer() {
    let grasps: Vec<_> = [0.2, 0.5, 0.7].into_iter().map(grasp).collect();
    let episodes: Vec<_> = grasps.iter().map(|(o, c, _)| episode(o, Some(c))).collect();
    let gripper = prove(&episodes, &fingers(), &OpeningConfig::default()).unwrap();
    assert_eq!(
        (gripper.closes, gripper.basis, gripper.shut),
        (Closes::Decreasing, Proof::FingerDistance, Some(0.0))
    );
    for (own, (_, _, held)) in modes(&episodes, &gripper).iter().zip(&grasps) {
        let transfer: Vec<usize> = (0..own.len()).filter(|&frame| own[frame] == Mode::Transfer).collect();
        assert!(
            transfer.first().unwrap().abs_diff(held.start) <= 1,
            "{transfer:?} {held:?}"
        );
        assert!(
            transfer.last().unwrap().abs_diff(held.end - 1) <= 1,
            "{transfer:?} {held:?}"
        );
    }
}

#[test]
fn a_gripper_that_closes_on_nothing_holds_nothing() {
    let (openings, commands, _) = grasp(0.0);
    let (others, other_commands, _) = grasp(0.5);
    let episodes = [
        episode(&openings, Some(&commands)),
        episode(&others, Some(&other_commands)),
    ];
    let gripper = prove(&episodes, &fingers(), &OpeningConfig::default()).unwrap();
    let found = modes(&episodes, &gripper);
    assert!(found[0].iter().all(|mode| *mode == Mode::Transit));
    assert!(found[1].contains(&Mode::Transfer));
}

#[test]
fn a_target_proves_which_way_the_gripper_closes() {
    // The command is a target below the object's width, which the gripper does not reach.
    let episodes: Vec<_> = [0.3, 0.5, 0.4]
        .into_iter()
        .map(|width| {
            let (openings, commands, _) = grasp(width);
            // Targets take time, so they are not of two values.
            let mut target = 1.0_f64;
            let targets: Vec<f64> = commands
                .iter()
                .map(|goal| {
                    target += (goal - target).clamp(-0.06, 0.06);
                    target
                })
                .collect();
            episode(&openings, Some(&targets))
        })
        .collect();
    let gripper = prove(&episodes, &Known::default(), &OpeningConfig::default()).unwrap();
    assert_eq!(
        (gripper.closes, gripper.basis),
        (Closes::Decreasing, Proof::KeptFromTarget)
    );
    // The targets reach from 0 to 1, so the shut opening is known although the gripper never gets there.
    assert_eq!(gripper.shut, Some(0.0));
    let mirrored: Vec<_> = episodes.iter().map(|own| transformed(own, -1.0, 0.0)).collect();
    let gripper = prove(&mirrored, &Known::default(), &OpeningConfig::default()).unwrap();
    assert_eq!(
        (gripper.closes, gripper.basis),
        (Closes::Increasing, Proof::KeptFromTarget)
    );
}

#[test]
fn what_is_not_proven_is_asked_for() {
    let (openings, commands, _) = grasp(0.5);
    let with = episode(&openings, Some(&commands));
    let mut nothing = with.clone();
    for frame in &mut nothing.frames {
        (frame.opening, frame.gripper) = (None, None);
    }
    let mut command_alone = with.clone();
    for frame in &mut command_alone.frames {
        frame.opening = None;
    }
    let without = episode(&openings, None);
    let sentences: Vec<String> = [with, without, command_alone, nothing]
        .into_iter()
        .map(|own| {
            let error = prove(&[own], &Known::default(), &OpeningConfig::default()).unwrap_err();
            format!("{error}; {}", error.remedy().unwrap())
        })
        .collect();
    let asked = "set segment.opening.closes to \"decreasing\" if the number falls when the gripper closes, or to \"increasing\" if it rises";
    assert_eq!(
        sentences,
        [
            format!("cannot segment by the gripper: which way it closes is not proven by the opening (the command is no target in the unit of the opening); {asked}"),
            format!("cannot segment by the gripper: which way it closes is not proven by the opening (there is no command to compare it with); {asked}"),
            format!("cannot segment by the gripper: which way it closes is not proven by the command (no opening was recorded); {asked}"),
            "cannot segment by the gripper: the dataset has neither its opening nor a command for it; name the gripper in the table [ingest.arm], for LeRobot datasets [ingest.lerobot], or set segment.rule = \"always_transit\" if the arm has no gripper".to_owned(),
        ]
    );
}

/// The opening in another unit, and the command, too.
fn transformed(own: &ArmEpisode, factor: f64, offset: f64) -> ArmEpisode {
    let mut own = own.clone();
    for frame in &mut own.frames {
        frame.opening = frame.opening.map(|opening| factor * opening + offset);
        frame.gripper = frame.gripper.map(|command| factor * command + offset);
    }
    own
}

proptest! {
    #[test]
    fn modes_depend_neither_on_the_unit_nor_on_the_sign(
        widths in prop::collection::vec(0.15_f64..0.8, 2..5),
        noise in prop::collection::vec(-0.002_f64..0.002, 90),
        factor in prop_oneof![0.01_f64..0.1, 20.0_f64..200.0],
        offset in -50.0_f64..50.0,
        mirrored: bool,
    ) {
        let episodes: Vec<_> = widths
            .iter()
            .map(|&width| {
                let (openings, commands, _) = grasp(width);
                let openings: Vec<f64> = openings.iter().zip(&noise).map(|(opening, noise)| opening + noise).collect();
                episode(&openings, Some(&commands))
            })
            .collect();
        let own = prove(&episodes, &Known::default(), &closes(Closes::Decreasing, 0.0)).unwrap();
        let factor = if mirrored { -factor } else { factor };
        let others: Vec<_> = episodes.iter().map(|own| transformed(own, factor, offset)).collect();
        let setting = if mirrored { Closes::Increasing } else { Closes::Decreasing };
        let other = prove(&others, &Known::default(), &closes(setting, offset)).unwrap();
        prop_assert_eq!(modes(&episodes, &own), modes(&others, &other));
    }

    #[test]
    fn noise_of_the_opening_makes_no_segments(
        width in 0.2_f64..0.7,
        noise in prop::collection::vec(-0.01_f64..0.01, 90),
    ) {
        let (openings, commands, held) = grasp(width);
        let noisy: Vec<f64> = openings.iter().zip(&noise).map(|(opening, noise)| opening + noise).collect();
        let episodes = [episode(&noisy, Some(&commands))];
        let gripper = prove(&episodes, &fingers(), &OpeningConfig::default()).unwrap();
        let found = segment_arm(&episodes[0], Rule::Gripper, Some(&gripper)).unwrap();
        prop_assert_eq!(found.segments.len(), 3, "{:?} {:?}", found.segments, held);
    }
}

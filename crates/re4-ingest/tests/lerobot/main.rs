//! LeRobot datasets as sources of demonstrations: the samples beside the store they were converted from, and made-up datasets.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may stop where it fails"
)]

#[path = "../common/mod.rs"]
mod common;
mod made;

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use made::{Feature, Pushes, dataset};
use re4_geometry::periodic_distance;
use re4_ingest::lerobot::{LerobotChoice, LerobotKeys, LerobotSource, describe};
use re4_ingest::pusht::{PushtConventions, PushtOptions, PushtReader, PushtSource};
use re4_ingest::{
    ArmColumns, DemoName, DemoSource, Frames, IngestError, LeftOut, OnBad, PlanarColumns, Selection, SignalRole, Tally,
    WarningCode,
};
use re4_sim::{GOAL, coverage};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

fn choice(keys: &LerobotKeys, planar: bool) -> LerobotChoice<'_> {
    LerobotChoice {
        planar,
        keys,
        split: None,
        select: &Selection::All,
        images: true,
        cameras: None,
    }
}

fn open_with(
    path: &Path,
    choice: &LerobotChoice<'_>,
    options: &PushtOptions<'_>,
) -> Result<LerobotSource, IngestError> {
    let (files, _) = choice.open(path, &|| false)?.hash(path, &|| false)?;
    LerobotSource::read(path, files, choice, options)
}

fn pusht(path: &Path) -> Result<LerobotSource, IngestError> {
    open_with(path, &choice(&LerobotKeys::default(), true), &PushtOptions::default())
}

fn arm(path: &Path, keys: &LerobotKeys) -> Result<LerobotSource, IngestError> {
    open_with(path, &choice(keys, false), &PushtOptions::default())
}

/// Names and frames of all demonstrations, and those left out.
fn read<S: DemoSource>(source: &S) -> (Vec<(DemoName, Frames)>, Vec<LeftOut>) {
    let (mut good, mut left) = (Vec::new(), Vec::new());
    source
        .episodes(0..source.count(), |place, episode| {
            match episode {
                Ok(episode) => {
                    assert_eq!(place, good.len() + left.len());
                    good.push((episode.name, episode.frames));
                }
                Err(bad) => left.push(bad),
            }
            Ok::<(), IngestError>(())
        })
        .unwrap();
    (good, left)
}

fn planar(frames: &Frames) -> &[PlanarColumns] {
    match frames {
        Frames::Planar(frames) => frames,
        _ => panic!("not planar"),
    }
}

fn arms(frames: &Frames) -> &[ArmColumns] {
    match frames {
        Frames::Arm(frames) => frames,
        _ => panic!("not of an arm"),
    }
}

/// SHA-256 of all images, and their places.
fn images<S: DemoSource>(source: &S) -> (String, Vec<(u32, u32)>) {
    let of: Vec<(DemoName, usize)> = read(source)
        .0
        .into_iter()
        .map(|(name, frames)| (name, frames.count()))
        .collect();
    let camera = &source.info().cameras[0];
    let (mut hash, mut places) = (Sha256::new(), Vec::new());
    source
        .images(camera, &of, |block| {
            let block = block.unwrap();
            assert_eq!(block.bytes.len(), block.places.len() * block.width * block.height * 3);
            hash.update(&block.bytes);
            places.extend(block.places);
            Ok::<(), IngestError>(())
        })
        .unwrap();
    let mut text = String::new();
    for byte in hash.finalize() {
        write!(text, "{byte:02x}").unwrap();
    }
    (text, places)
}

fn samples() -> Option<PathBuf> {
    let folder = common::real_dataset()?.parent()?.parent()?.join("lerobot");
    let there = folder.is_dir();
    if !there {
        println!("skipped: no samples in {}", folder.display());
    }
    there.then_some(folder)
}

/// SHA-256 of the RGB images of the videos: planes decoded by `FFmpeg` and dav1d, converted by a program of numpy that follows the
/// definition of BT.601 (coefficients with 16 bits, the nearest chroma sample).
const VIDEOS: [(&str, &str); 6] = [
    (
        "pusht-v2.1-video-av1",
        "73accd6d59a53c3e740ebfea9ee460411e63d320b88cafe373d22fb093821414",
    ),
    (
        "pusht-v2.1-video-h264",
        "65fe67db1b730ba59eac5d1b81724836e4e0054738a0a3a2b2f19517d04a5637",
    ),
    (
        "pusht-v3.0-converted-av1",
        "73accd6d59a53c3e740ebfea9ee460411e63d320b88cafe373d22fb093821414",
    ),
    (
        "pusht-v3.0-multifile",
        "9bfd26964043a57f73d86a7c2e653bf2c33e2a3bb4971c98c191f668d669a44e",
    ),
    (
        "pusht-v3.0-video-av1",
        "9bfd26964043a57f73d86a7c2e653bf2c33e2a3bb4971c98c191f668d669a44e",
    ),
    (
        "pusht-v3.0-video-h264",
        "a330dad74fbbf85cef77d372e951eec9e549b06e39f50997a3d713df8a8f200e",
    ),
];

#[test]
fn samples_equal_the_store_that_they_were_converted_from() {
    let (Some(store), Some(folder)) = (common::real_dataset(), samples()) else {
        return;
    };
    let options = PushtOptions {
        images: true,
        ..PushtOptions::default()
    };
    let zarr = PushtSource::read(PushtReader::open(&store).unwrap(), &Selection::First(3), &options).unwrap();
    let (expected, _) = read(&zarr);
    let (pixels, places) = images(&zarr);
    let entries = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path());
    let mut sets: Vec<PathBuf> = entries.filter(|path| path.is_dir()).collect();
    sets.sort();
    assert_eq!(sets.len(), 10);
    for set in sets {
        let name = set.file_name().unwrap().to_str().unwrap();
        let source = pusht(&set).unwrap();
        let (found, left) = read(&source);
        assert!(left.is_empty());
        let corners = ["keypoints", "multifile", "handwritten"]
            .iter()
            .any(|kind| name.contains(kind));
        assert_eq!(source.info().object_poses, corners, "{name}");
        for ((demo, frames), (same, others)) in found.iter().zip(&expected) {
            assert_eq!((&demo.name, demo.number), (&same.name, same.number), "{name}");
            assert_eq!(demo.filter_keys, ["train"], "{name}");
            assert_eq!(frames.count(), others.count(), "{name}");
            for (frame, other) in planar(frames).iter().zip(planar(others)) {
                assert_eq!((frame.eef, frame.action), (other.eef, other.action), "{name}");
                assert_eq!(frame.object.is_some(), corners, "{name}");
                let (Some(pose), Some(recorded)) = (frame.object, other.object) else {
                    continue;
                };
                assert!((pose.x - recorded.x).hypot(pose.y - recorded.y) < 1e-4, "{name}");
                assert!(periodic_distance(pose.theta, recorded.theta, TAU) < 1e-5, "{name}");
            }
        }
        if name.contains("keypoints") {
            assert!(source.info().cameras.is_empty());
            continue;
        }
        let coding = &source.info().details["image_coding"]["img"];
        let video = VIDEOS.iter().find(|(sample, _)| *sample == name);
        assert_eq!(coding["lossy"], Value::Bool(video.is_some()), "{name}");
        let (found, found_places) = images(&source);
        assert_eq!(found_places, places, "{name}");
        assert_eq!(found, video.map_or(pixels.as_str(), |(_, hash)| hash), "{name}");
        source.unchanged().unwrap();
    }
}

#[test]
fn conventions_are_proven_with_their_evidence() {
    let pushes = Pushes::new(4, 60);
    let mut features = pushes.features();
    features.extend([pushes.corners(), pushes.rewards()]);
    let folder = dataset(10.0, &features);
    let source = pusht(folder.path()).unwrap();
    let rows: Vec<String> = source
        .conventions()
        .iter()
        .map(|row| {
            let proven = row.residual.unwrap() < row.threshold.unwrap()
                && row.runner_up.is_none_or(|other| other > row.threshold.unwrap());
            assert!(proven, "{row:?}");
            format!("{} {}", row.convention.0, row.value.0)
        })
        .collect();
    assert_eq!(
        rows,
        [
            "object_pose corners_xy",
            "reward coverage_next_frame",
            "action_kind absolute"
        ]
    );
    let (found, _) = read(&source);
    for ((_, frames), poses) in found.iter().zip(&pushes.poses) {
        for (frame, pose) in planar(frames).iter().zip(poses) {
            let found = frame.object.unwrap();
            assert!((found.x - pose.x).hypot(found.y - pose.y) < 1e-4);
            assert!(periodic_distance(found.theta, pose.theta, TAU) < 1e-5);
        }
    }
    assert_eq!(found[0].0.filter_keys, ["train"]);
    assert_eq!(found[3].0.filter_keys, ["test"]);
}

#[test]
fn splits_and_selections_choose_demonstrations() {
    let pushes = Pushes::new(5, 30);
    let folder = dataset(10.0, &pushes.features());
    let keys = LerobotKeys::default();
    let names = |split: Option<&str>, select: &Selection| {
        let choice = LerobotChoice {
            split,
            select,
            ..choice(&keys, true)
        };
        match open_with(folder.path(), &choice, &PushtOptions::default()) {
            Ok(source) => {
                let names: Vec<&str> = source.demos().iter().map(|demo| demo.name.as_str()).collect();
                names.join(", ")
            }
            Err(error) => error.fault.to_string(),
        }
    };
    assert_eq!(names(None, &Selection::Last(2)), "episode 3, episode 4");
    assert_eq!(names(Some("train"), &Selection::All), "episode 0, episode 1, episode 2");
    assert_eq!(names(Some("test"), &Selection::First(1)), "episode 3");
    let refused = names(Some("val"), &Selection::All);
    assert!(
        refused.contains("no split val; set ingest.filter to one of the splits (") && refused.contains("train"),
        "{refused}"
    );
    let refused = names(Some("test"), &Selection::First(3));
    assert!(refused.contains("there are 2"), "{refused}");
}

/// The refusal of a dataset, with keys.
fn refusal(features: &[Feature], keys: &Value, conventions: PushtConventions) -> String {
    let folder = dataset(10.0, features);
    let keys: LerobotKeys = serde_json::from_value(keys.clone()).unwrap();
    let options = PushtOptions {
        conventions,
        ..PushtOptions::default()
    };
    let refused = open_with(folder.path(), &choice(&keys, true), &options);
    refused
        .err()
        .map_or_else(|| "read".to_owned(), |error| error.fault.to_string())
}

#[test]
fn numbers_that_are_not_those_of_push_t_are_refused() {
    let pushes = Pushes::new(6, 80);
    let none = json!({});
    let with = |more: Vec<Feature>| {
        let mut features = pushes.features();
        features.extend(more);
        features
    };
    let refuse = |features: &[Feature], keys: &Value| refusal(features, keys, PushtConventions::default());
    // Corners of something else.
    let mut wrong = pushes.corners();
    for value in wrong.values.iter_mut().flatten() {
        *value = 512.0 - *value * 0.5;
    }
    let sentence = refuse(&with(vec![wrong]), &none);
    assert!(
        sentence.contains("column observation.environment_state does not contain the corners"),
        "{sentence}"
    );
    // Rewards of something else.
    let mut wrong = pushes.rewards();
    for value in wrong.values.iter_mut().flatten() {
        *value = 1.0 - *value;
    }
    let features = with(vec![pushes.corners(), wrong]);
    let sentence = refuse(&features, &none);
    assert!(
        sentence.contains("column next.reward contradicts the poses of the block: in 6 of 6 episodes"),
        "{sentence}"
    );
    assert_eq!(refuse(&features, &json!({ "reward": "" })), "read");
    // Rewards of the same frame are recognized.
    let mut same = pushes.rewards();
    for (values, poses) in same.values.iter_mut().zip(&pushes.poses) {
        *values = poses
            .iter()
            .map(|pose| (coverage(*pose, GOAL) / 0.95).min(1.0))
            .collect();
    }
    let folder = dataset(10.0, &with(vec![pushes.corners(), same]));
    let source = pusht(folder.path()).unwrap();
    assert_eq!(&*source.conventions()[1].value.0, "coverage_same_frame");
    // Positions in another unit, without a block.
    let mut unit = pushes.features();
    for values in unit.iter_mut().flat_map(|feature| &mut feature.values) {
        for value in values.iter_mut() {
            *value = *value / 256.0 - 1.0;
        }
    }
    let sentence = refuse(&unit, &none);
    assert!(sentence.contains("set ingest.pusht.window = [-1, 1]"), "{sentence}");
    let window = PushtConventions {
        window: Some([-1.0, 1.0]),
        ..PushtConventions::default()
    };
    assert_eq!(refusal(&unit, &none, window), "read");
    // Actions of another kind.
    let mut relative = pushes.features();
    let states = relative[0].values.clone();
    for (action, state) in relative[1]
        .values
        .iter_mut()
        .flatten()
        .zip(states.into_iter().flatten())
    {
        *action -= state;
    }
    let sentence = refuse(&relative, &none);
    assert!(
        sentence.contains("action explains") && sentence.contains("ingest.pusht.action = \"relative\""),
        "{sentence}"
    );
    // Names of features.
    let sentence = refuse(&pushes.features(), &json!({ "state": "observation.agent" }));
    assert!(
        sentence.contains("there is no feature observation.agent; set ingest.lerobot.state")
            && sentence.contains("action"),
        "{sentence}"
    );
    let sentence = refuse(&pushes.features(), &json!({ "keypoints": "action" }));
    assert!(
        sentence.contains("a frame has 2 values, but Push-T has 16"),
        "{sentence}"
    );
    let sentence = refuse(&pushes.features(), &json!({ "image": "observation.top" }));
    assert!(sentence.contains("there is no camera observation.top"), "{sentence}");
    let sentence = refuse(&pushes.features(), &json!({ "arm": "left" }));
    assert!(
        sentence.contains("ingest.lerobot.arm applies only to the task \"arm\"; remove it"),
        "{sentence}"
    );
}

#[test]
fn single_bad_demonstrations_are_named_or_left_out() {
    let pushes = Pushes::new(6, 60);
    let mut features = pushes.features();
    let (mut corners, mut rewards) = (pushes.corners(), pushes.rewards());
    corners.values[1][40] += 7.0;
    for value in &mut rewards.values[3] {
        *value *= 0.5;
    }
    features[0].values[4][11] = f64::NAN;
    features.extend([corners, rewards]);
    let folder = dataset(10.0, &features);
    let error = pusht(folder.path()).err().unwrap().to_string();
    for part in [
        "3 of 6 episodes",
        "corners in column observation.environment_state",
        "column next.reward",
        "column observation.state has NaN",
    ] {
        assert!(error.contains(part), "{part}: {error}");
    }
    let options = PushtOptions {
        on_bad: OnBad::LeaveOut,
        ..PushtOptions::default()
    };
    let source = open_with(folder.path(), &choice(&LerobotKeys::default(), true), &options).unwrap();
    let (good, left) = read(&source);
    let names: Vec<&str> = left.iter().map(|left| left.demo.as_str()).collect();
    assert_eq!(names, ["episode 1", "episode 3", "episode 4"]);
    assert_eq!(good.len(), 3);
    assert!((planar(&good[1].1)[0].object.unwrap().x - pushes.poses[2][0].x).abs() < 1e-4);
}

#[test]
fn without_corners_poses_are_unknown() {
    let pushes = Pushes::new(3, 60);
    let folder = dataset(10.0, &pushes.features());
    let source = pusht(folder.path()).unwrap();
    let (found, _) = read(&source);
    assert!(
        found
            .iter()
            .flat_map(|(_, frames)| planar(frames))
            .all(|frame| frame.object.is_none())
    );
    let codes: Vec<WarningCode> = source
        .warnings(&Tally::default())
        .unwrap()
        .iter()
        .map(|warning| warning.code)
        .collect();
    assert!(
        codes.contains(&WarningCode::NoObjectPoses) && codes.contains(&WarningCode::NoImages),
        "{codes:?}"
    );
    assert!(!codes.contains(&WarningCode::NoContacts), "{codes:?}");
    // The pose after the position of the agent.
    let states = pushes.states.iter().zip(&pushes.poses).map(|(states, poses)| {
        let frames = states.chunks(2).zip(poses);
        frames
            .flat_map(|(agent, pose)| [agent[0], agent[1], pose.x, pose.y, pose.theta])
            .collect()
    });
    let wide = Feature::of("observation.state", Value::Null, 5, states.collect());
    let folder = dataset(10.0, &[wide, pushes.features().pop().unwrap(), pushes.rewards()]);
    let source = pusht(folder.path()).unwrap();
    assert!(source.info().object_poses);
    let (found, _) = read(&source);
    assert!((planar(&found[2].1)[7].object.unwrap().x - pushes.poses[2][7].x).abs() < 1e-4);
}

/// Values of an arm: each element is a sine of its own.
fn waves(episodes: usize, frames: usize, width: usize) -> Vec<Vec<f64>> {
    let wave = |episode: usize, frame: usize, at: usize| (0.1 * frame as f64 + at as f64 + 0.3 * episode as f64).sin();
    (0..episodes)
        .map(|episode| {
            (0..frames * width)
                .map(|i| wave(episode, i / width, i % width))
                .collect()
        })
        .collect()
}

/// Roles of the elements of the state, then of the action, as letters.
fn letters(source: &LerobotSource) -> String {
    let letter = |role| match role {
        SignalRole::Joint => 'j',
        SignalRole::EefPosition => 'p',
        SignalRole::EefOrientation => 'o',
        SignalRole::Gripper => 'g',
        SignalRole::Other => '-',
    };
    source.signals().iter().map(|row| letter(row.role)).collect()
}

#[test]
fn robomimic_on_the_hub_has_an_end_effector_and_two_fingers() {
    let mut states = waves(3, 40, 9);
    for frame in states.iter_mut().flat_map(|values| values.chunks_mut(9)) {
        let length = frame[3..7].iter().map(|value| value * value).sum::<f64>().sqrt();
        for value in &mut frame[3..7] {
            *value /= length;
        }
        frame[8] = -frame[7];
    }
    let names: Vec<String> = [("eef_pos", 3), ("eef_quat", 4), ("gripper_qpos", 2)]
        .iter()
        .flat_map(|(name, count)| (0..*count).map(move |i| format!("robot0_{name}_{i}")))
        .collect();
    let actions: Vec<String> = (0..7).map(|i| format!("action_{i}")).collect();
    let features = [
        Feature::of("observation.state", json!({ "motors": names }), 9, states.clone()),
        Feature::of("action", json!([actions]), 7, waves(3, 40, 7)),
        Feature::of("next.done", Value::Null, 1, vec![vec![0.0; 40]; 3]),
    ];
    let folder = dataset(20.0, &features);
    let source = arm(folder.path(), &LerobotKeys::default()).unwrap();
    assert_eq!(letters(&source), "pppooooggpppooog");
    assert_eq!(source.info().rate, Some(20.0));
    assert_eq!(&*source.conventions()[0].value.0, "finger_distance");
    let (found, _) = read(&source);
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    for ((_, frames), states) in found.iter().zip(&states) {
        for (at, (frame, state)) in arms(frames).iter().zip(states.chunks(9)).enumerate() {
            assert!(frame.state.iter().zip(state).all(|(a, b)| near(*a, *b)));
            let eef = frame.eef.unwrap();
            assert!(near(eef.x, state[0]) && near(eef.y, state[1]) && near(eef.z, state[2]));
            let turn = frame.eef_orientation.unwrap();
            assert!(near(turn.i, state[3]) && near(turn.w, state[6]));
            assert!(near(frame.opening.unwrap(), (state[7] - state[8]).abs()));
            assert_eq!(frame.gripper, frame.action.last().copied());
            assert!(near(frame.time.unwrap(), at as f64 / 20.0));
            assert_eq!(frame.done, Some(false));
        }
    }
}

#[test]
fn joints_with_a_gripper_are_read_by_their_names() {
    let names = json!([
        "main_shoulder_pan",
        "main_shoulder_lift",
        "main_elbow_flex",
        "main_wrist_flex",
        "main_wrist_roll",
        "main_gripper"
    ]);
    let states = waves(2, 50, 6);
    let features = [
        Feature::of("observation.state", names.clone(), 6, states.clone()),
        Feature::of("action", names, 6, waves(2, 50, 6)),
    ];
    let folder = dataset(30.0, &features);
    let source = arm(folder.path(), &LerobotKeys::default()).unwrap();
    assert_eq!(letters(&source), "jjjjjgjjjjjg");
    let (found, _) = read(&source);
    let frame = &arms(&found[1].1)[9];
    assert!(frame.eef.is_none() && frame.eef_orientation.is_none());
    assert!((frame.opening.unwrap() - states[1][9 * 6 + 5]).abs() < 1e-6);
    assert_eq!(frame.gripper, Some(frame.action[5]));
}

#[test]
fn libero_on_the_hub_has_fingers_of_one_name() {
    let names = json!({ "motors": ["x", "y", "z", "roll", "pitch", "yaw", "gripper", "gripper"] });
    let mut states = waves(2, 30, 8);
    for frame in states.iter_mut().flat_map(|values| values.chunks_mut(8)) {
        frame[7] = -frame[6];
    }
    let command = json!({ "motors": ["x", "y", "z", "roll", "pitch", "yaw", "gripper"] });
    let features = [
        Feature::of("observation.state", names, 8, states.clone()),
        Feature::of("action", command, 7, waves(2, 30, 7)),
    ];
    let folder = dataset(10.0, &features);
    let source = arm(folder.path(), &LerobotKeys::default()).unwrap();
    assert_eq!(letters(&source), "pppooogg".to_owned() + "pppooog");
    let (found, _) = read(&source);
    let frame = &arms(&found[0].1)[3];
    // Whether three numbers are angles of Euler or a rotation vector, these names do not say.
    assert!(frame.eef.is_some() && frame.eef_orientation.is_none());
    assert!((frame.opening.unwrap() - 2.0 * states[0][3 * 8 + 6].abs()).abs() < 1e-6);
}

#[test]
fn settings_choose_the_gripper_and_the_arm() {
    let plain = [
        Feature::of("observation.state", Value::Null, 7, waves(2, 30, 7)),
        Feature::of("action", Value::Null, 7, waves(2, 30, 7)),
    ];
    let folder = dataset(10.0, &plain);
    let keys = |keys: Value| serde_json::from_value::<LerobotKeys>(keys).unwrap();
    let source = arm(folder.path(), &LerobotKeys::default()).unwrap();
    assert_eq!(letters(&source), "-".repeat(14));
    assert!(arms(&read(&source).0[0].1)[0].opening.is_none());
    let chosen = keys(json!({ "gripper": ["observation.state_6"], "gripper_command": "action_6" }));
    let source = arm(folder.path(), &chosen).unwrap();
    assert_eq!(letters(&source), "------g------g");
    let frame = arms(&read(&source).0[0].1)[5].clone();
    assert_eq!(
        (frame.opening, frame.gripper),
        (Some(frame.state[6]), Some(frame.action[6]))
    );
    let refused = arm(folder.path(), &keys(json!({ "gripper": ["claw"] })))
        .err()
        .unwrap()
        .to_string();
    assert!(
        refused.contains("no element of the state is called claw; set ingest.lerobot.gripper"),
        "{refused}"
    );
    let refused = arm(folder.path(), &keys(json!({ "keypoints": "action" })))
        .err()
        .unwrap()
        .to_string();
    assert!(refused.contains("applies only to Push-T; remove it"), "{refused}");

    let two = json!(["left_waist", "left_gripper", "right_waist", "right_gripper"]);
    let features = [
        Feature::of("observation.state", two.clone(), 4, waves(2, 30, 4)),
        Feature::of("action", two, 4, waves(2, 30, 4)),
    ];
    let folder = dataset(50.0, &features);
    let refused = arm(folder.path(), &LerobotKeys::default()).err().unwrap().to_string();
    assert!(
        refused.contains("several arms (left, right); set ingest.lerobot.arm"),
        "{refused}"
    );
    let source = arm(folder.path(), &keys(json!({ "arm": "right" }))).unwrap();
    assert_eq!(letters(&source), "jgjg");
    assert_eq!(source.signals()[0].name, "right_waist");
}

#[test]
fn a_description_says_what_can_be_done() {
    let pushes = Pushes::new(4, 60);
    let possible = |features: &[Feature]| {
        let folder = dataset(10.0, features);
        let about = describe(folder.path(), &|| false).unwrap();
        let uses = about
            .uses
            .iter()
            .map(|each| format!("{}{}", if each.possible { "+" } else { "-" }, each.command));
        (
            about.task.clone().unwrap_or_default(),
            uses.collect::<Vec<_>>().join(" "),
        )
    };
    let pusht = || "pusht".to_owned();
    assert_eq!(
        possible(&pushes.features()),
        (pusht(), "+audit +segment -index -rollout".to_owned())
    );
    let how = |features: &[Feature]| {
        let folder = dataset(10.0, features);
        let about = describe(folder.path(), &|| false).unwrap();
        about.uses.into_iter().map(|each| each.how).collect::<Vec<_>>()
    };
    // Without poses of the block, the recording can be audited as that of an arm without a gripper.
    assert_eq!(
        how(&pushes.features())[0],
        "task = \"arm\", segment.rule = \"always_transit\"; the checks that do not need the poses of the block, which are not recorded"
    );
    let mut features = pushes.features();
    features.extend([pushes.corners(), pushes.rewards()]);
    assert_eq!(
        possible(&features),
        (pusht(), "+audit +segment +index +rollout".to_owned())
    );
    let arm = [
        Feature::of("observation.state", json!(["shoulder", "gripper"]), 2, waves(2, 30, 2)),
        Feature::of("action", json!(["shoulder", "elbow", "gripper"]), 3, waves(2, 30, 3)),
    ];
    assert_eq!(
        possible(&arm),
        ("arm".to_owned(), "+audit +segment -index -rollout".to_owned())
    );
    assert_eq!(how(&arm)[1], "task = \"arm\", segment.rule = \"gripper\"");
    let joints = json!(["shoulder", "elbow", "wrist"]);
    let no_gripper = [
        Feature::of("observation.state", joints.clone(), 3, waves(2, 30, 3)),
        Feature::of("action", joints, 3, waves(2, 30, 3)),
    ];
    assert_eq!(
        possible(&no_gripper),
        ("arm".to_owned(), "+audit +segment -index -rollout".to_owned())
    );
    assert_eq!(how(&no_gripper)[1], "task = \"arm\", segment.rule = \"always_transit\"");
    let names = json!(["right_waist", "right_gripper", "left_waist", "left_gripper"]);
    let two = [
        Feature::of("observation.state", names.clone(), 4, waves(2, 30, 4)),
        Feature::of("action", names, 4, waves(2, 30, 4)),
    ];
    assert_eq!(
        possible(&two),
        ("arm".to_owned(), "+audit +segment -index -rollout".to_owned())
    );
    assert_eq!(
        how(&two)[1],
        "task = \"arm\", segment.rule = \"gripper\", ingest.lerobot.arm = \"left\""
    );
    let nothing = [Feature::of("observation.state", Value::Null, 3, waves(2, 30, 3))];
    assert_eq!(
        possible(&nothing),
        (String::new(), "-audit -segment -index -rollout".to_owned())
    );
}

#[test]
fn every_change_of_a_file_is_detected() {
    let pushes = Pushes::new(3, 30);
    let folder = dataset(10.0, &pushes.features());
    let keys = LerobotKeys::default();
    let choice = choice(&keys, true);
    let hash = || {
        choice
            .open(folder.path(), &|| false)
            .unwrap()
            .hash(folder.path(), &|| false)
            .unwrap()
    };
    let (files, before) = hash();
    let source = LerobotSource::read(folder.path(), files.clone(), &choice, &PushtOptions::default()).unwrap();
    assert_eq!(hash().1, before);
    let tasks = folder.path().join("meta/tasks.jsonl");
    let text = std::fs::read_to_string(&tasks).unwrap();
    std::fs::write(&tasks, text.replace("move it", "move on")).unwrap();
    let episodes = folder.path().join("meta/episodes.jsonl");
    let text = std::fs::read_to_string(&episodes).unwrap();
    std::fs::write(&episodes, text.replace("move it", "move on")).unwrap();
    assert!(
        source
            .unchanged()
            .unwrap_err()
            .to_string()
            .contains("changed while it was read")
    );
    assert_ne!(hash().1, before);
    let again = LerobotSource::read(folder.path(), files, &choice, &PushtOptions::default());
    assert!(again.err().unwrap().to_string().contains("changed while it was read"));
}

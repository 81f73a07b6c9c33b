//! All faults of a dataset are reported in one error, and bad episodes are left out on request.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use common::made::{Made, made};
use common::{Copy, FRAMES, SIDE, expected, image};
use re4_ingest::pusht::{PushtOptions, PushtReader, PushtReading};
use re4_ingest::{LeftOut, OnBad, Selection, WarningCode};
use serde_json::json;

fn read(copy: &Copy, on_bad: OnBad, images: bool) -> Result<PushtReading, String> {
    let options = PushtOptions {
        on_bad,
        images,
        ..PushtOptions::default()
    };
    let error = |error: re4_ingest::IngestError| error.fault.to_string();
    PushtReader::open(&copy.path())
        .map_err(error)?
        .read(&Selection::All, &options)
        .map_err(error)
}

fn numbers(left_out: &[LeftOut]) -> Vec<&str> {
    left_out.iter().map(|left| left.demo.as_str()).collect()
}

/// The original fixture with invalid values in episodes 0 (a state), 1 (an action and a count) and optionally 2 (a keypoint).
fn bad_values(third: bool) -> Copy {
    let mut state: Vec<f64> = (0..FRAMES).flat_map(common::state).collect();
    state[5 * 3 + 1] = f64::NAN;
    state[5 * 4] = f64::INFINITY;
    let mut action: Vec<f64> = (0..FRAMES).flat_map(common::action).collect();
    action[2 * 14] = 5000.0;
    let mut contacts: Vec<f64> = (0..FRAMES).map(common::contacts).collect();
    contacts[13] = 0.5;
    let mut keypoint: Vec<f64> = (0..FRAMES).flat_map(common::keypoint).flatten().collect();
    if third {
        keypoint[18 * 20] = -1000.0;
    }
    Copy::of("original")
        .floats("data/state", &[FRAMES, 5], &state)
        .floats("data/action", &[FRAMES, 2], &action)
        .floats("data/n_contacts", &[FRAMES, 1], &contacts)
        .floats("data/keypoint", &[FRAMES, 9, 2], &keypoint)
}

#[test]
fn all_bad_episodes_are_named_at_once() {
    let sentences = [
        read(&bad_values(false), OnBad::Refuse, true).unwrap_err(),
        // No episode would remain.
        read(&bad_values(true), OnBad::Refuse, true).unwrap_err(),
        read(&bad_values(true), OnBad::LeaveOut, true).unwrap_err(),
    ];
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn bad_episodes_are_left_out_on_request() {
    let copy = bad_values(false);
    let reading = read(&copy, OnBad::LeaveOut, true).unwrap();
    assert_eq!(reading.episodes, expected(&[2], true));
    assert_eq!(numbers(&reading.left_out), ["episode 0", "episode 1"]);
    insta::assert_snapshot!(
        reading
            .left_out
            .iter()
            .map(|left| left.why.as_str())
            .collect::<Vec<_>>()
            .join("\n")
    );
    // The images are those of the remaining episodes.
    let reader = PushtReader::open(&copy.path()).unwrap();
    let mut frame = 17;
    for block in reader.image_blocks_of(&reading.episodes).unwrap() {
        for bytes in block.unwrap().bytes.chunks(SIDE * SIDE * 3) {
            assert_eq!(bytes, image(frame));
            frame += 1;
        }
    }
    assert_eq!(frame, FRAMES);
    // A valid dataset is read completely.
    let valid = read(&Copy::of("original"), OnBad::LeaveOut, true).unwrap();
    assert_eq!((valid.episodes, valid.left_out), (expected(&[0, 1, 2], true), vec![]));
}

/// Images of episodes 0 and 1 with invalid values, and a chunk that cannot be decoded.
#[test]
fn bad_images_count_as_bad_episodes() {
    let mut values: Vec<f64> = (0..FRAMES).flat_map(image).map(f64::from).collect();
    let frame = SIDE * SIDE * 3;
    values[3 * frame + 7] = 300.0;
    values[4 * frame] = -1.0;
    values[12 * frame + 1] = 0.5;
    let copy = Copy::of("original").floats("data/img", &[FRAMES, SIDE, SIDE, 3], &values);
    assert_eq!(
        numbers(&read(&copy, OnBad::LeaveOut, true).unwrap().left_out),
        ["episode 0", "episode 1"]
    );
    // Images were not requested.
    assert!(read(&copy, OnBad::LeaveOut, false).unwrap().left_out.is_empty());
    let chunk = Copy::of("original").edit("data/img/2.0.0.0", |bytes| bytes.truncate(40));
    assert_eq!(
        numbers(&read(&chunk, OnBad::LeaveOut, true).unwrap().left_out),
        ["episode 1", "episode 2"]
    );
    let lost = Copy::of("original").remove("data/img/0.0.0.0");
    assert_eq!(
        numbers(&read(&lost, OnBad::LeaveOut, true).unwrap().left_out),
        ["episode 0"]
    );
    let sentences = [copy, chunk, lost].map(|copy| common::read_all(&copy.path()).unwrap_err());
    let sentences = sentences.map(|sentence| sentence.split_once(".zarr: ").unwrap().1.to_owned());
    insta::assert_snapshot!(sentences.join("\n"));
}

#[test]
fn unreadable_chunks_affect_only_the_episodes_that_use_them() {
    let cut = |bytes: &mut Vec<u8>| bytes.truncate(bytes.len() / 2);
    // Rows 0 to 6 of the states, rows 7 to 13 of the actions.
    let copy = Copy::of("original")
        .remove("data/state/0.0")
        .edit("data/action/1.0", cut);
    let reading = read(&copy, OnBad::LeaveOut, false).unwrap();
    assert_eq!(numbers(&reading.left_out), ["episode 0", "episode 1"]);
    assert_eq!(reading.episodes, expected(&[2], true));
    insta::assert_snapshot!(read(&copy, OnBad::Refuse, false).unwrap_err());
    // Episodes that do not use these chunks can be read on their own.
    let reader = PushtReader::open(&copy.path()).unwrap();
    assert_eq!(
        reader.read_episodes(&Selection::Last(1)).unwrap().0,
        expected(&[2], true)
    );
}

#[test]
fn all_faults_of_the_arrays_are_named_at_once() {
    let sentences = [
        Copy::of("original")
            .replace("data/keypoint", "<f2", &[FRAMES, 9, 2], vec![0; FRAMES * 36])
            .remove("data/state/3.0")
            .metadata("data/n_contacts", &[("fill_value", json!(null))])
            .remove("data/n_contacts/1.0"),
        Copy::of("original")
            .replace("data/action", "<f4", &[FRAMES - 1, 2], vec![0; (FRAMES - 1) * 8])
            .ends(&[12, 12, 30])
            .floats("data/img", &[FRAMES, 3, 8, 8], &vec![0.0; FRAMES * 192]),
        Copy::of("original").remove("data").remove("meta"),
    ]
    .map(|copy| {
        PushtReader::open(&copy.path())
            .map(|_| ())
            .unwrap_err()
            .fault
            .to_string()
    });
    insta::assert_snapshot!(sentences.join("\n"));
}

/// At most 20 faults are listed.
#[test]
fn long_lists_are_truncated() {
    let mut many: Made = made(40, 12);
    for episode in 0..30 {
        let frame = many.frames(episode).start;
        many.state[frame][2] = f64::NAN;
    }
    let sentence = read(&many.store(), OnBad::Refuse, false).unwrap_err();
    assert!(
        sentence.starts_with("30 of 40 episodes cannot be used: array data/state has NaN at frame 0 (episode 0)"),
        "{sentence}"
    );
    assert!(
        sentence.contains("(episode 19)") && !sentence.contains("(episode 20)"),
        "{sentence}"
    );
    assert!(
        sentence.contains("; and 10 more; repair them, or set ingest.on_bad"),
        "{sentence}"
    );
    let reading = read(&many.store(), OnBad::LeaveOut, false).unwrap();
    assert_eq!((reading.episodes.episode_count(), reading.left_out.len()), (10, 30));
}

/// A missing chunk is read as the fill value only if that is a valid count and the writer omits such chunks.
#[test]
fn contact_chunks_with_only_the_fill_value_may_be_omitted() {
    let with = |contacts: &dyn Fn(usize) -> f64| {
        let values: Vec<f64> = (0..FRAMES).map(contacts).collect();
        let bytes = |chunk: usize| -> Vec<u8> {
            let rows = chunk * 10..(chunk + 1) * 10;
            values[rows]
                .iter()
                .flat_map(|value| (*value as f32).to_le_bytes())
                .collect()
        };
        let copy = Copy::of("original")
            .floats("data/n_contacts", &[FRAMES, 1], &values)
            .metadata("data/n_contacts", &[("chunks", json!([10, 1]))]);
        (0..3).fold(copy, |copy, chunk| {
            copy.write(&format!("data/n_contacts/{chunk}.0"), bytes(chunk))
        })
    };
    let contacts = |t: usize| if (10..20).contains(&t) { 0.0 } else { 1.0 };
    let left_out = with(&contacts).remove("data/n_contacts/1.0");
    let reading = read(&left_out, OnBad::Refuse, false).unwrap();
    assert_eq!(
        reading.episodes,
        read(&with(&contacts), OnBad::Refuse, false).unwrap().episodes
    );
    let warning = reading
        .warnings
        .iter()
        .find(|warning| warning.code == WarningCode::AbsentChunks)
        .unwrap();
    assert_eq!(warning.count, 1);
    // The writer stores chunks that contain only the fill value, so a missing one is lost.
    let zeros = with(&|t| if t < 10 { 1.0 } else { 0.0 }).remove("data/n_contacts/1.0");
    // The fill value is not a valid count.
    let negative = with(&contacts)
        .metadata("data/n_contacts", &[("fill_value", json!(-1))])
        .remove("data/n_contacts/1.0");
    let sentences = [zeros, negative].map(|copy| read(&copy, OnBad::Refuse, false).unwrap_err());
    insta::assert_snapshot!(sentences.join("\n"));
}

/// Only requested arrays have to be valid.
#[test]
fn images_that_are_not_requested_are_not_checked() {
    let copy = Copy::of("original").write("data/img/.zarray", "{ not json");
    assert!(PushtReader::open(&copy.path()).is_err());
    let reader = PushtReader::open_for(&copy.path(), false, &|| false).unwrap();
    assert!(reader.has_images() && reader.image_shape().is_none());
    let (episodes, warnings) = reader.read_episodes(&Selection::All).unwrap();
    assert_eq!(episodes, expected(&[0, 1, 2], true));
    assert!(warnings.iter().all(|warning| warning.code != WarningCode::NoImages));
}

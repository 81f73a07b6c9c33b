//! Sources of both formats: their descriptions, demonstrations and images.
#![allow(clippy::unwrap_used, reason = "a test may stop where it fails")]

mod common;

use std::ops::Range;
use std::path::{Path, PathBuf};

use common::{FRAMES, SIDE, fixture, image};
use re4_ingest::pusht::{PushtOptions, PushtReader, PushtSource};
use re4_ingest::robomimic::{
    Access, DemoChoice, Interpreter, Layout, Reading, RobomimicReader, RobomimicSource, Sources, Surveyed,
};
use re4_ingest::{DemoSource, Episode, Frames, IngestError, LeftOut, Selection, Tally};
use re4_robosuite::conventions::{RobosuiteTask, Settings};
use re4_robosuite::hand_from_site;

fn sample() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/can-sample.hdf5")
}

fn episodes<S: DemoSource>(source: &S) -> Vec<Result<Episode, LeftOut>> {
    let all = in_range(source, 0..source.count());
    // Ranges give the same demonstrations.
    let cut = all.len() / 3;
    let mut parts = in_range(source, 0..cut);
    parts.extend(in_range(source, cut..all.len()));
    assert_eq!(parts, all);
    all
}

fn in_range<S: DemoSource>(source: &S, range: Range<usize>) -> Vec<Result<Episode, LeftOut>> {
    let mut all = Vec::new();
    source
        .episodes(range.clone(), |place, episode| {
            assert_eq!(place, range.start + all.len());
            all.push(episode);
            Ok::<(), IngestError>(())
        })
        .unwrap();
    all
}

fn can(select: Selection) -> RobomimicSource {
    let choice = DemoChoice {
        select,
        ..DemoChoice::default()
    };
    let reader = RobomimicReader::open(&Sources::open(&sample()).unwrap(), &choice, Access::Direct, None).unwrap();
    let reading = Reading {
        task: RobosuiteTask::named("can"),
        object: None,
        env_args: None,
        conventions: Settings::default(),
    };
    let learned = Interpreter::learn(&reader, &reading).unwrap();
    RobomimicSource::new(reader, learned, None, Vec::new()).unwrap()
}

#[test]
fn formats_are_recognized() {
    let folder = tempfile::tempdir().unwrap();
    let unnamed = folder.path().join("dataset");
    std::fs::copy(sample(), &unnamed).unwrap();
    for (path, hdf5, zarr) in [
        (sample(), true, false),
        (unnamed, true, false),
        (fixture("original"), false, true),
        (folder.path().join("nothing.hdf5"), false, false),
    ] {
        let found = (RobomimicSource::probe(&path), PushtSource::probe(&path));
        assert_eq!(found, (hdf5, zarr), "{}", path.display());
    }
}

#[test]
fn push_t_yields_episodes() {
    let reader = PushtReader::open(&fixture("original")).unwrap();
    let options = PushtOptions {
        images: true,
        ..PushtOptions::default()
    };
    let source = PushtSource::read(reader, &Selection::All, &options).unwrap();
    let info = source.info();
    assert_eq!(
        (info.rate, info.object_poses, &info.cameras[..]),
        (Some(10.0), true, &["img".to_owned()][..])
    );
    assert_eq!(info.demonstrations, source.count());
    let mut tally = Tally::default();
    let (mut first, mut kept) = (0, Vec::new());
    for episode in episodes(&source) {
        let mut episode = episode.unwrap();
        let Frames::Planar(frames) = &episode.frames else {
            unreachable!()
        };
        let [x, y, ..] = common::state(first);
        assert_eq!(
            [frames[0].eef.x, frames[0].eef.y],
            [x, y].map(|value| f64::from(value as f32))
        );
        first += frames.len();
        kept.push((episode.name.clone(), frames.len()));
        tally.add(&mut episode);
    }
    assert_eq!((first, tally.frames), (FRAMES, FRAMES));
    let lengths: Vec<usize> = kept.iter().map(|(_, frames)| *frames).collect();
    let expected: Vec<(u32, u32)> = (0..)
        .zip(&lengths)
        .flat_map(|(episode, &frames)| (0..frames as u32).map(move |frame| (episode, frame)))
        .collect();
    let (mut places, mut bytes) = (Vec::new(), Vec::new());
    source
        .images("img", &kept, |block| {
            let block = block.unwrap();
            assert_eq!((block.height, block.width), (SIDE, SIDE));
            places.extend(block.places);
            bytes.extend(block.bytes);
            Ok::<(), IngestError>(())
        })
        .unwrap();
    assert_eq!(places, expected);
    assert_eq!(bytes, (0..FRAMES).flat_map(image).collect::<Vec<u8>>());
    source.unchanged().unwrap();
}

#[test]
fn hdf5_poses_are_of_the_grip_site() {
    let source = can(Selection::First(3));
    let info = source.info();
    assert_eq!((info.rate, info.demonstrations, source.count()), (Some(20.0), 19, 3));
    assert!(info.features.contains(&"actions".to_owned()) && info.features.contains(&"obs/object".to_owned()));
    assert_eq!(info.details["environment"], "PickPlaceCan");
    for (episode, name) in episodes(&source).into_iter().zip(source.demos()) {
        let episode = episode.unwrap();
        assert_eq!(episode.name, *name);
        let Frames::Spatial(frames) = episode.frames else {
            unreachable!()
        };
        for frame in frames {
            // The file has the orientation of the hand body, and robosuite's gripper sign.
            let recorded = frame.raw_eef.unwrap();
            assert_eq!(frame.eef.rotation, recorded * hand_from_site());
            assert_eq!(frame.raw_gripper, None);
            assert!(frame.object.is_some() && frame.gripper.abs() <= 1.0);
        }
    }
}

#[test]
fn errors_of_the_closure_are_returned() {
    struct Enough;
    impl From<IngestError> for Enough {
        fn from(_: IngestError) -> Self {
            Self
        }
    }
    let source = can(Selection::All);
    let mut taken = 0;
    let ended = source.episodes(0..source.count(), |_, _| {
        taken += 1;
        if taken == 2 { Err(Enough) } else { Ok(()) }
    });
    assert!(ended.is_err() && taken == 2);
}

fn reader(path: &Path, choice: &DemoChoice, known: Option<&Surveyed>) -> Result<RobomimicReader, String> {
    let sources = Sources::open(path).map_err(|error| error.to_string())?;
    RobomimicReader::open(&sources, choice, Access::Library, known).map_err(|error| error.to_string())
}

/// What a reader says of the file as a whole.
fn whole(reader: &RobomimicReader) -> impl PartialEq + std::fmt::Debug {
    (
        (reader.demos().to_vec(), reader.layout(), reader.warnings().to_vec()),
        (reader.cameras(None).unwrap(), reader.surveyed().clone()),
    )
}

#[test]
fn a_file_that_was_surveyed_opens_equally() {
    let mut paths = vec![sample()];
    for folder in ["foreign", "malformed"]
        .iter()
        .filter_map(|name| common::available(name))
    {
        paths.extend(common::files_below(&folder, "hdf5"));
    }
    let files = paths.len();
    let mut opened = 0;
    for path in paths {
        let choice = DemoChoice::default();
        let Ok(first) = reader(&path, &choice, None) else {
            continue;
        };
        opened += 1;
        // As another process receives it.
        let text = serde_json::to_string(first.surveyed()).unwrap();
        let known: Surveyed = serde_json::from_str(&text).unwrap();
        let again = reader(&path, &choice, Some(&known)).unwrap();
        assert_eq!(whole(&first), whole(&again), "{}", path.display());
    }
    // Some of the malformed files cannot be opened.
    assert!(opened > files / 2, "{opened} of {files}");
}

#[test]
fn a_survey_holds_for_its_choice_only() {
    let choice = DemoChoice::default();
    let first = reader(&sample(), &choice, None).unwrap();
    let mut other = serde_json::to_value(first.surveyed()).unwrap();
    assert_eq!(other["layout"], "observed");
    other["layout"] = "raw".into();
    let other: Surveyed = serde_json::from_value(other).unwrap();
    let layout = |choice: &DemoChoice| reader(&sample(), choice, Some(&other)).unwrap().layout();
    // The demonstrations are not looked at again.
    assert_eq!(layout(&choice), Layout::Raw);
    let fewer = DemoChoice {
        select: Selection::First(3),
        ..choice.clone()
    };
    assert_eq!(layout(&fewer), Layout::Observed);
    let cautious = DemoChoice {
        cautious: true,
        ..choice
    };
    assert_eq!(layout(&cautious), Layout::Observed);
}

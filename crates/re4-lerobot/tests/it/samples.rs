//! The samples are read as their writers meant them.

use std::fs;
use std::path::Path;

use re_mp4::Mp4;
use re4_lerobot::{Cameras, Codec, Dataset, LerobotError, Planes, Version, Video};
use sha2::{Digest as _, Sha256};

use super::support::{contents, hex, samples};

/// Frames of the three episodes.
const LENGTHS: [usize; 3] = [161, 118, 141];

/// SHA-256 of the first 420 rows of the human demonstrations of Push-T, read by numcodecs: agent and target positions as 64-bit floats,
/// and images as bytes.
const STATES: &str = "20962713c1d7056ef98a2fc0fbec1c0fb67b990dfbc8508aa0c659107504c7d0";
const ACTIONS: &str = "adb4fa82aab7277999697976e658daa5cc33772182b44f8c8ab41e25fd2dbdf2";
const IMAGES: &str = "c9cc5dfa346ca17892f2bf9259e2d5ecd099cd98610e347ebbc56e24af0e3d2b";

fn open(path: &Path) -> Dataset {
    Dataset::open(path, &Cameras::All, &|| false).unwrap_or_else(|error| panic!("{}", error.faults))
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = entries.filter(|name| name.starts_with("pusht")).collect();
    names.sort();
    assert_eq!(names.len(), 10);
    names
}

/// Hash of a column over all episodes.
fn hash(dataset: &Dataset, column: &str) -> String {
    let mut hash = Sha256::new();
    let all = 0..dataset.episodes().len();
    let read = dataset.read(all, &|| false, |episode, frames| {
        let frames = frames.unwrap();
        let column = frames.column(column).unwrap();
        assert_eq!(
            column.values.len(),
            episode.length * column.shape.iter().product::<usize>()
        );
        (0..column.values.len()).for_each(|at| hash.update(column.values.number(at).unwrap().to_le_bytes()));
        Ok::<(), LerobotError>(())
    });
    read.unwrap();
    hex(hash.finalize())
}

#[test]
fn numbers_of_all_samples_are_those_of_the_human_demonstrations() {
    let Some(folder) = samples() else { return };
    for name in names(&folder) {
        let dataset = open(&folder.join(&name));
        let lengths: Vec<usize> = dataset.episodes().iter().map(|episode| episode.length).collect();
        assert_eq!(lengths, LENGTHS, "{name}");
        let version = if name.contains("v2.1") {
            Version::V2
        } else {
            Version::V3
        };
        assert_eq!((dataset.info().version, dataset.info().fps), (version, 10.0), "{name}");
        assert_eq!(hash(&dataset, "observation.state"), STATES, "{name}");
        assert_eq!(hash(&dataset, "action"), ACTIONS, "{name}");
        assert!(dataset.notes().is_empty(), "{name}: {:?}", dataset.notes());
        dataset.unchanged().unwrap();
        println!("{name}\n{}", dataset.summary().unwrap());
    }
}

#[test]
fn png_images_are_those_of_the_human_demonstrations() {
    let Some(folder) = samples() else { return };
    for name in ["pusht-v3.0-image", "pusht-v2.1-image", "pusht-v3.0-handwritten"] {
        assert_eq!(
            contents(&folder.join(name), true).unwrap().images.as_deref(),
            Some(IMAGES),
            "{name}"
        );
    }
}

fn add(hash: &mut Sha256, planes: &Planes) {
    for plane in [&planes.y, &planes.u, &planes.v] {
        hash.update(plane);
    }
}

#[test]
fn decoded_videos_equal_those_of_other_decoders() {
    let Some(folder) = samples() else { return };
    let text = fs::read_to_string(folder.join("DECODED_SHA256")).unwrap();
    let mut checked = 0;
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let [expected, name, file] = [(); 3].map(|()| words.next().unwrap());
        let dataset = open(&folder.join(name));
        // `file-000` holds all episodes, `episode_000001` the second one.
        let episode = file
            .strip_prefix("episode_")
            .map_or(0, |number| number.parse().unwrap());
        let (video, first) = dataset.video("observation.image", episode).unwrap();
        assert_eq!(first, 0);
        let mut hash = Sha256::new();
        video
            .decode(0..video.frames(), &|| false, |_, planes| {
                add(&mut hash, &planes);
                Ok::<(), re4_lerobot::Fault>(())
            })
            .unwrap();
        assert_eq!(hex(hash.finalize()), expected, "{name}");
        checked += 1;
    }
    assert_eq!(checked, 4);
}

#[test]
fn single_frames_equal_those_of_the_whole_video() {
    let Some(folder) = samples() else { return };
    for (name, codec) in [
        ("pusht-v2.1-video-av1", Codec::Av1),
        ("pusht-v3.0-video-h264", Codec::H264),
    ] {
        let dataset = open(&folder.join(name));
        for (number, length) in LENGTHS.into_iter().enumerate() {
            let (video, first) = dataset.video("observation.image", number).unwrap();
            assert_eq!(video.codec(), codec);
            let mut all = Vec::new();
            let whole = video.decode(first..first + length, &|| false, |frame, planes| {
                assert_eq!(frame, first + all.len());
                all.push(planes);
                Ok::<(), re4_lerobot::Fault>(())
            });
            whole.unwrap();
            for frame in (0..length).rev().step_by(13).chain([0, 1, length - 1]) {
                let single = video.frame(first + frame).unwrap();
                assert!(single == all[frame], "{name}, episode {number}, frame {frame}");
                let image = dataset.image("observation.image", number, frame).unwrap();
                let mut rgb = Vec::new();
                all[frame].append_rgb(&mut rgb);
                assert!((image.first, image.count) == (frame, 1) && image.bytes == rgb);
            }
            assert!(video.frame(video.frames()).is_err());
        }
    }
}

/// Videos in which frames are decoded in another order than they are shown; `tests/data/make_videos.py` writes them.
#[test]
fn frames_are_passed_on_in_the_order_in_which_they_are_shown() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let text = fs::read_to_string(folder.join("DECODED_SHA256")).unwrap();
    for line in text.lines() {
        let (expected, name) = line.split_once("  ").unwrap();
        let video = Video::open(&folder.join(name), name).unwrap();
        let mut hash = Sha256::new();
        let mut all = Vec::new();
        let decoded = video.decode(0..video.frames(), &|| false, |frame, planes| {
            assert_eq!(frame, all.len());
            add(&mut hash, &planes);
            all.push(planes);
            Ok::<(), re4_lerobot::Fault>(())
        });
        decoded.unwrap();
        assert_eq!((all.len(), hex(hash.finalize()).as_str()), (90, expected), "{name}");
        // Both have more than one key frame, so that decoding one frame starts at different places.
        assert!(video.key_frames() > 1, "{name}");
        for frame in [89, 0, 1, 38, 39, 40, 41, 59, 60, 61, 62, 75] {
            assert!(video.frame(frame).unwrap() == all[frame], "{name}, frame {frame}");
        }
        let expected: Vec<f64> = (0..90).map(|frame| f64::from(frame) / 30.0).collect();
        let times: Vec<f64> = video.times().collect();
        assert!(
            times
                .iter()
                .zip(&expected)
                .all(|(time, expected)| (time - expected).abs() < 1e-4),
            "{name}: {times:?}"
        );
    }
}

#[test]
fn all_ways_to_store_one_video_give_the_same_images() {
    let Some(folder) = samples() else { return };
    let images = |name: &str| contents(&folder.join(name), true).unwrap().images.unwrap();
    // The converter concatenates the files of v2.1 without encoding them again.
    assert_eq!(images("pusht-v2.1-video-av1"), images("pusht-v3.0-converted-av1"));
    // One file per episode, encoded like the file with all episodes.
    assert_eq!(images("pusht-v3.0-multifile"), images("pusht-v3.0-video-av1"));
}

#[test]
fn png_and_video_are_read_at_random() {
    let Some(folder) = samples() else { return };
    let dataset = open(&folder.join("pusht-v3.0-image"));
    let mut all = Vec::new();
    let read = dataset.images("observation.image", [2, 0], &|| false, |block| {
        all.push(block.unwrap());
        Ok::<(), LerobotError>(())
    });
    read.unwrap();
    assert_eq!(
        all.iter().map(|block| (block.episode, block.first)).collect::<Vec<_>>()[0],
        (2, 0)
    );
    for frame in [0, 77, 140] {
        let image = dataset.image("observation.image", 2, frame).unwrap();
        let block = all
            .iter()
            .find(|block| block.episode == 2 && (block.first..block.first + block.count).contains(&frame))
            .unwrap();
        let size = 3 * block.width * block.height;
        assert!(image.bytes == block.bytes[(frame - block.first) * size..][..size]);
    }
    assert!(dataset.image("observation.image", 2, 141).is_err());
    assert!(dataset.image("action", 0, 0).is_err());
    // Episodes in any order, one by one.
    let direct = dataset.episode(1).unwrap();
    let mut found = Vec::new();
    let read = dataset.read([2, 1, 0, 1], &|| false, |episode, frames| {
        found.push((episode.index, frames.unwrap()));
        Ok::<(), LerobotError>(())
    });
    read.unwrap();
    assert!(found.iter().map(|(index, _)| *index).eq([2, 1, 0, 1]));
    assert!(found[1].1 == direct && found[3].1 == direct);
}

#[test]
fn tables_of_videos_agree_with_another_reader() {
    let Some(folder) = samples() else { return };
    let dataset = open(&folder.join("pusht-v3.0-video-h264"));
    let other = open(&folder.join("pusht-v2.1-video-av1"));
    for (dataset, name) in [(&dataset, "pusht-v3.0-video-h264"), (&other, "pusht-v2.1-video-av1")] {
        for episode in 0..3 {
            let (video, _) = dataset.video("observation.image", episode).unwrap();
            let (mp4, _) = Mp4::read_file(folder.join(name).join(video.name())).unwrap();
            let track = mp4.tracks().values().next().unwrap();
            assert_eq!(video.size(), (usize::from(track.width), usize::from(track.height)));
            assert_eq!(
                video.key_frames(),
                track.samples.iter().filter(|sample| sample.is_sync).count()
            );
            let mut times: Vec<f64> = track
                .samples
                .iter()
                .map(|sample| sample.composition_timestamp as f64 / track.timescale as f64)
                .collect();
            times.sort_by(f64::total_cmp);
            assert_eq!(video.times().collect::<Vec<_>>(), times);
        }
    }
}

#[test]
fn reading_stops_when_asked() {
    let Some(folder) = samples() else { return };
    let path = folder.join("pusht-v3.0-video-av1");
    let stopped = |error: LerobotError| assert!(error.faults.stopped(), "{error}");
    stopped(Dataset::open(&path, &Cameras::All, &|| true).err().unwrap());
    let dataset = open(&path);
    stopped(
        dataset
            .read(0..3, &|| true, |_, _| Ok::<(), LerobotError>(()))
            .unwrap_err(),
    );
    stopped(
        dataset
            .images("observation.image", 0..3, &|| true, |_| Ok::<(), LerobotError>(()))
            .unwrap_err(),
    );
}

#[test]
fn cameras_are_chosen_by_name() {
    let Some(folder) = samples() else { return };
    let path = folder.join("pusht-v3.0-video-av1");
    let none = Dataset::open(&path, &Cameras::none(), &|| false).unwrap();
    assert!(none.cameras().is_empty() && none.episode(0).is_ok());
    let error = Dataset::open(&path, &Cameras::Named(vec!["wrist".to_owned()]), &|| false)
        .err()
        .unwrap();
    let text = error.faults.to_string();
    assert_eq!(
        text,
        "meta/info.json, key features.wrist: there is no camera of this name; choose one of the cameras (observation.image)"
    );
    let error = Dataset::open(&folder, &Cameras::All, &|| false).err().unwrap();
    assert!(
        error.faults.to_string().contains("there is no meta/info.json in it"),
        "{error}"
    );
}

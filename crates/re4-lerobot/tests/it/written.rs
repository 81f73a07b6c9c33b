//! Written datasets: the reader of this crate returns what was written, statistics are those of all values, and equal input gives equal
//! bytes.

use std::fs;
use std::path::{Path, PathBuf};

use image::{ExtendedColorType, ImageEncoder as _};
use re4_lerobot::write::{
    Data, Declaration, Declared, EpisodeValue, FeatureKind, Limits, NewEpisode, Number, WriteError, Writer, Written,
};
use re4_lerobot::{Cameras, Dataset, Values, Version};
use serde_json::{Map, Value, json};

const SIZE: (usize, usize) = (32, 18);

/// An image with a gradient that moves with the frame.
fn pixels(episode: usize, frame: usize) -> Vec<u8> {
    let (width, height) = SIZE;
    let at = |x: usize, y: usize| [(8 * x + 3 * frame) % 256, (13 * y) % 256, (20 * episode + x + y) % 256];
    let rows = (0..height).flat_map(|y| (0..width).flat_map(move |x| at(x, y)));
    rows.map(|value| value as u8).collect()
}

fn png(episode: usize, frame: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(
            &pixels(episode, frame),
            SIZE.0 as u32,
            SIZE.1 as u32,
            ExtendedColorType::Rgb8,
        )
        .unwrap();
    bytes
}

fn declaration(version: Version, image: FeatureKind) -> Declaration {
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
    let declared = |name: &str, kind| Declared {
        name: name.to_owned(),
        kind,
    };
    Declaration {
        version,
        fps: 10,
        robot: "arm".to_owned(),
        features: vec![
            declared(
                "observation.state",
                FeatureKind::Vector(Number::Single, names(&["x", "y"])),
            ),
            declared("action", FeatureKind::Vector(Number::Double, names(&["x", "y", "z"]))),
            declared("next.done", FeatureKind::Scalar(Number::Truth)),
            declared("re4.mode", FeatureKind::Scalar(Number::Integer)),
            declared("observation.image", image),
        ],
        columns: vec!["re4/name".to_owned(), "re4/seed".to_owned()],
        about: json!({ "key": "abc" }).as_object().cloned().unwrap_or_default(),
        limits: Limits::default(),
    }
}

const LENGTHS: [usize; 5] = [7, 1, 64, 65, 3];

fn episode(number: usize) -> NewEpisode {
    let length = LENGTHS[number];
    let value = |frame: usize, column: usize| ((frame * 37 + column * 11 + number * 5) % 101) as f64 / 7.0 - 3.0;
    let values = |width: usize| (0..length).flat_map(move |frame| (0..width).map(move |column| value(frame, column)));
    NewEpisode {
        task: ["Push it.", "Lift it."][number % 2].to_owned(),
        data: vec![
            Data::Single(values(2).map(|value| value as f32).collect()),
            Data::Double(values(3).collect()),
            Data::Truth((0..length).map(|frame| frame + 1 == length).collect()),
            Data::Integer((0..length).map(|frame| (frame % 2) as i64).collect()),
            Data::Images((0..length).map(|frame| png(number, frame)).collect()),
        ],
        values: vec![
            EpisodeValue::Text(format!("demo_{number}")),
            EpisodeValue::Integer(number as i64 + 500),
        ],
    }
}

fn write(path: &Path, declared: Declaration) -> Written {
    let mut writer = Writer::create(path, declared).unwrap();
    for number in 0..LENGTHS.len() {
        writer.add(&episode(number)).unwrap();
    }
    writer.finish(&|| false).unwrap()
}

/// Paths of all files below a folder, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn images() -> FeatureKind {
    FeatureKind::Image(SIZE.0, SIZE.1)
}

/// Checks all numbers of a dataset; returns it.
fn checked(path: &Path) -> Dataset {
    let dataset = Dataset::open(path, &Cameras::All, &|| false).unwrap();
    assert!(dataset.notes().is_empty(), "{:?}", dataset.notes());
    let lengths: Vec<usize> = dataset.episodes().iter().map(|episode| episode.length).collect();
    assert_eq!(lengths, LENGTHS);
    for number in 0..LENGTHS.len() {
        let (expected, frames) = (episode(number), dataset.episode(number).unwrap());
        assert_eq!(dataset.episodes()[number].tasks, [expected.task]);
        for (data, column) in expected.data.iter().zip(&frames.columns) {
            let (numbers, values): (Vec<f64>, &Values) = (numbers(data), &column.values);
            for (at, number) in numbers.iter().enumerate() {
                assert_eq!(values.number(at), Some(*number), "{} {at}", column.name);
            }
            assert_eq!(values.number(numbers.len()), None);
        }
        assert_eq!(frames.columns.len(), 4);
    }
    dataset
}

fn numbers(data: &Data) -> Vec<f64> {
    match data {
        Data::Single(values) => values.iter().map(|&value| f64::from(value)).collect(),
        Data::Double(values) => values.clone(),
        Data::Integer(values) => values.iter().map(|&value| value as f64).collect(),
        Data::Truth(values) => values.iter().map(|&value| f64::from(u8::from(value))).collect(),
        Data::Images(_) => Vec::new(),
    }
}

/// The pixels of all images, episode by episode and frame by frame.
fn decoded(dataset: &Dataset) -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    dataset
        .images("observation.image", 0..LENGTHS.len(), &|| false, |block| {
            let block = block.unwrap();
            assert_eq!((block.width, block.height), SIZE);
            all.extend(block.bytes.chunks(3 * SIZE.0 * SIZE.1).map(<[u8]>::to_vec));
            Ok::<(), re4_lerobot::LerobotError>(())
        })
        .unwrap();
    all
}

#[test]
fn what_was_written_is_read() {
    for version in [Version::V3, Version::V2] {
        for small in [false, true] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("set");
            let mut declared = declaration(version, images());
            if small {
                declared.limits = Limits {
                    data_bytes: 1,
                    video_bytes: 1,
                    chunk: 2,
                };
            }
            let written = write(&path, declared);
            let all = files(&path);
            let bytes: u64 = all.iter().map(|file| fs::metadata(file).unwrap().len()).sum();
            assert_eq!((written.episodes, written.frames, written.bytes), (5, 140, bytes));
            let data = all.iter().filter(|file| file.starts_with(path.join("data"))).count();
            assert_eq!(data, if version == Version::V2 || small { 5 } else { 1 });
            let dataset = checked(&path);
            let expected: Vec<Vec<u8>> = LENGTHS
                .iter()
                .enumerate()
                .flat_map(|(number, length)| (0..*length).map(move |frame| pixels(number, frame)))
                .collect();
            assert_eq!(decoded(&dataset), expected);
            // Only the dataset remains beside the temporary folder.
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        }
    }
}

#[test]
fn equal_input_gives_equal_bytes() {
    for (version, image) in [
        (Version::V3, images()),
        (Version::V3, FeatureKind::Video(SIZE.0, SIZE.1)),
        (Version::V2, FeatureKind::Video(SIZE.0, SIZE.1)),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let contents = ["one", "two"].map(|name| {
            let path = folder.path().join(name);
            write(&path, declaration(version, image.clone()));
            let relative = |file: &PathBuf| file.strip_prefix(&path).unwrap().to_owned();
            files(&path)
                .iter()
                .map(|file| (relative(file), fs::read(file).unwrap()))
                .collect::<Vec<_>>()
        });
        assert_eq!(contents[0], contents[1]);
    }
}

#[test]
fn videos_show_the_images() {
    for version in [Version::V3, Version::V2] {
        for limit in [200 << 20, 1] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("set");
            let mut declared = declaration(version, FeatureKind::Video(SIZE.0, SIZE.1));
            declared.limits.video_bytes = limit;
            write(&path, declared);
            let dataset = checked(&path);
            let frames = decoded(&dataset);
            let mut expected = Vec::new();
            for (number, length) in LENGTHS.iter().enumerate() {
                expected.extend((0..*length).map(|frame| pixels(number, frame)));
            }
            assert_eq!(frames.len(), expected.len());
            for (at, (frame, expected)) in frames.iter().zip(&expected).enumerate() {
                let squares = frame
                    .iter()
                    .zip(expected)
                    .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
                let error = squares.sum::<f64>() / expected.len() as f64;
                // Gradients that wrap have hard edges of colour, whose chroma is halved; frames of another place differ by thousands.
                assert!(error < 900.0, "frame {at}: {error}");
            }
        }
    }
}

fn stats(path: &Path) -> Map<String, Value> {
    let text = fs::read_to_string(path.join("meta/stats.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn statistics_are_those_of_all_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set");
    write(&path, declaration(Version::V3, images()));
    let stats = stats(&path);
    let mut columns = vec![Vec::new(); 3];
    for number in 0..LENGTHS.len() {
        for row in numbers(&episode(number).data[1]).chunks(3) {
            columns
                .iter_mut()
                .zip(row)
                .for_each(|(column, value)| column.push(*value));
        }
    }
    for (at, mut column) in columns.into_iter().enumerate() {
        column.sort_by(f64::total_cmp);
        let of = |name: &str| stats["action"][name][at].as_f64().unwrap();
        let count = column.len() as f64;
        let mean = column.iter().sum::<f64>() / count;
        let variance = column.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        let range = column[column.len() - 1] - column[0];
        assert_eq!((of("min"), of("max")), (column[0], column[column.len() - 1]));
        assert!((of("mean") - mean).abs() < 1e-12 && (of("std") - variance.sqrt()).abs() < 1e-12);
        for (name, fraction) in [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)] {
            let rank = fraction * (count - 1.0);
            let (low, high) = (column[rank.floor() as usize], column[rank.ceil() as usize]);
            let found = of(name);
            assert!(
                found > low - range / 1e4 && found < high + range / 1e4,
                "{name} {found} {low} {high}"
            );
        }
    }
    assert_eq!(stats["action"]["count"], json!([140]));
    assert_eq!(stats["index"]["max"], json!([139.0]));
    assert_eq!(stats["next.done"]["mean"][0].as_f64(), Some(5.0 / 140.0));
    assert_eq!(stats["observation.image"]["max"].as_array().map(Vec::len), Some(3));
    // All episodes but two have at most 32 frames.
    assert_eq!(stats["observation.image"]["count"], json!([7 + 1 + 32 + 32 + 3]));
}

#[test]
fn the_information_names_the_origin_and_the_features() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set");
    write(&path, declaration(Version::V3, FeatureKind::Video(SIZE.0, SIZE.1)));
    let info: Value = serde_json::from_str(&fs::read_to_string(path.join("meta/info.json")).unwrap()).unwrap();
    assert_eq!(info["codebase_version"], "v3.0");
    assert_eq!(info["re4"], json!({ "key": "abc" }));
    assert_eq!(
        info["features"]["action"],
        json!({ "dtype": "float64", "shape": [3], "names": ["x", "y", "z"] })
    );
    assert_eq!(info["features"]["observation.image"]["info"]["video.codec"], "h264");
    assert_eq!(info["splits"], json!({ "train": "0:5" }));
    assert_eq!(info["total_tasks"], 2);
}

/// Runs a change of an episode that must be refused; nothing remains.
fn refused(change: impl FnOnce(&mut NewEpisode)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(&folder.path().join("set"), declaration(Version::V3, images())).unwrap();
    let mut episode = episode(0);
    change(&mut episode);
    let error = writer.add(&episode).unwrap_err();
    drop(writer);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    error.to_string()
}

#[test]
fn values_that_a_dataset_cannot_contain_are_refused() {
    let message = refused(|episode| {
        if let Data::Double(values) = &mut episode.data[1] {
            values[7] = f64::NAN;
        }
    });
    assert!(
        message.ends_with("episode 0, action: frame 2 has a value that is not a finite number"),
        "{message}"
    );
    let message = refused(|episode| {
        if let Data::Single(values) = &mut episode.data[0] {
            values.pop();
        }
    });
    assert!(message.contains("observation.state: it has 13 values"), "{message}");
    let message = refused(|episode| episode.data[2] = Data::Integer(vec![0; 7]));
    assert!(message.contains("next.done: its values have another type"), "{message}");
    let message = refused(|episode| {
        if let Data::Images(images) = &mut episode.data[4] {
            images[3] = b"no image".to_vec();
        }
    });
    assert!(message.ends_with("the image of frame 3 is not a PNG file"), "{message}");
    let message = refused(|episode| {
        if let Data::Images(images) = &mut episode.data[4] {
            images[6].truncate(40);
        }
    });
    assert!(message.contains("the image of frame 6 cannot be decoded"), "{message}");
}

#[test]
fn an_occupied_path_is_refused_and_an_empty_folder_is_filled() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set");
    let declared = || declaration(Version::V3, images());
    fs::create_dir(&path).unwrap();
    write(&path, declared());
    assert!(matches!(
        Writer::create(&path, declared()),
        Err(WriteError::Exists { .. })
    ));
    let file = folder.path().join("file");
    fs::write(&file, "text").unwrap();
    assert!(matches!(
        Writer::create(&file, declared()),
        Err(WriteError::Exists { .. })
    ));
    let inside = folder.path().join("no/set");
    assert!(matches!(
        Writer::create(&inside, declared()),
        Err(WriteError::Io { .. })
    ));
    // The path is taken while the dataset is written.
    let late = folder.path().join("late");
    let mut writer = Writer::create(&late, declared()).unwrap();
    writer.add(&episode(0)).unwrap();
    fs::create_dir(&late).unwrap();
    fs::write(late.join("file"), "text").unwrap();
    assert!(matches!(writer.finish(&|| false), Err(WriteError::Exists { .. })));
    assert_eq!(fs::read_to_string(late.join("file")).unwrap(), "text");
}

#[test]
fn leftovers_of_killed_writers_are_removed_and_running_ones_are_not_disturbed() {
    let folder = tempfile::tempdir().unwrap();
    let left = folder.path().join(".re4-export-left");
    fs::create_dir(&left).unwrap();
    fs::write(left.join(".lock"), "").unwrap();
    let begun = folder.path().join(".re4-export-begun");
    fs::create_dir(&begun).unwrap();
    let mut running = Writer::create(&folder.path().join("one"), declaration(Version::V3, images())).unwrap();
    assert!(!left.exists() && begun.exists());
    write(&folder.path().join("two"), declaration(Version::V3, images()));
    running.add(&episode(0)).unwrap();
    running.finish(&|| false).unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
}

#[test]
fn a_dataset_needs_an_episode_and_names_without_slash() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("set");
    let writer = Writer::create(&path, declaration(Version::V3, images())).unwrap();
    assert!(matches!(writer.finish(&|| false), Err(WriteError::Empty { .. })));
    for name in ["a/b", "", "index", "action"] {
        let mut declared = declaration(Version::V3, images());
        name.clone_into(&mut declared.features[0].name);
        assert!(
            matches!(Writer::create(&path, declared), Err(WriteError::Feature { .. })),
            "{name}"
        );
    }
    let mut writer = Writer::create(&path, declaration(Version::V3, images())).unwrap();
    writer.add(&episode(0)).unwrap();
    assert!(matches!(writer.finish(&|| true), Err(WriteError::Stopped { .. })));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

//! Tests on the original dataset, if it is available.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use common::real_dataset;
use re4_ingest::pusht::{PushtReader, PushtWriter, RecordedEpisode};
use re4_ingest::{Selection, WarningCode};
use tempfile::TempDir;

#[test]
fn the_original_dataset_reads_as_documented() {
    let Some(dataset) = real_dataset() else { return };
    let reader = PushtReader::open(&dataset).unwrap();
    let lengths: Vec<usize> = reader.episode_ranges().iter().map(ExactSizeIterator::len).collect();
    assert_eq!((lengths.len(), reader.frame_count()), (206, 25_650));
    assert_eq!((lengths[205], lengths[174]), (49, 246));
    assert_eq!((lengths.iter().min(), lengths.iter().max()), (Some(&49), Some(&246)));
    assert_eq!(reader.image_shape(), Some([96, 96, 3]));
    let (episodes, warnings) = reader.read_episodes(&Selection::All).unwrap();
    let brief: Vec<_> = warnings.iter().map(|w| (w.code, w.count)).collect();
    assert_eq!(brief, [(WarningCode::AngleSeam, 91)]);
    let counts = [0.0, 1.0, 2.0].map(|n| episodes.contacts.as_ref().unwrap().iter().filter(|&&c| c == n).count());
    assert_eq!(counts, [13_755, 11_207, 688]);
    // The scenes of the demonstrations are those of seeds 0, 1, ...: integers sampled below 450.
    assert!(episodes.frames.iter().all(|frames| {
        episodes.state[frames.start][..2]
            .iter()
            .all(|x| (0.0..512.0).contains(x))
    }));
}

#[test]
fn images_match_their_documentation() {
    let Some(dataset) = real_dataset() else { return };
    let reader = PushtReader::open(&dataset).unwrap();
    let (mut low, mut high, mut sum, mut next) = (255, 0, 0u64, 0);
    for block in reader.image_blocks(&Selection::First(30)).unwrap() {
        let block = block.unwrap();
        assert_eq!(block.frames.start, next);
        assert_eq!(block.bytes.len(), block.frames.len() * 96 * 96 * 3);
        next = block.frames.end;
        for &byte in &block.bytes {
            low = low.min(byte);
            high = high.max(byte);
            sum += u64::from(byte);
        }
    }
    assert_eq!(next, reader.episode_ranges()[29].end);
    assert_eq!((low, high), (65, 255));
    assert!(sum > 0);
}

#[test]
fn the_columns_survive_a_round_trip() {
    let Some(dataset) = real_dataset() else { return };
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("copy.zarr");
    let (episodes, _) = PushtReader::open(&dataset)
        .unwrap()
        .read_episodes(&Selection::First(20))
        .unwrap();
    let recorded: Vec<RecordedEpisode> = episodes.planar_episodes().iter().map(RecordedEpisode::from).collect();
    PushtWriter::write(&path, &recorded).unwrap();
    let (copy, _) = PushtReader::open(&path)
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap();
    assert_eq!(
        (&copy.state, &copy.action, &copy.contacts),
        (&episodes.state, &episodes.action, &episodes.contacts)
    );
    // Recorded keypoints agree closely in nearly all frames with those computed from the recorded pose and the constants.
    let pairs = copy.keypoint.iter().flatten().zip(episodes.keypoint.iter().flatten());
    let mut distances: Vec<f64> = pairs
        .map(|(a, b)| {
            a.iter()
                .flatten()
                .zip(b.iter().flatten())
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max)
        })
        .collect();
    distances.sort_by(f64::total_cmp);
    assert!(distances[distances.len() / 2] < 1e-4);
    assert!(distances[distances.len() * 99 / 100] < 0.1);
}

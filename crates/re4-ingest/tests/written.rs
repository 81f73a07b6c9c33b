//! Round trips from the writer to the reader.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "helpers of tests may fail like tests"
)]

mod common;

use std::f64::consts::TAU;
use std::fs;

use common::{expected, files_of};
use re4_episode::{PlanarEpisode, PlanarFrame};
use re4_geometry::{Point2, Pose2, periodic_distance};
use re4_ingest::Selection;
use re4_ingest::pusht::{KEYPOINTS_IN_BLOCK, PushtReader, PushtWriter, RecordedEpisode};
use tempfile::TempDir;

fn frame(x: f64, theta: f64) -> PlanarFrame {
    PlanarFrame {
        eef: Point2::new(x, 2.0 * x),
        object: Pose2::new(256.0 - x, 200.0 + x, theta),
        action: Point2::new(x + 1.0, 3.0),
        contacts: (x as u32 % 3).into(),
    }
}

/// Two episodes over more than two chunks, with angles beyond one full rotation.
fn episodes() -> Vec<RecordedEpisode> {
    [200, 150]
        .map(|count| RecordedEpisode {
            frames: (0..count)
                .map(|i| frame(f64::from(i), f64::from(i) * 0.37 - 9.0))
                .collect(),
        })
        .into()
}

#[test]
fn the_reader_reads_what_was_written() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("rollouts.zarr");
    let episodes = episodes();
    PushtWriter::write(&path, &episodes).unwrap();
    let reader = PushtReader::open(&path).unwrap();
    assert_eq!(reader.episode_ranges(), [0..200, 200..350]);
    let (read, _) = reader.read_episodes(&Selection::All).unwrap();
    let planar = read.planar_episodes();
    assert_eq!(planar.len(), 2);
    let keypoints = read.keypoint.as_ref().unwrap();
    for (episode, (read, recorded)) in planar.iter().zip(&episodes).enumerate() {
        assert_eq!(read.source, episode as u32);
        for (i, (a, b)) in read.frames.iter().zip(&recorded.frames).enumerate() {
            assert_eq!((a.eef, a.action, a.contacts), (b.eef, b.action, b.contacts));
            assert_eq!(a.object.translation(), b.object.translation());
            assert!(periodic_distance(a.object.theta, b.object.theta, TAU) < 1e-6);
            assert!((0.0..TAU).contains(&a.object.theta));
            for (point, local) in keypoints[i + 200 * episode].iter().zip(KEYPOINTS_IN_BLOCK) {
                let local = Point2::new(local[0], local[1]);
                assert!((b.object.transform_point(local) - Point2::new(point[0], point[1])).norm() < 1e-4);
            }
        }
    }
}

#[test]
fn bytes_depend_only_on_the_episodes() {
    let folder = TempDir::new().unwrap();
    let write = |name: &str, threads: usize| {
        let path = folder.path().join(name);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| PushtWriter::write(&path, &episodes())).unwrap();
        files_of(&path, "")
    };
    let files = write("a.zarr", 1);
    assert_eq!(files, write("b.zarr", 3));
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    insta::assert_snapshot!(names.join("\n"));
    // No other files remain beside the datasets.
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn an_angle_just_below_two_pi_is_stored_as_zero() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("x.zarr");
    let frames = vec![
        frame(1.0, -1e-12),
        frame(2.0, TAU - 1e-9),
        frame(3.0, TAU),
        frame(4.0, 3.0 * TAU + 1.0),
    ];
    PushtWriter::write(&path, &[RecordedEpisode { frames }]).unwrap();
    let (read, _) = PushtReader::open(&path)
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap();
    let angles: Vec<f64> = read.state.iter().map(|state| state[4]).collect();
    assert_eq!(angles[..3], [0.0, 0.0, 0.0]);
    assert!((angles[3] - 1.0).abs() < 1e-6);
}

#[test]
fn unknown_contacts_are_not_written() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("x.zarr");
    let mut episodes = episodes();
    episodes
        .iter_mut()
        .flat_map(|e| &mut e.frames)
        .for_each(|frame| frame.contacts = f64::NAN);
    PushtWriter::write(&path, &episodes).unwrap();
    let (read, _) = PushtReader::open(&path)
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap();
    assert!(read.contacts.is_none());
}

#[test]
fn invalid_episodes_are_refused_without_leaving_files() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("x.zarr");
    let good = || RecordedEpisode {
        frames: vec![frame(1.0, 0.5); 3],
    };
    let with = |edit: &dyn Fn(&mut PlanarFrame)| {
        let mut bad = good();
        edit(&mut bad.frames[2]);
        PushtWriter::write(&path, &[good(), bad]).unwrap_err().to_string()
    };
    let mut sentences = vec![
        PushtWriter::write(&path, &[]).unwrap_err().to_string(),
        PushtWriter::write(&path, &[good(), RecordedEpisode { frames: vec![] }])
            .unwrap_err()
            .to_string(),
        with(&|frame| frame.object.y = f64::NAN),
        with(&|frame| frame.object.theta = f64::INFINITY),
        with(&|frame| frame.action.x = 1e30),
        with(&|frame| frame.contacts = f64::NAN),
        PushtWriter::write(&folder.path().join("no/where/x.zarr"), &[good()])
            .unwrap_err()
            .to_string(),
    ];
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    fs::create_dir(&path).unwrap();
    sentences.push(PushtWriter::write(&path, &[good()]).unwrap_err().to_string());
    assert_eq!(fs::read_dir(&path).unwrap().count(), 0);
    insta::assert_snapshot!(
        sentences
            .join("\n")
            .replace(folder.path().to_str().unwrap(), "[folder]")
    );
}

#[test]
fn a_fixture_survives_a_round_trip() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("copy.zarr");
    let source = expected(&[0, 1, 2], true);
    let recorded: Vec<RecordedEpisode> = source.planar_episodes().iter().map(RecordedEpisode::from).collect();
    PushtWriter::write(&path, &recorded).unwrap();
    let (read, _) = PushtReader::open(&path)
        .unwrap()
        .read_episodes(&Selection::All)
        .unwrap();
    assert_eq!(
        (&read.state, &read.action, &read.contacts),
        (&source.state, &source.action, &source.contacts)
    );
    assert_eq!(read.rows, source.rows);
    let planar: Vec<PlanarEpisode> = read.planar_episodes();
    assert_eq!(planar, source.planar_episodes());
}

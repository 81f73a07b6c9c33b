//! The estimator on images that were decoded from videos, against the poses of the same frames. Runs if the folder in `RE4_DATA`, or
//! `../shared/data` beside the repository, has the samples.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests fail by panicking, and print what is skipped"
)]

mod common;

use std::path::{Path, PathBuf};

use common::{error, outline, view};
use re4_geometry::{Point2, Pose2};
use re4_lerobot::{Cameras, Dataset, LerobotError};
use re4_pose::{AnchorBuilder, AnchorError, Flag, LogPolarEstimator, SIDE, Storage};
use re4_sim::{GOAL, tee_rectangles};

fn sample(name: &str) -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let data = std::env::var_os("RE4_DATA").map_or_else(beside, PathBuf::from);
    data.join("lerobot").join(name)
}

/// Whether the samples are there; if not, prints that the test is skipped.
fn has_samples() -> bool {
    let folder = sample("pusht-v3.0-keypoints");
    let there = folder.is_dir();
    if !there {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            folder.display()
        );
    }
    there
}

/// The poses of all frames, from the corners of the block: a rigid fit.
fn truth() -> Vec<Pose2> {
    let dataset = Dataset::open(&sample("pusht-v3.0-keypoints"), &Cameras::none(), &|| false).unwrap();
    let model: Vec<Point2> = tee_rectangles().into_iter().flatten().collect();
    let mut poses = Vec::new();
    for episode in 0..dataset.episodes().len() {
        let frames = dataset.episode(episode).unwrap();
        let column = frames.column("observation.environment_state").unwrap();
        let values: Vec<f64> = (0..column.values.len())
            .map(|at| column.values.number(at).unwrap())
            .collect();
        for corners in values.chunks_exact(16) {
            let points: Vec<Point2> = corners.chunks_exact(2).map(|c| Point2::new(c[0], c[1])).collect();
            poses.push(rigid_fit(&model, &points));
        }
    }
    poses
}

fn rigid_fit(model: &[Point2], points: &[Point2]) -> Pose2 {
    let mean = |points: &[Point2]| points.iter().sum::<Point2>() / points.len() as f64;
    let (a, b) = (mean(model), mean(points));
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (m, p) in model.iter().zip(points) {
        let (m, p) = (m - a, p - b);
        cosine += m.dot(&p);
        sine += m.x * p.y - m.y * p.x;
    }
    let rotation = Pose2::new(0.0, 0.0, sine.atan2(cosine));
    let origin = b - rotation.transform_point(a);
    Pose2::new(origin.x, origin.y, rotation.theta)
}

fn images(name: &str) -> Vec<Vec<u8>> {
    let dataset = Dataset::open(&sample(name), &Cameras::All, &|| false).unwrap();
    let camera = dataset.cameras()[0].clone();
    let mut images = Vec::new();
    dataset
        .images(&camera, 0..dataset.episodes().len(), &|| false, |block| {
            let block = block.unwrap();
            images.extend(block.bytes.chunks_exact(3 * SIDE * SIDE).map(<[u8]>::to_vec));
            Ok::<(), LerobotError>(())
        })
        .unwrap();
    images
}

/// Errors of all frames in increasing order: px, then degrees. Also returns the number of frames with the flag `Clear`.
fn errors(name: &str, storage: Storage, truth: &[Pose2]) -> (Vec<f64>, Vec<f64>, usize) {
    let images = images(name);
    assert_eq!(images.len(), truth.len());
    let mut builder = AnchorBuilder::default();
    for image in &images {
        builder.add(&view(image));
    }
    let anchor = builder.finish(GOAL, &outline(), storage).unwrap();
    let estimator = LogPolarEstimator::new(&anchor, outline(), true).for_images(storage);
    let estimates: Vec<_> = images.iter().map(|image| estimator.estimate(&view(image))).collect();
    let clear = estimates.iter().filter(|one| one.flag == Flag::Clear).count();
    let (mut position, mut angle): (Vec<f64>, Vec<f64>) = estimates
        .iter()
        .zip(truth)
        .map(|(one, &truth)| error(one, truth))
        .unzip();
    position.sort_by(f64::total_cmp);
    angle.sort_by(f64::total_cmp);
    (position, angle, clear)
}

/// Half of the positions of videos are accurate to a fifth of an image pixel (5.3 px), 99 of 100 to a half.
#[test]
fn poses_from_videos_are_accurate() {
    if !has_samples() {
        return;
    }
    let truth = truth();
    for name in [
        "pusht-v3.0-video-av1",
        "pusht-v3.0-video-h264",
        "pusht-v2.1-video-av1",
        "pusht-v2.1-video-h264",
    ] {
        let (position, angle, clear) = errors(name, Storage::Lossy, &truth);
        let all = position.len();
        assert_eq!(all, 420);
        assert!(clear >= all - 2, "{name}: {clear} clear");
        let (half, most) = (all / 2, all * 99 / 100);
        assert!(
            position[half] < 1.0 && position[most] < 2.7,
            "{name}: {} and {} px",
            position[half],
            position[most]
        );
        assert!(
            angle[half] < 0.4 && angle[most] < 2.0,
            "{name}: {} and {} degrees",
            angle[half],
            angle[most]
        );
    }
}

/// Treating a PNG source as lossy costs little, so a source whose history is unknown can be treated so.
#[test]
fn lossless_images_can_be_treated_as_lossy() {
    if !has_samples() {
        return;
    }
    let truth = truth();
    let [lossless, lossy] =
        [Storage::Lossless, Storage::Lossy].map(|storage| errors("pusht-v3.0-image", storage, &truth));
    assert_eq!((lossless.2, lossy.2), (420, 420));
    assert!(
        lossless.0[210] < 0.6 && lossy.0[210] < 0.7,
        "{} and {} px",
        lossless.0[210],
        lossy.0[210]
    );
}

#[test]
fn a_video_as_a_lossless_source_is_refused() {
    if !has_samples() {
        return;
    }
    let mut builder = AnchorBuilder::default();
    for image in &images("pusht-v3.0-video-av1") {
        builder.add(&view(image));
    }
    assert!(matches!(
        builder.finish(GOAL, &outline(), Storage::Lossless),
        Err(AnchorError::Area { .. })
    ));
}

#[test]
fn the_goal_has_to_be_where_it_is_expected_in_lossy_images_too() {
    if !has_samples() {
        return;
    }
    let mut builder = AnchorBuilder::default();
    for image in &images("pusht-v3.0-video-h264") {
        builder.add(&view(image));
    }
    let elsewhere = Pose2::new(GOAL.x - 16.0, GOAL.y, GOAL.theta);
    assert!(matches!(
        builder.finish(elsewhere, &outline(), Storage::Lossy),
        Err(AnchorError::Position { .. })
    ));
}

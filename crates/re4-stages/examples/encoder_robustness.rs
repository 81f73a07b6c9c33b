//! Measures how the estimates of a trained encoder change if its images do: noise, brightness, and a camera that moved.
//!
//! ```text
//! encoder_robustness ENCODER POSES EPISODES
//! ```
//!
//! The arguments are folders of an `encoder` artifact, of its `poses` and of the `episodes` that it was trained on. Frames before the grasp of
//! held-out demonstrations are estimated again with changed images. For each change, one row of Markdown states the distance of
//! the estimates from those of the unchanged images (median and 90 % quantile, in mm), and the fraction of unsure estimates.
#![allow(clippy::print_stdout, reason = "this example prints its results")]

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use re4_artifact::{Artifact, Row as _};
use re4_encoder::{Calibration, EncoderConfig, Prediction, Predictor, SIDE};
use re4_ingest::ImageRow;
use re4_pose::PoseErrorRow;
use re4_pose::spatial::GraspPhase;
use re4_stats::{quantile, sorted};

/// Number of images per call of the encoder.
const BATCH: usize = 64;

/// A change of the number `index` of an image's pixels: a row, a column and a channel.
type Change = fn(&[u8], usize) -> u8;

fn clamped(value: f64) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// Noise that depends only on the pixel: the sum of twelve uniform numbers is nearly normal.
fn noisy(image: &[u8], index: usize, deviation: f64) -> u8 {
    let mut state = index as u64 ^ u64::from(image[index]) << 32 ^ u64::from(image[image.len() / 2]) << 40;
    let mut sum = -6.0;
    for _ in 0..12 {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        sum += (state >> 11) as f64 / (1_u64 << 53) as f64;
    }
    clamped(f64::from(image[index]) + deviation * sum)
}

fn scaled(image: &[u8], index: usize, factor: f64) -> u8 {
    clamped(factor * f64::from(image[index]))
}

/// The image of a camera that has rotated, so that the scene moves to the left by some pixels.
fn moved(image: &[u8], index: usize, pixels: usize) -> u8 {
    let (row, column, channel) = (index / (3 * SIDE), index / 3 % SIDE, index % 3);
    image[(row * SIDE + (column + pixels).min(SIDE - 1)) * 3 + channel]
}

const CHANGES: [(&str, Change); 9] = [
    ("none", |image, index| image[index]),
    ("noise, standard deviation 4 of 255", |image, index| {
        noisy(image, index, 4.0)
    }),
    ("noise, standard deviation 12 of 255", |image, index| {
        noisy(image, index, 12.0)
    }),
    ("brightness x 0.9", |image, index| scaled(image, index, 0.9)),
    ("brightness x 1.1", |image, index| scaled(image, index, 1.1)),
    ("brightness x 0.7", |image, index| scaled(image, index, 0.7)),
    ("camera moved by 1 pixel", |image, index| moved(image, index, 1)),
    ("camera moved by 2 pixels", |image, index| moved(image, index, 2)),
    ("camera moved by 4 pixels", |image, index| moved(image, index, 4)),
];

fn main() -> Result<()> {
    let paths: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).collect();
    let [encoder, poses, episodes] = paths.as_slice() else {
        bail!("usage: encoder_robustness ENCODER POSES EPISODES");
    };
    let [encoder, poses, episodes] = [encoder, poses, episodes].map(|path| Artifact::open(path));
    let (encoder, poses, episodes) = (encoder?, poses?, episodes?);
    let config: EncoderConfig = serde_json::from_value(poses.manifest().config["pose"]["encoder"].clone())
        .context("the artifact has no encoder")?;
    let predictor = Predictor::open(&encoder.path().join("encoder.safetensors"), &config)?;
    let calibration: Calibration = serde_json::from_slice(&std::fs::read(encoder.path().join("confidence.json"))?)?;
    let errors: Vec<PoseErrorRow> = poses.read()?;
    let wanted: BTreeSet<(u32, u32)> = errors
        .iter()
        .filter(|row| !row.trained_on && row.phase == GraspPhase::BeforeGrasp)
        .map(|row| (row.episode, row.frame))
        .collect();
    let mut images = Vec::new();
    for row in episodes.table(ImageRow::table())?.stream::<ImageRow>()? {
        let row = row?;
        if wanted.contains(&(row.episode, row.frame)) && row.camera.as_deref() == Some(config.camera.as_str()) {
            images.push(image::load_from_memory(&row.image)?.into_rgb8().into_raw());
        }
    }
    let estimate = |change: Change| -> Result<Vec<Prediction>> {
        let mut all = Vec::with_capacity(images.len());
        for chunk in images.chunks(BATCH) {
            let changed: Vec<Vec<u8>> = chunk
                .iter()
                .map(|image| (0..image.len()).map(|index| change(image, index)).collect())
                .collect();
            all.extend(predictor.predict(&changed.iter().map(Vec::as_slice).collect::<Vec<_>>())?);
        }
        Ok(all)
    };
    let plain = estimate(CHANGES[0].1)?;
    println!(
        "| change of {} images | distance, mm | unsure |\n|---|---|---|",
        images.len()
    );
    for (name, change) in CHANGES {
        let estimates = estimate(change)?;
        let pairs = estimates.iter().zip(&plain);
        let distances =
            sorted(pairs.map(|(a, b)| 1e3 * (a.pose.translation.vector - b.pose.translation.vector).norm()));
        let [p50, p90] = [0.5, 0.9].map(|probability| quantile(&distances, probability).unwrap_or(f64::NAN));
        let unsure = estimates.iter().filter_map(|estimate| estimate.disagreement);
        let unsure = unsure
            .filter(|score| Calibration::is_unsure(calibration.confidence(*score)))
            .count();
        println!(
            "| {name} | {p50:.1} / {p90:.1} | {:.2} |",
            unsure as f64 / estimates.len().max(1) as f64
        );
    }
    Ok(())
}

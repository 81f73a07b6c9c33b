//! Measures the training rate of the encoder: complete training steps on random images, with loading, cropping, losses,
//! gradients and `AdamW`.
//!
//! ```text
//! encoder_rate [--network keypoints] [--width 16] [--batch 64] [--steps 20] [--threads 2] [--backend flex]
//! ```
//!
//! Prints one JSON object with the seconds of every step after five warm-up steps. `benches/encoder_rate.py` runs it alternately
//! with `PyTorch`. Networks and backends are those of a pipeline file.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "this example prints its results"
)]

use std::process::ExitCode;
use std::time::Instant;

use nalgebra::{Isometry3, Vector3};
use re4_encoder::batches::{Sampler, TrainingDemo};
use re4_encoder::images::ImageFile;
use re4_encoder::loss::Alternatives;
use re4_encoder::train::{Task, train};
use re4_encoder::{EncoderConfig, EncoderError, IMAGE_BYTES, Network, Preset};
use re4_train::Checkpoints;

/// Steps that are not measured.
const WARM_UP: usize = 5;

/// Demonstrations, and frames of each: half of them before the grasp.
const DEMOS: u64 = 32;
const FRAMES: u32 = 16;

fn arguments() -> Option<(EncoderConfig, usize)> {
    let mut config = EncoderConfig::preset(Preset::Re4);
    let (mut steps, mut threads, mut width) = (20, 2, None);
    let mut words = std::env::args().skip(1);
    while let Some(name) = words.next() {
        let value = words.next()?;
        match name.as_str() {
            "--network" => {
                let network: Network = serde_json::from_value(value.into()).ok()?;
                config = EncoderConfig {
                    backend: config.backend,
                    batch: config.batch,
                    ..EncoderConfig::preset(match network {
                        Network::Resnet18 => Preset::Paper,
                        Network::Keypoints => Preset::Re4,
                    })
                };
            }
            "--width" => width = Some(value.parse().ok()?),
            "--batch" => config.batch = value.parse().ok()?,
            "--steps" => steps = value.parse().ok()?,
            "--threads" => threads = value.parse().ok()?,
            "--backend" => config.backend = serde_json::from_value(value.into()).ok()?,
            _ => return None,
        }
    }
    config.width = width.unwrap_or(config.width);
    config.epochs = 1;
    config.steps = Some((WARM_UP + steps) as u32);
    Some((config, threads))
}

fn rate(config: &EncoderConfig, threads: usize) -> Result<Vec<f64>, EncoderError> {
    config.backend.set_threads(threads, re4_encoder::train::BACKEND)?;
    let folder = tempfile::tempdir().map_err(EncoderError::ScratchRead)?;
    let count = DEMOS * u64::from(FRAMES);
    let mut state = 1_u32;
    let image = |_| {
        let mut byte = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        Ok::<_, EncoderError>((0..IMAGE_BYTES).map(|_| byte()).collect())
    };
    let images = ImageFile::write(folder.path(), (0..count).map(image))?;
    let demo = |number: u64| {
        let anchor = Isometry3::new(
            Vector3::new(0.01 * number as f64, 0.0, 0.8),
            Vector3::x() * std::f64::consts::PI,
        );
        TrainingDemo {
            first: number * u64::from(FRAMES),
            before: (0..FRAMES / 2).collect(),
            held: (FRAMES / 2..FRAMES).collect(),
            anchor,
            eef: vec![anchor; FRAMES as usize],
        }
    };
    let sampler = Sampler::new((0..DEMOS).map(demo).collect(), config, Alternatives::NONE);
    let task = Task {
        config,
        sampler: &sampler,
        images: &images,
        held_out: &[],
        weights: None,
        symmetry: Alternatives::NONE,
    };
    let (mut last, mut seconds) = (Instant::now(), Vec::new());
    let checkpoints = Checkpoints::open(&folder.path().join("checkpoints"), [0; 32])?;
    train(&task, &checkpoints, |_| {
        seconds.push(last.elapsed().as_secs_f64());
        last = Instant::now();
        Ok::<_, EncoderError>(())
    })?;
    Ok(seconds.split_off(WARM_UP))
}

fn main() -> ExitCode {
    let Some((config, threads)) = arguments() else {
        eprintln!(
            "encoder_rate [--network keypoints|resnet18] [--width 16] [--batch 64] [--steps 20] [--threads 2] \
             [--backend flex|torch|cuda]"
        );
        return ExitCode::from(2);
    };
    match rate(&config, threads) {
        Ok(seconds) => {
            println!("{}", serde_json::json!({ "seconds": seconds }));
            ExitCode::SUCCESS
        }
        Err(why) => {
            eprintln!("{why}");
            ExitCode::from(2)
        }
    }
}

//! Measures the training rate of the encoder: forward pass, loss, backward pass and an `AdamW` step on constant 76 x 76 images.
//!
//! ```text
//! encoder_rate [--width 64] [--batch 64] [--steps 5] [--threads 2] [--backend flex]
//! ```
//!
//! Prints one JSON object with the seconds of every step after one warm-up step. `benches/encoder_rate.py` runs it alternately
//! with `PyTorch`. The backends are those of a pipeline file.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "this example prints its results"
)]

use std::process::ExitCode;
use std::time::Instant;

use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::{Distribution, Tensor};
use re4_encoder::Backend;
use re4_encoder::resnet::Encoder;

struct Arguments {
    width: usize,
    batch: usize,
    steps: usize,
    threads: usize,
    backend: Backend,
}

fn arguments() -> Option<Arguments> {
    let mut arguments = Arguments {
        width: 64,
        batch: 64,
        steps: 5,
        threads: 2,
        backend: Backend::Flex,
    };
    let mut words = std::env::args().skip(1);
    while let Some(name) = words.next() {
        let value = words.next()?;
        match name.as_str() {
            "--width" => arguments.width = value.parse().ok()?,
            "--batch" => arguments.batch = value.parse().ok()?,
            "--steps" => arguments.steps = value.parse().ok()?,
            "--threads" => arguments.threads = value.parse().ok()?,
            "--backend" => arguments.backend = serde_json::from_value(value.into()).ok()?,
            _ => return None,
        }
    }
    Some(arguments)
}

fn rate(arguments: &Arguments) -> Result<Vec<f64>, String> {
    let Arguments {
        width,
        batch,
        steps,
        threads,
        backend,
    } = *arguments;
    backend.set_threads(threads).map_err(|error| error.to_string())?;
    let device = backend.device().map_err(|error| error.to_string())?.autodiff();
    let mut encoder = Encoder::new(width, &device);
    let mut optimiser = AdamWConfig::new().with_weight_decay(1e-4).init();
    let images = Tensor::<4>::random([batch, 3, 76, 76], Distribution::Normal(0.0, 1.0), &device);
    let mut seconds = Vec::with_capacity(steps + 1);
    for _ in 0..=steps {
        let start = Instant::now();
        let (_, poses) = encoder.forward(images.clone());
        let loss = poses.powf_scalar(2.0).mean();
        let gradients = GradientsParams::from_grads(loss.backward(), &encoder);
        encoder = optimiser.step(3e-4, encoder, gradients);
        device.sync().map_err(|error| format!("{error:?}"))?;
        seconds.push(start.elapsed().as_secs_f64());
    }
    Ok(seconds.split_off(1))
}

fn main() -> ExitCode {
    let Some(arguments) = arguments() else {
        eprintln!("encoder_rate [--width 64] [--batch 64] [--steps 5] [--threads 2] [--backend flex|torch|cuda]");
        return ExitCode::from(2);
    };
    match rate(&arguments) {
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

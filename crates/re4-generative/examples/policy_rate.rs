//! Measures the training rate of a generative policy on random demonstrations: complete steps with sampling of windows and noise,
//! gradients, `AdamW` and the moving average of the weights.
//!
//! ```text
//! policy_rate [--network mlp] [--method diffusion] [--batch 256] [--steps 20]
//! ```
//!
//! Prints one JSON object with the seconds of every step after five warm-up steps. `benches/policy_rate.py` runs it alternately
//! with `PyTorch`.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "this example prints its results"
)]

use std::process::ExitCode;
use std::time::Instant;

use re4_generative::config::FlowConfig;
use re4_generative::train::{Task, train};
use re4_generative::{Demo, GenerativeConfig, GenerativeError, Kind, Method, NetworkSize, Normalizer, Windows};
use re4_train::Checkpoints;

/// Steps that are not measured.
const WARM_UP: usize = 5;

/// Numbers per observation and per action: those of Push-T.
const OBSERVATION: usize = 18;
const CHANNELS: usize = 2;

fn arguments() -> Option<(GenerativeConfig, Method, usize)> {
    let mut config = GenerativeConfig::diffusion();
    let (mut method, mut steps) = (Method::Diffusion, 20);
    let mut words = std::env::args().skip(1);
    while let Some(name) = words.next() {
        let value = words.next()?;
        match name.as_str() {
            "--network" => {
                config.network = match value.as_str() {
                    "paper" => NetworkSize::Paper,
                    "small" => NetworkSize::Small,
                    "mlp" => NetworkSize::Mlp,
                    _ => return None,
                }
            }
            "--method" => {
                method = match value.as_str() {
                    "diffusion" => Method::Diffusion,
                    "flow" => Method::Flow(FlowConfig::default()),
                    _ => return None,
                }
            }
            "--batch" => config.batch = value.parse().ok()?,
            "--steps" => steps = value.parse().ok()?,
            _ => return None,
        }
    }
    Some((config, method, steps))
}

fn measure(mut config: GenerativeConfig, method: Method, steps: usize) -> Result<(), GenerativeError> {
    config.steps = u32::MAX;
    let wave = |numbers: usize, frame: usize| (0..numbers).map(|i| ((frame * (i + 3)) as f64 * 0.01).sin()).collect();
    let demo = |number: u32| Demo {
        number,
        observations: (0..120)
            .map(|frame| wave(OBSERVATION, frame + 7 * number as usize))
            .collect(),
        actions: (0..120)
            .map(|frame| wave(CHANNELS, frame + 7 * number as usize))
            .collect(),
        rest: vec![0.0; CHANNELS],
    };
    let demos: Vec<Demo> = (0..20).map(demo).collect();
    let fit = |numbers: usize, rows: &dyn Fn(&Demo) -> Vec<Vec<f64>>| {
        let rows: Vec<Vec<f64>> = demos.iter().flat_map(rows).collect();
        Normalizer::fit(&vec![Kind::Range; numbers], rows.iter().map(Vec::as_slice))
    };
    let observations = fit(OBSERVATION, &|demo| demo.observations.clone());
    let actions = fit(CHANNELS, &|demo| demo.actions.clone());
    let windows = Windows::new(&demos, &config, &observations, &actions)?;
    let task = Task {
        config: &config,
        method,
        windows: &windows,
        held_out: None,
        shape: method.shape(&config, CHANNELS, OBSERVATION),
    };
    let folder = std::env::temp_dir().join(format!("policy-rate-{}", std::process::id()));
    let checkpoints = Checkpoints::open(&folder, [0; 32])?;
    let mut times = Vec::new();
    let mut last = Instant::now();
    let stopped = train(&task, &checkpoints, |_| {
        times.push(last.elapsed().as_secs_f64());
        last = Instant::now();
        if times.len() == steps + WARM_UP {
            return Err(Stop(None));
        }
        Ok(())
    });
    checkpoints.remove()?;
    if let Err(Stop(Some(error))) = stopped {
        return Err(error);
    }
    println!(
        "{}",
        serde_json::json!({ "batch": config.batch, "seconds": times[WARM_UP..] })
    );
    Ok(())
}

/// The end of the measurement, or an error before it.
struct Stop(Option<GenerativeError>);

impl From<GenerativeError> for Stop {
    fn from(error: GenerativeError) -> Self {
        Self(Some(error))
    }
}

fn main() -> ExitCode {
    let Some((config, method, steps)) = arguments() else {
        eprintln!(
            "usage: policy_rate [--network paper|small|mlp] [--method diffusion|flow] [--batch 256] [--steps 20]"
        );
        return ExitCode::FAILURE;
    };
    match measure(config, method, steps) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

//! Prints how many control steps per second one thread simulates, with coverage, on the actions of the reference trace.
//!
//! `cargo run --release -p re4-sim --example throughput [rounds]`
#![expect(clippy::print_stdout, reason = "this example prints its results")]

#[path = "../tests/common/mod.rs"]
#[expect(dead_code, reason = "the tests use more of the trace than this example")]
mod common;

use std::time::Instant;

use re4_sim::{PushT, ResetOrder, SimError, Simulator, chipmunk_version};

fn main() -> Result<(), SimError> {
    let rounds = std::env::args()
        .nth(1)
        .and_then(|text| text.parse().ok())
        .unwrap_or(20_u32);
    let trace = common::read(&common::path());
    let mut simulator = PushT::new()?;
    let mut steps = 0_u64;
    let mut sum = 0.0;
    let start = Instant::now();
    for _ in 0..rounds {
        for episode in &trace.episodes {
            simulator.reset(&episode.scene, ResetOrder::Legacy)?;
            for step in &episode.steps {
                sum += simulator.step(&step.action)?.coverage;
            }
            steps += episode.steps.len() as u64;
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    println!("chipmunk {}", chipmunk_version());
    println!("mean_coverage {:.12}", sum / steps as f64);
    println!("steps {steps}");
    println!("steps_per_second {:.0}", steps as f64 / seconds);
    Ok(())
}

//! Prints the time per image on one thread, over the states of the reference trace: for the canvas, for the observation made
//! from it, and for both.
//!
//! `cargo run --release -p re4-sim --example render_rate`
#![expect(clippy::print_stdout, reason = "this example prints its results")]

#[path = "../tests/common/mod.rs"]
#[expect(dead_code, reason = "the tests use more of the trace than this example")]
mod common;

use std::time::Instant;

use re4_sim::{Canvas, PushT, ResetOrder, SimError, Simulator};

fn main() -> Result<(), SimError> {
    let trace = common::read(&common::path());
    let mut simulator = PushT::new()?;
    let (mut canvas, mut observation) = (Canvas::new(), Vec::new());
    let mut frames = 0_u32;
    let (mut rendering, mut shrinking) = (0.0, 0.0);
    let mut sum = 0_u64;
    for episode in &trace.episodes {
        simulator.reset(&episode.scene, ResetOrder::Legacy)?;
        for step in &episode.steps {
            simulator.step(&step.action)?;
            let start = Instant::now();
            simulator.render_into(&mut canvas);
            let rendered = Instant::now();
            canvas.observation_into(&mut observation);
            shrinking += rendered.elapsed().as_secs_f64();
            rendering += (rendered - start).as_secs_f64();
            // Using the images keeps the compiler from removing the computation.
            sum += observation.iter().map(|&value| u64::from(value)).sum::<u64>();
            frames += 1;
        }
    }
    let per_frame = |seconds: f64| 1e3 * seconds / f64::from(frames);
    println!("frames {frames}");
    println!(
        "mean_value {:.6}",
        sum as f64 / f64::from(frames) / observation.len() as f64
    );
    println!("milliseconds_canvas {:.4}", per_frame(rendering));
    println!("milliseconds_observation {:.4}", per_frame(shrinking));
    println!("milliseconds_frame {:.4}", per_frame(rendering + shrinking));
    Ok(())
}

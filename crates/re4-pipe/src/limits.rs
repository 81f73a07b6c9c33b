//! Values that fit their type and still make no sense.

use anyhow::{Result, ensure};

use crate::pipeline::Pipeline;

/// Refuses settings under which a stage could not do its work: no steps at all, way-points with no distance between them.
///
/// # Errors
/// The first such setting, with the values that it can have.
pub(crate) fn check(pipeline: &Pipeline) -> Result<()> {
    let rollout = &pipeline.rollout;
    let (retrieve, replan, replay) = (&rollout.retrieve, &rollout.replan, &rollout.replay);
    at_least_one("index.longest_chunk", u64::from(pipeline.index.longest_chunk))?;
    at_least_one("rollout.max_steps", u64::from(rollout.max_steps))?;
    at_least_one("rollout.retrieve.candidates", retrieve.candidates as u64)?;
    at_least_one("rollout.replan.iterations", u64::from(replan.iterations))?;
    at_least_one("rollout.replay.horizon", replay.horizon as u64)?;
    at_least_one("rollout.replay.stride", replay.stride as u64)?;
    not_negative("rollout.retrieve.epsilon", retrieve.epsilon)?;
    not_negative("rollout.retrieve.step_cost", retrieve.step_cost)?;
    not_negative("rollout.retrieve.motion_cost", retrieve.motion_cost)?;
    not_negative("rollout.replan.keepout", replan.keepout)?;
    if let Some(divergence) = replay.divergence {
        not_negative("rollout.replay.divergence", divergence)?;
    }
    long_enough("rollout.replan.step", replan.step)?;
    long_enough("rollout.replan.spacing", replan.spacing)?;
    long_enough("rollout.replay.speed", replay.speed)?;
    let bias = replan.goal_bias;
    ensure!(
        (0.0..=1.0).contains(&bias),
        "rollout.replan.goal_bias is {bias}; it is a share, from 0 to 1"
    );
    Ok(())
}

fn at_least_one(name: &str, value: u64) -> Result<()> {
    ensure!(value >= 1, "{name} is {value}; give 1 or more");
    Ok(())
}

fn not_negative(name: &str, value: f64) -> Result<()> {
    ensure!(value >= 0.0, "{name} is {value}; give 0 or more");
    Ok(())
}

/// Shorter steps would cut a way across the window into more way-points than any episode has steps.
const SHORTEST: f64 = 0.01;

fn long_enough(name: &str, value: f64) -> Result<()> {
    ensure!(value >= SHORTEST, "{name} is {value} px; give {SHORTEST} or more");
    Ok(())
}

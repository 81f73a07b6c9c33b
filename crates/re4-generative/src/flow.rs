//! The targets of Streaming Flow Policy: positions near a demonstrated chunk and the velocities along it.

use crate::config::FlowConfig;

/// A training example of the flow.
#[derive(Debug, Clone, PartialEq)]
pub struct Example {
    /// The network's input: the action, and the latent variable if there is one.
    pub input: Vec<f32>,
    /// The velocities of the same.
    pub target: Vec<f32>,
}

/// The demonstrated action at a time of the chunk and its velocity: the chunk is linear between its actions, which are evenly
/// spaced over the times [0, 1].
pub fn path(chunk: &[f32], channels: usize, time: f64) -> (Vec<f64>, Vec<f64>) {
    let spans = chunk.len() / channels - 1;
    let place = time * spans as f64;
    let span = (place.floor() as usize).min(spans - 1);
    let fraction = place - span as f64;
    let at = |step: usize, channel: usize| f64::from(chunk[step * channels + channel]);
    (0..channels)
        .map(|channel| {
            let (from, to) = (at(span, channel), at(span + 1, channel));
            (from + fraction * (to - from), (to - from) * spans as f64)
        })
        .unzip()
}

/// The training example at a time of a chunk. `noise` yields standard normal numbers: one per channel, and another one per
/// channel if the flow has a latent variable.
pub fn example(
    config: &FlowConfig,
    chunk: &[f32],
    channels: usize,
    time: f64,
    mut noise: impl FnMut() -> f64,
) -> Example {
    let (position, velocity) = path(chunk, channels, time);
    let (sigma, k) = (config.deviation, config.stabilization);
    let (mut input, mut target) = (Vec::new(), Vec::new());
    for (xi, speed) in position.iter().zip(&velocity) {
        // The tube narrows as the stabilisation contracts it.
        let away = sigma * (-k * time).exp() * noise();
        input.push((xi + away) as f32);
        target.push((speed - k * away) as f32);
    }
    if config.stochastic {
        for (xi, speed) in position.iter().zip(&velocity) {
            let start = noise();
            let scale = 1.0 - sigma;
            input.push(((1.0 - scale * time) * start + time * xi) as f32);
            target.push((xi + time * speed - scale * start) as f32);
        }
    }
    Example { input, target }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHUNK: [f32; 8] = [0.0, 1.0, 0.3, 0.8, 0.9, -0.2, 0.6, 0.0];

    /// Integrating the exact velocity of the path from its first action gives every later action.
    #[test]
    fn path_is_the_integral_of_its_velocity() {
        let steps = 300;
        let (mut position, _) = path(&CHUNK, 2, 0.0);
        for step in 0..steps {
            let (_, velocity) = path(&CHUNK, 2, (f64::from(step) + 0.5) / f64::from(steps));
            for (x, v) in position.iter_mut().zip(velocity) {
                *x += v / f64::from(steps);
            }
            if (step + 1) % 100 == 0 {
                let action = (step + 1) / 100;
                for (channel, x) in position.iter().enumerate() {
                    let expected = f64::from(CHUNK[action as usize * 2 + channel]);
                    assert!((x - expected).abs() < 1e-9);
                }
            }
        }
    }

    /// The targets are the velocity of the conditional flow `a(t) = xi(t) + sigma e^{-kt} n`, here by finite differences.
    #[test]
    fn targets_are_the_time_derivative_of_the_inputs() {
        let config = FlowConfig {
            deviation: 0.2,
            stabilization: 3.0,
            stochastic: true,
        };
        let numbers = [0.7, -1.2, 0.4, 2.0];
        let at = |time: f64| {
            let mut next = numbers.iter();
            example(&config, &CHUNK, 2, time, || *next.next().unwrap())
        };
        let (time, step) = (0.45, 1e-3);
        let (before, middle, after) = (at(time - step), at(time), at(time + step));
        for channel in 0..4 {
            let slope = f64::from(after.input[channel] - before.input[channel]) / (2.0 * step);
            assert!((slope - f64::from(middle.target[channel])).abs() < 2e-3, "{channel}");
        }
    }
}

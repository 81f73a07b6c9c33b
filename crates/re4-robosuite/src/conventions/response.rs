//! How far the hand moves for what its actions ask: a model of robosuite's operational-space controller without free
//! parameters.
//!
//! The controller pulls the hand to its goal with stiffness `kp` and damping `2 * damping_ratio * sqrt(kp)` (both of the mass
//! that is moved), and takes a new goal every step. Per axis, with `d[t]` from the hand to the goal of step `t` and `s[t]` the
//! hand's motion in that step, velocities drop out of the equations, and
//!
//! ```text
//! s[t+1] - kept * s[t] = now * d[t+1] + before * d[t]
//! ```
//!
//! Robosuite's recordings follow it closely where the hand moves freely: translations of scripted and human demonstrations of
//! robosuite 1.0 and 1.4 have a gain of 0.88 to 1.01 and leave 1 to 10 % of the motion unexplained, pushing included. Rotations
//! have one of 0.65 to 0.85 in robosuite 1.4, whose joints have friction, and of -0.95 to -1.02 in 1.0, which turned the other
//! way.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::env_args::EnvArgs;

/// Steps of the simulation, in seconds.
const SIMULATED: f64 = 0.002;
/// robosuite's default stiffness.
const STIFFNESS: f64 = 150.0;

/// The numbers of the equation above.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Response {
    /// Part of the way to the goal that the hand goes from rest, in the step itself.
    pub now: f64,
    /// What it goes in the step after.
    pub before: f64,
    /// Part of the velocity that is left after a step.
    pub kept: f64,
}

impl Response {
    /// That of the controller that a file declares.
    pub(super) fn of(env: &EnvArgs) -> Self {
        let controller = env.controller.as_ref();
        let sound = |value: Option<f64>| value.filter(|value| value.is_finite() && *value > 0.0);
        let kp = sound(controller.and_then(|controller| controller.kp)).unwrap_or(STIFFNESS);
        let damping = sound(controller.and_then(|controller| controller.damping_ratio)).unwrap_or(1.0);
        Self::new(kp, damping, env.control_freq.unwrap_or(20.0))
    }

    /// The simulation's own steps, from rest towards a goal, and with a velocity alone.
    fn new(kp: f64, damping_ratio: f64, control_freq: f64) -> Self {
        let steps = (1.0 / (control_freq * SIMULATED)).round().clamp(1.0, 1e4) as usize;
        let run = |goal: f64, mut velocity: f64| {
            let mut position = 0.0;
            for _ in 0..steps {
                let force = kp * (goal - position) - 2.0 * damping_ratio * kp.sqrt() * velocity;
                velocity += force * SIMULATED;
                position += velocity * SIMULATED;
            }
            (position, velocity)
        };
        let (now, speed) = run(1.0, 0.0);
        let (carried, kept) = run(0.0, 1.0);
        Self {
            now,
            before: carried * speed - now * kept,
            kept,
        }
    }

    /// What one distance asked for adds to the right-hand side over two steps.
    pub(super) fn both(&self) -> f64 {
        self.now + self.before
    }

    /// Part of what is asked for that a hand in steady motion goes in each step.
    pub(super) fn steady(&self) -> f64 {
        self.both() / (1.0 - self.kept)
    }
}

/// Sums over the rows of one axis: the left-hand side `y`, the right-hand side `z`.
#[derive(Debug, Clone, Copy, Default)]
struct Axis {
    y: f64,
    z: f64,
    yy: f64,
    zz: f64,
    yz: f64,
}

/// A straight line through the rows of some axes, each with an intercept of its own.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    /// How many times further the hand moves than it is asked to.
    pub(super) gain: f64,
    /// Fraction of the motion that is not explained, 0 to 1.
    pub(super) unexplained: f64,
}

/// Rows of the equation, summed for the six axes.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    axes: [Axis; 6],
    rows: usize,
    moving: usize,
}

/// A row in which the hand moves less (metres) tells little.
const MOVES: f64 = 2e-4;
/// Root of the sum of squared motion (metres, radians) without which no line is drawn.
const LEAST_MOTION: [f64; 2] = [0.01, 0.01];

/// Axes of translation.
pub(super) const TRANSLATION: [usize; 3] = [0, 1, 2];
/// Axes of rotation.
pub(super) const ROTATION: [usize; 3] = [3, 4, 5];

impl Sums {
    /// Of one demo: the hand's motion in each step but the last, and what is asked for in each.
    pub(super) fn of(response: &Response, steps: &[[f64; 6]], ask: impl Fn(usize) -> [f64; 6]) -> Self {
        let mut sums = Self::default();
        let mut before = match steps.first() {
            Some(_) => ask(0),
            None => return sums,
        };
        for (t, pair) in steps.windows(2).enumerate() {
            let now = ask(t + 1);
            let mut moved = 0.0;
            for (axis, sum) in sums.axes.iter_mut().enumerate() {
                let y = pair[1][axis] - response.kept * pair[0][axis];
                let z = response.now * now[axis] + response.before * before[axis];
                sum.y += y;
                sum.z += z;
                sum.yy += y * y;
                sum.zz += z * z;
                sum.yz += y * z;
                if axis < 3 {
                    moved += y * y;
                }
            }
            sums.rows += 1;
            sums.moving += usize::from(moved > MOVES * MOVES);
            before = now;
        }
        sums
    }

    pub(super) fn add(&mut self, other: &Self) {
        for (own, other) in self.axes.iter_mut().zip(&other.axes) {
            own.y += other.y;
            own.z += other.z;
            own.yy += other.yy;
            own.zz += other.zz;
            own.yz += other.yz;
        }
        self.rows += other.rows;
        self.moving += other.moving;
    }

    /// Rows in which the hand moves.
    pub(super) fn frames(&self) -> usize {
        self.moving
    }

    /// The line through the rows of some axes of one kind; none where the hand hardly moves or nothing is asked for.
    pub(super) fn line(&self, axes: &[usize]) -> Option<Line> {
        let rows = self.rows as f64;
        let [mut yy, mut zz, mut yz] = [0.0; 3];
        for &axis in axes {
            let sum = self.axes.get(axis)?;
            yy += sum.yy - sum.y * sum.y / rows;
            zz += sum.zz - sum.z * sum.z / rows;
            yz += sum.yz - sum.y * sum.z / rows;
        }
        let minimum = LEAST_MOTION[usize::from(axes.first().is_some_and(|axis| *axis > 2))];
        // Rounding leaves a little of columns that never change.
        if self.rows < 3 || yy < minimum * minimum || zz < 1e-12 * yy {
            return None;
        }
        Some(Line {
            gain: yz / zz,
            unexplained: (1.0 - yz * yz / (yy * zz)).clamp(0.0, 1.0),
        })
    }

    /// What is asked for on an axis where the hand rests, given how many times further it moves than it is asked to.
    pub(super) fn at_rest(&self, response: &Response, axis: usize, gain: f64) -> f64 {
        let sum = &self.axes[axis];
        (sum.z - sum.y / gain) / (self.rows.max(1) as f64 * response.both())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_controller_goes_a_quarter_of_the_way() {
        let response = Response::new(150.0, 1.0, 20.0);
        assert!((response.now - 0.126).abs() < 0.01, "{response:?}");
        assert!((response.kept - 0.21).abs() < 0.02, "{response:?}");
        assert!((response.steady() - 0.2655).abs() < 0.01, "{response:?}");
        // Twice the time for a step: nearly all of the velocity is gone, and more than half of the way is done.
        let slow = Response::new(150.0, 1.0, 5.0);
        assert!(slow.now > 0.6 && slow.kept.abs() < 0.15, "{slow:?}");
    }

    #[test]
    fn a_hand_that_follows_has_a_gain_of_one_and_rests_at_zero() {
        let response = Response::new(150.0, 1.0, 20.0);
        let asked: Vec<[f64; 6]> = (0..80)
            .map(|t| std::array::from_fn(|axis| 0.04 * (f64::from(t) * (0.2 + 0.1 * axis as f64)).sin()))
            .collect();
        let mut steps = vec![[0.0; 6]];
        for t in 1..80 {
            let last = steps[t - 1];
            steps.push(std::array::from_fn(|axis| {
                response.kept * last[axis] + response.now * asked[t][axis] + response.before * asked[t - 1][axis]
            }));
        }
        let sums = Sums::of(&response, &steps, |t| asked[t]);
        let line = sums.line(&TRANSLATION).unwrap();
        assert!((line.gain - 1.0).abs() < 1e-12 && line.unexplained < 1e-12, "{line:?}");
        // The same in another unit, and beside itself.
        let shifted = Sums::of(&response, &steps, |t| asked[t].map(|value| value / 20.0 + 0.01));
        let line = shifted.line(&TRANSLATION).unwrap();
        assert!((line.gain - 20.0).abs() < 1e-9, "{line:?}");
        assert!((shifted.at_rest(&response, 0, line.gain) - 0.01).abs() < 1e-9);
        assert!(Sums::of(&response, &steps, |_| [0.3; 6]).line(&TRANSLATION).is_none());
    }
}

//! A model of robosuite's operational-space controller without free parameters. It predicts how far the end effector moves for a
//! given action.
//!
//! The controller pulls the end effector to its goal with stiffness `kp` and damping `2 * damping_ratio * sqrt(kp)` (both per
//! unit of the moved mass), and gets a new goal in every step. For each axis, let `d[t]` be the displacement from the end
//! effector to the goal of step `t`, and `s[t]` the end effector's motion in that step. Eliminating the velocities gives
//!
//! ```text
//! s[t+1] - kept * s[t] = now * d[t+1] + before * d[t]
//! ```
//!
//! Recordings of robosuite follow this equation closely if the end effector moves freely. For translations in scripted and human
//! demonstrations of robosuite 1.0 and 1.4, the gain is 0.88 to 1.01, and 1 to 10 % of the motion remains unexplained, pushing
//! included. For rotations, the gain is 0.65 to 0.85 in robosuite 1.4, whose joints have friction, and -0.95 to -1.02 in robosuite
//! 1.0, which rotated in the opposite direction.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::env_args::EnvArgs;

/// Time step of the simulation, in seconds.
const TIME_STEP: f64 = 0.002;
/// robosuite's default stiffness.
const STIFFNESS: f64 = 150.0;

/// The coefficients of the module's equation `s[t+1] - kept * s[t] = now * d[t+1] + before * d[t]`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Response {
    /// Fraction of the distance to the goal that the end effector moves from rest, in the same step.
    pub now: f64,
    /// Fraction of the distance to the previous goal that it still moves in the step after.
    pub before: f64,
    /// Fraction of the velocity that remains after a step.
    pub kept: f64,
}

impl Response {
    /// The response of the controller that a file declares, with robosuite's defaults for missing values.
    pub(super) fn of(env: &EnvArgs) -> Self {
        let controller = env.controller.as_ref();
        let positive = |value: Option<f64>| value.filter(|value| value.is_finite() && *value > 0.0);
        let kp = positive(controller.and_then(|controller| controller.kp)).unwrap_or(STIFFNESS);
        let damping = positive(controller.and_then(|controller| controller.damping_ratio)).unwrap_or(1.0);
        Self::new(kp, damping, env.control_freq.unwrap_or(20.0))
    }

    /// Integrates the time steps of the simulation twice: from rest towards a goal, and with an initial velocity at the goal.
    fn new(kp: f64, damping_ratio: f64, control_freq: f64) -> Self {
        let steps = (1.0 / (control_freq * TIME_STEP)).round().clamp(1.0, 1e4) as usize;
        let run = |goal: f64, mut velocity: f64| {
            let mut position = 0.0;
            for _ in 0..steps {
                let force = kp * (goal - position) - 2.0 * damping_ratio * kp.sqrt() * velocity;
                velocity += force * TIME_STEP;
                position += velocity * TIME_STEP;
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

    /// Coefficient of a constant displacement on the right-hand side: `now + before`.
    pub(super) fn both(&self) -> f64 {
        self.now + self.before
    }

    /// Fraction of a constant commanded displacement that the end effector moves per step in steady motion.
    pub(super) fn steady(&self) -> f64 {
        self.both() / (1.0 - self.kept)
    }
}

/// Sums over the rows of one axis, where `y` is the left-hand side of the equation and `z` the right-hand side.
#[derive(Debug, Clone, Copy, Default)]
struct Axis {
    y: f64,
    z: f64,
    yy: f64,
    zz: f64,
    yz: f64,
}

/// A line fitted to the rows of some axes, with one common slope and one intercept per axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    /// The slope: ratio of the end effector's motion to the motion that the model predicts.
    pub(super) gain: f64,
    /// Fraction of the motion that the line does not explain, 0 to 1.
    pub(super) unexplained: f64,
}

/// Sums over the rows of the equation for all six axes.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    axes: [Axis; 6],
    rows: usize,
    moving: usize,
}

/// Minimum motion (metres) for a row to count as one with motion.
const MOVES: f64 = 2e-4;
/// Minimum root of the sum of squared motion (metres for translations, radians for rotations) for fitting a line.
const MINIMUM_MOTION: [f64; 2] = [0.01, 0.01];

/// Axes of translation.
pub(super) const TRANSLATION: [usize; 3] = [0, 1, 2];
/// Axes of rotation.
pub(super) const ROTATION: [usize; 3] = [3, 4, 5];

impl Sums {
    /// The sums of one demonstration, from the end effector's motion in each step and the displacement that each action asks for.
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

    /// Adds the sums of another demonstration.
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

    /// Number of rows in which the end effector moves.
    pub(super) fn frames(&self) -> usize {
        self.moving
    }

    /// The line for some axes, which are either all translations or all rotations. Returns `None` if the end effector hardly moves
    /// or the commands do not vary.
    pub(super) fn line(&self, axes: &[usize]) -> Option<Line> {
        let rows = self.rows as f64;
        let [mut yy, mut zz, mut yz] = [0.0; 3];
        for &axis in axes {
            let sum = self.axes.get(axis)?;
            yy += sum.yy - sum.y * sum.y / rows;
            zz += sum.zz - sum.z * sum.z / rows;
            yz += sum.yz - sum.y * sum.z / rows;
        }
        let minimum = MINIMUM_MOTION[usize::from(axes.first().is_some_and(|axis| *axis > 2))];
        // The variance of a constant column is not exactly zero because of rounding.
        if self.rows < 3 || yy < minimum * minimum || zz < 1e-12 * yy {
            return None;
        }
        Some(Line {
            gain: yz / zz,
            unexplained: (1.0 - yz * yz / (yy * zz)).clamp(0.0, 1.0),
        })
    }

    /// The displacement that the actions ask for along an axis when the end effector rests, given the gain of the line.
    pub(super) fn at_rest(&self, response: &Response, axis: usize, gain: f64) -> f64 {
        let sum = &self.axes[axis];
        (sum.z - sum.y / gain) / (self.rows.max(1) as f64 * response.both())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_controller_moves_a_quarter_of_the_displacement_per_step() {
        let response = Response::new(150.0, 1.0, 20.0);
        assert!((response.now - 0.126).abs() < 0.01, "{response:?}");
        assert!((response.kept - 0.21).abs() < 0.02, "{response:?}");
        assert!((response.steady() - 0.2655).abs() < 0.01, "{response:?}");
        // With four times the step length, most of the velocity is lost and more than half of the distance is covered.
        let slow = Response::new(150.0, 1.0, 5.0);
        assert!(slow.now > 0.6 && slow.kept.abs() < 0.15, "{slow:?}");
    }

    #[test]
    fn end_effector_that_follows_its_commands_has_gain_one_and_rests_at_zero() {
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
        // The same actions in another unit and with an offset.
        let shifted = Sums::of(&response, &steps, |t| asked[t].map(|value| value / 20.0 + 0.01));
        let line = shifted.line(&TRANSLATION).unwrap();
        assert!((line.gain - 20.0).abs() < 1e-9, "{line:?}");
        assert!((shifted.at_rest(&response, 0, line.gain) - 0.01).abs() < 1e-9);
        assert!(Sums::of(&response, &steps, |_| [0.3; 6]).line(&TRANSLATION).is_none());
    }
}

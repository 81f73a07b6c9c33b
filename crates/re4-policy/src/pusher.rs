//! A model of the pusher: a point under proportional-derivative control that contact does not disturb.
//!
//! The controller is part of the robot and not of the scene. Its gains are public (`k_p` 100, `k_v` 20, 10 substeps of 0.01 s,
//! gym-pusht 0.1.8 `PushTEnv`), and it acts on the pusher only. A policy may therefore predict how its commands are executed, and
//! estimate the velocity of the pusher from its own commands.

use re4_geometry::Point2;
use re4_sim::{DAMPING_GAIN, PROPORTIONAL_GAIN, SUBSTEPS, TIME_STEP};

/// Position and velocity of the pusher, in pixels and pixels per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PusherState {
    /// Position in the world frame.
    pub position: Point2,
    /// Velocity in the world frame.
    pub velocity: Point2,
}

/// The motion in one control period as a linear map of `(position - target, velocity)`, which is the same for both axes.
#[derive(Debug, Clone, Copy)]
pub struct PusherModel {
    m: [[f64; 2]; 2],
}

impl Default for PusherModel {
    fn default() -> Self {
        let column = |mut x: f64, mut v: f64| {
            for _ in 0..SUBSTEPS {
                v += (PROPORTIONAL_GAIN * -x - DAMPING_GAIN * v) * TIME_STEP;
                x += v * TIME_STEP;
            }
            (x, v)
        };
        let (a, c) = column(1.0, 0.0);
        let (b, d) = column(0.0, 1.0);
        Self { m: [[a, b], [c, d]] }
    }
}

impl PusherModel {
    /// Predicts the state after one control period with the target held at `target`.
    pub fn predict(&self, state: PusherState, target: Point2) -> PusherState {
        let [[a, b], [c, d]] = self.m;
        let offset = state.position - target;
        PusherState {
            position: target + offset * a + state.velocity * b,
            velocity: offset * c + state.velocity * d,
        }
    }

    /// Returns the target that brings the pusher to `goal` at the end of one control period.
    pub fn target_for_position(&self, state: PusherState, goal: Point2) -> Point2 {
        let [[a, b], _] = self.m;
        (goal - state.position * a - state.velocity * b) / (1.0 - a)
    }

    /// Returns the first of `steps` targets that bring the pusher to `goal` with velocity `velocity`. The targets form the
    /// sequence with the smallest sum of squared distances from `goal` (minimum-effort control). With one step left, only the
    /// position can be reached.
    pub fn first_target(&self, state: PusherState, goal: Point2, velocity: Point2, steps: usize) -> Point2 {
        if steps <= 1 {
            return self.target_for_position(state, goal);
        }
        // With s = (position - goal, velocity) and u = target - goal: s' = M s + g u, g = (1, 0) - M (1, 0).
        let m = self.m;
        let g = [1.0 - m[0][0], -m[1][0]];
        let times = |v: [f64; 2]| [m[0][0] * v[0] + m[0][1] * v[1], m[1][0] * v[0] + m[1][1] * v[1]];
        // Reachability columns M^k g for k = steps-1 .. 0 and the Gramian of their span.
        let mut columns = Vec::with_capacity(steps);
        let mut column = g;
        for _ in 0..steps {
            columns.push(column);
            column = times(column);
        }
        let (mut g00, mut g01, mut g11) = (0.0, 0.0, 0.0);
        for c in &columns {
            g00 += c[0] * c[0];
            g01 += c[0] * c[1];
            g11 += c[1] * c[1];
        }
        let determinant = g00 * g11 - g01 * g01;
        let solve = |s: [f64; 2], wanted: f64| {
            let mut free = s;
            for _ in 0..steps {
                free = times(free);
            }
            let (e0, e1) = (-free[0], wanted - free[1]);
            let (l0, l1) = ((g11 * e0 - g01 * e1) / determinant, (g00 * e1 - g01 * e0) / determinant);
            // The first input acts through the column with the highest power of M.
            columns.last().map_or(0.0, |c| c[0] * l0 + c[1] * l1)
        };
        let offset = state.position - goal;
        goal + Point2::new(
            solve([offset.x, state.velocity.x], velocity.x),
            solve([offset.y, state.velocity.y], velocity.y),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point2> {
        (-200.0..200.0f64, -200.0..200.0f64).prop_map(|(x, y)| Point2::new(x, y))
    }

    proptest! {
        #[test]
        fn one_step_meets_the_position(p in point(), v in point(), goal in point()) {
            let model = PusherModel::default();
            let state = PusherState { position: p, velocity: v };
            let reached = model.predict(state, model.target_for_position(state, goal));
            prop_assert!((reached.position - goal).norm() < 1e-8);
        }

        #[test]
        fn several_steps_meet_position_and_velocity(p in point(), v in point(), goal in point(), w in point(), n in 2usize..9) {
            let model = PusherModel::default();
            let mut state = PusherState { position: p, velocity: v };
            for left in (1..=n).rev() {
                let target = model.first_target(state, goal, w, left);
                state = model.predict(state, target);
            }
            prop_assert!((state.position - goal).norm() < 1e-6);
            prop_assert!((state.velocity - w).norm() < 1e-5);
        }
    }
}

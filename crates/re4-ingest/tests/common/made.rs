//! Synthetic datasets with agents that are moved by the controller of Push-T.

use std::path::Path;

use super::Copy;

/// A dataset as columns, in pixels and radians, actions as absolute targets.
pub(crate) struct Made {
    pub(crate) state: Vec<[f64; 5]>,
    pub(crate) action: Vec<[f64; 2]>,
    pub(crate) ends: Vec<i64>,
}

/// Episodes of `frames` frames each, with targets that drift and sometimes jump. Every second episode has idle periods.
pub(crate) fn made(episodes: usize, frames: usize) -> Made {
    let mut made = Made {
        state: Vec::new(),
        action: Vec::new(),
        ends: Vec::new(),
    };
    let mut seed = 7_u64;
    let mut draw = move || {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    for episode in 0..episodes {
        let mut agent = [60.0 + 380.0 * draw(), 60.0 + 380.0 * draw()];
        let mut velocity = [0.0; 2];
        let mut block = [150.0 + 200.0 * draw(), 150.0 + 200.0 * draw(), 6.2 * draw()];
        let mut target = agent;
        let mut drift = [0.0; 2];
        for frame in 0..frames {
            let idle = episode % 2 == 1 && frame % 40 > 30;
            for axis in 0..2 {
                if frame % 25 == 10 {
                    target[axis] = 40.0 + 430.0 * draw();
                } else if !idle {
                    drift[axis] = 0.8 * drift[axis] + 16.0 * (draw() - 0.5);
                    target[axis] = (target[axis] + drift[axis]).clamp(10.0, 500.0);
                }
            }
            made.state.push([agent[0], agent[1], block[0], block[1], block[2]]);
            made.action.push(target);
            // PD control with k_p = 100 and k_v = 20, ten steps of 0.01 s.
            for _ in 0..10 {
                for axis in 0..2 {
                    velocity[axis] += (100.0 * (target[axis] - agent[axis]) - 20.0 * velocity[axis]) * 0.01;
                    agent[axis] += velocity[axis] * 0.01;
                }
            }
            block[2] = (block[2] + 0.05 * draw()) % std::f64::consts::TAU;
            for value in &mut block[..2] {
                *value += draw() - 0.5;
            }
        }
        made.ends.push(made.state.len() as i64);
    }
    made
}

impl Made {
    /// Changes every number of states and actions; `map` receives the column (0 to 4, and 5 and 6 for actions).
    pub(crate) fn map(mut self, map: impl Fn(usize, f64) -> f64) -> Self {
        for row in &mut self.state {
            for (column, value) in row.iter_mut().enumerate() {
                *value = map(column, *value);
            }
        }
        for row in &mut self.action {
            for (column, value) in row.iter_mut().enumerate() {
                *value = map(5 + column, *value);
            }
        }
        self
    }

    /// Changes every action; `map` receives the axis, the agent's coordinate and the action's.
    pub(crate) fn map_actions(mut self, map: impl Fn(usize, f64, f64) -> f64) -> Self {
        for (action, state) in self.action.iter_mut().zip(&self.state) {
            for axis in 0..2 {
                action[axis] = map(axis, state[axis], action[axis]);
            }
        }
        self
    }

    /// Frames of an episode.
    pub(crate) fn frames(&self, episode: usize) -> std::ops::Range<usize> {
        let start = episode.checked_sub(1).map_or(0, |before| self.ends[before] as usize);
        start..self.ends[episode] as usize
    }

    /// Writes the dataset to a store.
    pub(crate) fn store(&self) -> Copy {
        let frames = self.state.len();
        Copy::of("minimal")
            .floats("data/state", &[frames, 5], self.state.as_flattened())
            .floats("data/action", &[frames, 2], self.action.as_flattened())
            .ends(&self.ends)
    }
}

/// A test input that reproduces a public bug report, if it is available.
pub(crate) fn foreign(case: &str) -> Option<std::path::PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let data = std::env::var_os("RE4_DATA").map_or_else(beside, std::path::PathBuf::from);
    let folder = data.join("foreign").join(case);
    let store = std::fs::read_dir(&folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.extension().is_some_and(|end| end == "zarr"));
    if store.is_none() {
        println!(
            "skipped: no {}; set RE4_DATA to the folder of the datasets",
            folder.display()
        );
    }
    store
}

//! Windows: pairs of an observation history and the chunk of actions that follows it.

use crate::normalize::{Normalizer, check_finite};
use crate::{GenerativeConfig, GenerativeError};

/// A demonstration as vectors of numbers, one per frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Demo {
    /// Number of the demonstration.
    pub number: u32,
    /// The observation of every frame.
    pub observations: Vec<Vec<f64>>,
    /// The action of every frame.
    pub actions: Vec<Vec<f64>>,
    /// The action before the first frame: what the robot would be commanded to stay where it is.
    pub rest: Vec<f64>,
}

/// All windows of the demonstrations, normalised.
///
/// The chunk of a window at frame `f` begins with the action of frame `f - 1` (as in Diffusion Policy with two observations), so
/// the first action to execute is the chunk's second. Windows begin at every frame whose chunk exceeds the demonstration by at
/// most half of the horizon, less one; frames before the first are the first frame again, and frames after the last are the last
/// one again.
#[derive(Debug, Clone)]
pub struct Windows {
    demos: Vec<Normalized>,
    /// The demonstration and the frame of every window.
    starts: Vec<(u32, u32)>,
    history: usize,
    horizon: usize,
}

#[derive(Debug, Clone)]
struct Normalized {
    number: u32,
    observations: Vec<Vec<f32>>,
    actions: Vec<Vec<f32>>,
    rest: Vec<f32>,
}

impl Windows {
    /// The windows of demonstrations.
    ///
    /// # Errors
    /// If there are no demonstrations, or one of their numbers is not finite.
    pub fn new(
        demos: &[Demo],
        config: &GenerativeConfig,
        observations: &Normalizer,
        actions: &Normalizer,
    ) -> Result<Self, GenerativeError> {
        check_finite(demos)?;
        let normalized: Vec<Normalized> = demos
            .iter()
            .filter(|demo| !demo.actions.is_empty())
            .map(|demo| {
                let all =
                    |rows: &[Vec<f64>], by: &Normalizer| rows.iter().map(|row| by.forward(row).collect()).collect();
                Normalized {
                    number: demo.number,
                    observations: all(&demo.observations, observations),
                    actions: all(&demo.actions, actions),
                    rest: actions.forward(&demo.rest).collect(),
                }
            })
            .collect();
        // Frame f is the present one: its chunk covers the frames f - 1 to f - 2 + horizon.
        let excess = config.horizon / 2 - 1;
        let mut starts = Vec::new();
        for (at, demo) in (0..).zip(&normalized) {
            let last = (demo.actions.len() + excess + 2).saturating_sub(config.horizon).max(1);
            starts.extend((0..last.min(demo.actions.len())).map(|frame| (at, frame as u32)));
        }
        if starts.is_empty() {
            return Err(GenerativeError::NoDemonstrations);
        }
        Ok(Self {
            demos: normalized,
            starts,
            history: config.history,
            horizon: config.horizon,
        })
    }

    /// Number of windows, at least 1.
    pub fn count(&self) -> usize {
        self.starts.len()
    }

    /// The number of the demonstration of a window, and its frame.
    pub fn place(&self, window: usize) -> (u32, u32) {
        let (demo, frame) = self.starts[window];
        (self.demos[demo as usize].number, frame)
    }

    /// Appends the observation history of a window, the oldest observation first.
    pub fn push_history(&self, window: usize, into: &mut Vec<f32>) {
        let (demo, frame) = self.starts[window];
        let demo = &self.demos[demo as usize];
        for back in (0..self.history).rev() {
            into.extend(&demo.observations[(frame as usize).saturating_sub(back)]);
        }
    }

    /// Appends the chunk of a window. Its first action is that of the frame before.
    pub fn push_chunk(&self, window: usize, into: &mut Vec<f32>) {
        let (demo, frame) = self.starts[window];
        let (demo, frame) = (&self.demos[demo as usize], frame as usize);
        let last = demo.actions.len() - 1;
        for at in frame..frame + self.horizon {
            match at.checked_sub(1) {
                None => into.extend(&demo.rest),
                Some(at) => into.extend(&demo.actions[at.min(last)]),
            }
        }
    }
}

//! The last states of an episode.

use std::collections::VecDeque;

use super::{Lookup, Memory};

/// The last `length` states, the newest first. Before there are as many, the oldest one counts several times.
pub(crate) struct History<D: Lookup> {
    length: usize,
    states: VecDeque<D::State>,
}

impl<D: Lookup> History<D> {
    pub(crate) fn new(length: u32) -> Self {
        Self {
            length: length as usize,
            states: VecDeque::new(),
        }
    }

    /// Adds the present state.
    pub(crate) fn push(&mut self, state: D::State) {
        if self.states.is_empty() {
            self.states.extend(std::iter::repeat_n(state, self.length));
        }
        self.states.push_front(state);
        self.states.truncate(self.length);
    }

    /// Squared distance to the history of a frame: the sum of the squared distances of the states, each to the state of the
    /// demonstration as many frames earlier. The first frame of a demonstration is repeated.
    pub(crate) fn squared(&self, memory: &Memory<D>, at: usize) -> f64 {
        let states = self.states.iter().enumerate();
        states
            .map(|(back, state)| {
                let entry = &memory.entries[memory.before(at, back)];
                D::squared(&memory.scales, &entry.state, state)
            })
            .sum()
    }

    /// The feature vectors of the states, one after the other.
    pub(crate) fn features(&self, memory: &Memory<D>) -> Vec<f64> {
        let states = self.states.iter();
        states.flat_map(|state| D::features(&memory.scales, state)).collect()
    }

    /// The feature vectors of the history of a frame.
    pub(crate) fn features_of(memory: &Memory<D>, at: usize, length: u32) -> Vec<f64> {
        (0..length as usize)
            .flat_map(|back| D::features(&memory.scales, &memory.entries[memory.before(at, back)].state))
            .collect()
    }
}

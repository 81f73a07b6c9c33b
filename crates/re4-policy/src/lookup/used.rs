//! Frames that an episode has already used and must not retrieve again.

use std::collections::VecDeque;

/// The most recently used frames. Without a limit, every frame that was used in the episode.
pub(crate) struct UsedFrames {
    memory: Option<usize>,
    order: VecDeque<usize>,
    used: Vec<bool>,
}

impl UsedFrames {
    /// Creates an empty set for `frames` frames, which remembers the last `memory` of them.
    pub(crate) fn new(frames: usize, memory: Option<u32>) -> Self {
        Self {
            memory: memory.map(|memory| memory as usize),
            order: VecDeque::new(),
            used: vec![false; frames],
        }
    }

    pub(crate) fn contains(&self, at: usize) -> bool {
        self.used[at]
    }

    /// Marks a frame as used and forgets the oldest one if there are too many.
    pub(crate) fn insert(&mut self, at: usize) {
        if !std::mem::replace(&mut self.used[at], true) {
            self.order.push_back(at);
        }
        while self.memory.is_some_and(|memory| self.order.len() > memory) {
            if let Some(oldest) = self.order.pop_front() {
                self.used[oldest] = false;
            }
        }
    }

    /// Forgets all frames.
    pub(crate) fn clear(&mut self) {
        for at in self.order.drain(..) {
            self.used[at] = false;
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.order.len()
    }
}

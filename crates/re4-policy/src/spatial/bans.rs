//! Bans of demonstrations during an episode.

use std::collections::BTreeSet;

use re4_episode::Mode;

use crate::spatial::config::BanConfig;

/// The banned demonstrations, and the retrievals that can lead to a ban.
pub(crate) struct Bans {
    config: Option<BanConfig>,
    /// Number of demonstrations. When all of them are banned, all bans are lifted.
    demos: usize,
    horizon: u32,
    banned: BTreeSet<u32>,
    mode: Mode,
    /// Retrieved (demonstration, frame) pairs since the mode of the query last changed.
    retrieved: Vec<(u32, u32)>,
}

impl Bans {
    pub(crate) fn new(config: Option<BanConfig>, demos: usize, horizon: u32) -> Self {
        Self {
            config,
            demos,
            horizon,
            banned: BTreeSet::new(),
            mode: Mode::Transit,
            retrieved: Vec::new(),
        }
    }

    pub(crate) fn set(&self) -> &BTreeSet<u32> {
        &self.banned
    }

    /// Whether all demonstrations but one are banned.
    pub(crate) fn is_nearly_full(&self) -> bool {
        self.banned.len() + 1 >= self.demos && !self.banned.is_empty()
    }

    /// Bans a demonstration if bans are enabled. Returns whether it was not banned before.
    pub(crate) fn ban(&mut self, demo: u32) -> bool {
        if self.config.is_none() {
            return false;
        }
        let new = self.banned.insert(demo);
        if self.banned.len() >= self.demos {
            self.banned.clear();
        }
        new
    }

    /// Records a retrieval. Returns true if the demonstration has been retrieved too often near this frame in the current mode.
    pub(crate) fn is_repeated(&mut self, mode: Mode, demo: u32, frame: u32) -> bool {
        if mode != self.mode {
            self.mode = mode;
            self.retrieved.clear();
        }
        let Some(config) = &self.config else {
            return false;
        };
        // With chunks shorter than the window, normal progress would retrieve several frames within the window.
        let window = config.window.min(self.horizon.saturating_sub(1));
        self.retrieved.push((demo, frame));
        let is_near = |&&(d, f): &&(u32, u32)| d == demo && f.abs_diff(frame) <= window;
        let repeated = self.retrieved.iter().filter(is_near).count() >= config.repeats as usize;
        if repeated {
            // Start counting again, in case all bans are lifted.
            self.retrieved.retain(|(d, _)| *d != demo);
        }
        repeated
    }
}

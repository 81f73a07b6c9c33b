//! Which demonstrations are not followed again in an episode.

use std::collections::BTreeSet;

use re4_episode::Mode;

use crate::spatial::config::BanConfig;

/// Bans and what leads to them.
pub(crate) struct Bans {
    config: Option<BanConfig>,
    /// Number of demonstrations; when all of them are banned, none is.
    demos: usize,
    horizon: u32,
    banned: BTreeSet<u32>,
    mode: Mode,
    /// Demonstrations and frames retrieved since the mode of the query changed.
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

    /// Bans a demonstration, where there are bans; tells whether it was not banned before.
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

    /// Takes a retrieval down. True when the demonstration has been retrieved about this frame too often in this mode.
    pub(crate) fn leads_nowhere(&mut self, mode: Mode, demo: u32, frame: u32) -> bool {
        if mode != self.mode {
            self.mode = mode;
            self.retrieved.clear();
        }
        let Some(config) = &self.config else {
            return false;
        };
        // Chunks shorter than the window would pass through it more than once while all goes well.
        let window = config.window.min(self.horizon.saturating_sub(1));
        self.retrieved.push((demo, frame));
        let about = |&&(d, f): &&(u32, u32)| d == demo && f.abs_diff(frame) <= window;
        let often = self.retrieved.iter().filter(about).count() >= config.repeats as usize;
        if often {
            self.retrieved.retain(|(d, _)| *d != demo);
        }
        often
    }
}

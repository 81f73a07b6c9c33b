//! The demonstrations a policy replays from.

use std::ops::Range;

use re4_episode::{Mode, PlanarFrame};

use re4_episode::DemoNames;

/// Frames of all demonstrations, one after the other, with their modes.
#[derive(Debug, Clone, Default)]
pub struct DemoSet {
    frames: Vec<PlanarFrame>,
    modes: Vec<Mode>,
    /// Number and frames of each demonstration, in ascending order of the number.
    demos: Vec<(u32, Range<usize>)>,
    names: DemoNames,
}

impl DemoSet {
    /// Collects demonstrations, given in ascending order of their numbers; those without frames are left out.
    pub fn new(demos: impl IntoIterator<Item = (u32, Vec<(PlanarFrame, Mode)>)>) -> Self {
        let mut set = Self::default();
        for (number, frames) in demos {
            let start = set.frames.len();
            for (frame, mode) in frames {
                set.frames.push(frame);
                set.modes.push(mode);
            }
            if set.frames.len() > start {
                set.demos.push((number, start..set.frames.len()));
            }
        }
        set.demos.sort_by_key(|(number, _)| *number);
        set
    }

    /// The same demonstrations with the names that they have in their source.
    #[must_use]
    pub fn with_names(mut self, names: DemoNames) -> Self {
        self.names = names;
        self
    }

    /// Names of the demonstrations.
    pub fn names(&self) -> &DemoNames {
        &self.names
    }

    /// Number and frames of every demonstration.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[PlanarFrame])> {
        self.demos
            .iter()
            .map(|(number, range)| (*number, &self.frames[range.clone()]))
    }

    /// Frames of one demonstration.
    pub fn demo(&self, number: u32) -> Option<&[PlanarFrame]> {
        let at = self.demos.binary_search_by_key(&number, |(number, _)| *number).ok()?;
        Some(&self.frames[self.demos[at].1.clone()])
    }

    /// Modes of one demonstration, frame by frame.
    pub fn modes(&self, number: u32) -> Option<&[Mode]> {
        let at = self.demos.binary_search_by_key(&number, |(number, _)| *number).ok()?;
        Some(&self.modes[self.demos[at].1.clone()])
    }

    /// Number of frames in all demonstrations.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether there is no frame at all.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }
}

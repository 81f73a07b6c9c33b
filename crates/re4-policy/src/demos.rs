//! The demonstrations that a policy replays.

use re4_episode::DemoNames;

/// Frames of all demonstrations, in ascending order of the demonstration numbers.
#[derive(Debug, Clone)]
pub struct DemoSet<F> {
    demos: Vec<(u32, Vec<F>)>,
    names: DemoNames,
}

impl<F> Default for DemoSet<F> {
    fn default() -> Self {
        Self::new([])
    }
}

impl<F> DemoSet<F> {
    /// Collects demonstrations from their numbers and frames. Demonstrations without frames are dropped, and of demonstrations
    /// with the same number only the first is kept.
    pub fn new(demos: impl IntoIterator<Item = (u32, Vec<F>)>) -> Self {
        let mut demos: Vec<_> = demos.into_iter().filter(|(_, frames)| !frames.is_empty()).collect();
        demos.sort_by_key(|(number, _)| *number);
        demos.dedup_by_key(|(number, _)| *number);
        Self {
            demos,
            names: DemoNames::default(),
        }
    }

    /// Sets the names that the demonstrations have in their source.
    #[must_use]
    pub fn with_names(mut self, names: DemoNames) -> Self {
        self.names = names;
        self
    }

    /// Returns the names of the demonstrations.
    pub fn names(&self) -> &DemoNames {
        &self.names
    }

    /// Iterates over the number and frames of every demonstration.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[F])> {
        self.demos.iter().map(|(number, frames)| (*number, frames.as_slice()))
    }

    /// Returns the frames of a demonstration, or `None` if it does not exist.
    pub fn demo(&self, number: u32) -> Option<&[F]> {
        let at = self.demos.binary_search_by_key(&number, |(number, _)| *number).ok()?;
        Some(&self.demos[at].1)
    }

    /// Returns the number of demonstrations.
    pub fn len(&self) -> usize {
        self.demos.len()
    }

    /// Returns whether there are no demonstrations.
    pub fn is_empty(&self) -> bool {
        self.demos.is_empty()
    }
}

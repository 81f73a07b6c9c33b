//! The demonstrations a policy replays from.

use re4_episode::DemoNames;

/// Frames of all demonstrations, in ascending order of their numbers.
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
    /// Collects demonstrations, each with its number and all its frames; those without frames are left out, and of those with
    /// the same number all but the first.
    pub fn new(demos: impl IntoIterator<Item = (u32, Vec<F>)>) -> Self {
        let mut demos: Vec<_> = demos.into_iter().filter(|(_, frames)| !frames.is_empty()).collect();
        demos.sort_by_key(|(number, _)| *number);
        demos.dedup_by_key(|(number, _)| *number);
        Self {
            demos,
            names: DemoNames::default(),
        }
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
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[F])> {
        self.demos.iter().map(|(number, frames)| (*number, frames.as_slice()))
    }

    /// Frames of one demonstration.
    pub fn demo(&self, number: u32) -> Option<&[F]> {
        let at = self.demos.binary_search_by_key(&number, |(number, _)| *number).ok()?;
        Some(&self.demos[at].1)
    }

    /// Number of demonstrations.
    pub fn len(&self) -> usize {
        self.demos.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.demos.is_empty()
    }
}

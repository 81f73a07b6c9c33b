//! Iterates over a table one demonstration at a time, so that the table need not fit in memory.

use std::iter::Peekable;

use anyhow::Result;
use re4_artifact::{Artifact, Row, RowsOf};

/// An iterator over a table that is sorted by episode: yields each episode's number and rows.
pub(crate) struct ByEpisode<R: Row> {
    rows: Peekable<RowsOf<R>>,
    episode: fn(&R) -> u32,
}

impl<R: Row> ByEpisode<R> {
    /// Opens the table of rows `R` of this artifact. `episode` returns the episode number of a row.
    pub(crate) fn open(artifact: &Artifact, episode: fn(&R) -> u32) -> Result<Self> {
        let rows = artifact.table(R::table())?.stream()?.peekable();
        Ok(Self { rows, episode })
    }
}

impl<R: Row> Iterator for ByEpisode<R> {
    type Item = Result<(u32, Vec<R>)>;

    fn next(&mut self) -> Option<Self::Item> {
        let first = match self.rows.next()? {
            Ok(row) => row,
            Err(error) => return Some(Err(error.into())),
        };
        let number = (self.episode)(&first);
        let mut own = vec![first];
        let same = |row: &Result<R, _>| row.as_ref().is_ok_and(|row| (self.episode)(row) == number);
        own.extend(std::iter::from_fn(|| self.rows.next_if(same)).flatten());
        Some(Ok((number, own)))
    }
}

//! Iterates over a table one demonstration at a time, so that the table need not fit in memory.

use std::iter::Peekable;

use super::{Cell, Row, RowsOf};
use crate::error::ArtifactError;
use crate::reader::Artifact;
use crate::table::Table;

/// An iterator over a table that is sorted by episode: yields each episode's number and rows.
pub struct ByEpisode<C: Cell> {
    rows: Peekable<RowsOf<C>>,
    episode: fn(&C) -> u32,
}

impl<R: Row> ByEpisode<R> {
    /// Opens the table of rows `R` of this artifact. `episode` returns the episode number of a row.
    ///
    /// # Errors
    /// As [`Artifact::table`] and [`Table::stream`].
    pub fn open(artifact: &Artifact, episode: fn(&R) -> u32) -> Result<Self, ArtifactError> {
        Self::of(&artifact.table(R::table())?, episode)
    }
}

impl<C: Cell> ByEpisode<C> {
    /// Opens some of the columns of a table. `episode` returns the episode number of a row.
    ///
    /// # Errors
    /// As [`Table::stream`].
    pub fn of(table: &Table, episode: fn(&C) -> u32) -> Result<Self, ArtifactError> {
        let rows = table.stream()?.peekable();
        Ok(Self { rows, episode })
    }
}

impl<C: Cell> Iterator for ByEpisode<C> {
    type Item = Result<(u32, Vec<C>), ArtifactError>;

    fn next(&mut self) -> Option<Self::Item> {
        let first = match self.rows.next()? {
            Ok(row) => row,
            Err(error) => return Some(Err(error)),
        };
        let number = (self.episode)(&first);
        let mut own = vec![first];
        let same = |row: &Result<C, _>| row.as_ref().is_ok_and(|row| (self.episode)(row) == number);
        own.extend(std::iter::from_fn(|| self.rows.next_if(same)).flatten());
        Some(Ok((number, own)))
    }
}

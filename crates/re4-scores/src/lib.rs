//! Quality scores of demonstrations. Every score is one function of a [`Motion`] or of all demonstrations; docs/concepts/scores.md
//! gives the formulas and their sources. The crate does no input or output.
//!
//! [`Sketch::of`] reduces a demonstration to the scores that depend on it alone and to a few kilobytes for the scores that compare
//! it with the others, so demonstrations are read once and not held in memory. [`score`] makes the rows of the table.
//! [`Others`] and [`rank`] do the same if sketches are read one at a time.

mod envelope;
mod information;
mod motion;
mod novelty;
mod ranks;
mod sketch;
mod smoothness;
mod tables;

pub use envelope::envelope_distance;
pub use information::{Chunk, NEIGHBOURS, REFERENCE, information, reference};
pub use motion::{Motion, chunks, idle_share, path_efficiency, regrasps};
pub use novelty::{Descriptor, describe, nearest};
pub use ranks::{correlation, ranks};
pub use sketch::{Others, Sketch, rank, score};
pub use smoothness::{log_dimensionless_jerk, spectral_arc_length};
pub use tables::{Better, KINDS, Kind, PathRow, Ranks, ReferenceRow, ScoreRow, Scores, SketchRow};

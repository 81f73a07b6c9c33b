//! SQL over the tables of any artifacts.
//!
//! [`Sources`] opens artifacts: folders, folders of artifacts, patterns. Every table of theirs is a table of SQL under its declared
//! name. Tables of the same name in several artifacts are concatenated, and two columns say where a row comes from (see
//! [`ARTIFACT`] and [`DATASET`]). [`Sources::query`] plans a `SELECT` statement and [`Answer`] runs it.
//!
//! The engine is polars. It reads the Parquet files lazily and in parts: only the columns that a query needs. Only joins and sorts hold
//! their rows in memory. The program verifies the hash of a file before the engine decodes it.
//!
//! Rows have a defined order (see [`Sources::query`]). Only the last digits of sums and means of floats can differ between runs, because
//! the engine adds floats in the order in which its threads finish.

mod about;
mod answer;
mod faults;
mod format;
mod sources;
mod statement;
mod tables;

use std::num::NonZeroUsize;

pub use answer::{Answer, OutputColumn};
pub use format::{Preview, write_csv, write_json};
pub use sources::{ARTIFACT, DATASET, Sources};

/// Sets the number of threads of the engine. It has no effect after the first query of the process.
pub fn limit_threads(threads: NonZeroUsize) {
    // The engine reads its settings from the environment when it is first used; it has no other interface for them.
    #[expect(
        unsafe_code,
        reason = "called before the program starts threads, so that nothing reads the environment at the same time"
    )]
    unsafe {
        std::env::set_var("POLARS_MAX_THREADS", threads.to_string());
    }
    // An error means that the pool is already in use, with its own number of threads.
    let _ = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.get())
        .build_global();
}

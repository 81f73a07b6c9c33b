//! Tests on datasets that other programs wrote. They run if the folder in `RE4_DATA`, or `../shared/data` beside the repository, has the
//! samples in `lerobot/`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests may fail and print like tests"
)]

#[allow(clippy::too_many_lines, reason = "lists of cases")]
mod mutations;
mod random;
mod samples;
mod support;
mod written;

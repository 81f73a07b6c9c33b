//! Tests on datasets that other programs wrote. They run if the folder in `RE4_DATA`, or `../shared/data` beside the repository, has the
//! samples in `lerobot/`.

#![expect(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a failed assumption of a test is a panic"
)]

mod mutations;
mod random;
mod samples;
mod support;

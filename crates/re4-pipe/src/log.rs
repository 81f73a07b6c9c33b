//! What the program does, for those who ask: `-v`, `-vv`, or the variable `RUST_LOG`. On standard error, and quiet by default.

use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::time::uptime;
use tracing_subscriber::prelude::*;

/// Crates of this workspace.
const OWN: &str = "re4_";

/// Begins to log. `RUST_LOG`, as in `re4_stages=debug`, goes before the count of `-v`: 1 says what is read, found and made, 2 or
/// more also of what.
pub(crate) fn start(verbose: u8) {
    let asked = std::env::var("RUST_LOG").ok().filter(|text| !text.is_empty());
    let targets = match (asked.and_then(|text| text.parse().ok()), verbose) {
        (Some(targets), _) => targets,
        (None, 0) => return,
        (None, 1) => Targets::new().with_target(OWN, Level::INFO),
        (None, _) => Targets::new().with_target(OWN, Level::DEBUG),
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_timer(uptime())
        .with_ansi(false)
        // A closed standard error is no reason to stop the work.
        .log_internal_errors(false)
        .with_writer(std::io::stderr);
    // The program has one subscriber, so nobody was before this one.
    let _ = tracing_subscriber::registry().with(targets).with(lines).try_init();
}

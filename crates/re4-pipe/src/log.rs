//! Logging to standard error with `-v`, `-vv` or the environment variable `RUST_LOG`. By default nothing is logged.

use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::time::uptime;
use tracing_subscriber::prelude::*;

/// Prefix of the names of this workspace's crates.
const OWN: &str = "re4_";

/// Starts logging. `RUST_LOG`, for instance `re4_stages=debug`, has priority over the number of `-v`: with one, the level is INFO,
/// with more it is DEBUG.
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
        // A closed standard error does not stop the command.
        .log_internal_errors(false)
        .with_writer(std::io::stderr);
    // Fails only if a subscriber is already set, and the program sets no other.
    let _ = tracing_subscriber::registry().with(targets).with(lines).try_init();
}

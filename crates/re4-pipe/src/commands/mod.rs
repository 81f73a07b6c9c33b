//! The subcommands. Those that run stages share the file `run.rs`, except `audit`.

pub(crate) mod audit;
pub(crate) mod compare;
pub(crate) mod curate;
pub(crate) mod doctor;
pub(crate) mod export;
pub(crate) mod fetch;
pub(crate) mod influence;
pub(crate) mod inspect;
pub(crate) mod plan;
#[cfg(feature = "query")]
pub(crate) mod query;
pub(crate) mod report;
pub(crate) mod run;
pub(crate) mod schemas;
pub(crate) mod suite;
pub(crate) mod verify;
pub(crate) mod video;

/// The result of a command that ended without an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Success.
    Done,
    /// A check that the user requested failed.
    GateFailed,
}

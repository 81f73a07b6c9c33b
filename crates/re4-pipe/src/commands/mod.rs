//! The subcommands: one file each, or one for those that run stages.

pub(crate) mod audit;
pub(crate) mod doctor;
pub(crate) mod fetch;
pub(crate) mod inspect;
pub(crate) mod report;
pub(crate) mod run;
pub(crate) mod schemas;
pub(crate) mod verify;
pub(crate) mod video;

/// How a command ended, unless in an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done.
    Done,
    /// What was to be checked did not hold.
    GateFailed,
}

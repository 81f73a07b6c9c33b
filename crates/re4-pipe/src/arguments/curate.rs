//! The words of `curate`.

use clap::ValueEnum;
use re4_influence::{Aim, By};

/// What `curate` ranks demonstrations by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ByArgument {
    /// The results of the episodes that follow a demonstration.
    Influence,
    /// The findings of the audit.
    Audit,
    /// Scores of the demonstrations, such as their duration.
    Scores,
    /// All of these.
    Combined,
}

impl ByArgument {
    pub(crate) fn by(self) -> By {
        match self {
            Self::Influence => By::Influence,
            Self::Audit => By::Audit,
            Self::Scores => By::Scores,
            Self::Combined => By::Combined,
        }
    }
}

/// What `curate` aims at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum AimArgument {
    /// Drop demonstrations as long as that makes episodes better.
    Harmful,
    /// Drop only demonstrations on which no episode depends.
    Redundant,
    /// Also drop demonstrations as long as episodes stay as good, up to a standard error.
    Smallest,
}

impl AimArgument {
    pub(crate) fn aim(self) -> Aim {
        match self {
            Self::Harmful => Aim::Harmful,
            Self::Redundant => Aim::Redundant,
            Self::Smallest => Aim::Smallest,
        }
    }
}

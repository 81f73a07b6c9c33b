//! The kinds of policies that a pipeline file can name, as `[policy] kind = "..."`.
//!
//! A new one is a module beside `re4`, with settings, factories, a decision record and its table, and a line in each domain
//! below that it runs in. Everything else, from the pipeline file to its schema, its tables and the driver, follows from that.

mod nearest;
mod re4;

use std::collections::BTreeSet;
use std::error::Error;
use std::path::PathBuf;

use re4_artifact::{Artifact, ArtifactError, Row as _, Stage, TableSpec};
use re4_episode::DemoNames;
use re4_fault::Remedy;
use re4_geometry::spatial::Symmetry;
use re4_index::{IndexError, Normalization};
use re4_rollout::{Opened, Plane, Recorded, Space};
use schemars::{Schema, schema_for};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::LookupError;
use crate::config::PolicyConfig;
use crate::spatial::SpatialPolicyConfig;

pub use nearest::{NearestRow, PlaneNearest, SpaceNearest};
pub use re4::{PlaneRe4Row, SpaceRe4Row};

/// Declares an enum of kinds: of each the settings, its name in pipeline files, its defaults, and the row of its own table.
macro_rules! kinds {
    (
        $(#[doc = $about:literal])*
        $name:ident in $domain:ty {
            $($(#[doc = $doc:literal])* $kind:ident($settings:ty) = $word:literal, $defaults:expr, $row:ty;)*
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, PartialEq, Serialize)]
        #[serde(tag = "kind")]
        pub enum $name {
            $($(#[doc = $doc])* #[serde(rename = $word)] $kind($settings),)*
        }

        impl Kinds for $name {
            type Domain = $domain;

            const NAMES: &'static [&'static str] = &[$($word),*];

            fn defaults(kind: &str) -> Option<Self> {
                match kind {
                    $($word => Some(Self::$kind($defaults)),)*
                    _ => None,
                }
            }

            fn read<'de, S: Deserializer<'de>>(kind: &str, settings: S) -> Result<Self, S::Error> {
                match kind {
                    $($word => <$settings>::deserialize(settings).map(Self::$kind),)*
                    _ => Err(S::Error::custom(format!("unknown policy {kind:?}"))),
                }
            }

            fn schema(kind: &str) -> Option<Schema> {
                match kind {
                    $($word => Some(schema_for!($settings)),)*
                    _ => None,
                }
            }

            fn tables() -> Vec<&'static TableSpec> {
                vec![$(<$row>::table()),*]
            }

            fn kind(&self) -> &'static str {
                match self {
                    $(Self::$kind(_) => $word,)*
                }
            }

            fn settings(&self) -> &dyn Settings<$domain> {
                match self {
                    $(Self::$kind(settings) => settings,)*
                }
            }
        }
    };
}

kinds! {
    /// A policy of Push-T with its settings.
    PlanePolicy in Plane {
        /// The best found.
        Re4(PolicyConfig) = "re4", PolicyConfig::re4(), re4::PlaneRe4Row;
        /// The paper's words and constants.
        Paper(PolicyConfig) = "paper", PolicyConfig::paper(), re4::PlaneRe4Row;
        /// The paper's without Reframe and Replan.
        Re2(PolicyConfig) = "re2", PolicyConfig::re2(), re4::PlaneRe4Row;
        /// The actions of the nearest frame.
        Nearest(PlaneNearest) = "nearest", PlaneNearest::default(), NearestRow;
    }
}

kinds! {
    /// A policy of robosuite's tasks with its settings.
    SpacePolicy in Space {
        /// The paper's with what was found to help.
        Re4(SpatialPolicyConfig) = "re4", SpatialPolicyConfig::re4(), re4::SpaceRe4Row;
        /// The paper's words and constants.
        Paper(SpatialPolicyConfig) = "paper", SpatialPolicyConfig::paper(), re4::SpaceRe4Row;
        /// The paper's without Reframe and Replan.
        Re2(SpatialPolicyConfig) = "re2", SpatialPolicyConfig::re2(), re4::SpaceRe4Row;
        /// The actions of the nearest frame.
        Nearest(SpaceNearest) = "nearest", SpaceNearest::default(), NearestRow;
    }
}

/// The tables of all policies, each once.
pub fn tables() -> Vec<&'static TableSpec> {
    let mut seen = BTreeSet::new();
    let mut tables: Vec<_> = PlanePolicy::tables().into_iter().chain(SpacePolicy::tables()).collect();
    tables.retain(|table| seen.insert((table.name, table.domain)));
    tables
}

/// Settings of a policy in a domain.
pub trait Settings<D: Recorded> {
    /// Stages whose artifacts it opens, beside that of the demonstrations.
    fn inputs(&self) -> &'static [Stage] {
        &[Stage::Index]
    }

    /// Looks every setting over. `images` says whether the object's pose is estimated from images.
    ///
    /// # Errors
    /// The first that makes no sense.
    fn check(&self, images: bool) -> Result<(), SettingError>;

    /// Opens what the policy knows.
    ///
    /// # Errors
    /// When an artifact cannot be read, or holds nothing that the policy can use.
    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<D>>, OpenError>;
}

/// The kinds of policies of a domain.
pub trait Kinds: Serialize + Sized {
    /// The domain.
    type Domain: Recorded;

    /// Their names.
    const NAMES: &'static [&'static str];

    /// The policy of a kind with its default settings; none where there is no such kind.
    fn defaults(kind: &str) -> Option<Self>;

    /// The policy of a kind with these settings.
    ///
    /// # Errors
    /// When they are not those of the kind, or there is no such kind.
    fn read<'de, S: Deserializer<'de>>(kind: &str, settings: S) -> Result<Self, S::Error>;

    /// JSON Schema of the settings of a kind.
    fn schema(kind: &str) -> Option<Schema>;

    /// The table of each kind's decisions.
    fn tables() -> Vec<&'static TableSpec>;

    /// The name of its kind.
    fn kind(&self) -> &'static str;

    /// Its settings.
    fn settings(&self) -> &dyn Settings<Self::Domain>;
}

/// A setting that makes no sense.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Remedy)]
#[error("{setting} is {value}")]
#[remedy("{fix}")]
pub struct SettingError {
    /// Its name in the pipeline file, below the policy's table.
    pub setting: &'static str,
    /// What was given.
    pub value: String,
    /// What would do.
    pub fix: &'static str,
}

impl SettingError {
    /// Refuses a setting unless it is sound.
    ///
    /// # Errors
    /// When it is not.
    #[expect(clippy::needless_pass_by_value, reason = "callers have numbers")]
    pub fn unless(sound: bool, setting: &'static str, value: impl ToString, fix: &'static str) -> Result<(), Self> {
        if sound {
            return Ok(());
        }
        Err(Self {
            setting,
            value: value.to_string(),
            fix,
        })
    }
}

/// What policies are opened with.
pub struct Inputs<'a> {
    /// The artifacts of the stages that they asked for.
    pub artifacts: &'a [(Stage, &'a Artifact)],
    /// What the demonstrations are called.
    pub names: DemoNames,
    /// Turns after which the object looks the same, in its own frame.
    pub symmetry: Symmetry,
}

impl Inputs<'_> {
    /// The artifact of a stage.
    ///
    /// # Errors
    /// When it is not there.
    pub fn of(&self, stage: Stage) -> Result<&Artifact, OpenError> {
        let found = self.artifacts.iter().find(|(of, _)| *of == stage);
        found
            .map(|(_, artifact)| *artifact)
            .ok_or(OpenError::Missing { stage: stage.as_str() })
    }
}

/// Why a policy could not be opened.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum OpenError {
    /// An artifact that it needs was not made.
    #[error("cannot open the policy: it needs what stage {stage} makes")]
    #[remedy("report this together with the pipeline file")]
    Missing {
        /// The stage.
        stage: &'static str,
    },
    /// An artifact cannot be read.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Artifact(#[from] ArtifactError),
    /// Normalised coordinates that are of other dimensions.
    #[error(
        "cannot read {}: table scales names other dimensions than {}",
        folder.display(),
        Normalization::DIMENSIONS.join(", ")
    )]
    #[remedy("build it again")]
    Scales {
        /// Folder of the artifact.
        folder: PathBuf,
    },
    /// The frames cannot be searched.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Index(#[from] IndexError),
    /// The demonstrations hold nothing to choose from.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Lookup(#[from] LookupError),
    /// Reasons of the policy's own.
    #[error("{0}")]
    Own(#[from] Box<dyn Error + Send + Sync>),
}

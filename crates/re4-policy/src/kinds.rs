//! The kinds of policies that a pipeline file can select by `[policy] kind = "..."`.
//!
//! To add a policy:
//!
//! 1. Add a module beside `nearest`, which is the smallest complete example. The module defines the settings (a `serde` struct
//!    that implements [`Settings`] for every domain in which the policy runs), the policy with its factory
//!    ([`Policy`](re4_rollout::Policy), [`PolicyFactory`](re4_rollout::PolicyFactory)), and the decision record with its table
//!    ([`Explained`](re4_rollout::Explained)).
//! 2. Add one line to the list of kinds of each of these domains below: [`PlanePolicy`] for Push-T, [`SpacePolicy`] for the
//!    robosuite tasks.
//! 3. Regenerate the schemas with `re4-pipe schemas schemas`.
//!
//! The pipeline parser, the schema of the pipeline file, the list of tables and the rollout driver use these lists, so nothing
//! else needs to change.

mod alt;
mod diffusion;
mod flow;
mod generative;
mod gpi;
mod gpi_tuned;
mod nearest;
mod re4;
mod vinn;

use std::collections::BTreeSet;
use std::error::Error;
use std::path::PathBuf;

use re4_artifact::{Artifact, ArtifactError, Row as _, Stage, TableSpec};
use re4_episode::DemoNames;
use re4_fault::Remedy;
use re4_generative::GenerativeError;
use re4_geometry::spatial::Symmetry;
use re4_index::{IndexError, Normalization};
use re4_rollout::{Opened, Plane, Recorded, Space};
use re4_sim::robosuite::RobosuiteTask;
use schemars::{Schema, schema_for};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::LookupError;
use crate::config::PolicyConfig;
use crate::spatial::SpatialPolicyConfig;

pub use crate::lookup::{ActionFrame, QueryNoiseConfig, SpaceWeights};
pub use alt::{AltRow, PlaneAlt, SpaceAlt};
pub use diffusion::{DiffusionSampler, PlaneDiffusion, SpaceDiffusion};
pub use flow::{PlaneFlow, SpaceFlow};
pub use generative::{Codec, GenerativeRow, PlaneCodec, PolicyCard, SpaceCodec, Training};
pub use gpi::{GpiRow, PlaneGpi, SpaceGpi};
pub use gpi_tuned::{GpiTunedRow, Reach, SpaceGpiTuned, TunedFor};
pub use nearest::{NearestRow, PlaneNearest, SpaceNearest};
pub use re4::{PlaneRe4Row, SpaceRe4Row};
pub use vinn::{PlaneVinn, SpaceVinn, VinnRow};

/// Declares the enum of the kinds of a domain and implements [`Kinds`] for it. An entry lists the variant, the type of its
/// settings, its name in pipeline files, its default settings, and the row type of its table.
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
    /// A policy for Push-T with its settings.
    PlanePolicy in Plane {
        /// RE4 with the best settings found.
        Re4(PolicyConfig) = "re4", PolicyConfig::re4(), re4::PlaneRe4Row;
        /// RE4 as the paper describes it, with the paper's constants.
        Paper(PolicyConfig) = "paper", PolicyConfig::paper(), re4::PlaneRe4Row;
        /// `paper` without Reframe and Replan.
        Re2(PolicyConfig) = "re2", PolicyConfig::re2(), re4::PlaneRe4Row;
        /// Replays the actions of the nearest frame.
        Nearest(PlaneNearest) = "nearest", PlaneNearest::default(), NearestRow;
        /// Diffusion Policy.
        Diffusion(PlaneDiffusion) = "diffusion", PlaneDiffusion::default(), GenerativeRow;
        /// Streaming Flow Policy.
        Flow(PlaneFlow) = "flow", PlaneFlow::default(), GenerativeRow;
        /// Follows a velocity field over the frames of the demonstrations (GPI).
        Gpi(PlaneGpi) = "gpi", PlaneGpi::default(), GpiRow;
        /// Averages the actions of the nearest frames (VINN).
        Vinn(PlaneVinn) = "vinn", PlaneVinn::default(), VinnRow;
        /// Replays the actions of a table entry, with a monitor for unfamiliar states (ALT).
        Alt(PlaneAlt) = "alt", PlaneAlt::default(), AltRow;
    }
}

kinds! {
    /// A policy for the robosuite tasks with its settings.
    SpacePolicy in Space {
        /// RE4 with the additions to the paper that improve it.
        Re4(SpatialPolicyConfig) = "re4", SpatialPolicyConfig::re4(), re4::SpaceRe4Row;
        /// RE4 as the paper describes it, with the paper's constants.
        Paper(SpatialPolicyConfig) = "paper", SpatialPolicyConfig::paper(), re4::SpaceRe4Row;
        /// `paper` without Reframe and Replan.
        Re2(SpatialPolicyConfig) = "re2", SpatialPolicyConfig::re2(), re4::SpaceRe4Row;
        /// Replays the actions of the nearest frame.
        Nearest(SpaceNearest) = "nearest", SpaceNearest::default(), NearestRow;
        /// Diffusion Policy.
        Diffusion(SpaceDiffusion) = "diffusion", SpaceDiffusion::default(), GenerativeRow;
        /// Streaming Flow Policy.
        Flow(SpaceFlow) = "flow", SpaceFlow::default(), GenerativeRow;
        /// Follows a velocity field over the frames of the demonstrations (GPI), as the RE4 paper ports it.
        Gpi(SpaceGpi) = "gpi", SpaceGpi::default(), GpiRow;
        /// GPI as its authors tuned it for Lift, Can and Square.
        GpiTuned(SpaceGpiTuned) = "gpi-tuned", SpaceGpiTuned::default(), GpiTunedRow;
        /// Averages the actions of the nearest frames (VINN).
        Vinn(SpaceVinn) = "vinn", SpaceVinn::default(), VinnRow;
        /// Replays the actions of a table entry, with a monitor for unfamiliar states (ALT).
        Alt(SpaceAlt) = "alt", SpaceAlt::default(), AltRow;
    }
}

/// Returns the decision tables of all policies without duplicates.
pub fn tables() -> Vec<&'static TableSpec> {
    let mut seen = BTreeSet::new();
    let mut tables: Vec<_> = PlanePolicy::tables().into_iter().chain(SpacePolicy::tables()).collect();
    tables.retain(|table| seen.insert((table.name, table.domain)));
    tables
}

/// The settings of a policy, as the table `[policy]` of a pipeline file defines them.
///
/// The settings are checked when the pipeline file is loaded. When the rollout stage runs, [`Settings::open`] loads the data of
/// the policy and creates its factory.
pub trait Settings<D: Recorded> {
    /// Stages whose artifacts the policy opens, in addition to the demonstrations. The runner runs these stages before the
    /// rollout.
    fn inputs(&self) -> &'static [Stage] {
        &[Stage::Index]
    }

    /// What the stage `train` trains for the policy, or `None` if the policy needs no training.
    fn training(&self) -> Option<Training<'_, D>> {
        None
    }

    /// Checks all settings. `images` is true if the object pose is estimated from images.
    ///
    /// # Errors
    /// The first invalid setting.
    fn check(&self, images: bool) -> Result<(), SettingError>;

    /// Loads the data that the policy needs and creates its factory.
    ///
    /// # Errors
    /// If an artifact cannot be read or contains no data that the policy can use.
    fn open(&self, inputs: &Inputs<'_>) -> Result<Box<dyn Opened<D>>, OpenError>;
}

/// The kinds of policies in a domain. The macro `kinds!` implements this trait.
pub trait Kinds: Serialize + Sized {
    /// The domain.
    type Domain: Recorded;

    /// Names of the kinds in pipeline files.
    const NAMES: &'static [&'static str];

    /// Returns the policy of a kind with its default settings, or `None` if the kind does not exist.
    fn defaults(kind: &str) -> Option<Self>;

    /// Deserialises the settings of a kind.
    ///
    /// # Errors
    /// If the settings do not match the kind, or the kind does not exist.
    fn read<'de, S: Deserializer<'de>>(kind: &str, settings: S) -> Result<Self, S::Error>;

    /// Returns the JSON Schema of the settings of a kind, or `None` if the kind does not exist.
    fn schema(kind: &str) -> Option<Schema>;

    /// Returns the decision table of every kind, in the order of [`Self::NAMES`].
    fn tables() -> Vec<&'static TableSpec>;

    /// Returns the name of the kind.
    fn kind(&self) -> &'static str;

    /// Returns the settings.
    fn settings(&self) -> &dyn Settings<Self::Domain>;
}

/// An invalid setting.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Remedy)]
#[error("{setting} is {value}")]
#[remedy("{fix}")]
pub struct SettingError {
    /// Path of the setting in the pipeline file, relative to the table `[policy]`.
    pub setting: &'static str,
    /// The given value.
    pub value: String,
    /// Remedy: the values that are allowed, as an imperative.
    pub fix: &'static str,
}

impl SettingError {
    /// Returns an error unless the setting is valid.
    ///
    /// # Errors
    /// If `valid` is false.
    #[expect(clippy::needless_pass_by_value, reason = "callers have numbers")]
    pub fn unless(valid: bool, setting: &'static str, value: impl ToString, fix: &'static str) -> Result<(), Self> {
        if valid {
            return Ok(());
        }
        Err(Self {
            setting,
            value: value.to_string(),
            fix,
        })
    }
}

/// The inputs of [`Settings::open`].
pub struct Inputs<'a> {
    /// The artifacts of the stages that [`Settings::inputs`] lists.
    pub artifacts: &'a [(Stage, &'a Artifact)],
    /// The artifact `episodes`, with everything that was recorded of the demonstrations.
    pub episodes: &'a Artifact,
    /// The robosuite task, or `None` for Push-T.
    pub task: Option<RobosuiteTask>,
    /// Names of the demonstrations.
    pub names: DemoNames,
    /// Symmetry of the object, in the object frame.
    pub symmetry: Symmetry,
}

impl Inputs<'_> {
    /// Returns the artifact of a stage.
    ///
    /// # Errors
    /// [`OpenError::Missing`] if the artifact was not given.
    pub fn of(&self, stage: Stage) -> Result<&Artifact, OpenError> {
        let found = self.artifacts.iter().find(|(of, _)| *of == stage);
        found
            .map(|(_, artifact)| *artifact)
            .ok_or(OpenError::Missing { stage: stage.as_str() })
    }
}

/// An error from opening a policy.
#[derive(Debug, thiserror::Error, Remedy)]
pub enum OpenError {
    /// An artifact that the policy needs is not among its inputs.
    #[error("cannot open the policy: it needs the artifact of stage {stage}, which was not given")]
    #[remedy("report this error together with the pipeline file")]
    Missing {
        /// Name of the stage.
        stage: &'static str,
    },
    /// An artifact cannot be read.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Artifact(#[from] ArtifactError),
    /// The table of normalisation ranges lists unexpected dimensions.
    #[error(
        "cannot read {}: the dimensions in table scales are not {}",
        folder.display(),
        Normalization::DIMENSIONS.join(", ")
    )]
    #[remedy("build the artifact again")]
    Scales {
        /// Folder of the artifact.
        folder: PathBuf,
    },
    /// The index over the frames cannot be built.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Index(#[from] IndexError),
    /// The demonstrations contain nothing that the policy can use.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Lookup(#[from] LookupError),
    /// The card of a trained policy cannot be read.
    #[error("cannot read {}: {why}", path.display())]
    #[remedy("delete the policy artifact and train again")]
    Card {
        /// The file.
        path: PathBuf,
        /// The reason.
        why: String,
    },
    /// The network cannot be loaded.
    #[error(transparent)]
    #[remedy(_0.remedy())]
    Generative(#[from] GenerativeError),
    /// `gpi-tuned` has no constants for the task.
    #[error("gpi-tuned has no constants for this task")]
    #[remedy("set policy.tuning to lift, can or square to use those of another task, or use the policy gpi")]
    NoTuning,
    /// An error of the policy's own type.
    #[error("{0}")]
    Own(#[from] Box<dyn Error + Send + Sync>),
}

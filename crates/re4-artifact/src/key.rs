//! Stages, keys, and recipes, whose hashes are the keys.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

use crate::canonical::{canonical_compact, canonical_json};
use crate::error::ArtifactError;

/// A stage of the pipeline. Every stage produces one kind of artifact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Reads a raw dataset and produces `episodes`.
    Ingest,
    /// Reads `episodes` and produces `modes`.
    Segment,
    /// Reads `episodes` and `modes` and produces `observations`, from which the audit of many demonstrations derives thresholds.
    Observe,
    /// Reads `episodes`, `modes` and, for many demonstrations, `observations`, and produces `audit`, a table of findings.
    Audit,
    /// Reads `episodes` and `modes` and produces `encoder`, the weights of a pose estimator.
    TrainEncoder,
    /// Reads `episodes` and, if an encoder estimates poses, `modes` and `encoder`, and produces `poses`.
    TrainPose,
    /// Reads `episodes`, `modes` and, in image variants, `poses`, and produces `index`.
    Index,
    /// Reads `episodes` and `index` and produces `policy`, the weights of a learned policy.
    Train,
    /// Reads `episodes` and produces `scenes`.
    Scenes,
    /// Reads `index` and, if the pipeline has them, `encoder` and `scenes`, and produces `rollouts`.
    Rollout,
    /// Replays `episodes` open-loop in the simulator and produces `replays`.
    Replay,
    /// Reads the `rollouts` of the cells of a suite and produces `comparison`.
    Compare,
    /// Reads what rollouts are made from and produces `influence`, the effect of leaving out each demonstration.
    Influence,
    /// Reads what rollouts are made from and `audit`, and produces `curation`, a subset of the demonstrations.
    Curate,
}

impl Stage {
    /// Every stage, in the order in which they run.
    pub const ALL: [Self; 14] = [
        Self::Ingest,
        Self::Segment,
        Self::Observe,
        Self::Audit,
        Self::TrainEncoder,
        Self::TrainPose,
        Self::Index,
        Self::Train,
        Self::Scenes,
        Self::Rollout,
        Self::Replay,
        Self::Compare,
        Self::Influence,
        Self::Curate,
    ];

    /// Name of the stage, as typed on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ingest => "ingest",
            Self::Segment => "segment",
            Self::Observe => "observe",
            Self::Audit => "audit",
            Self::TrainEncoder => "train-encoder",
            Self::TrainPose => "train-pose",
            Self::Index => "index",
            Self::Train => "train",
            Self::Scenes => "scenes",
            Self::Rollout => "rollout",
            Self::Replay => "replay",
            Self::Compare => "compare",
            Self::Influence => "influence",
            Self::Curate => "curate",
        }
    }

    /// Name of the artifact that the stage produces, which is also the name of the folder under the store's root.
    pub fn artifact(self) -> &'static str {
        match self {
            Self::Ingest => "episodes",
            Self::Segment => "modes",
            Self::Observe => "observations",
            Self::Audit => "audit",
            Self::TrainEncoder => "encoder",
            Self::TrainPose => "poses",
            Self::Index => "index",
            Self::Train => "policy",
            Self::Scenes => "scenes",
            Self::Rollout => "rollouts",
            Self::Replay => "replays",
            Self::Compare => "comparison",
            Self::Influence => "influence",
            Self::Curate => "curation",
        }
    }

    /// Returns the stage with this name, as returned by [`Stage::as_str`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|stage| stage.as_str() == name)
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A 256-bit BLAKE3 hash: the key of an artifact, or the hash of its raw source. Displayed as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Key([u8; 32]);

impl Key {
    /// Creates a key from its bytes.
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// The bytes.
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// The first 16 hexadecimal digits, which name the folder of an artifact.
    pub fn short(&self) -> String {
        self.to_string().chars().take(16).collect()
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Key({self})")
    }
}

impl FromStr for Key {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        blake3::Hash::from_hex(text)
            .map(|hash| Self(*hash.as_bytes()))
            .map_err(|_| format!("{text:?} is not a key: a key has 64 hexadecimal digits"))
    }
}

impl From<blake3::Hash> for Key {
    fn from(hash: blake3::Hash) -> Self {
        Self(*hash.as_bytes())
    }
}

impl Serialize for Key {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Key {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?
            .parse()
            .map_err(serde::de::Error::custom)
    }
}

/// The raw data from which an artifact was made.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// BLAKE3 hash of its bytes; part of the key.
    pub hash: Key,
    /// Description of the data (format, sizes, names); recorded in the manifest, not part of the key. It must not contain
    /// absolute paths or times, because equal keys must give equal bytes.
    pub summary: Value,
}

/// Everything that determines the bytes of an artifact. Its hash is the artifact's [`Key`].
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    stage: Stage,
    code_version: u32,
    config: Value,
    inputs: BTreeMap<String, Key>,
    source: Option<Source>,
}

impl Recipe {
    /// Creates the recipe of a stage whose code has this version, without configuration, inputs and source.
    ///
    /// Raise the version whenever the same configuration and inputs give other bytes than before.
    pub fn new(stage: Stage, code_version: u32) -> Self {
        Self {
            stage,
            code_version,
            config: Value::Object(serde_json::Map::new()),
            inputs: BTreeMap::new(),
            source: None,
        }
    }

    /// Sets the configuration, which is stored as canonical JSON: the order of its fields does not matter.
    ///
    /// # Errors
    /// [`ArtifactError::Json`] if the configuration cannot be represented in JSON.
    pub fn config(mut self, config: &impl Serialize) -> Result<Self, ArtifactError> {
        self.config = canonical_json(config)?;
        Ok(self)
    }

    /// Adds an artifact as an input. The names of inputs are part of the key, the order in which they are added is not.
    #[must_use]
    pub fn input(mut self, name: &str, key: &Key) -> Self {
        self.inputs.insert(name.to_owned(), *key);
        self
    }

    /// Sets the raw data by the BLAKE3 hash of its bytes. The summary is recorded in the manifest and is not part of the key.
    #[must_use]
    pub fn source(mut self, hash: &[u8; 32], summary: Value) -> Self {
        self.source = Some(Source {
            hash: Key::from_bytes(*hash),
            summary,
        });
        self
    }

    /// The stage.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// Version of the stage's code.
    pub fn code_version(&self) -> u32 {
        self.code_version
    }

    /// The configuration as canonical JSON.
    pub fn config_json(&self) -> &Value {
        &self.config
    }

    /// Keys of the inputs by name.
    pub fn inputs(&self) -> &BTreeMap<String, Key> {
        &self.inputs
    }

    /// The raw data, if the stage reads any.
    pub fn raw_source(&self) -> Option<&Source> {
        self.source.as_ref()
    }

    /// Computes the key: BLAKE3 over stage, code version, canonical configuration, inputs and source hash.
    pub fn key(&self) -> Key {
        key_of(
            self.stage.as_str(),
            self.code_version,
            &self.config,
            &self.inputs,
            self.source.as_ref().map(|source| &source.hash),
        )
    }
}

/// Hashes the parts of a recipe. Every part is preceded by its length, so that different recipes are different hasher inputs.
pub(crate) fn key_of(
    stage: &str,
    code_version: u32,
    config: &Value,
    inputs: &BTreeMap<String, Key>,
    source: Option<&Key>,
) -> Key {
    let mut hasher = blake3::Hasher::new_derive_key("re4-pipe artifact key 1");
    let mut part = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    part(stage.as_bytes());
    part(&code_version.to_le_bytes());
    part(canonical_compact(config).as_bytes());
    part(&(inputs.len() as u64).to_le_bytes());
    for (name, key) in inputs {
        part(name.as_bytes());
        part(key.as_bytes());
    }
    part(source.map_or(&[][..], |hash| &hash.as_bytes()[..]));
    hasher.finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn recipe() -> Recipe {
        Recipe::new(Stage::Index, 1)
            .config(&json!({"angle": "periodic", "epsilon": 0.1}))
            .unwrap()
            .input("episodes", &Key::from_bytes([1; 32]))
            .input("modes", &Key::from_bytes([2; 32]))
            .source(&[3; 32], json!({"format": "zarr"}))
    }

    #[test]
    fn the_key_depends_neither_on_the_order_of_fields_and_inputs_nor_on_the_summary() {
        let other = Recipe::new(Stage::Index, 1)
            .source(&[3; 32], json!({"format": "zip"}))
            .input("modes", &Key::from_bytes([2; 32]))
            .input("episodes", &Key::from_bytes([1; 32]))
            .config(&json!({"epsilon": 0.1, "angle": "periodic"}))
            .unwrap();
        assert_eq!(recipe().key(), other.key());
    }

    #[test]
    fn the_key_depends_on_every_part() {
        let configured = |epsilon: f64| {
            let config = json!({"angle": "periodic", "epsilon": epsilon});
            recipe().config(&config).unwrap().key()
        };
        assert_eq!(configured(0.1), recipe().key());
        let mut keys = vec![
            recipe().key(),
            Recipe {
                stage: Stage::Rollout,
                ..recipe()
            }
            .key(),
            Recipe {
                code_version: 2,
                ..recipe()
            }
            .key(),
            configured(0.1_f64.next_up()),
            recipe().input("modes", &Key::from_bytes([9; 32])).key(),
            recipe().input("poses", &Key::from_bytes([9; 32])).key(),
            recipe().source(&[4; 32], json!({})).key(),
            Recipe {
                source: None,
                ..recipe()
            }
            .key(),
        ];
        let parts = keys.len();
        keys.sort();
        keys.dedup();
        assert_eq!(keys.len(), parts);
    }

    #[test]
    fn keys_are_stable_between_builds() {
        // A change of this value invalidates every cached artifact. Change the derivation string only on purpose.
        assert_eq!(
            recipe().key().to_string(),
            "3bc88d3901293faf8528297513df187f8e0ccd42cd746b6b96e5cddfad18ec01"
        );
    }

    #[test]
    fn keys_and_stages_are_parsed_from_their_text() {
        let key = recipe().key();
        assert_eq!(key.to_string().parse::<Key>(), Ok(key));
        assert_eq!(key.short().len(), 16);
        assert!(key.to_string().starts_with(&key.short()));
        assert!("12".parse::<Key>().is_err());
        for stage in Stage::ALL {
            assert_eq!(Stage::from_name(stage.as_str()), Some(stage));
        }
    }
}

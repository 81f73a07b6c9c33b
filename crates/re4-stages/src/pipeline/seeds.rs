//! Sets of scene seeds.

use std::borrow::Cow;
use std::str::FromStr;

use anyhow::Result;
use re4_fault::{Remedy as _, bail, fault};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::notes::fault_of;

/// Maximum number of seeds in a run.
const MAX_SEEDS: usize = 10_000_000;

/// Distinct seeds, in the order in which they are written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seeds {
    text: String,
    seeds: Vec<u32>,
}

impl Seeds {
    /// The seeds as they were written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The seeds.
    pub fn as_slice(&self) -> &[u32] {
        &self.seeds
    }
}

impl FromStr for Seeds {
    type Err = anyhow::Error;

    /// The parsers of arguments and of the pipeline file keep only the text of an error, so the text contains the remedy.
    fn from_str(text: &str) -> Result<Self> {
        Self::read(text).map_err(|error| anyhow::Error::msg(fault_of(&error).sentence()))
    }
}

impl Seeds {
    fn read(text: &str) -> Result<Self> {
        let mut seeds = Vec::new();
        for part in text.split(',').map(str::trim) {
            let number = |word: &str| {
                word.trim().parse::<u32>().map_err(|_| {
                    fault!(
                        "seeds {text:?}: {word:?} is not a number from 0 to {}", u32::MAX;
                        "write 500..600, or 1,2,3"
                    )
                })
            };
            match part.split_once("..") {
                Some((from, to)) => {
                    let (from, to) = (number(from)?, number(to)?);
                    if from >= to {
                        bail!(
                            "seeds {text:?}: the range {part} is empty";
                            "its end is exclusive, so write {from}..{}", from.saturating_add(1)
                        );
                    }
                    // Checked before memory is reserved, because a short text can ask for billions of seeds.
                    if (to - from) as usize > MAX_SEEDS.saturating_sub(seeds.len()) {
                        bail!("the seeds up to {part} are more than 10,000,000"; "split them over several runs");
                    }
                    seeds.extend(from..to);
                }
                None => seeds.push(number(part)?),
            }
        }
        let mut sorted = seeds.clone();
        sorted.sort_unstable();
        if let Some((seed, _)) = sorted.iter().zip(sorted.iter().skip(1)).find(|(one, next)| one == next) {
            bail!("seeds {text:?}: seed {seed} occurs twice"; "name each seed once");
        }
        Ok(Self {
            text: text.to_owned(),
            seeds,
        })
    }
}

impl Serialize for Seeds {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text)
    }
}

impl<'de> Deserialize<'de> for Seeds {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = match serde_json::Value::deserialize(deserializer)? {
            serde_json::Value::Array(numbers) => numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(","),
            serde_json::Value::String(text) => text,
            other => other.to_string(),
        };
        text.parse().map_err(serde::de::Error::custom)
    }
}

impl JsonSchema for Seeds {
    fn schema_name() -> Cow<'static, str> {
        "Seeds".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A half-open range such as \"500..600\", several ranges or single seeds joined by commas, or a list of numbers.",
            "anyOf": [
                { "type": "string" },
                { "type": "integer", "minimum": 0 },
                { "type": "array", "items": { "type": "integer", "minimum": 0 } },
            ],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_lists_are_parsed() {
        assert_eq!("500..503".parse::<Seeds>().unwrap().as_slice(), &[500, 501, 502]);
        assert_eq!("7, 1..3".parse::<Seeds>().unwrap().as_slice(), &[7, 1, 2]);
        for bad in ["", "a", "3..3", "5..2", "1,1", "-1", "1..3,2", "1.5"] {
            assert!(bad.parse::<Seeds>().is_err(), "{bad}");
        }
    }

    #[test]
    fn the_total_number_of_seeds_is_bounded() {
        assert!("0..10000000".parse::<Seeds>().is_ok());
        let joined = (0..400).map(|i| format!("{}..{}", i * 10_000_000_u64, (i + 1) * 10_000_000_u64));
        let text = joined.collect::<Vec<_>>().join(",");
        let message = text.parse::<Seeds>().unwrap_err().to_string();
        assert!(
            message.contains("seeds up to 10000000..20000000 are more than 10,000,000"),
            "{message}"
        );
    }
}

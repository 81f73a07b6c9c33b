//! Sets of scene seeds.

use std::borrow::Cow;
use std::str::FromStr;

use anyhow::Result;
use re4_fault::{Remedy as _, bail, fault};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::notes::fault_of;

/// Most seeds of a run.
const MOST: usize = 10_000_000;

/// Seeds in the order in which they are written, each once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seeds {
    text: String,
    seeds: Vec<u32>,
}

impl Seeds {
    /// The seeds.
    pub fn as_slice(&self) -> &[u32] {
        &self.seeds
    }
}

impl FromStr for Seeds {
    type Err = anyhow::Error;

    /// Parsers of arguments and files pass a text on, so the error is the whole sentence.
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
                    // Before memory is reserved: a short text can name all seeds that there are, many times.
                    if (to - from) as usize > MOST.saturating_sub(seeds.len()) {
                        bail!("seeds up to {part} are more than 10,000,000"; "split them over several runs");
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
            "description": "A half-open range such as \"500..600\", several of them or single seeds joined by commas, or a list of numbers.",
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
    fn ranges_lists_and_mixtures() {
        assert_eq!("500..503".parse::<Seeds>().unwrap().as_slice(), &[500, 501, 502]);
        assert_eq!("7, 1..3".parse::<Seeds>().unwrap().as_slice(), &[7, 1, 2]);
        for bad in ["", "a", "3..3", "5..2", "1,1", "-1", "1..3,2", "1.5"] {
            assert!(bad.parse::<Seeds>().is_err(), "{bad}");
        }
    }

    #[test]
    fn ranges_together_are_bounded_too() {
        assert!("0..10000000".parse::<Seeds>().is_ok());
        let joined = (0..400).map(|i| format!("{}..{}", i * 10_000_000_u64, (i + 1) * 10_000_000_u64));
        let text = joined.collect::<Vec<_>>().join(",");
        let said = text.parse::<Seeds>().unwrap_err().to_string();
        assert!(
            said.contains("seeds up to 10000000..20000000 are more than 10,000,000"),
            "{said}"
        );
    }
}
